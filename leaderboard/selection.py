"""Which run records may stand in tables together."""

from collections.abc import Sequence

from benchmark.errors import InputError
from benchmark.records.planner_versions import labelled
from benchmark.records.run import RunRecord
from benchmark.report.words import split_of


def one_run_each(records: Sequence[RunRecord]) -> list[RunRecord]:
    """The record that stands for each version of a planner on each split of each data set.

    Versions are told apart by `benchmark.records.planner_versions`. A run of the whole split goes
    before runs of some of its scenes; of those the one with most scenes is taken.

    Args:
        records: Any records.

    Returns:
        At most one record for each data set, split and planner, in an order that does not depend on the input's.

    Raises:
        InputError: If two records cover the same split with the same planner, or runs on one split of one data set
            saw different content.
    """
    chosen: dict[tuple[str, str, str], RunRecord] = {}
    for record in sorted(labelled(records), key=_preference):
        key = (record.run.data.name, record.run.split, record.planner)
        first = chosen.setdefault(key, record)
        if first is not record and record.covers_split:
            raise InputError(
                f"{first.directory} and {record.directory} both hold {record.planner} on split {record.run.split}; "
                "move one of them away or name the records' folder with --records"
            )
    found = list(chosen.values())
    _require_same_content(found)
    return sorted(found, key=lambda record: (record.run.data.name, record.run.split, record.planner))


def _preference(record: RunRecord) -> tuple[bool, int, list[str], str]:
    return not record.covers_split, -len(record.run.scenes), record.run.scenes, record.directory.as_posix()


def _require_same_content(records: Sequence[RunRecord]) -> None:
    """Numbers on different scenes under one name would be taken for comparable."""
    seen: dict[tuple[str, str], RunRecord] = {}
    for record in records:
        first = seen.setdefault((record.run.data.name, record.run.split), record)
        if first.run.data.fingerprint != record.run.data.fingerprint:
            raise InputError(
                f"{first.directory} and {record.directory} ran on different content of "
                f"{split_of(record.run.split, record.run.data.name)} (the data fingerprints differ); run "
                "challenger-bench eval again for the older "
                "one, or move it away"
            )
