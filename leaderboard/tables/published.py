"""The paper's tables as printed, apart from ours, and which of its numbers may stand beside ours.

Each model's row was computed with the protocol of the model's own repository, so rows of different models are not
comparable, and none of them is comparable with the ``exact`` protocol.

Published values of planners: who prints what on which split and protocol; ours beside where all are the same.
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
    QUALITY_SOURCE,
    RUNTIME_MACHINE,
    RUNTIME_S,
    RUNTIME_SOURCE,
    SAMPLES_OF,
    STANDING,
    TABLE_1,
    TABLE_1_SOURCE,
    TABLE_3,
    PublishedRate,
    StandingValue,
)
from benchmark.records.ablation import VARIANTS
from benchmark.records.planner_versions import file_notes
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, UNDEFINED, Cell, Origin, Shown, origin_of
from benchmark.report.table import Table
from leaderboard.frame.specification import Columns, Value, numbers, tabulate, texts, under

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


def quoted_table(
    name: str, title: str, columns: Columns, rows: Iterable[Sequence[Value]], sources: Sequence[str], *notes: str
) -> Table:
    """Numbers that others print, each row in the order of the columns."""
    names = [column.name for column in columns]
    values = (dict(zip(names, row, strict=True)) for row in rows)
    return tabulate(name, f"Published {title}", columns, values, notes, sources=sources)


def published_table() -> Table:
    """The paper's Table 1, with the protocol behind each row."""
    return quoted_table(
        "published",
        "numbers, not ours: collision rate (%)",
        [
            *texts("planner", "data set", "protocol"),
            *under(_RATES, numbers("col. 1s", "col. 2s", "col. 3s", "col. avg", "increase")),
        ],
        [(row.model, row.data_set, row.protocol, *published_rates(row), published_increase(row)) for row in TABLE_1],
        [TABLE_1_SOURCE],
        "Each row quotes the protocol of the model's own repository; rows of different protocols are not comparable "
        "with each other, nor with our tables unless the protocol is the same.",
    )


def published_ablation_table() -> Table:
    """The paper's ablation study."""
    origin = Origin(protocol="uniad", source=ABLATION_SOURCE)
    return quoted_table(
        "ablation-published",
        "numbers, not ours: ablation, collision rate (%)",
        [*texts("search"), *under("samples on which UniAD fails in %, uniad", numbers("collision rate"))],
        [(variant.label, quoted(variant.published, PERCENT, origin)) for variant in VARIANTS],
        [ABLATION_SOURCE],
        "UniAD on 20 scenes of the nuScenes validation set; MTR: multi-round refinement, TS: scoring.",
    )


def published_quality_table() -> Table:
    """The paper's Table 3."""
    columns = [*texts("data set"), *numbers("SC", "IQ")]
    rows: list[tuple[Value, ...]] = [(name, *quoted_quality(name)) for name in TABLE_3]
    note = "SC: subject consistency, IQ: imaging quality."
    return quoted_table("quality-published", "numbers, not ours: video quality", columns, rows, [QUALITY_SOURCE], note)


def published_data_set_table() -> Table:
    """The paper's overview of its data set."""
    title, columns = "numbers, not ours: rows of Adv-nuSc", [*texts("rows of"), *numbers("Adv-nuSc")]
    rows = [(name.replace("_", " "), published_rows(name)) for name in ADV_NUSC]
    return quoted_table("data-set-published", title, columns, rows, [DATA_SET_SOURCE])


def published_runtime_table() -> Table:
    """The paper's runtime of one scene."""
    total, origin = sum(RUNTIME_S.values()), Origin(source=RUNTIME_SOURCE)
    return quoted_table(
        "runtime-published",
        "numbers, not ours: seconds for one scene",
        [*texts("stage"), *numbers("seconds"), *numbers("%", digits=1)],
        [
            (stage, published_seconds(stage), origin.cell(value / total, PERCENT, None, scale=100.0))
            for stage, value in {**RUNTIME_S, "all": total}.items()
        ],
        [RUNTIME_SOURCE],
        f"About 240 frames and six cameras on {RUNTIME_MACHINE}.",
    )


def quoted_quality(data_set: str) -> tuple[Shown, ...]:
    """The paper's subject consistency and imaging quality, as printed; nothing of data sets that it has not."""
    values = zip(TABLE_3.get(data_set, ()), ("SC", "IQ"))
    return tuple(quoted(text, unit, Origin(source=QUALITY_SOURCE)) for text, unit in values)


def published_rows(name: str) -> Shown:
    """Rows of a table of Adv-nuSc, as printed."""
    return quoted(f"{ADV_NUSC[name]:,}", "rows", Origin(source=DATA_SET_SOURCE))


def published_seconds(stage: str) -> Shown | str:
    """Seconds of a stage of one scene as printed, of ``all`` stages together, or a dash where none are printed."""
    seconds = sum(RUNTIME_S.values()) if stage == "all" else RUNTIME_S.get(stage)
    return Origin(source=RUNTIME_SOURCE).cell(seconds, "s", None).shown(2)


def published_rate(record: RunRecord, judge: str) -> PublishedRate | None:
    """The paper's row of a run's model, split and protocol, which is that of the numbers beside it."""
    model = _model_of(record)
    data_set = DATA_SET_OF_SPLIT.get(record.run.split)
    return next(
        (row for row in TABLE_1 if (row.model, row.data_set, row.protocol) == (model, data_set, judge)),
        None,
    )


