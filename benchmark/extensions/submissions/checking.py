"""Is a stranger's folder of records fit for a leaderboard: everything it claims, computed again from its plans.

A record holds the plans, so nothing in it has to be believed: hashes, coverage and samples are compared with the data
set, every plan is judged or driven anew, and every number is summed up anew. What cannot be checked from outside, that
the named model made the plans from the images, is said as what it is.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.errors import InputError
from benchmark.extensions.submissions.claims import claims_of, split_findings
from benchmark.extensions.submissions.findings import Finding, Level, Said
from benchmark.extensions.submissions.identity import OursLike, planner_findings
from benchmark.extensions.submissions.leaked_futures import leak_findings
from benchmark.extensions.submissions.recomputed import drives_anew, protocols_of, run_anew
from benchmark.records.drives import DRIVE_FILE, DriveRecord, load_drives
from benchmark.records.run import RunRecord, load_record
from benchmark.records.run_schema import PlannerFacts, RecordFacts
from benchmark.runs.rescoring import Opened, opened_as, record_directories

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

Record = RunRecord | DriveRecord
_LABELS: Final = {"published_as", "miniature", "wants"}
"""What makes no other planner of one."""


def no_planner_of_ours(planner: PlannerFacts) -> PlannerFacts | None:
    """For who knows no planners: everything that is said of one is a declaration."""
    return None


def check_submission(
    folder: Path,
    data_name: str,
    open_split: Callable[[str], "DataSet"],
    ours_like: OursLike = no_planner_of_ours,
) -> tuple[list[Record], list[Finding]]:
    """Check every record below a folder; one that is bad does not stop the others. Nothing is written.

    Args:
        folder: The submission.
        data_name: Name of the data set that records must be of.
        open_split: Opens the data set that holds a split; asked once for each split.
        ours_like: Knows this program's planners.

    Returns:
        Records without an error, runs before drives, and all findings by record.

    Raises:
        InputError: If there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; name the one that holds the submitted run records")
    places: list[tuple[Path, Callable[[Path], Record]]] = [
        *((directory, load_record) for directory in record_directories(folder)),
        *((path.parent, load_drives) for path in sorted(folder.rglob(DRIVE_FILE))),
    ]
    if not places:
        return [], [
            Finding(folder, Level.ERROR, "holds no run record (run.json, samples.jsonl, summary.json) and no drives "
                    "(drive.json, ...); submit what challenger-bench eval and drive write below OUT")
        ]  # fmt: skip
    opened: Opened = {}
    sound: list[Record] = []
    findings: list[Finding] = []
    for directory, load in places:
        found: list[Finding] = []
        try:
            record = load(directory)
            facts = facts_of_record(record)
            found += [Finding(directory, level, says) for level, says in _claims(record, data_name, ours_like)]
            if facts.data.name == data_name:
                data = opened_as(facts, opened, open_split)
                found += [Finding(directory, level, says) for level, says in _anew(record, data)]
        except InputError as error:
            findings += [*found, Finding(directory, Level.ERROR, str(error))]
            continue
        findings += found
        if all(finding.level is not Level.ERROR for finding in found):
            sound.append(record)
    return sound, [*findings, *_twice(sound)]


def facts_of_record(record: Record) -> RecordFacts:
    """Facts in the first file of a record."""
    return record.run if isinstance(record, RunRecord) else record.facts


def _claims(record: Record, data_name: str, ours_like: OursLike) -> Iterator[Said]:
    unit = "sample" if isinstance(record, RunRecord) else "drive"
    failed = sum(row.status == "failed" for row in record.rows)
    yield from claims_of(facts_of_record(record), failed, len(record.rows), unit, data_name)
    if isinstance(record, RunRecord):
        yield from protocols_of(record)
    yield from planner_findings(facts_of_record(record), ours_like)


def _anew(record: Record, data: "DataSet") -> Iterator[Said]:
    facts = facts_of_record(record)
    of_split = list(split_findings(facts, data))
    yield from of_split
    # Scenes that the data set does not have cannot be judged.
    if set(facts.scenes) <= set(data.scene_names(facts.split)):
        yield from run_anew(record, data) if isinstance(record, RunRecord) else drives_anew(record, data)
        yield from leak_findings(record, data)


def _twice(records: Sequence[Record]) -> Iterator[Finding]:
    """Two records that would be one row of a table."""
    seen: dict[tuple[Any, ...], Path] = {}
    for record in records:
        facts = facts_of_record(record)
        measured = None if isinstance(record, RunRecord) else record.facts.measured.model_dump_json()
        key = (facts.data.name, facts.split, facts.planner.model_dump_json(exclude=_LABELS), measured)
        first = seen.setdefault(key, record.directory)
        if first != record.directory:
            yield Finding(
                record.directory,
                Level.ERROR,
                f"is the same planner on the same split as {first}; keep one of them",
            )
