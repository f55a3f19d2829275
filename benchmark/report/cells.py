"""The facts behind the numbers of tables: value and unit, what was counted, interval, protocol, record or source.

A number is written by its own cell, so that what is shown and what stands behind it cannot differ.
"""

import math
from dataclasses import dataclass, fields
from typing import Any, Final, Protocol

from benchmark.records.run import RunRecord

UNDEFINED: Final = "–"
"""Shown where a number does not exist; never a zero."""
PERCENT: Final = "%"
RANKS_NOTHING: Final = "demonstrates the pipeline; not for ranking"
"""Note on a miniature wherever it is shown (docs/miniatures.md)."""
MINIATURE_MARK: Final = "§"
MINIATURE_WORDS: Final = f"{MINIATURE_MARK} miniature: {RANKS_NOTHING}"
_STORED_DIGITS: Final = 12
"""Significant digits of numbers in JSON: the last bits of a double may differ between processors."""


class AnyRate(Protocol):
    """A ratio with its denominator and interval: `benchmark.metrics.rates.Rate`, or the same from a record."""

    @property
    def value(self) -> float | None:
        """The ratio."""

    @property
    def denominator(self) -> int:
        """Number of samples, scenes or contacts that it was counted over."""

    @property
    def low(self) -> float | None:
        """Lower end of the interval."""

    @property
    def high(self) -> float | None:
        """Upper end of the interval."""


@dataclass(frozen=True, slots=True)
class TableCell:
    """One cell of a table, with the facts behind a number; ``miniature`` marks a planner that ranks nothing."""

    text: str
    cell: "CellSource | None" = None
    miniature: bool = False


@dataclass(frozen=True, slots=True)
class CellSource:
    """Facts behind a number.

    Attributes:
        value: In its unit, or ``None`` where it does not exist.
        unit: For example ``%``, ``m``, ``points`` (of per cent), ``x`` (times), or what a count counts.
        n: How many of ``of`` it was counted over; ``None`` where that is not known (quoted numbers).
        low: Lower end of the 95 % interval in the same unit, or ``None`` where there is none.
        high: Upper end; may be infinite.
        protocol: Protocol of the verdicts behind it, or ``None`` where it rests on none.
        record: Content id, planner and split of the records behind it; several are joined by semicolons.
        source: Where it is quoted from, if it is not ours.
    """

    value: float | None
    unit: str
    n: int | None
    of: str = "samples"
    low: float | None = None
    high: float | None = None
    protocol: str | None = None
    record: str | None = None
    source: str | None = None

    def shown(self, digits: int = 0, *, signed: bool = False, after: str = "") -> TableCell:
        """The number with ``digits`` decimals, or a dash; ``after`` is text behind a number that exists."""
        text = format_number(self.value, digits, signed=signed)
        return TableCell(text if self.value is None else f"{text}{after}", self)

    def interval(self, digits: int = 1) -> TableCell:
        """The interval as it is shown, for a column beside the number."""
        return TableCell(format_interval(self.low, self.high, digits=digits), self)

    def as_json(self) -> dict[str, Any]:
        """The facts that there are as JSON values; an end that is infinite is the text ``∞``."""
        facts = ((name, getattr(self, name)) for name in _FACTS)
        return {
            name: _to_json_number(value) if isinstance(value, float) else value
            for name, value in facts
            if value is not None
        }


_FACTS: Final = tuple(each.name for each in fields(CellSource))


@dataclass(frozen=True, slots=True)
class ValueSource:
    """Origin of numbers, fields as of `CellSource`; makes their cells."""

    protocol: str | None = None
    record: str | None = None
    source: str | None = None

    def cell(
        self,
        value: float | None,
        unit: str,
        n: int | None,
        of: str = "samples",
        *,
        low: float | None = None,
        high: float | None = None,
        scale: float = 1.0,
    ) -> CellSource:
        """A number from here, counted over ``n`` of ``of``.

        Number and ends are multiplied by ``scale`` (100 for a percentage), which gives the unit.
        """
        scaled = [None if number is None else scale * number for number in (value, low, high)]
        return CellSource(scaled[0], unit, n, of, scaled[1], scaled[2], self.protocol, self.record, self.source)

    def percent(self, rate: AnyRate, of: str = "samples") -> CellSource:
        """A rate as a percentage."""
        return self.cell(rate.value, PERCENT, rate.denominator, of, low=rate.low, high=rate.high, scale=100.0)

    def amount(self, rate: AnyRate, unit: str, of: str = "samples") -> CellSource:
        """A rate in its own unit."""
        return self.cell(rate.value, unit, rate.denominator, of, low=rate.low, high=rate.high)

    def count(self, count: int | None, of: str, among: int | None = None) -> CellSource:
        """Cell of a count among so many; ``None`` where it is all there are."""
        return self.cell(count, of, count if among is None else among, of)


def make_value_source(record: RunRecord, protocol: str | None) -> ValueSource:
    """Origin of the numbers of a run under a protocol."""
    return ValueSource(protocol, join_record_names(record))


def join_record_names(*records: RunRecord) -> str:
    """Content id, planner and split of each record, as cells name them."""
    return "; ".join(format_record_name(record.content_id, record.planner, record.run.split) for record in records)


def format_record_name(content_id: str, planner: str, split: str) -> str:
    """A record in a cell: its content id is the first word."""
    return f"{content_id} {planner} on {split}"


def format_number(value: float | None, digits: int = 2, *, signed: bool = False) -> str:
    """A number, or a dash where it does not exist; never "-0.0"."""
    if value is None:
        return UNDEFINED
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    text = f"{value:.{digits}f}"
    if float(text) == 0.0:
        return text.removeprefix("-")
    return f"+{text}" if signed and value > 0 else text


def format_interval(low: float | None, high: float | None, *, digits: int = 1) -> str:
    """An interval as ``[low, high]``, ``high`` perhaps infinite, or a dash where there is none to speak of.

    An interval without width is a dash too: where all scenes agree, "[0.0, 0.0]" would look like certainty.
    """
    if low is None or high is None or low == high:
        return UNDEFINED
    return f"[{format_number(low, digits)}, {format_number(high, digits)}]"


def _to_json_number(value: float) -> float | str:
    if math.isinf(value):
        return format_number(value)
    rounded = float(f"{value:.{_STORED_DIGITS}g}")
    return int(rounded) if rounded.is_integer() else rounded
