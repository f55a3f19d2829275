"""Failures of one planner for people: its worst scenes, its worst samples or drives, and where there is no plan."""

from collections.abc import Sequence
from typing import Final

from benchmark.metrics.failures import Crash, FailedScene, Failure, Failures
from benchmark.records.drives import DriveRecord
from benchmark.records.run_schema import RecordFacts
from benchmark.report.cells import UNDEFINED, format_number
from benchmark.report.fault_words import FAULT_CELLS
from benchmark.report.table import Table, build_table
from benchmark.report.words import pluralise

_NOTES: Final = {
    "sample": "At and contact: seconds since the scene's first sample, when the plan is made and when it first touches "
    "something. At fault: docs/fault.md. Delta-v: change of the ego's velocity, m/s. A dash: the record does not "
    "say.",
    "drive": "Contact: seconds since the planner drives. At fault: docs/fault.md. Delta-v: change of the ego's "
    "velocity, m/s.",
}


def describe_failures(failures: Failures) -> str:
    """Sentence on how many samples, or drives, and scenes fail."""
    record, found, unit = failures.record, failures.worst, failures.unit
    facts: RecordFacts
    if isinstance(record, DriveRecord):
        facts, how = record.facts, f"{record.facts.measured.world}, sensor {record.facts.measured.sensor}"
        verb = "touch something" if len(found) != 1 else "touches something"
    else:
        facts, how = record.run, "exact, 3 s"
        verb = "fail" if len(found) != 1 else "fails"
    where = f"{record.planner} on {facts.data.name} {facts.split} ({how})"
    counted, scenes = pluralise(failures.counted, unit), pluralise(failures.scenes_counted, "scene")
    words = f"no failure in {counted} of {scenes}"
    if found:
        adversary, at_fault = _count(found)
        words = (
            f"{len(found)} of {counted} {verb}, in {len(failures.scenes)} of {scenes}; {adversary} with the adversary, "
            f"{at_fault} at the planner's fault"
        )
    crashed = f"; {pluralise(len(failures.crashes), unit)} without a plan" if failures.crashes else ""
    return f"{where}: {words}{crashed}"


def failure_tables(failures: Failures, limit: int) -> list[Table]:
    """The worst scenes, the worst samples or drives, and those without a plan, so many of each; none without any."""
    unit, tables = failures.unit, []
    number = "run" if unit == "drive" else "sample"
    if failures.scenes:
        scenes, worst = failures.scenes[:limit], failures.worst[:limit]
        columns: tuple[str, ...] = ("scene", f"worst {number}", f"failed {unit}s", "adversary", "at fault")
        rows = [_scene_row(scene) for scene in scenes]
        tables.append(build_table("", _title("worst scenes", len(scenes), len(failures.scenes)), columns, rows))
        columns = ("scene", "hits", "at fault", number, "at s", "contact s", "delta-v")
        title = _title(f"worst {unit}s", len(worst), len(failures.worst))
        rows = [_failure_row(failure) for failure in worst]
        tables.append(build_table("", title, columns, rows, notes=[_NOTES[unit]], text_columns=3))
    if failures.crashes:
        crashes = failures.crashes[:limit]
        title = _title(f"{unit}s without a plan", len(crashes), len(failures.crashes))
        rows = [_crash_row(crash) for crash in crashes]
        tables.append(build_table("", title, ("scene", number, "raised"), rows, text_columns=3))
    return tables


def _title(what: str, shown: int, found: int) -> str:
    return f"{what} ({shown} of {found})" if shown < found else f"{what} ({found})"


def _count(failures: Sequence[Failure]) -> tuple[int, int]:
    """How many are with the adversary, and how many at the planner's fault."""
    return sum(each.adversary is True for each in failures), sum(each.at_fault is True for each in failures)


def _scene_row(scene: FailedScene) -> tuple[str, ...]:
    adversary, at_fault = _count(scene.failures)
    return (
        scene.scene,
        str(scene.failures[0].index),
        f"{len(scene.failures)}/{scene.counted}",
        str(adversary),
        str(at_fault),
    )


def _failure_row(failure: Failure) -> tuple[str, ...]:
    hits, fault = failure.category or "an object", failure.fault
    return (
        failure.scene,
        f"{hits}, the adversary" if failure.adversary else hits,
        UNDEFINED if fault is None else FAULT_CELLS[fault.verdict],
        str(failure.index),
        format_number(failure.moment_s, 1),
        format_number(failure.contact_s, 1),
        format_number(failure.delta_v_m_s, 1),
    )


def _crash_row(crash: Crash) -> tuple[str, ...]:
    return crash.scene, str(crash.index), crash.raised
