"""Driving scores of our runs by the definition ``nuscenes-pdm``: sub-scores, their shares of ones, totals, filtered."""

from dataclasses import replace
from typing import Any, Final

from benchmark.records.driving import DEFINITION, NOTE, PDM, SUB_SCORES, VERSION
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import DrivingSummary
from benchmark.report.cells import TableCell
from benchmark.report.table import Table
from leaderboard.frame.rows import STALE_MARK, run_notes
from leaderboard.frame.runs import DataSetRuns, RunRow
from leaderboard.frame.specification import (
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)

HEADS: Final = {"score": "score", "score_without_ec": "without EC", **{name: name.upper() for name in SUB_SCORES}}
_SUB_HEADS: Final = [HEADS[name] for name in SUB_SCORES]
_FILTERED: Final = [head for name, head in HEADS.items() if name != "ec"]
_COLUMNS: Final = [
    *text_columns("planner", "split"),
    *group_columns(f"total in %, {DEFINITION}", estimate_columns("score"), number_columns("without EC", digits=1)),
    *group_columns(f"mean in %, {DEFINITION}", number_columns(*_SUB_HEADS, digits=1)),
    *group_columns(
        f"share of ones in %, {DEFINITION}", number_columns(*(f"{head} = 1" for head in _SUB_HEADS), digits=1)
    ),
    *group_columns(
        f"filtered by the recorded driver, mean in %, {DEFINITION}",
        number_columns(*(f"filtered {head}" for head in _FILTERED), digits=1),
    ),
    *group_columns(f"counted, {DEFINITION}", number_columns("samples", "scenes")),
]
WORDS_NOTE: Final = (
    "NC no collision at fault, DAC drivable area, DDC driving direction, EP progress beside the recorded future, TTC "
    "time to collision, LK lane keeping, HC comfort including the past, EC agreement with the previous plan. Score: NC "
    "DAC DDC times the weighted mean of the others, over samples with a previous plan; without EC over all."
)
FULL_NOTE: Final = (
    "Means of the plans in %; beside them the share of plans that have exactly 1. Filtered: a sub-score in which the "
    "recorded driver has 0 counts as 1. HC: samples with 1.5 s of recording before them; totals count it as 1 where "
    "there are none, as in the official code. Brackets: 95 % bootstrap interval over recorded scenes."
)


def driving_table(frame: DataSetRuns) -> Table:
    """Driving scores, one row per planner and split; runs without them are named below."""
    rows = frame.rows(DEFINITION, _find_driving)
    versions = ", ".join(str(version) for version in sorted({row.found.version for row in rows} or {VERSION}))
    title = f"{frame.data_name}: driving scores (%), {DEFINITION} (version {versions})"
    run_notes = _notes(frame)
    return tabulate(
        PDM,
        title,
        _COLUMNS,
        map(_values, rows),
        (f"{NOTE}.", WORDS_NOTE, FULL_NOTE, *run_notes),
        brief=("planner", "split", "score", "95 % of score", *_SUB_HEADS),
        brief_notes=(f"{NOTE}.", WORDS_NOTE, *run_notes),
    )


def driving_tables(frame: DataSetRuns) -> list[Table]:
    """`driving_table`, where any run has driving scores."""
    return [driving_table(frame)] if any(record.summary.driving is not None for record in frame.runs) else []


def _values(row: RunRow[DrivingSummary]) -> Values:
    rates, percent = row.found.columns, row.origin.percent
    return {
        "planner": format_planner_name(row),
        "split": row.split,
        **{head: percent(rates[name]["mean"]) for name, head in HEADS.items()},
        **{f"{HEADS[name]} = 1": percent(rates[name]["ones"]) for name in SUB_SCORES},
        **{f"filtered {HEADS[name]}": percent(rates[f"filtered_{name}"]["mean"]) for name in HEADS if name != "ec"},
        "samples": row.samples(row.found.counted),
        "scenes": row.scenes_of_split(),
    }


def format_planner_name(row: RunRow[Any]) -> TableCell:
    """The planner's name with its marks, among them that of an earlier version of the definition."""
    name, summary = row.with_caveats, row.record.summary.driving
    earlier = summary is not None and summary.version != VERSION
    return replace(name, text=f"{name.text} {STALE_MARK}") if earlier else name


def _find_driving(record: RunRecord) -> DrivingSummary | None:
    return record.summary.driving


def _notes(frame: DataSetRuns) -> list[str]:
    sentences = []
    for record in frame.runs:
        run_name, summary = f"{record.planner} on {record.run.split}", record.summary.driving
        if summary is None:
            sentences.append(
                f"{run_name}: no driving scores; challenger-bench rescore computes them where the data set has a map "
                "and nuScenes' categories."
            )
        elif summary.version != VERSION:
            sentences.append(
                f"{STALE_MARK} {run_name}: scored by version {summary.version} of {DEFINITION}, now {VERSION}; run "
                "challenger-bench rescore."
            )
    return run_notes(frame.given, sentences)
