"""One unit of an evaluation: one scene, planned and judged, here or in another process."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.machine.storage import content_key
from benchmark.planning import Planner
from benchmark.records.row_schema import SampleRow
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.judging import judge, longer_truth, scene_with_map
from benchmark.runs.plan_rows import PlannedScene, PlannerFactory, plan_scene, rows_path, scene_key
from benchmark.surroundings.circumstances import circumstances_of

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True, slots=True)
class Run:
    """What every unit of work needs to know; picklable.

    Attributes:
        directory: Run directory.
        fingerprint: Of the data set.
        split: Name of the split.
        planner: Identity of the planner.
        protocols: Who judges.
        fresh: Plan again even where rows are kept.
    """

    directory: Path
    fingerprint: str
    split: str
    planner: PlannerFacts
    protocols: tuple[str, ...]
    fresh: bool


@dataclass(frozen=True, slots=True)
class SceneResult:
    """Rows of one scene.

    Attributes:
        scene: Its name.
        rows: One for each sample.
        seconds: Planning time, or ``None`` where the plans were kept from before.
    """

    scene: str
    rows: list[SampleRow]
    seconds: float | None


def work_here(run: Run, data: "DataSet", planner: Planner, scene: str) -> SceneResult:
    """Plan a scene, or take the plans that are kept, and judge them.

    Args:
        run: The run.
        data: The data set.
        planner: The planner.
        scene: Scene name.

    Returns:
        The rows.

    Raises:
        InputError: If the data is broken or rows cannot be written.
    """
    key = scene_key(run.fingerprint, run.split, scene, run.planner)
    planned = plan_scene(planner, data, scene, rows_path(run.directory, scene), key, fresh=run.fresh)
    return judged_scene(run, data, scene, planned)


def judged_scene(run: Run, data: "DataSet", scene: str, planned: PlannedScene) -> SceneResult:
    """Judge the plans of a scene; arguments and errors as of `work_here`."""
    judged = judge(
        planned.rows,
        data.truth(scene),
        run.protocols,
        scene=scene_with_map(data, scene),
        around=circumstances_of(data.scene(scene)),
        longer=partial(longer_truth, data, scene),
    )
    return SceneResult(scene, judged, planned.seconds)


_in_this_process: dict[str, tuple["DataSet", Planner]] = {}
"""Data set and planner of a worker process, opened once."""


def work_in_worker(run: Run, reopen: Callable[[], "DataSet"], factory: PlannerFactory, scene: str) -> SceneResult:
    """`work_here` in a worker process, which opens the data set and builds the planner the first time.

    Args:
        run: The run.
        reopen: Opens the data set.
        factory: Builds the planner.
        scene: Scene name.

    Returns:
        The rows.
    """
    key = content_key(run.fingerprint, run.planner.model_dump(mode="json"))
    if key not in _in_this_process:
        _in_this_process[key] = (reopen(), factory())
    return work_here(run, *_in_this_process[key], scene)


def reopen_root(root: Path, version: str, name: str) -> "DataSet":
    """Open a data set in a worker process."""
    # The devkit behind it takes seconds to import.
    from benchmark.datasets.roots import open_data

    return open_data(root, version=version, name=name)
