"""The main path of an evaluation: plan every sample, judge every plan, write the record.

`evaluate` chooses scenes, hands each to `benchmark.runs.scene_work`, and writes the record. One scene is one unit of
work, because planners have memory; of planners whose memory outlives a change of scene the whole split is. Plans of a
scene are kept under a content key (`benchmark.runs.plan_rows`), so the same command goes on where it stopped; verdicts
are computed anew each time, so a changed protocol never needs the planner.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from benchmark.datasets.annotated_objects import require_annotated
from benchmark.datasets.scene_facts import add_truth_facts
from benchmark.datasets.scene_names import resolve_names
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.metering import disable_malloc_trim_for
from benchmark.machine.progress import CountedUnits, track_progress
from benchmark.machine.storage import lock_folder
from benchmark.machine.workers import LocalProcesses, has_forkserver, map_ordered, single_threaded
from benchmark.planning import Planner, RemotePlanner, remembers_across_scenes
from benchmark.protocols import STANDARD, find_protocol
from benchmark.records.planner_cost import SceneCost, cost_path, gather_costs, note_cost, shard_cost_path
from benchmark.records.planner_versions import PLANS_SHA256
from benchmark.records.review import require_not_rejected
from benchmark.records.rows import SampleRows
from benchmark.records.run import RunRecord, write_record
from benchmark.records.run_schema import TruthFacts
from benchmark.report.words import pluralise
from benchmark.runs.caveats import list_run_caveats, list_source_caveats
from benchmark.runs.judging import JudgedScenes, describe_data, describe_given_names
from benchmark.runs.pairing import name_partner
from benchmark.runs.plan_rows import PlannerFactory, describe_sandbox_limits, open_plan_store, plan_scene, scene_key
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.runs.rescoring import find_unjudged, require_vocabulary
from benchmark.runs.run_directory import run_directory
from benchmark.runs.scene_work import (
    EvaluationJob,
    SceneResult,
    evaluate_scene,
    evaluate_scene_in_worker,
    evaluate_split_in_order,
    make_reopener,
)
from benchmark.runs.units import Shard, ShardProgress, write_failures

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

PROCESSES_PAY_AFTER_S = 10.0
"""Opening the data set in further processes takes seconds; less work than this is done sooner in one."""


@dataclass(frozen=True, slots=True)
class EvalSettings:
    """How to evaluate.

    Attributes:
        protocols: Who judges; by default those that every run is judged by.
        scenes: Only these scenes of the split, by their names or by those in the tables.
        limit: Only the first so many scenes.
        workers: Number of processes; the result does not depend on it.
        seed: Seed of the intervals.
        fresh: Plan again even where plans are kept.
        timings: Folder for notes on what planners cost, one file a record; without it none are kept.
        asked: Judges whose verdicts were asked for by name: refused where they have none on any contact.
        unchanged: Name of the data set that has the recordings which adversarial scenes were made from, if it is
            another one.
    """

    protocols: tuple[str, ...] = STANDARD
    scenes: tuple[str, ...] | None = None
    limit: int | None = None
    workers: int = 1
    seed: int = 0
    fresh: bool = False
    timings: Path | None = None
    asked: tuple[str, ...] = ()
    unchanged: str | None = None

    def chosen(self, data: "DataSet", split: str) -> tuple[str, ...]:
        """The scenes that will run, in the order of the split.

        Raises:
            InputError: If the split or a scene is unknown, or nothing is left.
        """
        names = data.scene_names(split)
        asked = None if self.scenes is None else set(resolve_names(data.provenance(), self.scenes))
        unknown = sorted((asked or set()) - set(names))
        require_not_rejected(unknown, data.review(split).rejected, str(data.root))
        if unknown:
            raise InputError(
                f"split {split!r} has no scene {', '.join(unknown[:3])}{' ...' if len(unknown) > 3 else ''}; "
                f"{did_you_mean(unknown[0], names)}it has {pluralise(len(names), 'scene')}, among them "
                f"{', '.join(names[:3])}"
            )
        if self.limit is not None and self.limit < 1:
            raise InputError(f"--limit must be at least 1, got {self.limit}")
        wanted = names if asked is None else tuple(name for name in names if name in asked)
        if not wanted:
            raise InputError(
                f"split {split!r} of {data.root} has no scenes to evaluate{_describe_all_rejected(data, split)}"
            )
        return wanted[: self.limit]


def _describe_all_rejected(data: "DataSet", split: str) -> str:
    rejected = len(data.review(split).rejected)
    return f": inspectors rejected all {rejected} (challenger-bench data review {data.root})" if rejected else ""


def require_whole_split(planner: str, scenes: object, limit: int | None, workers: int) -> None:
    """Refuse a part of a split, or several processes, for a planner whose memory outlives a change of scene.

    The default number of workers means one process.
    """
    given = {"--scenes": scenes is not None, "--limit": limit is not None, f"--workers {workers}": workers > 1}
    wrong = next((option for option, is_given in given.items() if is_given), None)
    if wrong is not None:
        raise InputError(
            f"{planner} keeps state across scenes, so it must plan the whole split in one process, in the published "
            f"order; leave {wrong} out"
        )


def evaluate(
    data: "DataSet",
    split: str,
    planner: Planner | PlannerFactory,
    out: Path,
    settings: EvalSettings | None = None,
    *,
    reopen: Callable[[], "DataSet"] | None = None,
) -> RunRecord:
    """Run a planner on a split and write the record.

    Args:
        data: The data set.
        split: Which of its splits.
        planner: A planner, or a factory, which is what more than one process needs.
        out: Folder of run directories.
        settings: Which scenes, judged by whom, in how many processes.
        reopen: Opens the data set in another process; by default from its root, version and name.

    Returns:
        The record, in the directory that `run_directory` names. Its status is ``partial`` if the planner failed
        on any sample.

    Raises:
        InputError: If the split, a scene or a protocol is unknown, the data is broken, or another command is writing
            the same record.
    """
    return evaluate_together(data, split, [(planner, settings or EvalSettings())], out, reopen=reopen)[0]


def evaluate_together(
    data: "DataSet",
    split: str,
    planners: Sequence[tuple[Planner | PlannerFactory, EvalSettings]],
    out: Path,
    *,
    reopen: Callable[[], "DataSet"] | None = None,
) -> list[RunRecord]:
    """`evaluate` for several planners, with the same records; those that need no network read each scene together."""
    records: dict[int, RunRecord] = {}
    waiting: dict[int, _PreparedRun] = {}
    # Networks last, in any order of names: planners without one then run together, and a network is loaded in
    # its turn, so that only one is in memory at a time.
    for place in sorted(range(len(planners)), key=lambda place: _has_weights(planners[place][0])):
        planned = _prepare_run(data, split, planners[place][0], out, planners[place][1])
        if not all(planned.can_run_with(other) for other in waiting.values()):
            records |= zip(waiting, _evaluate_runs(data, split, [*waiting.values()], out, reopen))
            waiting = {}
        waiting[place] = planned
    records |= zip(waiting, _evaluate_runs(data, split, [*waiting.values()], out, reopen))
    return [records[place] for place in range(len(planners))]


def plan_shard(
    data: "DataSet",
    split: str,
    planners: Sequence[tuple[Planner | PlannerFactory, EvalSettings]],
    out: Path,
    shard: Shard,
) -> list[ShardProgress]:
    """Plan the scenes of one shard, in this process, and store the plans; nothing is judged and no record is written.

    Raises `InputError` as `evaluate` does, and for planners that keep state across scenes.
    """
    single_threaded()
    finished = []
    for planner, settings in planners:
        planned = _prepare_run(data, split, planner, out, settings)
        run, ready = planned.run, planned.ready
        if remembers_across_scenes(ready):
            raise InputError(
                f"{ready.name} keeps state across scenes, so it must plan the whole split in one process; leave "
                "--shard out"
            )
        shard_scenes = shard.part(planned.scenes)
        costs: dict[str, SceneCost | None] = {}
        label = f"{run.planner.name} on {split}, shard {shard}"
        for scene in track_progress(shard_scenes, total=len(shard_scenes), label=label, count=CountedUnits()):
            key = scene_key(run.fingerprint, split, scene, run.planner)
            costs[scene] = plan_scene(ready, data, scene, run.directory, key, fresh=settings.fresh).cost
        if (timings_path := _find_cost_path(planned, out)) is not None:
            note_cost(shard_cost_path(timings_path, shard.number, shard.of), run.planner, costs)
        finished.append(ShardProgress(run.directory, len(shard_scenes), len(planned.scenes)))
    return finished


@dataclass(frozen=True, slots=True)
class _PreparedRun:
    run: EvaluationJob
    ready: Planner
    factory: PlannerFactory | None
    settings: EvalSettings
    scenes: tuple[str, ...]

    @property
    def is_portable(self) -> bool:
        """Whether it may run in other processes."""
        return self.factory is not None and not isinstance(self.ready, RemotePlanner)

    @property
    def light(self) -> bool:
        """Whether reading a scene takes longer than its planner does, and several of them fit into memory."""
        return self.is_portable and self.run.planner.weights_sha256 is None and not remembers_across_scenes(self.ready)

    def can_run_with(self, other: "_PreparedRun") -> bool:
        """Whether both can be done scene by scene together."""
        same = (self.scenes, self.settings.workers) == (other.scenes, other.settings.workers)
        return same and self.light and other.light and self.run.directory != other.run.directory


def _has_weights(planner: Planner | PlannerFactory) -> bool:
    facts = build_planner_facts(cast("Planner", planner)) if hasattr(planner, "plan") else planner.facts
    return facts.weights_sha256 is not None


def _prepare_run(
    data: "DataSet", split: str, planner: Planner | PlannerFactory, out: Path, settings: EvalSettings
) -> _PreparedRun:
    if settings.workers < 1:
        raise InputError(f"--workers must be at least 1, got {settings.workers}")
    factory = None if hasattr(planner, "plan") else planner
    ready = cast("Planner", planner) if factory is None else factory()
    if remembers_across_scenes(ready):
        require_whole_split(ready.name, settings.scenes, settings.limit, settings.workers)
    facts = build_planner_facts(ready) if factory is None else factory.facts
    disable_malloc_trim_for(facts.weights_sha256)
    for name in settings.protocols:
        find_protocol(name)
    scenes, every_scene = settings.chosen(data, split), data.scene_names(split)
    counts = require_annotated(data, split, scenes)
    own = () if facts.native_protocol is None else (facts.native_protocol,)
    require_vocabulary(counts, (*settings.asked, *own), settings.protocols, str(data.root))
    directory = run_directory(out, data.name, split, facts, () if len(scenes) == len(every_scene) else scenes)
    unjudged_protocols = find_unjudged(counts, settings.protocols)
    run = EvaluationJob(
        directory, data.fingerprint(), split, facts, settings.protocols, settings.fresh, unjudged_protocols
    )
    return _PreparedRun(run, ready, factory, settings, scenes)


def _evaluate_runs(
    data: "DataSet",
    split: str,
    planned: Sequence[_PreparedRun],
    out: Path,
    reopen: Callable[[], "DataSet"] | None,
) -> list[RunRecord]:
    if not planned:
        return []
    runs, workers, scenes = [prepared.run for prepared in planned], planned[0].settings.workers, planned[0].scenes
    elsewhere = None
    if workers > 1 and all(prepared.is_portable for prepared in planned):
        opener = reopen or make_reopener(data)
        elsewhere = partial(
            evaluate_scene_in_worker, runs, opener, [prepared.factory for prepared in planned if prepared.factory]
        )
    shared = describe_data(JudgedScenes(data, split, scenes, out, LocalProcesses(workers)))
    with ExitStack() as writing:
        for run in runs:
            writing.enter_context(lock_folder(run.directory))
        label = f"{', '.join(run.planner.name for run in runs[:3])}{', ...' if len(runs) > 3 else ''} on {split}"
        if remembers_across_scenes(planned[0].ready):
            scene_results: Iterator[list[SceneResult]] = (
                [result] for result in evaluate_split_in_order(runs[0], data, planned[0].ready, scenes)
            )
        else:
            here = partial(evaluate_scene, runs, data, [prepared.ready for prepared in planned])
            # Loading a network takes longer than starting a worker if the process that it is copied from exists.
            sure = has_forkserver() and len(scenes) > 1 and not all(prepared.light for prepared in planned)
            scene_results = _iterate_results(scenes, here, elsewhere, workers, label, sure=sure)
        rows: list[SampleRows] = [SampleRows() for _ in runs]
        costs: list[dict[str, SceneCost | None]] = [{} for _ in runs]
        truths: dict[str, TruthFacts] = {}
        for results in track_progress(
            scene_results, total=len(scenes), label=label, count=CountedUnits(kept=_all_cached)
        ):
            for place, result in enumerate(results):
                rows[place].add(result.rows)
                costs[place][result.scene] = result.cost
                truths[result.scene] = result.truth
        shared["scene_facts"] = add_truth_facts(shared["scene_facts"], truths)
        return [
            # Rows are by scene and time, independent of the order in which scenes were planned.
            _write_run(prepared, shared, own.in_order_of(scenes), spent, out, data)
            for prepared, own, spent in zip(planned, rows, costs, strict=True)
        ]


def _write_run(
    planned: _PreparedRun,
    shared: Mapping[str, Any],
    rows: SampleRows,
    costs: Mapping[str, SceneCost | None],
    out: Path,
    data: "DataSet",
) -> RunRecord:
    facts, settings, directory = planned.run.planner, planned.settings, planned.run.directory
    known = (*getattr(planned.factory, "caveats", ()), *list_source_caveats(facts, data, planned.scenes))
    run_facts = {
        **shared,
        "caveats": list_run_caveats(facts, shared["scene_facts"], rows, known),
        "planner": facts,
        "plans_from": getattr(planned.factory, "plans_from", None),
        "config": {
            "protocols": list(settings.protocols),
            "seed": settings.seed,
            **describe_sandbox_limits(planned.factory),
            **describe_given_names(data),
        },
    }
    versions = {name: find_protocol(name).version for name in settings.protocols}
    record = write_record(directory, run_facts, rows, versions, seed=settings.seed)
    record = name_partner(record, out, settings.unchanged)
    write_failures(directory, record.rows)
    open_plan_store(directory).tidy(costs)
    if (timings_path := _find_cost_path(planned, out)) is not None:
        beside = {
            scene: cost and cost.model_copy(update={"workers": settings.workers}) for scene, cost in costs.items()
        }
        gather_costs(timings_path, facts)
        note_cost(timings_path, facts, beside)
    return record


def _find_cost_path(planned: _PreparedRun, out: Path) -> Path | None:
    """File of what the planner of a run takes; looking plans up in a file says nothing of how fast theirs was."""
    timings = planned.settings.timings
    if timings is None or PLANS_SHA256 in planned.run.planner.settings:
        return None
    return cost_path(timings, out, planned.run.directory)


def _all_cached(results: Sequence[SceneResult]) -> bool:
    return all(result.kept for result in results)


def _iterate_results(
    scenes: tuple[str, ...],
    here: Callable[[str], list[SceneResult]],
    elsewhere: Callable[[str], list[SceneResult]] | None,
    workers: int,
    label: str,
    *,
    sure: bool,
) -> Iterator[list[SceneResult]]:
    """Results in order of scenes; the first is done here and tells whether more processes pay, unless ``sure``."""
    if elsewhere is not None and sure:
        yield from map_ordered(elsewhere, scenes, workers=workers, label=label)
        return
    started = time.perf_counter()
    yield from map_ordered(here, scenes[:1], workers=1, label=label)
    left_s = (time.perf_counter() - started) * (len(scenes) - 1)
    if elsewhere is not None and left_s > PROCESSES_PAY_AFTER_S:
        yield from map_ordered(elsewhere, scenes[1:], workers=workers, label=label)
    else:
        yield from map_ordered(here, scenes[1:], workers=1, label=label)
