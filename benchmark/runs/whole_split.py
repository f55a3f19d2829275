"""A split as one unit of work, for planners whose memory outlives a change of scene (docs/models.md)."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

from benchmark.machine.storage import content_key
from benchmark.planning import ContinuousPlanner
from benchmark.runs.plan_rows import PlannedScene, kept_rows, plan_scene, scene_key
from benchmark.runs.reading import SceneReading
from benchmark.runs.scene_work import Run, SceneResult, judged_scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


def published_order(data: "DataSet", scenes: Sequence[str]) -> tuple[str, ...]:
    """The order in which official code evaluates scenes: that of their samples' times.

    Scenes that were made from one recording share its times; official code would mix their samples, and the authors of
    Adv-nuSc have it sort by the scene's token first.
    """
    spans = {}
    for name in scenes:
        scene = data.scene(name)
        spans[name] = int(scene.timestamps_us[0]), int(scene.timestamps_us[-1]), scene.token
    by_time = sorted(scenes, key=lambda name: (spans[name], name))
    apart = all(spans[one][1] <= spans[following][0] for one, following in pairwise(by_time))
    return tuple(by_time) if apart else tuple(sorted(scenes, key=lambda name: (spans[name][2], name)))


def work_through(run: Run, data: "DataSet", planner: ContinuousPlanner, scenes: Sequence[str]) -> Iterator[SceneResult]:
    """Plan and judge all scenes of a split in the published order, with the memory that the one before left.

    Plans are taken from before where those of all scenes are kept; where any is not, all are made again, because it is
    not known what was remembered.
    """
    order = published_order(data, scenes)
    keys = {
        name: content_key(scene_key(run.fingerprint, run.split, name, run.planner), "after", list(order[:place]))
        for place, name in enumerate(order)
    }
    kept = {name: None if run.fresh else kept_rows(run.directory, name, keys[name]) for name in order}
    whole = all(rows is not None for rows in kept.values())
    if not whole:
        planner.begin_run()
    for name in order:
        rows = kept[name]
        if whole and rows is not None:
            planned = PlannedScene(rows, None)
        else:
            planned = plan_scene(planner, data, name, run.directory, keys[name], fresh=True)
        yield judged_scene(run, SceneReading(data, name), planned)
