"""Units of driving, one scene and one run each: driven and scored, here or in another process, alone or side by side.

Each is kept under a content key, in a file of its own that is written last: finished units are read. A kept drive that
was scored by earlier definitions is driven again by its stored plans, without its planner. Reference drivers drive each
encounter once for all planners, and are kept beside them.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final

from benchmark.closed_loop.adversary import AdversaryTrack
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import Episode, EpisodeSpec, run_episode, run_episodes
from benchmark.closed_loop.planner_calls import FailureReason
from benchmark.closed_loop.reference_drivers import simulate_reference_drivers
from benchmark.closed_loop.scoring import VERSION, score_episode
from benchmark.closed_loop.simulation_state import RecordedCan
from benchmark.datasets.steps import require_two_hz
from benchmark.errors import InputError
from benchmark.interactions.reaction import Driver
from benchmark.machine.metering import Meter, disable_malloc_trim_for
from benchmark.machine.storage import content_key, content_seed
from benchmark.planning import Planner, SupervisedPlanner
from benchmark.records.drive_schema import EpisodeRow, LadderOutcome
from benchmark.records.planner_cost import SceneCost
from benchmark.records.search_trace import read_search_trace, write_search_trace
from benchmark.runs.code_identity import code_sha256
from benchmark.runs.drive_rows import build_episode_row, build_search_trace, compare_drive
from benchmark.runs.drive_settings import CachedEpisode, ClosedLoopJob, EpisodeTask, EpisodeUnit
from benchmark.runs.plan_rows import (
    end_session_after,
    hash_sandboxed_code,
    measure_cost,
    run_with_restarts,
    seed_everything,
)
from benchmark.runs.redriving import read_recorded_can, redrive_and_score, repeat_search
from benchmark.runs.units import ResultStore
from benchmark.scene import Scene
from benchmark.untrusted.plan_plausibility import ComparedPlans

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

FOLDER: Final = "ladder"
"""Beside the records of one world."""
_LOOP: Final = "benchmark.closed_loop.reference_drivers:simulate_reference_drivers"


def run_reference_drivers(data: "DataSet", job: ClosedLoopJob, unit: EpisodeUnit) -> dict[str, LadderOutcome]:
    """Rows of reference drivers in an encounter, by name."""
    store: ResultStore[dict[str, LadderOutcome]] = ResultStore(job.directory.parent / FOLDER, dict[str, LadderOutcome])
    measured = job.measured.model_dump(mode="json", exclude={"sensor", "sensor_facts"})
    code = code_sha256(type(job.maker), made_by=_LOOP)
    key = content_key("ladder", job.fingerprint, unit.scene, unit.run, measured, list(job.ladder), code)
    rows = None if job.fresh else store.get(key, unit.name)
    if rows is None:
        if not isinstance(job.maker, DefaultBackend):
            raise InputError(f"reference drivers run only in the default engine, not in {job.measured.engine}")
        scene = data.scene(unit.scene)
        outcomes = simulate_reference_drivers(
            scene, job.maker.course(scene, unit.run), [Driver(name) for name in job.ladder]
        )
        rows = {driver.value: outcome for driver, outcome in outcomes.items()}
        store.put(key, rows, unit.name)
    return rows


_TRIED_AGAIN: Final = (FailureReason.TIMEOUT.value, FailureReason.DIED.value)
"""How long a plan takes, and how much memory there is for it, is the machine's matter: the same command tries again."""


@dataclass(frozen=True, slots=True)
class EpisodeResult:
    """Result of a unit; ``compared`` are its plans made where the ego was still where it was recorded.

    ``seconds`` is with the drives beside it. It and ``cost`` are ``None`` where the drive was kept from before.
    """

    unit: EpisodeUnit
    row: EpisodeRow
    seconds: float | None
    cost: SceneCost | None
    compared: ComparedPlans

    @property
    def kept(self) -> bool:
        """Whether it was driven before."""
        return self.seconds is None


def drive_tasks(data: "DataSet", planners: "PlannerPool", tasks: Sequence[EpisodeTask]) -> list[EpisodeResult]:
    """Drive units side by side (several only of planners that draw nothing), or take the drives that are kept.

    Broken data and drives that cannot be written are raised when the other units are kept.
    """
    results_by_place: dict[int, EpisodeResult] = {}
    left: dict[int, str] = {}
    for place, task in enumerate(tasks):
        job, unit = task
        cached = job.kept(unit)
        if cached is None:
            left[place] = job.key(unit)
            continue
        row, compared = cached.row, ComparedPlans.from_lists(cached.plan, cached.recorded)
        if cached.scoring != VERSION:
            scene = data.scene(unit.scene)
            row = redrive_and_score(job.maker, scene, data, row)
            compared = _cache_episode(task, scene, row, cached.loaded)
        _cache_search_trace(data, job, row)
        results_by_place[place] = EpisodeResult(unit, row, None, None, compared)
    started = time.perf_counter()
    driven = _drive_missing(data, planners, {place: tasks[place] for place in left}, [*left.values()]) if left else ()
    for place, scene, row, track, planner, meter in driven:
        job, unit = tasks[place]
        if job.keep_considered and track is not None:
            write_search_trace(job.directory, row, build_search_trace(track))
        lost = row.failure is not None and row.failure.reason in _TRIED_AGAIN
        compared = (
            compare_drive(scene, row)
            if lost
            else _cache_episode(tasks[place], scene, row, hash_sandboxed_code(planner))
        )
        seconds = time.perf_counter() - started
        results_by_place[place] = EpisodeResult(unit, row, seconds, measure_cost(planner, meter, seconds), compared)
    results = [results_by_place[place] for place in range(len(tasks))]
    return [add_reference_drivers(data, task, result) for task, result in zip(tasks, results, strict=True)]


