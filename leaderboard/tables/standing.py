"""Published values of planners: who prints what on which split and protocol; ours beside where all are the same."""

from collections.abc import Sequence
from typing import Final

from benchmark.metrics.rates import HORIZONS
from benchmark.published import DATA_SET_OF_SPLIT, NEURONCAP, SAMPLES_OF, STANDING, StandingValue
from benchmark.records.file_plans import file_notes
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, Cell, Origin, Shown, origin_of
from benchmark.report.table import Table
from leaderboard.frame.specification import numbers, texts
from leaderboard.tables.published import quoted, quoted_table

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
    found = [same_run(value, records) for value in STANDING]
    used = [record for record in found if record is not None]
    ours = tuple(f"ours {horizon}" for horizon in HORIZONS) if used else ()
    rows = [
        (
            value.planner,
            DATA_SET_OF_SPLIT[value.split],
            value.by,
            f"{_COLUMNS[value.column][0]} ({_COLUMNS[value.column][1]})",
            f"[{_SOURCES.index(value.source) + 1}]",
            *_printed(value.values, _COLUMNS[value.column][1], Origin(value.protocol, source=value.source)),
            *(_ours(value, record) if used else ()),
        )
        for value, record in zip(STANDING, found, strict=True)
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
        *dict.fromkeys(file_notes(used)),
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
