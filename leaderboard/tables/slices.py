"""Every rate by place, light, manoeuvre of the adversary, speed and command: a table a kind and a judge."""

from collections.abc import Callable, Sequence
from typing import Final

from benchmark.errors import InputError
from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import says_whom
from benchmark.metrics.rates import HORIZONS
from benchmark.metrics.scores import takes_maxima
from benchmark.metrics.slices import ADVERSARY, KINDS, Slice, SliceKind, causes_by, driving_by, rates_by, slicing
from benchmark.records.driving import DEFINITION, PDM, SUB_SCORES, TOTALS
from benchmark.records.row_schema import CAUSES
from benchmark.records.run import NATIVE, RunRecord
from benchmark.report.cells import UNDEFINED, Shown, origin_of
from benchmark.report.table import Brief, Table, table_of
from leaderboard.tables.driving import driver_name
from leaderboard.tables.effect import unsaid_whom
from leaderboard.tables.further_columns import COLUMNS, FurtherColumn
from leaderboard.tables.rows import in_table_order, judges, row_name, run_notes

SLICES: Final = "slices"
"""First word of the names of these tables."""
DIAGNOSIS: Final = "diagnosis"
"""Who is asked for why plans collide, beside protocols and ``pdm``."""
_SAYS: Final[dict[SliceKind, str]] = {
    "place": "Place: what the recorded car is on at the sample, from the map (docs/manoeuvres.md); unknown: on no lane "
    "that the map knows.",
    "light": "Light: what the description of the scene names, in words; a scene may have several, and nuScenes never "
    "says that it is day.",
    "manoeuvre": "Manoeuvre: what the first adversary of the scene does (docs/manoeuvres.md).",
    "speed": "Speed: of the recorded car at the sample; below 1 m/s it stands.",
    "command": "Command: where the route goes, read from where the recorded car will be in 3 s.",
}
_LACKING: Final[dict[SliceKind, str]] = {
    "place": "does not say at which places its samples are",
    "light": "does not say in what light its scenes are",
    "speed": "does not say how fast the recorded car is",
}
_INTERVALS: Final = "Brackets: 95 % bootstrap interval over recorded scenes, drawn as for the whole split."
_WHOM: Final = (
    "Adversary: the plan touches the adversary before anything else; any contact: whoever is touched, so that what it "
    "has more is bystanders. A dash: no adversaries, or the record does not say whom contacts are with."
)
_HEADS: Final = {"score": "score", "score_without_ec": "without EC", **{name: name.upper() for name in SUB_SCORES}}

_ADVERSARY_HEADS: Final = ("adversary 3s", "adversary avg", "95 % of adversary")

Row = tuple[str | Shown, ...]


def slice_tables(
    data_name: str, records: Sequence[RunRecord], asked: Sequence[str], kinds: Sequence[SliceKind] = KINDS
) -> list[Table]:
    """Tables by slice.

    Args:
        data_name: Name of the data set, for the titles.
        records: Runs on this data set.
        asked: Protocols, ``native`` (planners with a protocol of their own), ``pdm`` and ``diagnosis``.
        kinds: By what.

    Returns:
        For each kind one table for each that is asked; a table without rows says which records lack what it sorts by,
        and there is none where nothing can be sorted, as where no scene has an adversary.
    """
    makers = {PDM: _driving_table, DIAGNOSIS: _causes_table}
    tables = [
        makers[name](data_name, kind, records) if name in makers else _rates_table(data_name, kind, name, records)
        for kind in kinds
        for name in asked
    ]
    return [table for table in tables if table is not None]


def run_slices(
    data_name: str,
    records: Sequence[RunRecord],
    kinds: Sequence[SliceKind],
    protocols: Sequence[str] | None = None,
    *,
    allow_partial: bool = False,
) -> list[Table]:
    """The tables by slice that ``challenger-bench eval --by`` prints behind `run_tables`.

    Args:
        data_name: Name of the data set, for the titles.
        records: Runs on this data set.
        kinds: By what.
        protocols: Protocols, ``native`` or ``pdm``; by default ``exact``, and ``native`` where a planner has one of its
            own.
        allow_partial: Whether runs count in which the planner failed on samples.

    Returns:
        The tables.
    """
    shown = [record for record in records if allow_partial or record.complete]
    own = any(record.run.planner.native_protocol for record in shown)
    return slice_tables(data_name, shown, protocols or ((EXACT, NATIVE) if own else (EXACT,)), kinds)


