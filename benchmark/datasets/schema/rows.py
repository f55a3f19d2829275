"""Rows against their description: a quick look at whole columns, and where that fails each value by itself."""

import json
from collections import Counter
from collections.abc import Sequence
from operator import itemgetter
from typing import Any, Final

from benchmark.datasets.schema.faults import FaultList
from benchmark.datasets.schema.kinds import NAME, Kind
from benchmark.datasets.schema.tables import SCHEMA

Row = dict[str, Any]
_SHOWN_CHARACTERS: Final = 60


def check_table(table: str, content: list[Row], faults: FaultList) -> tuple[list[Row], dict[int, frozenset[str]]]:
    """Note all faults of a whole table, links apart.

    Returns:
        Rows with a sound token of their own; and the fields that are absent or unsound, by identity of
        the row.
    """
    unsound = check_rows(table, content, faults)
    rows = _with_tokens(table, content, unsound, faults)
    for name, field in SCHEMA[table].items():
        if field.unique and name != "token":
            _require_unique(table, name, field.kind, [row for row in rows if _has(row, name, unsound)], faults)
    return rows, unsound


def check_rows(table: str, rows: Sequence[Row], faults: FaultList, *, first: int = 0) -> dict[int, frozenset[str]]:
    """Fields that are absent or hold what they must not, by identity of the row, apart from all other rows.

    Args:
        first: Number of the first row in its file.
    """
    fields = SCHEMA[table]
    doubtful = [name for name, field in fields.items() if rows and not _column_holds(rows, name, field.kind)]
    unsound = {}
    for number, row in enumerate(rows if doubtful else (), first):
        bad = frozenset(name for name in doubtful if name not in row or not fields[name].kind.holds(row[name]))
        if not bad:
            continue
        unsound[id(row)] = bad
        token = "" if "token" in bad else row["token"]
        place = f"row {number}: " if not token else ""
        for name in sorted(bad):
            if name in row:
                sentence = f"{place}{name} is {shown(row[name])}, it must be {fields[name].kind.words}"
                faults.add(f"wrong {name}", table, token, sentence)
            else:
                faults.add(f"rows without {name}", table, token, f"{place}the field {name} is missing")
    return unsound


def shown(value: Any) -> str:
    """A value from a stranger's table, in a sentence: short, on one line, in plain characters."""
    try:
        text = json.dumps(value)
    except (RecursionError, ValueError):
        return f"a {type(value).__name__} too deep to show"
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[: _SHOWN_CHARACTERS - 3]}..."


def _column_holds(rows: Sequence[Row], name: str, kind: Kind) -> bool:
    try:
        return kind.column(list(map(itemgetter(name), rows)))
    except KeyError:
        return False


def _with_tokens(table: str, rows: list[Row], unsound: dict[int, frozenset[str]], faults: FaultList) -> list[Row]:
    """Rows with a token of their own."""
    seen: set[str] = set()
    kept: list[Row] = []
    for row in rows:
        if not _has(row, "token", unsound):
            continue
        if row["token"] in seen:
            faults.add("tokens used twice", table, row["token"], "two rows have this token")
        else:
            seen.add(row["token"])
            kept.append(row)
    return kept


def _has(row: Row, name: str, unsound: dict[int, frozenset[str]]) -> bool:
    return name not in unsound.get(id(row), ())


def _require_unique(table: str, name: str, kind: Kind, rows: list[Row], faults: FaultList) -> None:
    """Names of files count as one where they differ in capitals alone: not every system tells these apart."""
    spelled = [row[name].casefold() if kind is NAME else row[name] for row in rows]
    used = Counter(spelled)
    for row, spelling in zip(rows, spelled, strict=True):
        count = used.pop(spelling, 0)
        if count > 1:
            faults.add(f"{name} used twice", table, row["token"], f"{count} rows have the {name} {shown(row[name])}")
