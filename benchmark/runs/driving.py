"""The main path of closed loop: drive every scene and run of a split, write the record.

`drive_planners` chooses scenes and runs, hands units to `benchmark.runs.drive_work`, and writes the records. Results of
units are kept, so the same command resumes where it stopped; the record is the same bytes for any number of workers.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from benchmark.closed_loop.adversary import ADVERSARY
from benchmark.closed_loop.episodes import USUAL_HZ
from benchmark.closed_loop.observation_builder import RemoteSensor
from benchmark.closed_loop.planner_calls import LONGEST_TIMEOUT_S
from benchmark.closed_loop.scoring import VERSION
from benchmark.datasets.annotated_objects import require_annotated
from benchmark.datasets.scene_facts import add_truth_facts
from benchmark.errors import InputError
from benchmark.machine.metering import disable_malloc_trim_for
from benchmark.machine.storage import content_key, lock_folder, sanitise_file_name, writing_to
from benchmark.machine.workers import LocalProcesses
from benchmark.planning import Planner, RemotePlanner, remembers_across_scenes
from benchmark.records.drive_schema import ClosedLoopDefinition, EpisodeRow
from benchmark.records.drives import DriveRecord, write_drives
from benchmark.records.planner_cost import cost_path, gather_costs, note_cost, shard_cost_path
from benchmark.records.planner_versions import PLANS_SHA256
from benchmark.records.run_schema import PlannerFacts, TruthFacts
from benchmark.records.search_trace import FOLDER as CONSIDERED
from benchmark.report.words import pluralise
from benchmark.runs.caveats import list_drive_caveats, list_source_caveats
from benchmark.runs.drive_rows import mark_labelled
from benchmark.runs.drive_settings import KEPT, ClosedLoopJob, EpisodeTask, EpisodeUnit
from benchmark.runs.drive_settings import DriveSettings as DriveSettings
from benchmark.runs.drive_work import EpisodeResult, PlannerPool, collect_costs, drive_tasks, drive_tasks_in_worker
from benchmark.runs.judging import JudgedScenes, describe_data, describe_given_names
from benchmark.runs.plan_rows import PlannerFactory, describe_sandbox_limits
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.runs.run_directory import run_directory
from benchmark.runs.scene_reading import collect_truth_facts
from benchmark.runs.scene_work import make_reopener
from benchmark.runs.units import Shard, ShardProgress, run_units
from benchmark.untrusted.plan_plausibility import ComparedPlans

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True)
class ClosedLoopResults:
    """All drives of a job; results are in the order of the units."""

    data: "DataSet"
    split: str
    scenes: tuple[str, ...]
    job: ClosedLoopJob
    units: Sequence[EpisodeUnit]
    results: Sequence[EpisodeResult]
    settings: DriveSettings
    truths: Mapping[str, TruthFacts]

    @cached_property
    def rows(self) -> list[EpisodeRow]:
        """Of the record."""
        return mark_labelled([result.row for result in self.results], self.truths)

    @cached_property
    def of_data(self) -> dict[str, Any]:
        """Metadata of the record's data."""
        scenes = JudgedScenes(self.data, self.split, self.scenes)
        description = describe_data(scenes, "scene_facts", "frozen_split", "review", "generated")
        return {**description, "scene_facts": add_truth_facts(description["scene_facts"], self.truths)}


def _config(of: ClosedLoopResults) -> dict[str, Any]:
    return {
        "seed": of.settings.seed,
        "timeout_s": of.settings.timeout_s,
        **describe_sandbox_limits(of.job.factory),
        **describe_given_names(of.data),
    }


def _caveats(of: ClosedLoopResults) -> Any:
    compared = ComparedPlans.joined(result.compared for result in of.results)
    cameras = list_source_caveats(of.job.planner, of.data, of.scenes)
    door = (*getattr(of.job.factory, "caveats", ()), *cameras)
    return list_drive_caveats(of.job.planner, of.of_data["scene_facts"], of.rows, of.job.measured, compared, door)


FIELDS: Final[Mapping[str, Callable[[ClosedLoopResults], Any]]] = {
    "planner": lambda of: of.job.planner,
    "measured": lambda of: of.settings.measured,
    "runs": lambda of: of.settings.runs_made,
    "scoring": lambda of: VERSION,
    "config": _config,
    "caveats": _caveats,
}
"""Functions that compute fields of the record from its drives, by field."""


def write_record(of: ClosedLoopResults) -> DriveRecord:
    """Write the record of a job, note what its planner took, and remove what is kept of other scenes."""
    facts = of.of_data | {name: make(of) for name, make in FIELDS.items()}
    record = write_drives(of.job.directory, facts, of.rows, seed=of.settings.seed)
    if of.job.costs is not None:
        gather_costs(of.job.costs, of.job.planner)
        note_cost(of.job.costs, of.job.planner, collect_costs(of.job, of.results, of.settings.processes))
    _tidy(of.job, of.units)
    return record


