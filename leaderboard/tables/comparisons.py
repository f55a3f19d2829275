"""Differences between splits and between planners, with intervals."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeVar

from benchmark.errors import InputError
from benchmark.metrics.rates import HORIZONS, Estimate
from benchmark.metrics.scores import Scored, scored
from benchmark.metrics.significance import PlannerComparison, SplitComparison, compare_planners, compare_splits
from benchmark.records.run import NATIVE, RunRecord, protocol_of
from benchmark.report.cells import Cell, Origin, Shown, record_name
from benchmark.report.table import Table, table_of
from benchmark.report.words import counted, titled
from leaderboard.tables.rows import (
    FEW_NOTE,
    FEW_SCENES,
    completeness_notes,
    in_table_order,
    judges,
    name_cell,
    notes_of_marks,
    recordings,
)

Found = TypeVar("Found")

AVERAGE = HORIZONS[-1]
SPLIT_PAIRS = (("val", "adv"), ("val-r", "adv"), ("val", "val-r"))
"""Which splits are compared; the last pair is what rendering alone does."""
DRAWN_NOTE = (
    "Brackets: 95 % bootstrap interval; recorded scenes are drawn, each with everything made from it. An interval "
    "without 0 is a difference beyond chance; of twenty intervals about one errs."
)


REDRAWN_NOTE = (
    "val → val-r is what drawing the same scenes again does; val-r → adv is free of it, since one renderer draws both. "
    "How the embedded data are drawn again: docs/rendering.md."
)


class Verdicts:
    """Reads each record's verdicts under each protocol once."""

    def __init__(self) -> None:
        self._read: dict[tuple[int, str], tuple[RunRecord, Scored]] = {}

    def scored(self, record: RunRecord, protocol: str) -> Scored:
        """The same as `benchmark.metrics.scores.scored`.

        Args:
            record: The record.
            protocol: Whose verdicts.

        Returns:
            The values.

        Raises:
            InputError: If the record has no present verdicts of the protocol.
        """
        key = id(record), protocol_of(record, protocol)
        if key not in self._read:
            # The record is kept with them: nothing else can then have its identity.
            self._read[key] = record, scored(record, protocol=protocol)
        return self._read[key][1]

    def compared(
        self,
        pairs: Sequence[tuple[RunRecord, RunRecord]],
        protocol: str,
        compare: Callable[[Scored, Scored], Found],
    ) -> tuple[list[Found], tuple[str, ...]]:
        """Compare what can be compared.

        Args:
            pairs: Pairs of records.
            protocol: Whose verdicts.
            compare: The comparison.

        Returns:
            Comparisons, and one sentence for each reason why a pair is left out.
        """
        found, refused = [], []
        for first, second in pairs:
            try:
                found.append(compare(self.scored(first, protocol), self.scored(second, protocol)))
            except InputError as refusal:
                refused.append(f"Left out: {refusal}.")
        return found, tuple(dict.fromkeys(refused))


def split_table(
    data_name: str, protocol: str, records: Sequence[RunRecord], verdicts: Verdicts | None = None
) -> Table | None:
    """What a planner loses from one split to another.

    Args:
        data_name: Name of the data set, for the title.
        protocol: Whose verdicts; ``native`` for each planner's own.
        records: Runs on this data set.
        verdicts: What was read for other tables.

    Returns:
        One row per planner and pair of splits, or ``None`` if no planner ran on two of them.
    """
    runs = {(run.planner, run.run.split): run for run in records if run.covers_split}
    planners = list(dict.fromkeys(run.planner for run in in_table_order(records)))
    wanted = [
        (runs[planner, first], runs[planner, second])
        for planner in planners
        for first, second in SPLIT_PAIRS
        if (planner, first) in runs and (planner, second) in runs
    ]
    if not wanted:
        return None
    found, refused = (verdicts or Verdicts()).compared(wanted, protocol, partial(compare_splits, horizons=(AVERAGE,)))
    who = "own protocol" if protocol == NATIVE else protocol
    return table_of(
        f"changes-{protocol}",
        f"{data_name}: change of the average collision rate between splits, {judges(protocol)}",
        (
            *("planner", "splits", "protocol", "from (%)", "to (%)"),
            *("paired difference (points)", "95 % of difference", "scenes paired", "not paired", "failed samples"),
        ),
        [_split_row(comparison, runs) for comparison in found],
        notes=(
            "Rates: over all scenes of each split. Paired difference: over the recorded scenes that both have, in "
            "points of per cent.",
            DRAWN_NOTE,
            *([REDRAWN_NOTE] if any((one.baseline_split, one.split) == SPLIT_PAIRS[-1] for one in found) else []),
            *_unpaired(found),
            *_common_notes(records, min((len(comparison.sources) for comparison in found), default=FEW_SCENES)),
            *refused,
        ),
        text_columns=3,
        groups=(
            ("", 3),
            (f"average collision rate in %, {who}", 2),
            (f"paired difference in points, {who}", 2),
            (f"counted, {who}", 3),
        ),
    )


