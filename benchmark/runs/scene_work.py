"""One unit of an evaluation, planned and judged: a scene, or a split for planners whose memory outlives a scene."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.datasets.scene_names import find_shift_us
from benchmark.machine.metering import disable_malloc_trim_for
from benchmark.machine.storage import content_key
from benchmark.planning import ContinuousPlanner, Planner
from benchmark.records.planner_cost import SceneCost
from benchmark.records.row_schema import SampleRow
from benchmark.records.run_schema import PlannerFacts, TruthFacts
from benchmark.runs.judging import judge_plans
from benchmark.runs.plan_rows import PlannedScene, PlannerFactory, plan_scene, read_cached_plan_rows, scene_key
from benchmark.runs.scene_reading import SceneReading

if TYPE_CHECKING:
    from benchmark.datasets.categories import CategoryNames
    from benchmark.datasets.roots import DataSet
    from benchmark.road_map import Handedness


@dataclass(frozen=True, slots=True)
class EvaluationJob:
    """Settings that every unit of work needs; picklable.

    The protocols in ``unjudged``, and perhaps ``pdm``, say nothing of contacts here because the categories are not
    nuScenes' (`benchmark.runs.rescoring`). ``fresh`` plans again even where rows are kept.
    """

    directory: Path
    fingerprint: str
    split: str
    planner: PlannerFacts
    protocols: tuple[str, ...]
    fresh: bool
    unjudged: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SceneResult:
    """Rows of one scene, one for each sample; no cost where the plans were kept from before."""

    scene: str
    rows: list[SampleRow]
    cost: SceneCost | None
    truth: TruthFacts

    @property
    def kept(self) -> bool:
        """Whether its plans were there before."""
        return self.cost is None


def evaluate_scene(
    runs: Sequence[EvaluationJob], data: "DataSet", planners: Sequence[Planner], scene: str
) -> list[SceneResult]:
    """Plan a scene with every planner, or take the plans that are kept, and judge them; the scene is read once."""
    reading, planned = SceneReading(data, scene), []
    for run, planner in zip(runs, planners, strict=True):
        key = scene_key(run.fingerprint, run.split, scene, run.planner)
        planned.append(plan_scene(planner, reading, scene, run.directory, key, fresh=run.fresh))
    return judge_scenes(runs, reading, planned)


def judge_scenes(
    runs: Sequence[EvaluationJob], reading: SceneReading, planned: Sequence[PlannedScene]
) -> list[SceneResult]:
    """Judge the plans of a scene, those of runs with the same protocols together."""
    results: dict[int, SceneResult] = {}
    for protocols in dict.fromkeys(run.protocols for run in runs):
        places_together = [place for place, run in enumerate(runs) if run.protocols == protocols]
        unjudged = runs[places_together[0]].unjudged
        rows_of = judge_plans([planned[place].rows for place in places_together], reading, protocols, unjudged)
        results |= {
            place: SceneResult(reading.name, rows, planned[place].cost, reading.truth_facts)
            for place, rows in zip(places_together, rows_of)
        }
    return [results[place] for place in range(len(runs))]


def judge_scene(run: EvaluationJob, reading: SceneReading, planned: PlannedScene) -> SceneResult:
    """Judge the plans of a scene."""
    return judge_scenes([run], reading, [planned])[0]


_in_this_process: dict[str, tuple["DataSet", tuple[Planner, ...]]] = {}
"""Data set and planners of a worker process, opened once."""


def evaluate_scene_in_worker(
    runs: Sequence[EvaluationJob], reopen: Callable[[], "DataSet"], factories: Sequence[PlannerFactory], scene: str
) -> list[SceneResult]:
    """`evaluate_scene` in a worker process, which opens the data set and builds the planners the first time."""
    key = content_key([(run.fingerprint, run.planner.model_dump(mode="json")) for run in runs])
    if key not in _in_this_process:
        disable_malloc_trim_for(*(run.planner.weights_sha256 for run in runs))
        _in_this_process[key] = (reopen(), tuple(factory() for factory in factories))
    return evaluate_scene(runs, *_in_this_process[key], scene)


def make_reopener(data: "DataSet") -> Callable[[], "DataSet"]:
    """Opener of a data set in a worker process."""
    return partial(_reopen, data.root, data.version, data.name, data.categories, data.driving_side)


def _reopen(root: Path, version: str, name: str, categories: "CategoryNames", side: "Handedness | None") -> "DataSet":
    # The devkit behind it takes seconds to import.
    from benchmark.datasets.roots import open_data

    return open_data(root, version=version, name=name, categories=dict(categories)).with_driving_side(side)


def sort_as_published(data: "DataSet", scenes: Sequence[str]) -> tuple[str, ...]:
    """The order in which official code evaluates scenes: that of their samples' times.

    Scenes that were made from one recording share its times, before the writer moves them apart; official code would
    mix their samples, and the authors of Adv-nuSc have it sort by the scene's token first.
    """
    spans, made = {}, data.provenance()
    for name in scenes:
        scene = data.scene(name)
        recorded_us = scene.timestamps_us - find_shift_us(made, name)
        spans[name] = int(recorded_us[0]), int(recorded_us[-1]), scene.token
    by_time = sorted(scenes, key=lambda name: (spans[name], name))
    are_apart = all(spans[earlier][1] <= spans[following][0] for earlier, following in pairwise(by_time))
    return tuple(by_time) if are_apart else tuple(sorted(scenes, key=lambda name: (spans[name][2], name)))


def evaluate_split_in_order(
    run: EvaluationJob, data: "DataSet", planner: ContinuousPlanner, scenes: Sequence[str]
) -> Iterator[SceneResult]:
    """Plan and judge all scenes of a split in the published order, with the memory that the one before left.

    Where plans of any scene are not kept, all are made again, because it is not known what was remembered.
    """
    order = sort_as_published(data, scenes)
    keys = {
        name: content_key(scene_key(run.fingerprint, run.split, name, run.planner), "after", list(order[:place]))
        for place, name in enumerate(order)
    }
    cached_rows = {
        name: None if run.fresh else read_cached_plan_rows(run.directory, name, keys[name]) for name in order
    }
    all_cached = all(rows is not None for rows in cached_rows.values())
    if not all_cached:
        planner.begin_run()
    for name in order:
        rows = cached_rows[name]
        if all_cached and rows is not None:
            planned = PlannedScene(rows, None)
        else:
            planned = plan_scene(planner, data, name, run.directory, keys[name], fresh=True)
        yield judge_scene(run, SceneReading(data, name), planned)