def _tidy(job: ClosedLoopJob, units: Sequence[EpisodeUnit]) -> None:
    """Remove what is kept of scenes that are none of this record's any more; further runs of its own stay."""
    wanted = {_without_run(job.store.path(unit.name)) for unit in units}
    for folder in (job.directory / KEPT, job.directory / CONSIDERED):
        with writing_to(folder):
            for path in folder.iterdir() if folder.is_dir() else ():
                if _without_run(path) not in wanted:
                    path.unlink()


def _without_run(path: Path) -> str:
    return path.stem.rpartition("-")[0]


def drive_split(
    data: "DataSet",
    split: str,
    planner: Planner | PlannerFactory,
    out: Path,
    settings: DriveSettings,
    *,
    reopen: Callable[[], "DataSet"] | None = None,
) -> DriveRecord:
    """Drive a planner through a split and write the record.

    Args:
        data: The data set.
        split: Which of its splits.
        planner: A planner, or a factory, which is what further processes and drives side by side need.
        out: Folder of all records of drives.
        settings: How.
        reopen: Opens the data set in another process; by default from its root, version and name.

    Returns:
        The record. Its status is ``partial`` if the planner failed in any drive.

    Raises:
        InputError: If the split or a scene is unknown, a scene cannot be driven, the data is broken, or another command
            is writing the same record.
    """
    if not hasattr(planner, "plan"):
        (record,) = drive_planners(data, split, [planner], out, settings, reopen=reopen)
        return record
    single_planner = cast("Planner", planner)
    disable_malloc_trim_for(getattr(single_planner, "weights_sha256", None))
    _require_drivable([single_planner], settings)
    require_annotated(data, split, settings.chosen(data, split))
    job = make_job(data, split, build_planner_facts(single_planner), out, settings)
    single_settings = replace(settings, executor=LocalProcesses(1), together=1)
    (record,) = _records(data, split, [job], single_settings, PlannerPool(single_planner), None)
    return record


def drive_planners(
    data: "DataSet",
    split: str,
    planners: Sequence[PlannerFactory],
    out: Path,
    settings: DriveSettings,
    *,
    reopen: Callable[[], "DataSet"] | None = None,
) -> list[DriveRecord]:
    """Drive several planners through a split, scene by scene, and write a record of each.

    That is faster than one planner after the other, since a scene is read once, and the same bytes.

    Args:
        data: The data set.
        split: Which of its splits.
        planners: Who plans.
        out: Folder of all records of drives.
        settings: How; `DriveSettings.together` says how many drives are side by side.
        reopen: As in `drive_split`.

    Returns:
        The records, in the order of the planners.

    Raises:
        InputError: As in `drive_split`.
    """
    jobs, settings, elsewhere = _prepare_jobs(data, split, planners, out, settings, reopen)
    return _records(data, split, jobs, settings, PlannerPool(), elsewhere)


def drive_shard(
    data: "DataSet",
    split: str,
    planners: Sequence[PlannerFactory],
    out: Path,
    settings: DriveSettings,
    shard: Shard,
    *,
    reopen: Callable[[], "DataSet"] | None = None,
) -> list[ShardProgress]:
    """Drive the scenes of one shard as `drive_planners` does and keep the drives; no record is written."""
    jobs, settings, elsewhere = _prepare_jobs(data, split, planners, out, settings, reopen)
    scenes = settings.chosen(data, split)
    shard_scenes = shard.part(scenes)
    units = settings.units_of(data, shard_scenes)
    tasks = [EpisodeTask(job, unit) for unit in units for job in jobs]
    who = jobs[0].planner.name if len(jobs) == 1 else pluralise(len(jobs), "planner")
    label = f"{who} drive{'s' if len(jobs) == 1 else ''} {split}, shard {shard}"
    groups = settings.groups(tasks)
    results = (
        list(_results(groups, partial(drive_tasks, data, PlannerPool()), elsewhere, settings, label)) if tasks else []
    )
    for place, job in enumerate(jobs):
        if job.costs is not None:
            part = shard_cost_path(job.costs, shard.number, shard.of)
            note_cost(part, job.planner, collect_costs(job, results[place :: len(jobs)], settings.processes))
    return [ShardProgress(job.directory, len(shard_scenes), len(scenes)) for job in jobs]


def _prepare_jobs(
    data: "DataSet",
    split: str,
    planners: Sequence[PlannerFactory],
    out: Path,
    settings: DriveSettings,
    reopen: Callable[[], "DataSet"] | None,
) -> tuple[list[ClosedLoopJob], DriveSettings, Callable[[Sequence[EpisodeTask]], list[EpisodeResult]] | None]:
    """Job of every unit, the settings that these planners allow, and how others drive units."""
    disable_malloc_trim_for(*(factory.facts.weights_sha256 for factory in planners))
    built = [factory() for factory in planners]
    _require_drivable(built, settings)
    require_annotated(data, split, settings.chosen(data, split))
    jobs = [replace(make_job(data, split, factory.facts, out, settings), factory=factory) for factory in planners]
    if isinstance(settings.sensor, RemoteSensor) or any(isinstance(planner, RemotePlanner) for planner in built):
        # A planner in another process holds one scene at a time.
        return jobs, replace(settings, together=1), None
    open_again = reopen or make_reopener(data)
    return jobs, settings, partial(drive_tasks_in_worker, open_again)