def planner_table(
    data_name: str, split: str, protocol: str, records: Sequence[RunRecord], verdicts: Verdicts | None = None
) -> Table | None:
    """Which planner is better on a split.

    Args:
        data_name: Name of the data set, for the title.
        split: The split.
        protocol: Whose verdicts; not ``native``, under which no two planners compare.
        records: Runs on this data set.
        verdicts: What was read for other tables.

    Returns:
        One row per pair of planners, or ``None`` if fewer than two ran on the whole split.
    """
    here = [record for record in in_table_order(records) if record.run.split == split]
    pairs = list(itertools.combinations([record for record in here if record.covers_split], 2))
    if not pairs:
        return None
    found, refused = (verdicts or Verdicts()).compared(pairs, protocol, partial(compare_planners, horizons=(AVERAGE,)))
    by_name = {record.planner: record for record in here}
    return table_of(
        f"planners-{split}-{protocol}",
        f"{titled(data_name, split)}: difference of the average collision rate between planners, {judges(protocol)}",
        (
            *("first", "second", "first (%)", "second (%)", "second − first (points)", "95 % of difference"),
            *("samples", "failed samples", "scenes not shared"),
        ),
        [_planner_row(comparison, by_name) for comparison in found],
        notes=(
            "Both rates are over the samples that both planners planned; samples that one of them failed on are left "
            "out of both.",
            DRAWN_NOTE,
            *_common_notes(here, min(recordings(record) for record in here)),
            *refused,
        ),
        text_columns=2,
        groups=(
            ("", 2),
            (f"average collision rate in %, {protocol}", 2),
            (f"difference in points, {protocol}", 2),
            (f"counted, {protocol}", 3),
        ),
    )


def _split_row(comparison: SplitComparison, runs: Mapping[tuple[str, str], RunRecord]) -> tuple[str | Shown, ...]:
    everything, paired = comparison.everything[AVERAGE], comparison.paired[AVERAGE]
    judge, splits = comparison.protocol, (comparison.baseline_split, comparison.split)
    sides = [runs[comparison.planner, split] for split in splits]
    counted = [run.summary.protocols[judge].counted for run in sides]
    both = Origin(judge, record_name(*sides))
    difference, scenes = _points(both, paired.difference, len(comparison.sources)), len(comparison.sources)
    unpaired = len(comparison.only_baseline) + len(comparison.only_split)
    return (
        name_cell(comparison.planner, privileged=comparison.privileged, miniature=comparison.miniature),
        f"{comparison.baseline_split} → {comparison.split}",
        judge,
        *(
            Origin(judge, record_name(run)).cell(rate, "%", count, scale=100.0).shown(2)
            for run, rate, count in zip(sides, (everything.first, everything.second), counted)
        ),
        *(difference.shown(2, signed=True), difference.interval(2)),
        both.count(scenes, "recorded scenes").shown(),
        both.count(unpaired, "scenes").shown(),
        both.count(comparison.failed, "samples", sum(run.summary.samples for run in sides)).shown(),
    )


def _planner_row(comparison: PlannerComparison, by_name: Mapping[str, RunRecord]) -> tuple[str | Shown, ...]:
    found, judge = comparison.by_horizon[AVERAGE], comparison.protocol
    sides = [by_name[name] for name in comparison.planners]
    both = Origin(judge, record_name(*sides))
    difference = _points(both, found.difference, comparison.samples, "samples")
    return (
        *(
            name_cell(name, privileged=seen, miniature=small)
            for name, seen, small in zip(comparison.planners, comparison.privileged, comparison.miniatures)
        ),
        *(
            Origin(judge, record_name(run)).cell(rate, "%", comparison.samples, scale=100.0).shown(2)
            for run, rate in zip(sides, (found.first, found.second))
        ),
        *(difference.shown(2, signed=True), difference.interval(2)),
        both.count(comparison.samples, "samples").shown(),
        both.count(comparison.failed, "samples").shown(),
        both.count(len(comparison.unshared), "scenes").shown(),
    )


def _points(origin: Origin, estimate: Estimate, n: int, of: str = "recorded scenes") -> Cell:
    return origin.cell(estimate.value, "points", n, of, low=estimate.low, high=estimate.high, scale=100.0)


def _unpaired(comparisons: Sequence[SplitComparison]) -> list[str]:
    """Names the scenes that are in no paired difference, once for all planners that leave out the same."""
    notes = []
    for comparison in comparisons:
        pair = f"{comparison.baseline_split} → {comparison.split}"
        for split, names in (
            (comparison.baseline_split, comparison.only_baseline),
            (comparison.split, comparison.only_split),
        ):
            if names:
                some = f"{', '.join(names[:3])}{', …' if len(names) > 3 else ''}"
                notes.append(f"{pair}: {counted(len(names), 'scene')} only in {split} ({some}).")
    return list(dict.fromkeys(notes))


def _common_notes(records: Sequence[RunRecord], scenes: int) -> list[str]:
    few = [FEW_NOTE] if scenes < FEW_SCENES else []
    return [*few, *notes_of_marks(records), *completeness_notes(in_table_order(records))]
