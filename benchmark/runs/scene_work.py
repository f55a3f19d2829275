"""One unit of an evaluation: one scene, planned and judged, here or in another process."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.machine.pages import keep_pages_of
from benchmark.machine.storage import content_key
from benchmark.planning import Planner
from benchmark.records.planner_cost import SceneCost
from benchmark.records.row_schema import SampleRow
from benchmark.records.run_schema import PlannerFacts, TruthFacts
from benchmark.runs.judging import judge_plans
from benchmark.runs.plan_rows import PlannedScene, PlannerFactory, plan_scene, scene_key
from benchmark.runs.reading import SceneReading

if TYPE_CHECKING:
    from benchmark.datasets.categories import CategoryNames
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True, slots=True)
class Run:
    """Settings that every unit of work needs; picklable.

    Attributes:
        fresh: Plan again even where rows are kept.
        unjudged: Those of them, and ``pdm``, that say nothing of contacts here because the categories are not
            nuScenes' (`benchmark.runs.vocabulary`).
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


def work_here(runs: Sequence[Run], data: "DataSet", planners: Sequence[Planner], scene: str) -> list[SceneResult]:
    """Plan a scene with every planner, or take the plans that are kept, and judge them; the scene is read once."""
    reading, planned = SceneReading(data, scene), []
    for run, planner in zip(runs, planners, strict=True):
        key = scene_key(run.fingerprint, run.split, scene, run.planner)
        planned.append(plan_scene(planner, reading, scene, run.directory, key, fresh=run.fresh))
    return judged_scenes(runs, reading, planned)


def judged_scenes(runs: Sequence[Run], reading: SceneReading, planned: Sequence[PlannedScene]) -> list[SceneResult]:
    """Judge the plans of a scene, those of runs with the same protocols together."""
    found: dict[int, SceneResult] = {}
    for protocols in dict.fromkeys(run.protocols for run in runs):
        those = [place for place, run in enumerate(runs) if run.protocols == protocols]
        unjudged = runs[those[0]].unjudged
        rows_of = judge_plans([planned[place].rows for place in those], reading, protocols, unjudged)
        found |= {
            place: SceneResult(reading.name, rows, planned[place].cost, reading.truth_facts)
            for place, rows in zip(those, rows_of)
        }
    return [found[place] for place in range(len(runs))]


def judged_scene(run: Run, reading: SceneReading, planned: PlannedScene) -> SceneResult:
    """Judge the plans of a scene."""
    return judged_scenes([run], reading, [planned])[0]


_in_this_process: dict[str, tuple["DataSet", tuple[Planner, ...]]] = {}
"""Data set and planners of a worker process, opened once."""


def work_in_worker(
    runs: Sequence[Run], reopen: Callable[[], "DataSet"], factories: Sequence[PlannerFactory], scene: str
) -> list[SceneResult]:
    """`work_here` in a worker process, which opens the data set and builds the planners the first time."""
    key = content_key([(run.fingerprint, run.planner.model_dump(mode="json")) for run in runs])
    if key not in _in_this_process:
        keep_pages_of(*(run.planner.weights_sha256 for run in runs))
        _in_this_process[key] = (reopen(), tuple(factory() for factory in factories))
    return work_here(runs, *_in_this_process[key], scene)


def reopening(data: "DataSet") -> Callable[[], "DataSet"]:
    """Opener of a data set in a worker process."""
    return partial(_reopened, data.root, data.version, data.name, data.categories)


def _reopened(root: Path, version: str, name: str, categories: "CategoryNames") -> "DataSet":
    # The devkit behind it takes seconds to import.
    from benchmark.datasets.roots import open_data

    return open_data(root, version=version, name=name, categories=dict(categories))
