"""Table 1 of the paper: collision rate over 1, 2 and 3 seconds, by planner and split, ours and the published ones."""

from collections.abc import Sequence

from benchmark.metrics.rates import HORIZONS
from benchmark.metrics.scores import leaves_out_samples, takes_maxima
from benchmark.published import TABLE_1_SOURCE
from benchmark.records.driving import PDM
from benchmark.records.run import NATIVE, RunRecord, resolve_protocol
from benchmark.records.run_schema import ProtocolSummary
from benchmark.report.table import Table
from leaderboard.frame.rows import run_notes, stale_notes
from leaderboard.frame.runs import DataSetRuns, RunRow, choose_protocols, list_judged_rows, name_judges
from leaderboard.frame.specification import (
    Value,
    Values,
    group_columns,
    interval_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.tables.attacks import success_table
from leaderboard.tables.driving import driving_table
from leaderboard.tables.effect import effect_table
from leaderboard.tables.further_columns import further_table
from leaderboard.tables.longer_plans import longer_table
from leaderboard.tables.published import find_published_rate, is_model_variant, quote_rates

BRIEF_NOTE = (
    "Brackets: 95 % bootstrap interval over recorded scenes; a dash if there are fewer than two or all of them agree."
)
_BRIEF = ("planner", "split", "protocol", "col. avg", "95 % of col. avg", "L2 avg", "scenes failed")
"""Columns in a terminal; L2 exposes nonsense at once."""
BEFORE_MASK = "collision_before_mask"
MASK_COLUMNS = ("avg before mask", "steps masked", "masked for adversaries", "masked for others")
_MASK_NOTE = (
    "Mask: steps at which the recorded ego collides too, under the same protocol, do not count. Before it: the "
    "average without that exclusion; masked: number of removed colliding steps at which the recorded ego "
    "touches an adversary, and at which it touches only other objects. Where a protocol leaves out whole "
    "samples (safemvdrive), the colliding steps of these are counted, and there is no average before it."
)
_PAPER_NOTE = (
    "Paper: its numbers for the model of that name under the same protocol on nuScenes-val, nuScenes-val-R "
    "and Adv-nuSc; on other data they are a reference, not a target."
)


def collision_table(frame: DataSetRuns, protocol: str) -> Table:
    """Collision rates and L2 of our runs under one protocol, or the paper's Table 1; one row per planner and split.

    Rates come with the 95 % scene-bootstrap interval of their average, what the protocol's exclusion of recorded
    collisions removed (where it has one), and what was counted. ``native`` is each planner's own protocol: then
    planners without one come after the others, under ``exact``, and those whose own protocol takes maxima or latches
    stand in its own table alone.
    """
    title = f"{frame.data_name}: collision rate (%) and L2 (m), "
    if protocol == NATIVE:
        maxima = [record for record in frame.runs if takes_maxima(record.native_protocol)]
        runs = [record for record in frame.runs if not takes_maxima(record.native_protocol)]
        runs.sort(key=lambda record: record.run.planner.native_protocol is None)
        title += "each planner under its own protocol"
        return _table(runs, protocol, title, _native_notes(runs, maxima))
    versions = ", ".join(str(version) for version in sorted({row.found.version for row in frame.judged(protocol)}))
    return _table(frame.runs, protocol, f"{title}protocol {protocol} (version {versions})", ())


def _native_notes(runs: Sequence[RunRecord], maxima: Sequence[RunRecord]) -> list[str]:
    without = any(record.run.planner.native_protocol is None for record in runs)
    exact_note = " The last rows, under exact, are planners without a published repository." if without else ""
    return [
        "As in the paper, each row quotes the protocol of the planner's own repository: rows of different "
        f"protocols are not comparable.{exact_note}",
        *(
            f"{record.planner} on {record.run.split}: {record.native_protocol} reports any contact "
            "up to the horizon, which is not comparable with values at a step or means; see its own table."
            for record in maxima
        ),
    ]


def run_tables(
    data_name: str,
    records: Sequence[RunRecord],
    protocols: Sequence[str] | None = None,
    *,
    allow_partial: bool = False,
    against: Sequence[RunRecord] = (),
) -> list[Table]:
    """The tables that ``challenger-bench eval`` prints.

    Args:
        data_name: Name of the data set, for the titles.
        records: Runs on this data set.
        protocols: Protocols, ``native`` or ``pdm``; by default ``exact``, and ``native`` where a planner has one of its
            own.
        allow_partial: Whether runs count in which the planner failed on samples; their rates leave those out.
        against: Further records that runs on adversarial splits may be compared with, the newest last.

    Returns:
        Unasked the effect of adversaries first, where there are some. One table for each protocol, one more for its
        further rates where it has some, and unasked one for plans that go on beyond 3 s and one for attack success
        where there are adversaries; none if there are no runs to show.
    """
    chosen_runs = DataSetRuns(data_name, [record for record in records if allow_partial or record.complete], against)
    unasked = protocols is None
    tables: list[Table | None] = [effect_table(chosen_runs)] if unasked else []
    for name in choose_protocols(chosen_runs, protocols) if chosen_runs.runs else ():
        tables += (
            [driving_table(chosen_runs)]
            if name == PDM
            else [collision_table(chosen_runs, name), further_table(chosen_runs, name)]
        )
    tables += [longer_table(chosen_runs), success_table(chosen_runs)] if unasked else []
    return [table for table in tables if table is not None]


def _table(runs: Sequence[RunRecord], protocol: str, title: str, notes: Sequence[str]) -> Table:
    rows, judge_words, own = list_judged_rows(runs, protocol), name_judges(protocol), protocol == NATIVE
    has_mask = any(map(_has_mask, rows))
    has_paper = any(find_published_rate(row.record, row.judge) is not None for row in rows)
    columns = [
        *text_columns("planner", "split", *(("protocol",) if own else ())),
        *group_columns(
            f"collision rate in %, {judge_words}",
            number_columns(*(f"col. {horizon}" for horizon in HORIZONS), digits=2),
            interval_columns({"95 % of avg": "col. avg"}),
        ),
        *(
            group_columns(
                f"mask, {judge_words}", number_columns(MASK_COLUMNS[0], digits=2), number_columns(*MASK_COLUMNS[1:])
            )
            if has_mask
            else ()
        ),
        *group_columns(f"L2 in m, {judge_words}", number_columns(*(f"L2 {horizon}" for horizon in HORIZONS), digits=2)),
        *group_columns(
            f"counted, {judge_words}",
            number_columns("samples", "scenes", "scenes failed"),
            number_columns("coverage", digits=1),
        ),
        *group_columns(
            f"paper, collision rate in %, {judge_words}",
            number_columns(*(f"paper {horizon}" for horizon in HORIZONS if has_paper)),
        ),
    ]
    further_notes = _run_notes(runs, protocol)
    of_columns = [
        *([_PAPER_NOTE] if has_paper else []),
        *_list_variant_notes(runs, protocol),
        *([_MASK_NOTE] if has_mask else []),
    ]
    return tabulate(
        f"collision-{protocol}",
        title,
        columns,
        map(_values, rows),
        (*notes, BRIEF_NOTE, *of_columns, *further_notes),
        brief=_BRIEF,
        brief_notes=(*notes, *further_notes),
        sources=(TABLE_1_SOURCE,) if has_paper else (),
    )


def _values(row: RunRow[ProtocolSummary]) -> Values:
    summary, origin = row.found, row.origin
    paper = quote_rates(find_published_rate(row.record, row.judge))
    decided = summary.scenes_decided
    return {
        **row.names,
        "protocol": row.judge,
        **row.by_horizon("col. {}", "collision", summary.columns["collision"]),
        **(_mask_values(row) if _has_mask(row) else {}),
        **row.by_horizon("L2 {}", "l2", summary.columns["l2"]),
        "samples": row.samples(summary.counted),
        "scenes": row.scenes_of_split(),
        "scenes failed": origin.count(summary.scenes_failed, "scenes", decided).shown(after=f"/{decided}"),
        "coverage": origin.cell(row.record.summary.coverage, "%", row.record.summary.samples, scale=100.0),
        **{f"paper {horizon}": rate for horizon, rate in zip(HORIZONS, paper, strict=True)},
    }


def _mask_values(row: RunRow[ProtocolSummary]) -> dict[str, Value]:
    """Values of a mask; where whole samples are left out there is no rate of the same samples without that."""
    summary, masked = row.found, row.found.mask_removed_steps
    before = summary.columns.get(BEFORE_MASK)
    counts = (masked, summary.mask_removed_for_adversary, _count_masked(summary))
    return {
        MASK_COLUMNS[0]: None if before is None else row.origin.percent(before["avg"]),
        **{head: row.origin.count(count, "steps", masked) for head, count in zip(MASK_COLUMNS[1:], counts)},
    }


def _has_mask(row: RunRow[ProtocolSummary]) -> bool:
    return BEFORE_MASK in row.found.columns or leaves_out_samples(row.judge)


def _count_masked(summary: ProtocolSummary) -> int | None:
    masked, for_adversary = summary.mask_removed_steps, summary.mask_removed_for_adversary
    return None if masked is None or for_adversary is None else masked - for_adversary


def _run_notes(runs: Sequence[RunRecord], protocol: str) -> list[str]:
    sentences = []
    for record in runs:
        judge, run_name = resolve_protocol(record, protocol), f"{record.planner} on {record.run.split}"
        if judge not in record.summary.protocols:
            sentences.append(f"{run_name}: no verdicts under protocol {judge}; run challenger-bench rescore.")
        sentences += stale_notes(record, (judge,))
    return run_notes(runs, sentences)


def _list_variant_notes(runs: Sequence[RunRecord], protocol: str) -> list[str]:
    """Planners without published numbers beside them."""
    variants = {run.run.planner.name for run in runs if is_model_variant(run, resolve_protocol(run, protocol))}
    some = f"No published row is shown for {', '.join(sorted(variants))}"
    return [f"{some}: a miniature or a variant is not the model of the paper."] if variants else []
