"""The paper's tables as printed, published values of others, and which of them may stand beside ours.

Each model's row was computed with the protocol of the model's own repository, so rows of different models are not
comparable, and none of them is comparable with the ``exact`` protocol.
"""

from collections.abc import Iterable, Sequence
from typing import Final

from benchmark.metrics.rates import HORIZONS
from benchmark.published import (
    ABLATION_SOURCE,
    ADV_NUSC,
    DATA_SET_OF_SPLIT,
    DATA_SET_SOURCE,
    INCREASE,
    MODEL_OF_PLANNER,
    NEURONCAP,
    PUBLISHED_RESULTS,
    QUALITY_SOURCE,
    RUNTIME_MACHINE,
    RUNTIME_S,
    RUNTIME_SOURCE,
    SAMPLES_OF,
    TABLE_1,
    TABLE_1_SOURCE,
    TABLE_3,
    PublishedRate,
    PublishedResult,
)
from benchmark.records.ablation import VARIANTS
from benchmark.records.planner_versions import list_file_notes
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, UNDEFINED, CellSource, TableCell, ValueSource, make_value_source
from benchmark.report.table import Table
from leaderboard.frame.specification import Columns, Value, group_columns, number_columns, tabulate, text_columns

_RATES: Final = "collision rate in %, the protocol of the row"


def published_tables() -> tuple[Table, ...]:
    """Every table of the paper that has a counterpart among ours."""
    return (
        published_table(),
        published_ablation_table(),
        published_quality_table(),
        published_data_set_table(),
        published_runtime_table(),
    )


def build_quoted_table(
    name: str, title: str, columns: Columns, rows: Iterable[Sequence[Value]], sources: Sequence[str], *notes: str
) -> Table:
    """Numbers that others print, each row in the order of the columns."""
    names = [column.name for column in columns]
    values = (dict(zip(names, row, strict=True)) for row in rows)
    return tabulate(name, f"Published {title}", columns, values, notes, sources=sources)


def published_table() -> Table:
    """The paper's Table 1, with the protocol behind each row."""
    return build_quoted_table(
        "published",
        "numbers, not ours: collision rate (%)",
        [
            *text_columns("planner", "data set", "protocol"),
            *group_columns(_RATES, number_columns("col. 1s", "col. 2s", "col. 3s", "col. avg", "increase")),
        ],
        [(row.model, row.data_set, row.protocol, *quote_rates(row), quote_increase(row)) for row in TABLE_1],
        [TABLE_1_SOURCE],
        "Each row quotes the protocol of the model's own repository; rows of different protocols are not comparable "
        "with each other, nor with our tables unless the protocol is the same.",
    )


def published_ablation_table() -> Table:
    """The paper's ablation study."""
    origin = ValueSource(protocol="uniad", source=ABLATION_SOURCE)
    return build_quoted_table(
        "ablation-published",
        "numbers, not ours: ablation, collision rate (%)",
        [
            *text_columns("search"),
            *group_columns("samples on which UniAD fails in %, uniad", number_columns("collision rate")),
        ],
        [(variant.label, quote_number(variant.published, PERCENT, origin)) for variant in VARIANTS],
        [ABLATION_SOURCE],
        "UniAD on 20 scenes of the nuScenes validation set; MTR: multi-round refinement, TS: scoring.",
    )


def published_quality_table() -> Table:
    """The paper's Table 3."""
    columns = [*text_columns("data set"), *number_columns("SC", "IQ")]
    rows: list[tuple[Value, ...]] = [(name, *quote_quality(name)) for name in TABLE_3]
    note = "SC: subject consistency, IQ: imaging quality."
    return build_quoted_table(
        "quality-published", "numbers, not ours: video quality", columns, rows, [QUALITY_SOURCE], note
    )


def published_data_set_table() -> Table:
    """The paper's overview of its data set."""
    title, columns = "numbers, not ours: rows of Adv-nuSc", [*text_columns("rows of"), *number_columns("Adv-nuSc")]
    rows = [(name.replace("_", " "), quote_rows(name)) for name in ADV_NUSC]
    return build_quoted_table("data-set-published", title, columns, rows, [DATA_SET_SOURCE])


