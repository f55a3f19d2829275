"""Every rate by place, light, manoeuvre of the adversary, speed and command: a table a kind and a judge."""

from collections.abc import Callable, Sequence
from typing import Final

from benchmark.errors import InputError
from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import knows_contact_partners
from benchmark.metrics.rates import HORIZONS
from benchmark.metrics.scores import takes_maxima
from benchmark.metrics.slices import (
    ADVERSARY,
    KINDS,
    Slice,
    SliceKind,
    compute_causes_by,
    compute_driving_by,
    compute_rates_by,
    slice_samples,
)
from benchmark.records.driving import DEFINITION, PDM
from benchmark.records.row_schema import CAUSES
from benchmark.records.run import NATIVE, RunRecord, resolve_protocol
from benchmark.report.table import Table
from leaderboard.frame.rows import name_judge, run_notes
from leaderboard.frame.runs import DataSetRuns, RunRow, choose_protocols, name_judges
from leaderboard.frame.specification import (
    Columns,
    Values,
    estimate_columns,
    group_columns,
    interval_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.tables.driving import HEADS, format_planner_name
from leaderboard.tables.effect import explain_unknown_contacts
from leaderboard.tables.further_columns import COLUMNS, FurtherColumn, further_values

SLICES: Final = "slices"
"""First word of the names of these tables."""
DIAGNOSIS: Final = "diagnosis"
"""Name of the diagnosis among the sources of slices, beside protocols and ``pdm``."""
_SLICE_WORDS: Final[dict[SliceKind, str]] = {
    "place": "Place: part of the road under the recorded car, from the map (docs/manoeuvres.md); unknown: on no lane "
    "of the map.",
    "light": "Light: as named in the description of the scene; a scene may have several, and nuScenes never "
    "names daylight.",
    "manoeuvre": "Manoeuvre: of the first adversary of the scene (docs/manoeuvres.md).",
    "speed": "Speed: of the recorded car at the sample; below 1 m/s it stands.",
    "command": "Command: direction of the route, from the recorded car's position 3 s later.",
}
_LACKING_WORDS: Final[dict[SliceKind, str]] = {
    "place": "lacks the places of its samples",
    "light": "lacks the light of its scenes",
    "speed": "lacks the speed of the recorded car",
}
_INTERVALS: Final = "Brackets: 95 % bootstrap interval over recorded scenes, drawn as for the whole split."
_WHOM: Final = (
    "Adversary: the plan touches the adversary before anything else; any contact: with any object, so the "
    "difference is bystanders. A dash: no adversaries, or the record lacks the objects touched."
)
_ADVERSARY: Final = ["adversary 3s", "adversary avg", "95 % of adversary"]


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
    return build_slice_tables(DataSetRuns(data_name, records), asked, kinds)


def build_slice_tables(frame: DataSetRuns, asked: Sequence[str], kinds: Sequence[SliceKind] = KINDS) -> list[Table]:
    """`slice_tables` of a frame."""
    makers = {PDM: _driving_table, DIAGNOSIS: _causes_table}
    tables = [
        makers[name](frame, kind) if name in makers else _rates_table(frame, kind, name)
        for kind in kinds
        for name in asked
    ]
    return [table for table in tables if table.rows or any("rescore" in note for note in table.notes)]


def run_slices(
    data_name: str,
    records: Sequence[RunRecord],
    kinds: Sequence[SliceKind],
    protocols: Sequence[str] | None = None,
    *,
    allow_partial: bool = False,
) -> list[Table]:
    """The tables by slice that ``challenger-bench eval --by`` prints behind `run_tables`, with its defaults."""
    chosen_runs = DataSetRuns(data_name, [record for record in records if allow_partial or record.complete])
    return build_slice_tables(chosen_runs, choose_protocols(chosen_runs, protocols), kinds)


def _rates_table(frame: DataSetRuns, kind: SliceKind, protocol: str) -> Table:
    """Collision rates, L2 and the further rates of a protocol."""
    own, judge_words = protocol == NATIVE, name_judges(protocol)
    # As in the whole table: maxima share no column with means, and planners without a protocol are under exact.
    runs = [run for run in frame.runs if run.run.planner.native_protocol and not takes_maxima(run.native_protocol)]
    rows, notes = _rows(
        runs if own else frame.runs, protocol, kind, lambda record: compute_rates_by(record, kind, protocol)
    )
    further = [column for column in COLUMNS if not own and any(column.name in row.found.columns for row in rows)]
    pursued = [row.record for row in rows if protocol == EXACT and has_adversaries(row.record)]
    notes += dict.fromkeys(explain_unknown_contacts(record) for record in pursued if not knows_contact_partners(record))
    collision, contact = ("any", "any contact") if pursued else ("col.", "collision rate")
    columns = [
        *text_columns("planner", "split", kind, *(("protocol",) if own else ())),
        *group_columns(
            f"touches the adversary first, in %, {judge_words}",
            number_columns(*_ADVERSARY[:2], digits=2) if pursued else [],
            interval_columns({_ADVERSARY[2]: _ADVERSARY[1]}) if pursued else [],
        ),
        *group_columns(f"{contact} in %, {judge_words}", _horizon_columns(collision, 1)),
        *group_columns(f"L2 in m, {judge_words}", _horizon_columns("L2", 2)),
        *(
            column
            for further_column in further
            for column in group_columns(
                f"{further_column.head} in %, {judge_words}",
                number_columns(f"{further_column.head} avg", digits=2),
                interval_columns({f"95 % of {further_column.head}": f"{further_column.head} avg"}),
            )
        ),
        *group_columns(f"counted, {judge_words}", number_columns("samples", "scenes")),
    ]
    # A terminal has no room for everything, and L2 does not depend on other road users.
    first = (
        ("adversary avg", "95 % of adversary avg", "any avg") if pursued else ("col. avg", "95 % of col. avg", "L2 avg")
    )
    title = f"{frame.data_name}: collision rate (%) and L2 (m) by {kind}, {name_judge(protocol)}"
    words = [
        _SLICE_WORDS[kind],
        *((_WHOM,) if pursued else ()),
        *(column.says for column in further),
        _INTERVALS,
    ]
    values = [_rate_values(row, kind, collision, further) for row in rows]
    return _table(f"{SLICES}-{kind}-{protocol}", title, columns, values, words, notes, first)


def _horizon_columns(head: str, ends: int) -> Columns:
    rates = [f"{head} {horizon}" for horizon in HORIZONS]
    return [*number_columns(*rates, digits=2), *interval_columns({f"95 % of {head} avg": f"{head} avg"}, ends)]


def _rate_values(row: RunRow[Slice], kind: SliceKind, collision: str, further: Sequence[FurtherColumn]) -> Values:
    rates = row.found.columns
    return {
        **row.names,
        kind: row.found.name,
        "protocol": row.judge,
        **row.by_horizon("adversary {}", ADVERSARY, rates.get(ADVERSARY, {})),
        **row.by_horizon(f"{collision} {{}}", "collision", rates["collision"]),
        **row.by_horizon("L2 {}", "l2", rates["l2"]),
        **further_values(row, further, rates),
        "samples": row.samples(row.found.samples),
        "scenes": row.scenes(row.found.scenes),
    }


def _driving_table(frame: DataSetRuns, kind: SliceKind) -> Table:
    rows, notes = _rows(frame.runs, DEFINITION, kind, lambda record: compute_driving_by(record, kind))
    columns = [
        *text_columns("planner", "split", kind),
        *group_columns(f"mean in %, {DEFINITION}", estimate_columns(*HEADS.values())),
        *group_columns(f"counted, {DEFINITION}", number_columns("samples", "scenes")),
    ]
    values: list[Values] = [
        {
            "planner": format_planner_name(row),
            "split": row.split,
            kind: row.found.name,
            **{head: row.origin.percent(row.found.columns[name]["mean"]) for name, head in HEADS.items()},
            "samples": row.samples(row.found.samples),
            "scenes": row.scenes(row.found.scenes),
        }
        for row in rows
    ]
    title = f"{frame.data_name}: driving scores (%) by {kind}, {DEFINITION}"
    shown_heads = [head for head in HEADS.values() if head != HEADS["score_without_ec"]]
    words = (_SLICE_WORDS[kind], _INTERVALS)
    return _table(f"{SLICES}-{kind}-{PDM}", title, columns, values, words, notes, shown_heads)


def _causes_table(frame: DataSetRuns, kind: SliceKind) -> Table:
    rows, notes = _rows(frame.runs, EXACT, kind, lambda record: compute_causes_by(record, kind))
    columns = [
        *text_columns("planner", "split", kind),
        *group_columns(f"% of the colliding samples, {EXACT}", estimate_columns(*CAUSES)),
        *group_columns(f"colliding samples and their scenes, {EXACT}", number_columns("colliding", "scenes")),
    ]
    values: list[Values] = [
        {
            **row.names,
            kind: row.found.name,
            **{
                cause: row.origin.percent(rate, "colliding samples")
                for cause, rate in row.found.columns["cause"].items()
            },
            "colliding": row.samples(row.found.samples),
            "scenes": row.scenes(row.found.scenes),
        }
        for row in rows
    ]
    title = f"{frame.data_name}: causes of collisions (% of the colliding samples) by {kind}, protocol {EXACT}"
    words = [_SLICE_WORDS[kind], "The causes are those of docs/diagnosis.md.", _INTERVALS]
    return _table(f"{SLICES}-{kind}-{DIAGNOSIS}", title, columns, values, words, notes, CAUSES)


def _rows(
    runs: Sequence[RunRecord], protocol: str, kind: SliceKind, sliced: Callable[[RunRecord], list[Slice]]
) -> tuple[list[RunRow[Slice]], list[str]]:
    """A row for each slice of each run, and notes on the runs."""
    rows: list[RunRow[Slice]] = []
    sentences = []
    for record in runs:
        run_name = f"{record.planner} on {record.run.split}"
        if slice_samples(record, kind) is None:
            sentences += (
                [f"{run_name}: the record {_LACKING_WORDS[kind]}; run challenger-bench rescore."]
                if kind in _LACKING_WORDS
                else []
            )
            continue
        try:
            rows += [RunRow(record, resolve_protocol(record, protocol), part) for part in sliced(record)]
        except InputError as refusal:
            sentences.append(f"Left out: {refusal}.")
    shown_records = {id(row.record): row.record for row in rows}
    return rows, run_notes(list(shown_records.values()), sentences)


def _table(
    name: str,
    title: str,
    columns: Columns,
    rows: Sequence[Values],
    words: Sequence[str],
    run_notes: Sequence[str],
    shown: Sequence[str],
) -> Table:
    """A table with a brief form for terminals, which leaves out the ``words`` of its columns."""
    brief = [column.name for column in columns if column.text or column.name in ("samples", "colliding", "scenes")]
    notes = (*words, *run_notes)
    return tabulate(name, title, columns, rows, notes, brief=[*brief, *shown], brief_notes=run_notes)
