"""Shared parts of table rows: their order, names and marks, and notes on the runs behind them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, Protocol

from benchmark.metrics.scores import find_protocol_version, map_scenes_to_sources
from benchmark.records.planner_versions import list_file_notes
from benchmark.records.review import NOT_REVIEWED, describe_review
from benchmark.records.run import NATIVE, RunRecord
from benchmark.records.run_schema import RecordFacts
from benchmark.records.seed_splits import is_adversarial
from benchmark.report.cells import MINIATURE_MARK, MINIATURE_WORDS, TableCell
from benchmark.report.words import pluralise

SPLIT_ORDER = ("val", "val-r", "adv")
PRIVILEGED_MARK = "†"
PRIVILEGED_NOTE = f"{PRIVILEGED_MARK} privileged: sees boxes, the map or the recorded future; a reference row."
STALE_MARK = "‡"
REPRODUCED_MARK = "✓"
CAVEAT_MARK = "¶"
OLDER_WORDS = (
    "older records, without information on annotations; rates may count scenes without annotations as "
    "free of contacts until you run challenger-bench rescore"
)
MINIATURE_NOTE = f"{MINIATURE_WORDS} (docs/miniatures.md)."
OFF_SCALE: Final = "stop"
"""It is hit wherever it stands: figures whose axis had to reach it would show nothing of the others."""
FEW_SCENES = 20
"""Below this many recorded scenes the intervals are clearly too narrow (docs/studies/intervals.md)."""
FEW_NOTE = f"Fewer than {FEW_SCENES} recorded scenes: the intervals are too narrow, only an indication."


def split_sort_key(split: str) -> tuple[int, str]:
    """Place by which splits are sorted: the paper's three first, the others by name."""
    return SPLIT_ORDER.index(split) if split in SPLIT_ORDER else len(SPLIT_ORDER), split


def list_splits(records: Iterable[RunRecord]) -> list[str]:
    """Splits that were run, in their order."""
    return sorted({record.run.split for record in records}, key=split_sort_key)


