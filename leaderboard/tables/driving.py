"""Driving scores of our runs by the definition ``nuscenes-pdm``: sub-scores, their shares of ones, totals, filtered."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from benchmark.records.driving import DEFINITION, NOTE, PDM, SUB_SCORES, TOTALS, VERSION
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import DrivingSummary
from benchmark.report.cells import Origin, Shown, origin_of
from benchmark.report.table import Brief, Table, table_of
from leaderboard.tables.rows import STALE_MARK, in_table_order, name_cell, run_notes, with_caveat_mark

_HEADS: Final = {"score": "score", "score_without_ec": "without EC", **{name: name.upper() for name in SUB_SCORES}}
_MEANS: Final = (*TOTALS, *SUB_SCORES)
_FILTERED: Final = tuple(name for name in _MEANS if name != "ec")
WORDS_NOTE: Final = (
    "NC no collision at fault, DAC drivable area, DDC driving direction, EP progress beside the recorded future, TTC "
    "time to collision, LK lane keeping, HC comfort with what was before, EC agreement with the plan before. Score: NC "
    "DAC DDC times the weighted mean of the others, over samples with a plan before; without EC over all."
)
FULL_NOTE: Final = (
    "Means of the plans in %; beside them the share of plans that have exactly 1. Filtered: a sub-score in which the "
    "recorded driver has 0 counts as 1. HC: samples with 1.5 s of recording before them; totals count it as 1 where "
    "there are none, as the official code does. Brackets: 95 % bootstrap interval over recorded scenes."
)


def driving_table(data_name: str, records: Sequence[RunRecord]) -> Table:
    """Driving scores of our runs.

    Args:
        data_name: Name of the data set, for the title.
        records: Runs on this data set; those without driving scores are named below the table.

    Returns:
        One row per planner and split; none where no run has driving scores.
    """
    runs = [
        (record, record.summary.driving) for record in in_table_order(records) if record.summary.driving is not None
    ]
    versions = ", ".join(str(version) for version in sorted({summary.version for _, summary in runs} or {VERSION}))
    title = f"{data_name}: driving scores (%), {DEFINITION} (version {versions})"
    columns = (
        *("planner", "split", "score", "95 % of score", "without EC"),
        *(_HEADS[name] for name in SUB_SCORES),
        *(f"{_HEADS[name]} = 1" for name in SUB_SCORES),
        *(f"filtered {_HEADS[name]}" for name in _FILTERED),
        *("samples", "scenes"),
    )
    notes = (f"{NOTE}.", WORDS_NOTE, *_run_notes(records))
    return table_of(
        PDM,
        title,
        columns,
        [_row(record, summary) for record, summary in runs],
        notes=(notes[0], notes[1], FULL_NOTE, *notes[2:]),
        brief=Brief(title, (*range(4), *range(5, 5 + len(SUB_SCORES))), notes, 2),
        text_columns=2,
        groups=(
            ("", 2),
            (f"total in %, {DEFINITION}", 3),
            (f"mean in %, {DEFINITION}", len(SUB_SCORES)),
            (f"share of ones in %, {DEFINITION}", len(SUB_SCORES)),
            (f"filtered by the recorded driver, mean in %, {DEFINITION}", len(_FILTERED)),
            (f"counted, {DEFINITION}", 2),
        ),
    )


def _row(record: RunRecord, summary: DrivingSummary) -> tuple[str | Shown, ...]:
    origin, name = origin_of(record, DEFINITION), driver_name(record, summary)
    score = origin.percent(summary.columns["score"]["mean"])
    return (
        *(name, record.run.split, score.shown(1), score.interval()),
        _mean(origin, summary, "score_without_ec"),
        *(_mean(origin, summary, column) for column in SUB_SCORES),
        *(origin.percent(summary.columns[column]["ones"]).shown(1) for column in SUB_SCORES),
        *(_mean(origin, summary, f"filtered_{column}") for column in _FILTERED),
        origin.count(summary.counted, "samples", record.summary.samples).shown(),
        origin.count(len(record.run.scenes), "scenes", record.run.scenes_in_split).shown(),
    )


def driver_name(record: RunRecord, summary: DrivingSummary) -> Shown:
    """The planner's name with its marks, among them that of an earlier version of the definition."""
    planner = record.run.planner
    name = name_cell(record.planner, privileged=planner.privileged, miniature=planner.miniature)
    name = with_caveat_mark(name, record.run)
    return name if summary.version == VERSION else replace(name, text=f"{name.text} {STALE_MARK}")


def _mean(origin: Origin, summary: DrivingSummary, column: str) -> Shown:
    return origin.percent(summary.columns[column]["mean"]).shown(1)


def _run_notes(records: Sequence[RunRecord]) -> list[str]:
    told = []
    for record in in_table_order(records):
        who, summary = f"{record.planner} on {record.run.split}", record.summary.driving
        if summary is None:
            told.append(
                f"{who}: no driving scores; challenger-bench rescore computes them where the data set has a map and "
                "nuScenes' categories."
            )
        elif summary.version != VERSION:
            told.append(
                f"{STALE_MARK} {who}: judged by version {summary.version} of {DEFINITION}, now {VERSION}; run "
                "challenger-bench rescore."
            )
    return run_notes(records, told)
