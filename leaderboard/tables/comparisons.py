"""Differences between splits and between planners, with intervals."""

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from benchmark.errors import InputError
from benchmark.metrics.rates import HORIZONS, Estimate
from benchmark.metrics.scores import ScoredSamples
from benchmark.metrics.significance import PlannerComparison, SplitComparison, compare_planners, compare_splits
from benchmark.records.run import NATIVE, RunRecord
from benchmark.report.cells import CellSource, TableCell, ValueSource, join_record_names
from benchmark.report.table import Table
from benchmark.report.words import format_title, pluralise
from leaderboard.frame.rows import (
    FEW_NOTE,
    FEW_SCENES,
    completeness_notes,
    count_recordings,
    list_run_marks,
    name_cell,
    name_judge,
)
from leaderboard.frame.runs import DataSetRuns, name_judges
from leaderboard.frame.specification import (
    Columns,
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)

ComparisonResult = TypeVar("ComparisonResult")
Pair = tuple[RunRecord, RunRecord]

AVERAGE = HORIZONS[-1]
SPLIT_PAIRS = (("val", "adv"), ("val-r", "adv"), ("val", "val-r"))
"""Which splits are compared; the last pair is what rendering alone does."""
DRAWN_NOTE = (
    "Brackets: 95 % bootstrap interval; recorded scenes are resampled, each with everything made from it. An interval "
    "without 0 is a difference beyond chance; about one in twenty intervals errs."
)
REDRAWN_NOTE = (
    "val → val-r is the effect of rendering the same scenes; val-r → adv is free of it, since one renderer draws both. "
    "Rendering of the embedded data: docs/rendering.md."
)


def split_table(frame: DataSetRuns, protocol: str) -> Table | None:
    """Losses of planners between splits (``native``: by their own protocols); ``None`` if none ran on two."""
    runs = {(run.planner, run.run.split): run for run in frame.given if run.covers_split}
    pairs = [
        (runs[planner, first], runs[planner, second])
        for planner in dict.fromkeys(run.planner for run in frame.runs)
        for first, second in SPLIT_PAIRS
        if (planner, first) in runs and (planner, second) in runs
    ]
    if not pairs:
        return None
    compared, refused = _compare_pairs(frame, pairs, protocol, partial(compare_splits, horizons=(AVERAGE,)))
    comparisons, judge_words = [comparison for _, comparison in compared], name_judges(protocol)
    columns = [
        *text_columns("planner", "splits", "protocol"),
        *group_columns(f"average collision rate in %, {judge_words}", number_columns("from (%)", "to (%)", digits=2)),
        *group_columns(
            f"paired difference in points, {judge_words}", _difference_columns("paired difference (points)")
        ),
        *group_columns(f"counted, {judge_words}", number_columns("scenes paired", "not paired", "failed samples")),
    ]
    return tabulate(
        f"changes-{protocol}",
        f"{frame.data_name}: change of the average collision rate between splits, {name_judge(protocol)}",
        columns,
        [_split_row(pair, comparison) for pair, comparison in compared],
        (
            "Rates: over all scenes of each split. Paired difference: over the recorded scenes that both have, in "
            "points of per cent.",
            DRAWN_NOTE,
            *(
                [REDRAWN_NOTE]
                if any((comparison.baseline_split, comparison.split) == SPLIT_PAIRS[-1] for comparison in comparisons)
                else []
            ),
            *_list_unpaired_scenes(comparisons),
            *_notes(frame.runs, min((len(comparison.sources) for comparison in comparisons), default=FEW_SCENES)),
            *refused,
        ),
    )


def planner_table(frame: DataSetRuns, protocol: str, split: str) -> Table | None:
    """Comparison of every two planners on a split; ``None`` for fewer, and under ``native``, by which none compare."""
    here = [record for record in frame.runs if record.run.split == split]
    pairs = list(itertools.combinations([record for record in here if record.covers_split], 2))
    if not pairs or protocol == NATIVE:
        return None
    compared, refused = _compare_pairs(frame, pairs, protocol, partial(compare_planners, horizons=(AVERAGE,)))
    columns = [
        *text_columns("first", "second"),
        *group_columns(f"average collision rate in %, {protocol}", number_columns("first (%)", "second (%)", digits=2)),
        *group_columns(f"difference in points, {protocol}", _difference_columns("second − first (points)")),
        *group_columns(f"counted, {protocol}", number_columns("samples", "failed samples", "scenes not shared")),
    ]
    title = f"{format_title(frame.data_name, split)}: difference of the average collision rate between planners"
    return tabulate(
        f"planners-{split}-{protocol}",
        f"{title}, {name_judge(protocol)}",
        columns,
        [_planner_row(pair, comparison) for pair, comparison in compared],
        (
            "Both rates are over the samples that both planners planned; samples on which one of them failed are left "
            "out of both.",
            DRAWN_NOTE,
            *_notes(here, min(count_recordings(record) for record in here)),
            *refused,
        ),
    )


