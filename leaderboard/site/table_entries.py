"""Tables as the site's data: the rows as they were rendered, and the facts behind their cells."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

from benchmark.metrics.disagreement import EXACT
from benchmark.report.cells import CellSource, format_number
from benchmark.report.table import Table
from leaderboard.frame.rows import OFF_SCALE


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


def take_part(table: Table, rows: Sequence[int], columns: Sequence[int]) -> Table:
    """Some rows and columns of a table that has facts, by their places, with the notes that a terminal shows."""
    labels = [label for label, span in table.groups for _ in range(span)] or [""] * len(table.columns)
    brief = table.brief
    return replace(
        table,
        title=table.title if brief is None else brief.title,
        columns=tuple(table.columns[column] for column in columns),
        rows=tuple(tuple(table.rows[row][column] for column in columns) for row in rows),
        notes=table.notes if brief is None else brief.notes,
        text_columns=sum(column < table.text_columns for column in columns),
        groups=tuple((label, len(list(same))) for label, same in groupby(labels[column] for column in columns)),
        cells=None if table.cells is None else tuple(tuple(table.cells[r][c] for c in columns) for r in rows),
        miniatures=tuple(table.miniatures[row] for row in rows) if table.miniatures else (),
        brief=None,
    )


def pivot_pairs(table: Table) -> Table:
    """A table of pairs of planners as a matrix: differences above its diagonal, their intervals below it."""
    value = next(place for place, name in enumerate(table.columns) if name.startswith("second − first"))
    names = list(dict.fromkeys(name for row in table.rows for name in row[:2]))
    texts = [[name, *[""] * len(names)] for name in names]
    facts: list[list[CellSource | None]] = [[None] * (len(names) + 1) for _ in names]
    for row, cells in zip(table.rows, table.cells or ()):
        first, second = names.index(row[0]), names.index(row[1])
        for at, to, shown in ((first, second, value), (second, first, value + 1)):
            texts[at][to + 1], facts[at][to + 1] = row[shown], cells[shown]
    note = "Above the diagonal: the planner of the column less that of the row, in points; below it: the 95 % interval."
    return replace(
        table,
        columns=("planner", *names),
        rows=tuple(map(tuple, texts)),
        notes=(note, *table.notes),
        text_columns=1,
        groups=(("", 1), (table.groups[-2][0], len(names))) if names else (),
        cells=tuple(map(tuple, facts)),
        miniatures=(),
        brief=None,
    )


def shade_pairs(table: Table) -> list[list[str | None]]:
    """Shades of the cells of `pivot_pairs`: ``p`` above zero, ``m`` below, 1 to 3 by size; ``b`` if beyond chance."""
    cells = [[cell.value or 0.0 if cell else 0.0 for cell in row] for row in table.cells or ()]
    on_scale = [place for place, name in enumerate(table.columns) if name != OFF_SCALE]
    most = max((abs(cells[row - 1][column]) for row in on_scale[1:] for column in on_scale), default=0.0) or 1.0

    def shade(cell: CellSource | None) -> str | None:
        if cell is None or not cell.value:
            return None
        beyond = cell.low is not None and cell.high is not None and cell.low * cell.high > 0
        return (
            f"{'p' if cell.value > 0 else 'm'}{min(math.ceil(3 * abs(cell.value) / most), 3)}{' b' if beyond else ''}"
        )

    return [[shade(cell) for cell in row] for row in table.cells or ()]


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