def sort_for_tables(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Records by planner (privileged ones last), then split."""
    return sorted(
        records, key=lambda record: (record.run.planner.privileged, record.planner, split_sort_key(record.run.split))
    )


def mark_planner_name(planner: str, *, privileged: bool, miniature: bool) -> str:
    """The planner's name; marks tell that it saw what no car sees, and that it is a miniature."""
    return " ".join((planner, *([PRIVILEGED_MARK] if privileged else []), *([MINIATURE_MARK] if miniature else [])))


class PlannerFlags(Protocol):
    """Anything that says what a planner is."""

    @property
    def privileged(self) -> bool:
        """Whether the planner is privileged."""

    @property
    def miniature(self) -> bool:
        """Whether it is a miniature, which is not for ranking."""


def name_cell(planner: str, facts: PlannerFlags) -> TableCell:
    """`mark_planner_name` as the cell of a row about the planner."""
    return TableCell(
        mark_planner_name(planner, privileged=facts.privileged, miniature=facts.miniature), miniature=facts.miniature
    )


def row_name(record: RunRecord, judge: str) -> TableCell:
    """The planner's name with its marks, among them that of an earlier version of the protocol."""
    cell = name_cell(record.planner, record.run.planner)
    if record.reproduced is not None:
        cell = replace(cell, text=f"{cell.text} {REPRODUCED_MARK}")
    cell = add_caveat_mark(cell, record.run)
    return replace(cell, text=f"{cell.text} {STALE_MARK}") if judge in record.stale_protocols else cell


def add_caveat_mark(cell: TableCell, facts: RecordFacts) -> TableCell:
    """The name of a row, marked where its numbers needed something that they did not get."""
    return replace(cell, text=f"{cell.text} {CAVEAT_MARK}") if facts.caveats else cell


def caveat_notes(records: Iterable[RecordFacts]) -> list[str]:
    """Notes on unmet needs of the numbers of runs or drives, one for each caveat and split, with its planners.

    One more is for older records, of which it is not known whether their scenes are annotated.
    """
    planners: dict[tuple[str, str], list[str]] = {}
    older: list[str] = []
    for facts in records:
        for caveat in facts.caveats:
            planners.setdefault((facts.split, caveat.sentence), []).append(facts.planner.name)
        if not facts.says_truth:
            older.append(f"{facts.planner.name} on {facts.split}")
    notes = [
        f"{CAVEAT_MARK} {', '.join(dict.fromkeys(names))} on {split}: {sentence}."
        for (split, sentence), names in planners.items()
    ]
    return [*notes, *([f"{', '.join(dict.fromkeys(older))}: {OLDER_WORDS}."] if older else [])]


def mark_notes(*, privileged: bool, miniature: bool) -> list[str]:
    """Notes on the marks of the planners' names, where any planner of a table has them."""
    return [*([PRIVILEGED_NOTE] if privileged else []), *([MINIATURE_NOTE] if miniature else [])]


def list_planner_marks(planners: Iterable[PlannerFlags]) -> list[str]:
    """`mark_notes` of the planners of a table."""
    facts = list(planners)
    return mark_notes(
        privileged=any(planner.privileged for planner in facts), miniature=any(planner.miniature for planner in facts)
    )


def list_run_marks(records: Iterable[RunRecord]) -> list[str]:
    """`mark_notes` of the planners of some runs."""
    records = list(records)
    reproductions = dict.fromkeys(
        (record.planner, record.reproduced) for record in records if record.reproduced is not None
    )
    return [
        *list_planner_marks(record.run.planner for record in records),
        *(
            f"{REPRODUCED_MARK} {planner}: reproduced: the same weights, code and options gave {whose}."
            for planner, whose in reproductions
        ),
    ]


def stale_notes(record: RunRecord, protocols: Sequence[str]) -> list[str]:
    """One sentence for each of the protocols that judged a run in another version than the present one."""
    return [
        f"{STALE_MARK} {record.planner} on {record.run.split}: scored by version {record.run.protocols[name]} of "
        f"protocol {name}, now {find_protocol_version(name)}; run challenger-bench rescore."
        for name in protocols
        if name in record.stale_protocols
    ]


def name_judge(protocol: str) -> str:
    """Judge of a protocol, as titles name it."""
    return "each planner under its own protocol" if protocol == NATIVE else f"protocol {protocol}"


def count_recordings(record: RunRecord) -> int:
    """Number of recorded scenes that a run's scenes come from: what its intervals rest on."""
    return len(set(map_scenes_to_sources(record).values()))


def run_notes(records: Sequence[RunRecord], told: Sequence[str]) -> list[str]:
    """Notes behind a table, in its order: marks, missing inputs, few scenes, verdicts, ``told``, partial runs."""
    few = [FEW_NOTE] if any(count_recordings(record) < FEW_SCENES for record in records) else []
    lacking = caveat_notes(record.run for record in records)
    return [*list_run_marks(records), *lacking, *few, *review_notes(records), *told, *completeness_notes(records)]


def review_notes(records: Iterable[RunRecord]) -> list[str]:
    """Notes of inspectors on each split that has adversaries or a review; one sentence for all that have none."""
    reviews = {record.run.split: record.run.review for record in records if record.run.review is not None}
    notes = [f"{split}: {describe_review(reviews[split])}." for split in sorted(reviews, key=split_sort_key)]
    unreviewed_splits = {
        record.run.split for record in records if record.run.split not in reviews and _has_adversaries(record)
    }
    return [
        *notes,
        *(
            [f"{', '.join(sorted(unreviewed_splits, key=split_sort_key))}: {NOT_REVIEWED} by hand."]
            if unreviewed_splits
            else []
        ),
    ]


def _has_adversaries(record: RunRecord) -> bool:
    known = record.run.scene_facts.values()
    return is_adversarial(record.run.split) or any(facts.adversaries for facts in known)


def completeness_notes(records: Sequence[RunRecord]) -> list[str]:
    """One sentence for each run whose plans come from a file, with failed samples, or of a part of its split."""
    notes = list_file_notes(records)
    for record in records:
        run_name = f"{record.planner} on {record.run.split}"
        if not record.complete:
            summary = record.summary
            notes.append(
                f"{run_name}: {pluralise(summary.failed, 'sample')} failed. The rates cover "
                f"{100 * summary.coverage:.1f} % of {pluralise(summary.samples, 'sample')}."
            )
        if not record.covers_split:
            notes.append(f"{run_name}: {describe_split_part(len(record.run.scenes), record.run.scenes_in_split)}.")
    return notes


def describe_split_part(scenes: int, in_split: int) -> str:
    """Part of a split that there is, in words."""
    return f"{scenes} of {pluralise(in_split, 'scene')} of the split"