def _difference_columns(head: str) -> Columns:
    return estimate_columns(head, digits=2, ends=2, beside="95 % of difference", signed=True)


def _compare_pairs(
    frame: DataSetRuns,
    pairs: Sequence[Pair],
    protocol: str,
    compare: Callable[[ScoredSamples, ScoredSamples], ComparisonResult],
) -> tuple[list[tuple[Pair, ComparisonResult]], tuple[str, ...]]:
    """Pairs that can be compared, and one sentence for each reason why a pair is left out."""
    comparisons, refused = [], []
    for pair in pairs:
        try:
            comparisons.append((pair, compare(*(frame.scored(record, protocol) for record in pair))))
        except InputError as refusal:
            refused.append(f"Left out: {refusal}.")
    return comparisons, tuple(dict.fromkeys(refused))


def _split_row(runs: Pair, comparison: SplitComparison) -> Values:
    everything, both = comparison.everything[AVERAGE], ValueSource(comparison.protocol, join_record_names(*runs))
    samples = sum(run.summary.samples for run in runs)
    return {
        "planner": _name(runs[0]),
        "splits": f"{comparison.baseline_split} → {comparison.split}",
        "protocol": comparison.protocol,
        **{
            head: ValueSource(comparison.protocol, join_record_names(run)).cell(
                rate, "%", run.summary.protocols[comparison.protocol].counted, scale=100.0
            )
            for head, run, rate in zip(("from (%)", "to (%)"), runs, (everything.first, everything.second))
        },
        "paired difference (points)": _points_cell(
            both, comparison.paired[AVERAGE].difference, len(comparison.sources)
        ),
        "scenes paired": both.count(len(comparison.sources), "recorded scenes"),
        "not paired": both.count(len(comparison.only_baseline) + len(comparison.only_split), "scenes"),
        "failed samples": both.count(comparison.failed, "samples", samples),
    }


def _planner_row(runs: Pair, comparison: PlannerComparison) -> Values:
    rates, both = comparison.by_horizon[AVERAGE], ValueSource(comparison.protocol, join_record_names(*runs))
    return {
        "first": _name(runs[0]),
        "second": _name(runs[1]),
        **{
            head: ValueSource(comparison.protocol, join_record_names(run)).cell(
                rate, "%", comparison.samples, scale=100.0
            )
            for head, run, rate in zip(("first (%)", "second (%)"), runs, (rates.first, rates.second))
        },
        "second − first (points)": _points_cell(both, rates.difference, comparison.samples, "samples"),
        "samples": both.count(comparison.samples, "samples"),
        "failed samples": both.count(comparison.failed, "samples"),
        "scenes not shared": both.count(len(comparison.unshared), "scenes"),
    }


def _name(record: RunRecord) -> TableCell:
    return name_cell(record.planner, record.run.planner)


def _points_cell(origin: ValueSource, estimate: Estimate, n: int, of: str = "recorded scenes") -> CellSource:
    return origin.cell(estimate.value, "points", n, of, low=estimate.low, high=estimate.high, scale=100.0)


def _list_unpaired_scenes(comparisons: Sequence[SplitComparison]) -> list[str]:
    """Names of the scenes in no paired difference, once for all planners that leave out the same."""
    notes = []
    for comparison in comparisons:
        pair = f"{comparison.baseline_split} → {comparison.split}"
        for split, names in (
            (comparison.baseline_split, comparison.only_baseline),
            (comparison.split, comparison.only_split),
        ):
            if names:
                some = f"{', '.join(names[:3])}{', …' if len(names) > 3 else ''}"
                notes.append(f"{pair}: {pluralise(len(names), 'scene')} only in {split} ({some}).")
    return list(dict.fromkeys(notes))


def _notes(records: Sequence[RunRecord], scenes: int) -> list[str]:
    few = [FEW_NOTE] if scenes < FEW_SCENES else []
    return [*few, *list_run_marks(records), *completeness_notes(records)]