def _rates_table(data_name: str, kind: SliceKind, protocol: str, records: Sequence[RunRecord]) -> Table | None:
    """Collision rates, L2 and the further rates of a protocol."""
    own = protocol == NATIVE
    if own:
        # As in the whole table: maxima share no column with means, and who has no protocol stands under exact.
        records = [record for record in records if record.run.planner.native_protocol]
        records = [record for record in records if not takes_maxima(record.native_protocol)]
    runs, notes = _of_runs(records, kind, lambda record: rates_by(record, kind, protocol))
    further = [column for column in COLUMNS if any(column.name in one.columns for _, parts in runs for one in parts)]
    further = [] if own else further
    pursued = [record for record, _ in runs if protocol == EXACT and has_adversaries(record)]
    notes += dict.fromkeys(unsaid_whom(record) for record in pursued if not says_whom(record))
    collision = "any" if pursued else "col."
    columns = (
        *("planner", "split", kind, *(("protocol",) if own else ())),
        *(_ADVERSARY_HEADS if pursued else ()),
        *(*(f"{collision} {horizon}" for horizon in HORIZONS), f"95 % of {collision} avg"),
        *(*(f"L2 {horizon}" for horizon in HORIZONS), "95 % of L2 avg"),
        *(head for column in further for head in (f"{column.head} avg", f"95 % of {column.head}")),
        *("samples", "scenes"),
    )
    texts = 4 if own else 3
    # A terminal has no room for everything, and L2 does not ask who is in the way.
    first = ("adversary avg", "95 % of adversary", "any avg") if pursued else ("col. avg", "95 % of col. avg", "L2 avg")
    shown = (*range(texts), *(columns.index(head) for head in (*first, "samples")))
    who = "own protocol" if own else protocol
    return _table(
        f"{SLICES}-{kind}-{protocol}",
        f"{data_name}: collision rate (%) and L2 (m) by {kind}, {judges(protocol)}",
        columns,
        [
            _rates_row(record, protocol, one, further, names_protocol=own, pursued=bool(pursued))
            for record, parts in runs
            for one in parts
        ],
        notes=(_SAYS[kind], *((_WHOM,) if pursued else ()), *(column.says for column in further), _INTERVALS, *notes),
        shown=(*shown, columns.index("scenes")),
        texts=texts,
        groups=(
            ("", texts),
            *(((f"touches the adversary first, in %, {who}", len(_ADVERSARY_HEADS)),) if pursued else ()),
            (f"{'any contact' if pursued else 'collision rate'} in %, {who}", 5),
            (f"L2 in m, {who}", 5),
            *((f"{column.head} in %, {who}", 2) for column in further),
            (f"counted, {who}", 2),
        ),
    )


def _rates_row(
    record: RunRecord,
    protocol: str,
    part: Slice,
    further: Sequence[FurtherColumn],
    *,
    names_protocol: bool,
    pursued: bool,
) -> Row:
    judge = record.native_protocol if protocol == NATIVE else protocol
    origin = origin_of(record, judge)
    adversary: Row = (UNDEFINED,) * len(_ADVERSARY_HEADS) if pursued else ()
    if (said := part.columns.get(ADVERSARY)) is not None:
        average = origin.percent(said["avg"])
        adversary = origin.percent(said["3s"]).shown(2), average.shown(2), average.interval()
    collision = {horizon: origin.percent(part.columns["collision"][horizon]) for horizon in HORIZONS}
    apart = {horizon: origin.amount(part.columns["l2"][horizon], "m") for horizon in HORIZONS}
    others = [origin.percent(part.columns[column.name]["avg"]) for column in further]
    return (
        *(row_name(record, judge), record.run.split, part.name, *((judge,) if names_protocol else ())),
        *adversary,
        *(*(collision[horizon].shown(2) for horizon in HORIZONS), collision["avg"].interval()),
        *(*(apart[horizon].shown(2) for horizon in HORIZONS), apart["avg"].interval(2)),
        *(shown for cell in others for shown in (cell.shown(2), cell.interval())),
        *_counts(record, judge, part),
    )


