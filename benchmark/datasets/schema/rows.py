"""Rows against their description, whole columns first and single values where that fails; faults and their error."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, Literal

from benchmark.datasets.schema.tables import NAME, SCHEMA, ValueKind
from benchmark.errors import InputError
from benchmark.untrusted.files import to_one_line

Severity = Literal["error", "warning"]

SHOWN_PER_KIND: Final = 5
"""Faults of one kind in one table that are told one by one; the rest are counted."""
_LONGEST: Final = 1000
"""Characters of a sentence: a fault may quote what a stranger wrote."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with a data set; ``token`` of the row may be empty.

    ``error``: software that follows the format crashes or computes something wrong. ``warning``: legal, but most likely
    not meant.
    """

    table: str
    token: str
    sentence: str
    severity: Severity = "error"


@dataclass(slots=True)
class FaultList:
    """Collects faults; of each kind in each table the first few are kept and the rest counted."""

    faults: list[Fault] = field(default_factory=list)
    counts: Counter[tuple[str, str, Severity]] = field(default_factory=Counter)

    def add(self, kind: str, table: str, token: str, sentence: str, *, severity: Severity = "error") -> None:
        """Note a fault; ``kind``, two or three words for what such faults have in common, names them when counted."""
        self.counts[(kind, table, severity)] += 1
        if self.counts[(kind, table, severity)] <= SHOWN_PER_KIND:
            self.faults.append(Fault(table, token, to_one_line(sentence, _LONGEST), severity))

    def told(self) -> list[Fault]:
        """The faults, errors first, each kind that was cut short ended by how many more there are."""
        more = [
            Fault(table, "", f"and {count - SHOWN_PER_KIND} more: {kind}", severity)
            for (kind, table, severity), count in self.counts.items()
            if count > SHOWN_PER_KIND
        ]
        return sorted([*self.faults, *more], key=lambda fault: fault.severity)


@dataclass(slots=True)
class StrictFaultList(FaultList):
    """Refuses at the first error; warnings are for those who ask for them."""

    folder: Path = Path()

    def add(self, kind: str, table: str, token: str, sentence: str, *, severity: Severity = "error") -> None:
        """Raise for an error."""
        if severity == "warning":
            return
        path = self.folder / (table if table.endswith(".json") else f"{table}.json")
        place = f"{path} row {token}" if token else str(path)
        raise InputError(
            f"{place}: {sentence}; correct the data set (to see all faults, run challenger-bench data check "
            f"{self.folder.parent})"
        )


Row = dict[str, Any]
_SHOWN_CHARACTERS: Final = 60


def check_table(table: str, content: list[Row], faults: FaultList) -> tuple[list[Row], dict[int, frozenset[str]]]:
    """Note all faults of a whole table, links apart: rows with a sound token, and unsound fields by identity of row."""
    unsound = check_rows(table, content, faults)
    rows = _with_tokens(table, content, unsound, faults)
    for name, column in SCHEMA[table].items():
        if column.unique and name != "token":
            _require_unique(table, name, column.kind, [row for row in rows if _has(row, name, unsound)], faults)
    return rows, unsound


def check_rows(table: str, rows: Sequence[Row], faults: FaultList, *, first: int = 0) -> dict[int, frozenset[str]]:
    """Fields absent or with what they must not hold, by identity of the row; ``first`` is its number in the file."""
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
                sentence = f"{place}{name} is {format_value(row[name])}, it must be {fields[name].kind.words}"
                faults.add(f"wrong {name}", table, token, sentence)
            else:
                faults.add(f"rows without {name}", table, token, f"{place}the field {name} is missing")
    return unsound


def format_value(value: Any) -> str:
    """A value from a stranger's table, in a sentence: short, on one line, in plain characters."""
    try:
        text = json.dumps(value)
    except (RecursionError, ValueError):
        return f"a {type(value).__name__} too deep to show"
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[: _SHOWN_CHARACTERS - 3]}..."


def _column_holds(rows: Sequence[Row], name: str, kind: ValueKind) -> bool:
    try:
        return kind.column(list(map(itemgetter(name), rows)))
    except KeyError:
        return False


def _with_tokens(table: str, rows: list[Row], unsound: dict[int, frozenset[str]], faults: FaultList) -> list[Row]:
    tokens: set[str] = set()
    kept: list[Row] = []
    for row in rows:
        if not _has(row, "token", unsound):
            continue
        if row["token"] in tokens:
            faults.add("tokens used twice", table, row["token"], "two rows have this token")
        else:
            tokens.add(row["token"])
            kept.append(row)
    return kept


def _has(row: Row, name: str, unsound: dict[int, frozenset[str]]) -> bool:
    return name not in unsound.get(id(row), ())


def _require_unique(table: str, name: str, kind: ValueKind, rows: list[Row], faults: FaultList) -> None:
    """Names of files count as one where they differ in capitals alone: not every system tells these apart."""
    spelled = [row[name].casefold() if kind is NAME else row[name] for row in rows]
    used = Counter(spelled)
    for row, spelling in zip(rows, spelled, strict=True):
        count = used.pop(spelling, 0)
        if count > 1:
            faults.add(
                f"{name} used twice", table, row["token"], f"{count} rows have the {name} {format_value(row[name])}"
            )