def published_runtime_table() -> Table:
    """The paper's runtime of one scene."""
    total, origin = sum(RUNTIME_S.values()), ValueSource(source=RUNTIME_SOURCE)
    return build_quoted_table(
        "runtime-published",
        "numbers, not ours: seconds for one scene",
        [*text_columns("stage"), *number_columns("seconds"), *number_columns("%", digits=1)],
        [
            (stage, quote_seconds(stage), origin.cell(value / total, PERCENT, None, scale=100.0))
            for stage, value in {**RUNTIME_S, "all": total}.items()
        ],
        [RUNTIME_SOURCE],
        f"About 240 frames and six cameras on {RUNTIME_MACHINE}.",
    )


def quote_quality(data_set: str) -> tuple[TableCell, ...]:
    """The paper's subject consistency and imaging quality, as printed; nothing of data sets that it has not."""
    values = zip(TABLE_3.get(data_set, ()), ("SC", "IQ"))
    return tuple(quote_number(text, unit, ValueSource(source=QUALITY_SOURCE)) for text, unit in values)


def quote_rows(name: str) -> TableCell:
    """Rows of a table of Adv-nuSc, as printed."""
    return quote_number(f"{ADV_NUSC[name]:,}", "rows", ValueSource(source=DATA_SET_SOURCE))


def quote_seconds(stage: str) -> TableCell | str:
    """Seconds of a stage of one scene as printed, of ``all`` stages together, or a dash where none are printed."""
    seconds = sum(RUNTIME_S.values()) if stage == "all" else RUNTIME_S.get(stage)
    return ValueSource(source=RUNTIME_SOURCE).cell(seconds, "s", None).shown(2)


def find_published_rate(record: RunRecord, judge: str) -> PublishedRate | None:
    """The paper's row of a run's model, split and protocol, which is that of the numbers beside it."""
    model = _find_published_model(record)
    data_set = DATA_SET_OF_SPLIT.get(record.run.split)
    return next(
        (row for row in TABLE_1 if (row.model, row.data_set, row.protocol) == (model, data_set, judge)),
        None,
    )


def is_model_variant(record: RunRecord, judge: str) -> bool:
    """Whether a planner is named after a model of the paper with the same protocol, but is not that model."""
    planner = record.run.planner
    stems = {row.model.lower() for row in TABLE_1 if row.protocol == judge}
    alike = any(planner.name.lower().startswith(f"{stem}-") for stem in stems)
    return _find_published_model(record) is None and (alike or (planner.miniature and planner.native_protocol == judge))


def _find_published_model(record: RunRecord) -> str | None:
    """The paper's name of a planner that it ran."""
    planner = record.run.planner
    return planner.published_as or (None if planner.miniature else MODEL_OF_PLANNER.get(planner.name.lower()))


def quote_rates(row: PublishedRate | None) -> tuple[TableCell, ...]:
    """The paper's rates at 1, 2, 3 s and their average, as printed; dashes without a row."""
    if row is None:
        return (TableCell(UNDEFINED),) * 4
    return tuple(
        quote_number(text, PERCENT, ValueSource(protocol=row.protocol, source=TABLE_1_SOURCE)) for text in row.percent
    )


def quote_increase(row: PublishedRate | None) -> TableCell | None:
    """The paper's increase of the average, as printed, where it prints one."""
    if row is None or row.data_set != "Adv-nuSc":
        return None
    return quote_number(INCREASE[row.model], "×", ValueSource(protocol=row.protocol, source=TABLE_1_SOURCE), after="×")


def quote_number(text: str, unit: str, origin: ValueSource, *, after: str = "") -> TableCell:
    """A number as printed, possibly with commas between thousands, with text ``after`` it."""
    return TableCell(f"{text}{after}", origin.cell(float(text.replace(",", "")), unit, None))


_SOURCES: Final = tuple(dict.fromkeys(value.source for value in PUBLISHED_RESULTS))
_COLUMNS: Final = {"collision": ("collision", PERCENT), "l2": ("L2", "m")}


