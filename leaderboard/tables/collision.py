"""Table 1 of the paper: collision rate over 1, 2 and 3 seconds, by planner and split, ours and the published ones."""

from collections.abc import Callable, Sequence

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.rates import HORIZONS
from benchmark.metrics.scores import leaves_out_samples, takes_maxima
from benchmark.published import TABLE_1_SOURCE
from benchmark.records.driving import PDM
from benchmark.records.run import NATIVE, RunRecord
from benchmark.records.run_schema import ProtocolSummary
from benchmark.report.cells import UNDEFINED, Shown, origin_of
from benchmark.report.table import Brief, Table, table_of
from leaderboard.tables.attacks import success_table
from leaderboard.tables.driving import driving_table
from leaderboard.tables.effect import effect_table
from leaderboard.tables.further_columns import further_table
from leaderboard.tables.longer_plans import longer_table
from leaderboard.tables.published import is_variant, published_rate, published_rates
from leaderboard.tables.rows import in_table_order, row_name, run_notes, stale_notes

BRIEF_NOTE = (
    "Brackets: 95 % bootstrap interval over recorded scenes; a dash where there are fewer than two or all of them "
    "agree."
)
_BRIEF_COLUMNS = ("col. avg", "95 % of avg", "L2 avg", "scenes failed")
"""What a terminal shows behind planner, split and protocol; nonsense shows at once in L2."""
BEFORE_MASK = "collision_before_mask"
MASK_COLUMNS = ("avg before mask", "steps masked", "masked for adversaries", "masked for others")


def collision_table(data_name: str, protocol: str, records: Sequence[RunRecord]) -> Table:
    """Collision rates and L2 of our runs under one protocol.

    Args:
        data_name: Name of the data set, for the title.
        protocol: Protocol of every number in the table.
        records: Runs on this data set; those without the protocol are named below the table.

    Returns:
        One row per planner and split: rates with the 95 % scene-bootstrap interval of their average, what the
        protocol's exclusion of recorded collisions removed (where it has one), L2, and what was counted.
    """
    runs = [record for record in in_table_order(records) if protocol in record.summary.protocols]
    versions = sorted({record.summary.protocols[protocol].version for record in runs})
    return _table(
        f"collision-{protocol}",
        f"{data_name}: collision rate (%) and L2 (m), protocol {protocol} "
        f"(version {', '.join(str(version) for version in versions)})",
        in_table_order(records),
        lambda record: protocol,
        notes=(),
    )


def native_table(data_name: str, records: Sequence[RunRecord]) -> Table:
    """The paper's Table 1: every planner under the protocol of its own repository.

    Args:
        data_name: Name of the data set, for the title.
        records: Runs on this data set.

    Returns:
        One row per planner and split that says whose protocol it is; planners without one of their own come after the
        others, under ``exact``. Planners whose own protocol takes maxima or latches stand in its own table alone.
    """
    maxima = [record for record in records if takes_maxima(record.native_protocol)]
    records = [record for record in records if not takes_maxima(record.native_protocol)]
    ordered = sorted(in_table_order(records), key=lambda record: record.run.planner.native_protocol is None)
    without = any(record.run.planner.native_protocol is None for record in records)
    said = " The last rows, under exact, are planners without a repository of their own." if without else ""
    return _table(
        "collision-native",
        f"{data_name}: collision rate (%) and L2 (m), each planner under its own protocol",
        ordered,
        lambda record: record.native_protocol,
        notes=(
            "As in the paper, each row quotes the protocol of the planner's own repository: rows of different "
            f"protocols are not comparable.{said}",
            *(
                f"{record.planner} on {record.run.split}: {record.native_protocol} says whether there is any contact "
                "up to the horizon, which shares no column with values at a step or means; see its own table."
                for record in in_table_order(maxima)
            ),
        ),
        names_protocol=True,
    )


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
    shown = records if allow_partial else [record for record in records if record.complete]
    own = any(record.run.planner.native_protocol for record in shown)
    names = protocols or ((EXACT, NATIVE) if own else (EXACT,))
    by_name = {NATIVE: native_table, PDM: driving_table}
    tables = [
        (by_name[name](data_name, shown), None)
        if name in by_name
        else (collision_table(data_name, name, shown), further_table(data_name, name, shown))
        for name in names
        if shown
    ]
    unasked = [longer_table(data_name, shown), success_table(data_name, shown)] if protocols is None else []
    first = [effect_table(data_name, shown, against)] if protocols is None else []
    return [table for table in (*first, *(table for both in tables for table in both), *unasked) if table is not None]