def _records(
    data: "DataSet",
    split: str,
    jobs: Sequence[ClosedLoopJob],
    settings: DriveSettings,
    planners: PlannerPool,
    elsewhere: Callable[[Sequence[EpisodeTask]], list[EpisodeResult]] | None,
) -> list[DriveRecord]:
    scenes = settings.chosen(data, split)
    units = settings.units(data, scenes)
    scene_names = {unit.scene for unit in units}
    scenes = tuple(scene for scene in scenes if scene in scene_names)
    tasks = [EpisodeTask(job, unit) for unit in units for job in jobs]
    who = jobs[0].planner.name if len(jobs) == 1 else pluralise(len(jobs), "planner")
    label = f"{who} drive{'s' if len(jobs) == 1 else ''} {split}"
    with ExitStack() as writing:
        for job in jobs:
            writing.enter_context(lock_folder(job.directory))
        results = list(
            _results(settings.groups(tasks), partial(drive_tasks, data, planners), elsewhere, settings, label)
        )
        truths = collect_truth_facts(data, scenes)
        of_jobs = [
            ClosedLoopResults(data, split, scenes, job, units, results[place :: len(jobs)], settings, truths)
            for place, job in enumerate(jobs)
        ]
        return [write_record(job_results) for job_results in of_jobs]


def _require_drivable(planners: Sequence[Planner], settings: DriveSettings) -> None:
    """Refuse planners that single scenes cannot be driven with, and groups of none."""
    for planner in planners:
        if remembers_across_scenes(planner):
            raise InputError(f"{planner.name} keeps state across scenes, but a drive starts each anew; use eval")
    if not 0.0 < settings.timeout_s <= LONGEST_TIMEOUT_S:
        raise InputError(f"--timeout must be more than 0 and at most {LONGEST_TIMEOUT_S:g}, got {settings.timeout_s}")
    if settings.together < 1:
        raise InputError(f"drives side by side must be at least 1, got {settings.together}")


def make_job(data: "DataSet", split: str, facts: PlannerFacts, out: Path, settings: DriveSettings) -> ClosedLoopJob:
    """Job of every unit of a record; arguments as of `drive_split`, ``facts`` being the planner's."""
    scenes = settings.chosen(data, split)
    part = () if len(scenes) == len(data.scene_names(split)) else scenes
    directory = drives_directory(out, data.name, split, facts, settings.measured, part)
    # The time to read plans from a file is not the latency of their planner.
    timings = None if PLANS_SHA256 in facts.settings else settings.timings
    return ClosedLoopJob(
        directory=directory,
        fingerprint=data.fingerprint(),
        planner=facts,
        measured=settings.measured,
        maker=settings.maker,
        sensor=settings.sensor,
        timeout_s=settings.timeout_s,
        fresh=settings.fresh,
        ladder=settings.ladder if settings.agents == ADVERSARY else (),
        keep_considered=settings.keep_considered,
        costs=None if timings is None else cost_path(timings, out, directory),
    )


def drives_directory(
    out: Path,
    data_name: str,
    split: str,
    planner: PlannerFacts,
    measured: ClosedLoopDefinition,
    part: tuple[str, ...] = (),
) -> Path:
    """Directory of a record: ``<out>/<data>/<split>/<what was measured>/<planner>``."""
    base = run_directory(out, data_name, split, planner, part)
    parts = [measured.engine, *([measured.agents] if measured.engine == "default" else []), measured.sensor]
    parts += [measured.scenarios] if measured.scenarios != "recorded" else []
    parts += [f"{measured.latency_ms}ms"] if measured.latency_ms else []
    parts += [] if measured.window == "scene" else [measured.window]
    parts += ["as", *measured.windows_of.values()] if measured.windows_of else []
    parts += [f"{measured.plan_hz}hz"] if measured.plan_hz != USUAL_HZ else []
    parts += measured.until_words
    parts += [
        content_key(facts)[:8]
        for facts in (measured.agents_facts, measured.sensor_facts, measured.scenario_facts)
        if facts
    ]
    return base.parent / sanitise_file_name("-".join(parts)) / base.name


def count_cached_units(job: ClosedLoopJob, units: list[EpisodeUnit]) -> int:
    """How many units are kept already."""
    return sum(job.kept(unit) is not None for unit in units)


def _results(
    groups: list[list[EpisodeTask]],
    here: Callable[[Sequence[EpisodeTask]], list[EpisodeResult]],
    elsewhere: Callable[[Sequence[EpisodeTask]], list[EpisodeResult]] | None,
    settings: DriveSettings,
    label: str,
) -> Iterator[EpisodeResult]:
    """Results in the order of the tasks; those of one process are driven here."""
    executor = settings.executor
    works_here = elsewhere is None or (isinstance(executor, LocalProcesses) and executor.workers == 1)
    work, where = (here, LocalProcesses(1)) if works_here or elsewhere is None else (elsewhere, executor)
    drives = sum(map(len, groups))
    for results in run_units(work, groups, where, total=len(groups), label=label, noun="drive", of=drives):
        yield from results