def published_comparison_tables(records: Sequence[RunRecord] = ()) -> tuple[Table, ...]:
    """The standing tables of published values, beside any of ours: open loop, then NeuroNCAP's closed loop."""
    return _open_loop(records), _closed_loop()


def find_same_run(value: PublishedResult, records: Sequence[RunRecord]) -> RunRecord | None:
    """Our run of a published value: same planner, protocol, and split by its number of samples.

    Runs with failed samples, of a part of the split, or judged by another version of the protocol do not count.
    """
    for record in records:
        planner, protocol = record.run.planner, value.protocol
        if (
            planner.name.lower() in value.ours
            and not planner.miniature
            and record.run.split == value.split
            and record.summary.samples == SAMPLES_OF.get(value.split)
            and record.complete
            and record.covers_split
            and protocol in record.summary.protocols
            and protocol not in record.stale_protocols
        ):
            return record
    return None


def _open_loop(records: Sequence[RunRecord]) -> Table:
    own_runs = [find_same_run(value, records) for value in PUBLISHED_RESULTS]
    measured = [record for record in own_runs if record is not None]
    ours = tuple(f"ours {horizon}" for horizon in HORIZONS) if measured else ()
    rows = [
        (
            value.planner,
            DATA_SET_OF_SPLIT[value.split],
            value.by,
            f"{_COLUMNS[value.column][0]} ({_COLUMNS[value.column][1]})",
            f"[{_SOURCES.index(value.source) + 1}]",
            *_quote_values(value.values, _COLUMNS[value.column][1], ValueSource(value.protocol, source=value.source)),
            *(_own_cells(value, record) if measured else ()),
        )
        for value, record in zip(PUBLISHED_RESULTS, own_runs, strict=True)
    ]
    return build_quoted_table(
        "standing-published",
        "values, not ours: planning in open loop",
        [
            *text_columns("planner", "data set", "protocol", "value", "from"),
            *number_columns(*HORIZONS, *ours, digits=2),
        ],
        rows,
        _SOURCES,
        "Rows of different protocols are not comparable. Several rows of one planner and protocol are several "
        "evaluations by others, or several checkpoints.",
        "Ours is shown beside a row if planner, protocol and split are the same; the split is identified by its number "
        "of samples, which no source gives for nuScenes-val-R.",
        *(f"[{number}] {source}." for number, source in enumerate(_SOURCES, start=1)),
        *dict.fromkeys(list_file_notes(measured)),
    )


def _quote_values(values: Sequence[str | None], unit: str, origin: ValueSource) -> list[TableCell | None]:
    return [quote_number(text, unit, origin) if text else None for text in values]


def _own_cells(value: PublishedResult, record: RunRecord | None) -> list[CellSource | None]:
    if record is None or value.protocol is None:
        return [None] * len(HORIZONS)
    origin, rates = (
        make_value_source(record, value.protocol),
        record.summary.protocols[value.protocol].columns[value.column],
    )
    if value.column == "l2":
        return [origin.amount(rates[horizon], "m") for horizon in HORIZONS]
    return [origin.percent(rates[horizon]) for horizon in HORIZONS]


def _closed_loop() -> Table:
    sources = tuple(dict.fromkeys(value.source for value in NEURONCAP))
    rows = [
        (
            *(value.planner, value.renderer, f"[{sources.index(value.source) + 1}]"),
            *_quote_values(value.scores, "score", ValueSource(source=value.source)),
            *_quote_values([value.collision], PERCENT, ValueSource(source=value.source)),
        )
        for value in NEURONCAP
    ]
    return build_quoted_table(
        "neuroncap-published",
        "values, not ours: NeuroNCAP's closed loop",
        [
            *text_columns("planner", "renderer", "from"),
            *number_columns("score", "stationary", "frontal", "side", "collision rate (%)"),
        ],
        rows,
        sources,
        "Score: 0 to 5, higher is better. Post-processed: with trajectory post-processing. "
        "The renderer is part of what was measured.",
        *(f"[{number}] {source}." for number, source in enumerate(sources, start=1)),
    )