def _cache_episode(task: EpisodeTask, scene: Scene, row: EpisodeRow, loaded: dict[str, str]) -> ComparedPlans:
    """Keep a drive; returns its plans beside what was recorded."""
    compared = compare_drive(scene, row)
    episode = CachedEpisode(row, VERSION, compared.plan.tolist(), compared.recorded.tolist(), loaded)
    task.job.store.put(task.job.key(task.unit), episode, task.unit.name)
    return compared


def _cache_search_trace(data: "DataSet", job: ClosedLoopJob, row: EpisodeRow) -> None:
    """Search once more in a kept drive whose adversary's candidates are lost."""
    if job.keep_considered and row.adversary is not None and read_search_trace(job.directory, row) is None:
        track = repeat_search(job.maker, data.scene(row.scene), data, row)
        write_search_trace(job.directory, row, build_search_trace(track))


def collect_costs(job: ClosedLoopJob, results: Sequence[EpisodeResult], workers: int) -> dict[str, SceneCost | None]:
    """Cost of the planner in each drive of a job, by the name of the drive's file; ``None`` of drives kept from before.

    ``workers`` processes drove at the same time.
    """
    common_fields = {"workers": workers}
    return {
        job.store.path(result.unit.name).stem: result.cost and result.cost.model_copy(update=common_fields)
        for result in results
    }


def add_reference_drivers(data: "DataSet", task: EpisodeTask, result: EpisodeResult) -> EpisodeResult:
    """The same with what came of reference drivers in the same encounter, found on disk or driven once."""
    job, unit = task
    if not job.ladder:
        return result
    row = result.row.model_copy(update={"ladder": run_reference_drivers(data, job, unit)})
    return replace(result, row=row)


class PlannerPool:
    """Planners of a process: one for each drive that is under way, built when it is wanted."""

    def __init__(self, one: Planner | None = None) -> None:
        self._one = one
        self._built: dict[str, list[Planner]] = {}

    def of(self, jobs: Sequence[ClosedLoopJob]) -> list[Planner]:
        """A planner for each job, no two the same object; one given object serves one job alone."""
        if self._one is not None:
            if len(jobs) != 1:
                raise ValueError("one planner drives one scene at a time")
            return [self._one]
        taken_counts: Counter[str] = Counter()
        planners = []
        for job in jobs:
            assert job.factory is not None
            key = content_key(job.fingerprint, job.planner.model_dump(mode="json"))
            built_planners = self._built.setdefault(key, [])
            if len(built_planners) == taken_counts[key]:
                disable_malloc_trim_for(job.planner.weights_sha256)
                built_planners.append(job.factory())
            planners.append(built_planners[taken_counts[key]])
            taken_counts[key] += 1
        return planners


_opened: dict[str, "DataSet"] = {}
_planners = PlannerPool()
"""Data sets and planners of a worker process, opened and built once."""


def drive_tasks_in_worker(reopen: Callable[[], "DataSet"], tasks: Sequence[EpisodeTask]) -> list[EpisodeResult]:
    """`drive_tasks` in a worker process, which opens the data set and builds planners the first time."""
    fingerprint = tasks[0].job.fingerprint
    if fingerprint not in _opened:
        _opened[fingerprint] = reopen()
    return drive_tasks(_opened[fingerprint], _planners, tasks)


def _drive_missing(
    data: "DataSet", planners: PlannerPool, tasks: Mapping[int, EpisodeTask], keys: Sequence[str]
) -> Iterator[tuple[int, Scene, EpisodeRow, AdversaryTrack | None, Planner, Meter]]:
    """Scenes and rows of tasks by their places, as drives end, with adversaries, planners and what these took.

    What cannot be driven is raised at last.
    """
    seed = content_seed(*keys)
    seed_everything(seed)
    stages: dict[int, EpisodeSpec] = {}
    broken: list[InputError] = []
    cans: dict[str, RecordedCan] = {}
    for place, task in tasks.items():
        try:
            stages[place] = _make_episode_spec(data, task, cans)
        except InputError as error:
            broken.append(error)
    ready = planners.of([tasks[place].job for place in stages])
    for planner in ready:
        if isinstance(planner, SupervisedPlanner):
            planner.seed_generators(seed)
    places = [*stages]
    for number, episode in _run_episodes([*stages.values()], ready):
        stage = stages[places[number]]
        scores = None if episode.failure is not None else score_episode(stage.scene, episode)
        assert stage.meter is not None
        yield (
            places[number],
            stage.scene,
            build_episode_row(stage, episode, scores),
            episode.adversary,
            ready[number],
            stage.meter,
        )
    if broken:
        raise broken[0]


def _run_episodes(stages: Sequence[EpisodeSpec], planners: Sequence[Planner]) -> Iterable[tuple[int, Episode]]:
    """Drives by their places; of a planner elsewhere the only one, begun again where it went away half-way."""
    if len(planners) == 1:
        with end_session_after(planners[0]):
            return [(0, run_with_restarts(partial(run_episode, stages[0], planners[0]), planners[0]))]
    return run_episodes(stages, planners)


def _make_episode_spec(data: "DataSet", task: EpisodeTask, cans: dict[str, RecordedCan]) -> EpisodeSpec:
    """Stage of a task; measurements of cars are read once for all tasks of a scene."""
    job, unit = task
    scene = data.scene(unit.scene)
    require_two_hz(scene, "a drive")
    if unit.scene not in cans:
        cans[unit.scene] = read_recorded_can(data, unit.scene)
    can = cans[unit.scene]
    return EpisodeSpec(
        scene,
        can,
        unit.run,
        job.maker_of(unit),
        job.sensor,
        job.timeout_s,
        unit.family,
        meter=Meter(),
        plan_hz=job.measured.plan_hz,
    )