def _table(
    name: str,
    title: str,
    records: Sequence[RunRecord],
    judge_of: Callable[[RunRecord], str],
    *,
    notes: Sequence[str],
    names_protocol: bool = False,
) -> Table:
    """Rows of all records that have their judge's verdicts, in the order given."""
    runs = [record for record in records if judge_of(record) in record.summary.protocols]
    has_mask = any(_is_masked(run, judge_of(run)) for run in runs)
    has_paper = any(published_rate(run, judge_of(run)) is not None for run in runs)
    rows: list[tuple[str | Shown, ...]] = []
    for run in runs:
        judge = judge_of(run)
        rows.append(
            (
                *(row_name(run, judge), run.run.split, *((judge,) if names_protocol else ())),
                *_numbers(run, judge, has_mask=has_mask),
                *_distances_and_counts(run, judge),
                *(published_rates(published_rate(run, judge)) if has_paper else ()),
            )
        )
    who = "own protocol" if names_protocol else next((judge_of(run) for run in runs), "")
    columns = (
        *("planner", "split", *(("protocol",) if names_protocol else ())),
        *(*(f"col. {horizon}" for horizon in HORIZONS), "95 % of avg"),
        *(MASK_COLUMNS if has_mask else ()),
        *(f"L2 {horizon}" for horizon in HORIZONS),
        *("samples", "scenes", "scenes failed", "coverage"),
        *((f"paper {horizon}" for horizon in HORIZONS) if has_paper else ()),
    )
    texts = 3 if names_protocol else 2
    said = _run_notes(records, judge_of)
    of_columns = _column_notes(records, judge_of, has_mask=has_mask, has_paper=has_paper)
    return table_of(
        name,
        title,
        columns,
        rows,
        notes=(*notes, BRIEF_NOTE, *of_columns, *said),
        brief=Brief(
            title,
            (*range(texts), *(columns.index(head) for head in _BRIEF_COLUMNS)),
            (*notes, BRIEF_NOTE, *_mask_notes(records, judge_of), *said),
            texts,
        ),
        text_columns=texts,
        groups=(
            ("", 3 if names_protocol else 2),
            (f"collision rate in %, {who}", 5),
            (f"mask, {who}", len(MASK_COLUMNS) if has_mask else 0),
            (f"L2 in m, {who}", 4),
            (f"counted, {who}", 4),
            (f"paper, collision rate in %, {who}", 4 if has_paper else 0),
        ),
        sources=(TABLE_1_SOURCE,) if has_paper else (),
    )


def _numbers(record: RunRecord, judge: str, *, has_mask: bool) -> tuple[Shown, ...]:
    """Collision rates, the interval of their average, and what a mask takes away."""
    origin, summary = origin_of(record, judge), record.summary.protocols[judge]
    collision = {horizon: origin.percent(rate) for horizon, rate in summary.columns["collision"].items()}
    shown = (*(collision[horizon].shown(2) for horizon in HORIZONS), collision["avg"].interval())
    if not has_mask:
        return shown
    masked = summary.mask_removed_steps
    if not _is_masked(record, judge):
        return (*shown, *(Shown(UNDEFINED) for _ in MASK_COLUMNS))
    # Where whole samples are left out there is no rate of the same samples without that.
    before = origin.percent(summary.columns[BEFORE_MASK]["avg"]).shown(2) if BEFORE_MASK in summary.columns else None
    counts = (masked, summary.mask_removed_for_adversary, _masked_for_others(summary))
    return (*shown, before or Shown(UNDEFINED), *(origin.count(count, "steps", masked).shown() for count in counts))