def is_variant(record: RunRecord, judge: str) -> bool:
    """Whether a planner is named after a model of the paper that was judged likewise, and is not that model."""
    planner = record.run.planner
    stems = {row.model.lower() for row in TABLE_1 if row.protocol == judge}
    alike = any(planner.name.lower().startswith(f"{stem}-") for stem in stems)
    return _model_of(record) is None and (alike or (planner.miniature and planner.native_protocol == judge))


def _model_of(record: RunRecord) -> str | None:
    """The paper's name of a planner that it ran."""
    planner = record.run.planner
    return planner.published_as or (None if planner.miniature else MODEL_OF_PLANNER.get(planner.name.lower()))


def published_rates(row: PublishedRate | None) -> tuple[Shown, ...]:
    """The paper's rates at 1, 2, 3 s and their average, as printed; dashes without a row."""
    if row is None:
        return (Shown(UNDEFINED),) * 4
    return tuple(quoted(text, PERCENT, Origin(protocol=row.protocol, source=TABLE_1_SOURCE)) for text in row.percent)


def published_increase(row: PublishedRate | None) -> Shown | None:
    """The paper's increase of the average, as printed, where it prints one."""
    if row is None or row.data_set != "Adv-nuSc":
        return None
    return quoted(INCREASE[row.model], "×", Origin(protocol=row.protocol, source=TABLE_1_SOURCE), after="×")


def quoted(text: str, unit: str, origin: Origin, *, after: str = "") -> Shown:
    """A number as printed, possibly with commas between thousands, with text ``after`` it."""
    return Shown(f"{text}{after}", origin.cell(float(text.replace(",", "")), unit, None))


_SOURCES: Final = tuple(dict.fromkeys(value.source for value in STANDING))
_COLUMNS: Final = {"collision": ("collision", PERCENT), "l2": ("L2", "m")}


def standing_tables(records: Sequence[RunRecord] = ()) -> tuple[Table, ...]:
    """The standing tables of published values, beside any of ours: open loop, then NeuroNCAP's closed loop."""
    return _open_loop(records), _closed_loop()


def same_run(value: StandingValue, records: Sequence[RunRecord]) -> RunRecord | None:
    """Our run of what a published value is of: the planner, the protocol, and the split by its number of samples.

    Runs with failed samples, of a part of the split, or judged by another version of the protocol are none.
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
    own_runs = [same_run(value, records) for value in STANDING]
    measured = [record for record in own_runs if record is not None]
    ours = tuple(f"ours {horizon}" for horizon in HORIZONS) if measured else ()
    rows = [
        (
            value.planner,
            DATA_SET_OF_SPLIT[value.split],
            value.by,
            f"{_COLUMNS[value.column][0]} ({_COLUMNS[value.column][1]})",
            f"[{_SOURCES.index(value.source) + 1}]",
            *_printed(value.values, _COLUMNS[value.column][1], Origin(value.protocol, source=value.source)),
            *(_ours(value, record) if measured else ()),
        )
        for value, record in zip(STANDING, own_runs, strict=True)
    ]
    return quoted_table(
        "standing-published",
        "values, not ours: planning in open loop",
        [*texts("planner", "data set", "protocol", "value", "from"), *numbers(*HORIZONS, *ours, digits=2)],
        rows,
        _SOURCES,
        "Rows of different protocols are not comparable. Several rows of one planner and protocol are several "
        "evaluations by others, or several checkpoints.",
        "Ours stands beside a row where planner, protocol and split are the same; the split is known by its number "
        "of samples, which nobody prints of nuScenes-val-R.",
        *(f"[{number}] {source}." for number, source in enumerate(_SOURCES, start=1)),
        *dict.fromkeys(file_notes(measured)),
    )


def _printed(values: Sequence[str | None], unit: str, origin: Origin) -> list[Shown | None]:
    return [quoted(text, unit, origin) if text else None for text in values]


def _ours(value: StandingValue, record: RunRecord | None) -> list[Cell | None]:
    if record is None or value.protocol is None:
        return [None] * len(HORIZONS)
    origin, rates = origin_of(record, value.protocol), record.summary.protocols[value.protocol].columns[value.column]
    if value.column == "l2":
        return [origin.amount(rates[horizon], "m") for horizon in HORIZONS]
    return [origin.percent(rates[horizon]) for horizon in HORIZONS]


def _closed_loop() -> Table:
    sources = tuple(dict.fromkeys(value.source for value in NEURONCAP))
    rows = [
        (
            *(value.planner, value.renderer, f"[{sources.index(value.source) + 1}]"),
            *_printed(value.scores, "score", Origin(source=value.source)),
            *_printed([value.collision], PERCENT, Origin(source=value.source)),
        )
        for value in NEURONCAP
    ]
    return quoted_table(
        "neuroncap-published",
        "values, not ours: NeuroNCAP's closed loop",
        [
            *texts("planner", "renderer", "from"),
            *numbers("score", "stationary", "frontal", "side", "collision rate (%)"),
        ],
        rows,
        sources,
        "Score: 0 to 5, higher is better. Post-processed: with trajectory post-processing. "
        "The renderer is part of what was measured.",
        *(f"[{number}] {source}." for number, source in enumerate(sources, start=1)),
    )
