"""The main path of an evaluation: plan every sample, judge every plan, write the record.

Read from the top: `evaluate` chooses scenes, hands each to `benchmark.runs.scene_work`, and writes what comes back. One
scene is one unit of work, because planners have memory; of planners whose memory outlives a change of scene the whole
split is (`benchmark.runs.whole_split`). What the planner said about a scene is kept under a content key
(`benchmark.runs.plan_rows`), so the same command goes on where it stopped; verdicts are computed anew each time, so a
changed protocol never needs the planner.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

from benchmark.datasets.judged import stored_realism
from benchmark.datasets.scene_facts import frozen_split_of
from benchmark.errors import InputError, did_you_mean
from benchmark.judging.kept import judged_facts
from benchmark.machine.environment import facts as environment_facts
from benchmark.machine.progress import Count, progress
from benchmark.machine.storage import only_writer
from benchmark.machine.workers import LocalProcesses, map_ordered
from benchmark.planning import Planner, RemotePlanner, remembers_across_scenes
from benchmark.protocols import STANDARD, protocol
from benchmark.records.planner_versions import PLANS_SHA256
from benchmark.records.review import require_not_rejected
from benchmark.records.run import RunRecord, write_record
from benchmark.records.seed_splits import generated_facts
from benchmark.report.words import counted
from benchmark.runs.failures import write_failures
from benchmark.runs.plan_rows import PlannerFactory, facts_of, rows_path
from benchmark.runs.run_directory import run_directory, tidy
from benchmark.runs.scene_work import Run, SceneResult, reopen_root, work_here, work_in_worker
from benchmark.runs.whole_split import work_through

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

PROCESSES_PAY_AFTER_S = 10.0
"""Opening the data set in further processes takes seconds; less work than this is done sooner in one."""


@dataclass(frozen=True, slots=True)
class EvalSettings:
    """How to evaluate.

    Attributes:
        protocols: Who judges; by default those that every run is judged by.
        scenes: Only these scenes of the split.
        limit: Only the first so many scenes.
        workers: Number of processes; the result does not depend on it.
        seed: Seed of the intervals.
        fresh: Plan again even where plans are kept.
    """

    protocols: tuple[str, ...] = STANDARD
    scenes: tuple[str, ...] | None = None
    limit: int | None = None
    workers: int = 1
    seed: int = 0
    fresh: bool = False

    def chosen(self, data: "DataSet", split: str) -> tuple[str, ...]:
        """The scenes that will run.

        Args:
            data: The data set.
            split: The split.

        Returns:
            Scene names in the order of the split.

        Raises:
            InputError: If the split or a scene is unknown, or nothing is left.
        """
        names = data.scene_names(split)
        unknown = sorted(set(self.scenes or ()) - set(names))
        require_not_rejected(unknown, data.review(split).rejected, str(data.root))
        if unknown:
            raise InputError(
                f"split {split!r} has no scene {', '.join(unknown[:3])}{' ...' if len(unknown) > 3 else ''}; "
                f"{did_you_mean(unknown[0], names)}it has {counted(len(names), 'scene')}, among them "
                f"{', '.join(names[:3])}"
            )
        if self.limit is not None and self.limit < 1:
            raise InputError(f"--limit must be at least 1, got {self.limit}")
        wanted = names if self.scenes is None else tuple(name for name in names if name in set(self.scenes))
        if not wanted:
            raise InputError(f"split {split!r} of {data.root} has no scenes to evaluate{_all_rejected(data, split)}")
        return wanted[: self.limit]


def _all_rejected(data: "DataSet", split: str) -> str:
    rejected = len(data.review(split).rejected)
    return f": inspectors rejected all {rejected} (challenger-bench data review {data.root})" if rejected else ""


def require_whole_split(planner: str, scenes: object, limit: int | None, workers: int) -> None:
    """Refuse a part of a split, or several processes, for a planner whose memory outlives a change of scene.

    Args:
        planner: Its name.
        scenes: What ``--scenes`` says, or ``None``.
        limit: What ``--limit`` says.
        workers: What ``--workers`` says.

    Raises:
        InputError: If any is given; one process is what the default means then.
    """
    given = {"--scenes": scenes is not None, "--limit": limit is not None, f"--workers {workers}": workers > 1}
    wrong = next((option for option, is_given in given.items() if is_given), None)
    if wrong is not None:
        raise InputError(
            f"{planner} remembers across scenes, so that the whole split is planned in one process, in the published "
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
    settings = settings or EvalSettings()
    if settings.workers < 1:
        raise InputError(f"--workers must be at least 1, got {settings.workers}")
    factory = None if hasattr(planner, "plan") else planner
    ready = cast("Planner", planner) if factory is None else factory()
    if remembers_across_scenes(ready):
        require_whole_split(ready.name, settings.scenes, settings.limit, settings.workers)
    facts = facts_of(ready) if factory is None else factory.facts
    versions = {name: protocol(name).version for name in settings.protocols}
    scenes, every_scene = settings.chosen(data, split), data.scene_names(split)
    directory = run_directory(out, data.name, split, facts, () if len(scenes) == len(every_scene) else scenes)
    run = Run(directory, data.fingerprint(), split, facts, settings.protocols, settings.fresh)
    elsewhere = None
    if factory is not None and settings.workers > 1 and not isinstance(ready, RemotePlanner):
        opener = reopen or partial(reopen_root, data.root, data.version, data.name)
        elsewhere = partial(work_in_worker, run, opener, factory)
    described = {
        "planner": facts,
        "data": {"name": data.name, "version": data.version, "fingerprint": run.fingerprint},
        "split": split,
        "scenes": list(scenes),
        "scenes_in_split": len(every_scene),
        "scene_facts": judged_facts(data, scenes, out, LocalProcesses(settings.workers)),
        "realism": stored_realism(data.root, data.version),
        "frozen_split": frozen_split_of(data.provenance()),
        "review": data.review(split).facts,
        "generated": generated_facts(data.provenance()),
        "plans_from": getattr(factory, "plans_from", None),
        "config": {"protocols": list(settings.protocols), "seed": settings.seed},
        "environment": environment_facts(),
    }
    with only_writer(directory):
        label = f"{facts.name} on {split}"
        if remembers_across_scenes(ready):
            found = work_through(run, data, ready, scenes)
        else:
            found = _results(scenes, partial(work_here, run, data, ready), elsewhere, settings.workers, label)
        results = list(progress(found, total=len(scenes), label=label, count=Count(kept=_was_there)))
        # Rows are by scene and time, in whatever order scenes were planned.
        results.sort(key=lambda result: scenes.index(result.scene))
        rows = [row for result in results for row in result.rows]
        record = write_record(directory, described, rows, versions, seed=settings.seed)
        write_failures(directory, record.rows)
        # Looking plans up in a file says nothing of how fast their planner was.
        timed = PLANS_SHA256 not in facts.settings
        tidy(directory, {rows_path(directory, each.scene): each.seconds if timed else None for each in results})
    return record


def _was_there(result: SceneResult) -> bool:
    return result.seconds is None


def _results(
    scenes: tuple[str, ...],
    here: Callable[[str], SceneResult],
    elsewhere: Callable[[str], SceneResult] | None,
    workers: int,
    label: str,
) -> Iterator[SceneResult]:
    """Results in the order of the scenes; the first scene is done here and tells whether more processes pay."""
    started = time.perf_counter()
    yield from map_ordered(here, scenes[:1], workers=1, label=label)
    left_s = (time.perf_counter() - started) * (len(scenes) - 1)
    if elsewhere is not None and left_s > PROCESSES_PAY_AFTER_S:
        yield from map_ordered(elsewhere, scenes[1:], workers=workers, label=label)
    else:
        yield from map_ordered(here, scenes[1:], workers=1, label=label)