def _driving_table(data_name: str, kind: SliceKind, records: Sequence[RunRecord]) -> Table | None:
    """Driving scores."""
    runs, notes = _of_runs(records, kind, lambda record: driving_by(record, kind))
    names = (*TOTALS, *SUB_SCORES)

    def row(record: RunRecord, part: Slice) -> Row:
        origin = origin_of(record, DEFINITION)
        cells = [origin.percent(part.columns[name]["mean"]) for name in names]
        told = (shown for cell in cells for shown in (cell.shown(1), cell.interval()))
        assert record.summary.driving is not None
        name = driver_name(record, record.summary.driving)
        return name, record.run.split, part.name, *told, *_counts(record, DEFINITION, part)

    columns = (
        *("planner", "split", kind),
        *(head for name in names for head in (_HEADS[name], f"95 % of {_HEADS[name]}")),
        *("samples", "scenes"),
    )
    return _table(
        f"{SLICES}-{kind}-{PDM}",
        f"{data_name}: driving scores (%) by {kind}, {DEFINITION}",
        columns,
        [row(record, one) for record, parts in runs for one in parts],
        notes=(_SAYS[kind], _INTERVALS, *notes),
        shown=(*range(4), *(3 + 2 * place for place in range(2, len(names))), len(columns) - 2, len(columns) - 1),
        texts=3,
        groups=(("", 3), (f"mean in %, {DEFINITION}", 2 * len(names)), (f"counted, {DEFINITION}", 2)),
    )


def _causes_table(data_name: str, kind: SliceKind, records: Sequence[RunRecord]) -> Table | None:
    """Why plans collide."""
    runs, notes = _of_runs(records, kind, lambda record: causes_by(record, kind))

    def row(record: RunRecord, part: Slice) -> Row:
        origin = origin_of(record, EXACT)
        cells = [origin.percent(part.columns["cause"][cause], "colliding samples") for cause in CAUSES]
        told = (shown for cell in cells for shown in (cell.shown(1), cell.interval()))
        return row_name(record, EXACT), record.run.split, part.name, *told, *_counts(record, EXACT, part)

    columns = (
        *("planner", "split", kind),
        *(head for cause in CAUSES for head in (cause, f"95 % of {cause}")),
        *("colliding", "scenes"),
    )
    return _table(
        f"{SLICES}-{kind}-{DIAGNOSIS}",
        f"{data_name}: why plans collide (% of the colliding samples) by {kind}, protocol {EXACT}",
        columns,
        [row(record, one) for record, parts in runs for one in parts],
        notes=(_SAYS[kind], "The causes are those of docs/diagnosis.md.", _INTERVALS, *notes),
        shown=(*range(3), *(3 + 2 * place for place in range(len(CAUSES))), len(columns) - 2, len(columns) - 1),
        texts=3,
        groups=(
            ("", 3),
            (f"% of the colliding samples, {EXACT}", 2 * len(CAUSES)),
            (f"colliding samples and their scenes, {EXACT}", 2),
        ),
    )


def _of_runs(
    records: Sequence[RunRecord], kind: SliceKind, sliced: Callable[[RunRecord], list[Slice]]
) -> tuple[list[tuple[RunRecord, list[Slice]]], list[str]]:
    """Slices of every run that has some, and what has to be said of the runs."""
    found, told = [], []
    for record in in_table_order(records):
        who = f"{record.planner} on {record.run.split}"
        if slicing(record, kind) is None:
            told += [f"{who}: the record {_LACKING[kind]}; run challenger-bench rescore."] if kind in _LACKING else []
            continue
        try:
            parts = sliced(record)
        except InputError as refusal:
            told.append(f"Left out: {refusal}.")
            continue
        if parts:
            found.append((record, parts))
    return found, run_notes([record for record, _ in found], told)


def _counts(record: RunRecord, judge: str, part: Slice) -> tuple[Shown, Shown]:
    origin = origin_of(record, judge)
    return (
        origin.count(part.samples, "samples", record.summary.samples).shown(),
        origin.count(part.scenes, "scenes", len(record.run.scenes)).shown(),
    )


def _table(
    name: str,
    title: str,
    columns: tuple[str, ...],
    rows: Sequence[Row],
    *,
    notes: tuple[str, ...],
    shown: tuple[int, ...],
    texts: int,
    groups: tuple[tuple[str, int], ...],
) -> Table | None:
    if not rows and not any("rescore" in note for note in notes):
        return None
    brief = Brief(title, shown, notes, texts)
    return table_of(name, title, columns, rows, notes=notes, text_columns=texts, groups=groups, brief=brief)
