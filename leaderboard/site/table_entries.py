"""Tables as the site's data: the rows as they were rendered, and the facts behind their cells."""

import math
from collections.abc import Iterable
from typing import Any

from benchmark.metrics.disagreement import EXACT
from benchmark.report.cells import CellSource, format_number
from benchmark.report.table import Table


def sort_protocols(names: Iterable[str]) -> list[str]:
    """Protocols, each once, ``exact`` first."""
    return sorted(set(names), key=lambda name: (name != EXACT, name))


def table_entry(table: Table, name: str, origins: "OriginTable | None" = None) -> dict[str, Any]:
    """A table as the site shows it; `name` is its own on the site, and its cells have facts with `origins` alone."""
    cells = None
    if origins is not None and table.cells is not None:
        cells = [[origins.cell(cell) for cell in row] for row in table.cells]
    return {
        "id": name,
        "title": table.title,
        "columns": table.columns,
        "textColumns": table.text_columns,
        "rows": table.rows,
        "groups": table.groups,
        "cells": cells,
        "notes": table.remarks,
    }


class OriginTable:
    """Common parts of many cells, written once: cells name its place as ``record``.

    `found` has for each origin the places of its unit, of what is counted, of its protocol, record and source among the
    words; -1 where there is none.
    """

    def __init__(self) -> None:
        self._origins: dict[tuple[int, ...], int] = {}
        self._words: dict[str, int] = {}

    @property
    def found(self) -> list[list[int]]:
        """Places of the facts of each origin among the words."""
        return [list(origin) for origin in self._origins]

    @property
    def words(self) -> list[str]:
        """Texts, each once."""
        return list(self._words)

    def cell(self, cell: CellSource | None) -> dict[str, Any] | None:
        """The facts behind a number, whose text is in the row; what there is none of is left out."""
        if cell is None:
            return None
        origin_values = (cell.unit, cell.of, cell.protocol, cell.record, cell.source)
        origin = tuple(-1 if word is None else self._words.setdefault(word, len(self._words)) for word in origin_values)
        numbers = {"low": cell.low, "high": cell.high, "n": cell.n}
        rounded = {name: _round_significant(value) for name, value in numbers.items() if value is not None}
        return {**rounded, "record": self._origins.setdefault(origin, len(self._origins))}


def _round_significant(value: float) -> float | int | str:
    """Four digits: more than pages show."""
    if isinstance(value, int):
        return value
    if not math.isfinite(value):
        return format_number(value)
    short = float(f"{value:.4g}")
    return int(short) if short.is_integer() else short
