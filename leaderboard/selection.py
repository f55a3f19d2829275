"""Which run records may stand in tables together."""

from collections.abc import Sequence

from benchmark.errors import InputError
from benchmark.records.planner_versions import labelled
from benchmark.records.review import NOT_REVIEWED
from benchmark.records.run import RunRecord
from benchmark.report.words import split_of


def one_run_each(records: Sequence[RunRecord]) -> list[RunRecord]:
    """The record that stands for each version of a planner on each split of each data set.

    Versions are told apart by `benchmark.records.planner_versions`. A run of the whole split goes before runs of some
    of its scenes; of those the one with most scenes is taken. The order does not depend on the input's.

    An `InputError` says that two records cover the same split with the same planner, that runs on one split of one
    data set saw different content, or that adversarial scenes were recorded under the name of another split.
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
    _require_one_split(found)
    return sorted(found, key=lambda record: (record.run.data.name, record.run.split, record.planner))


def _preference(record: RunRecord) -> tuple[bool, int, list[str], str]:
    return not record.covers_split, -len(record.run.scenes), record.run.scenes, record.directory.as_posix()


def _require_same_content(records: Sequence[RunRecord]) -> None:
    """Numbers on different scenes under one name would be taken for comparable."""
    seen: dict[tuple[str, str], RunRecord] = {}
    for record in records:
        first = seen.setdefault((record.run.data.name, record.run.split), record)
        if first.judged_content[1] != record.judged_content[1]:
            raise InputError(
                f"{first.directory} and {record.directory} ran under different verdicts of inspectors on "
                f"{split_of(record.run.split, record.run.data.name)} ({_verdicts(first)} and {_verdicts(record)}); run "
                "challenger-bench eval again for the older one, or move it away"
            )
        if first.run.data.fingerprint != record.run.data.fingerprint:
            raise InputError(
                f"{first.directory} and {record.directory} ran on different content of "
                f"{split_of(record.run.split, record.run.data.name)} (the data fingerprints differ); run "
                "challenger-bench eval again for the older "
                "one, or move it away"
            )


def _verdicts(record: RunRecord) -> str:
    review = record.run.review
    return NOT_REVIEWED if review is None else f"review {review.content[:12]}"


def _require_one_split(records: Sequence[RunRecord]) -> None:
    """Adversarial scenes under the name of another split would be compared with themselves: an increase of 0."""
    adversarial = {_scenes(record): record for record in records if record.run.split == "adv"}
    for record in records:
        same = adversarial.get(_scenes(record))
        if same is not None and record is not same and record.run.split != "adv":
            raise InputError(
                f"{record.directory} and {same.directory} hold the same scenes of {record.run.data.name} as split "
                f"{record.run.split} and as split adv; remove the first, which is no {record.run.split}"
            )
        made = sorted(name for name, facts in record.run.scene_facts.items() if facts.manoeuvre is not None)
        if made and record.run.split == "val":
            raise InputError(
                f"{record.directory} calls scenes val that have a generated adversary ({made[0]}); remove it and run "
                "challenger-bench eval --split adv"
            )


def _scenes(record: RunRecord) -> tuple[str, str, tuple[str, ...]]:
    return record.run.data.name, record.run.data.fingerprint, tuple(record.run.scenes)