def _is_masked(record: RunRecord, judge: str) -> bool:
    return BEFORE_MASK in record.summary.protocols[judge].columns or leaves_out_samples(judge)


def _masked_for_others(summary: ProtocolSummary) -> int | None:
    masked, for_adversary = summary.mask_removed_steps, summary.mask_removed_for_adversary
    return None if masked is None or for_adversary is None else masked - for_adversary


def _mask_notes(records: Sequence[RunRecord], judge_of: Callable[[RunRecord], str]) -> list[str]:
    """What a terminal, which does not show the columns, says of masked steps."""
    found = [(record, record.summary.protocols.get(judge_of(record))) for record in records]
    counted = [(run, summary) for run, summary in found if summary is not None and summary.mask_removed_steps]
    if not counted:
        return []
    told = (
        f"{run.planner} on {run.run.split} {summary.mask_removed_for_adversary} / {_masked_for_others(summary)}"
        if summary.mask_removed_for_adversary is not None
        else f"{run.planner} on {run.run.split} {summary.mask_removed_steps} in all"
        for run, summary in counted
    )
    return [
        "Colliding steps masked because the recorded ego touches an adversary / something else under the same "
        f"protocol: {', '.join(told)}."
    ]


def _distances_and_counts(record: RunRecord, judge: str) -> tuple[Shown, ...]:
    origin, summary, run = origin_of(record, judge), record.summary.protocols[judge], record.run
    return (
        *(origin.amount(summary.columns["l2"][horizon], "m").shown(2) for horizon in HORIZONS),
        origin.count(summary.counted, "samples", record.summary.samples).shown(),
        origin.count(len(run.scenes), "scenes", run.scenes_in_split).shown(),
        origin.count(summary.scenes_failed, "scenes", summary.scenes_decided).shown(after=f"/{summary.scenes_decided}"),
        origin.cell(record.summary.coverage, "%", record.summary.samples, scale=100.0).shown(1),
    )


def _column_notes(
    records: Sequence[RunRecord], judge_of: Callable[[RunRecord], str], *, has_mask: bool, has_paper: bool
) -> list[str]:
    """What the columns mean that a terminal does not show unasked."""
    notes = _paper_notes(records, judge_of, has_paper=has_paper)
    if has_mask:
        notes.append(
            "Mask: steps at which the recorded ego collides too, under the same protocol, do not count. Before it: the "
            "average without that exclusion; masked: how many colliding steps it removed, at which the recorded ego "
            "touches an adversary, and at which it touches something else alone. Where a protocol leaves out whole "
            "samples (safemvdrive), the colliding steps of these are counted, and there is no average before it."
        )
    return notes


def _run_notes(records: Sequence[RunRecord], judge_of: Callable[[RunRecord], str]) -> list[str]:
    told = []
    for record in records:
        judge, who = judge_of(record), f"{record.planner} on {record.run.split}"
        if judge not in record.summary.protocols:
            told.append(f"{who}: no verdicts under protocol {judge}; run challenger-bench rescore.")
        told += stale_notes(record, (judge,))
    return run_notes(records, told)


def _paper_notes(records: Sequence[RunRecord], judge_of: Callable[[RunRecord], str], *, has_paper: bool) -> list[str]:
    """What the paper's numbers beside ours are, and beside whom they do not stand."""
    notes = []
    if has_paper:
        notes.append(
            "Paper: what it prints for the model of that name under the same protocol on nuScenes-val, nuScenes-val-R "
            "and Adv-nuSc; on other data it is a reference and no target."
        )
    variants = sorted({record.run.planner.name for record in records if is_variant(record, judge_of(record))})
    if variants:
        notes.append(
            f"No published row stands beside {', '.join(variants)}: a miniature or a variant is not the model that the "
            "paper ran."
        )
    return notes
