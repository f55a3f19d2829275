"""Tables after the check of their rows: which rows and fields can be relied on by the checks that follow."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Self

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.schema import FaultList, check_table
from benchmark.datasets.stored_rows import TableScan
from benchmark.errors import InputError

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class CheckedTables:
    """Tables after the check of their rows, which are objects with a token of their own.

    Nothing more is said about links into ``unreadable`` tables, which are missing or no list of rows; ``unsound`` are
    fields that are absent or hold what they must not, by identity of the row.
    """

    rows: Mapping[str, list[Row]]
    by_token: Mapping[str, Mapping[str, Row]]
    unreadable: frozenset[str]
    unsound: Mapping[int, frozenset[str]]

    @classmethod
    def of_sound_rows(cls, rows: Mapping[str, list[Row]]) -> Self:
        """Tables whose rows are known to be as they must."""
        by_token = {table: {row["token"]: row for row in rows[table]} for table in rows}
        return cls(rows, by_token, frozenset(), {})

    def having(self, table: str, *fields: str) -> Iterator[Row]:
        """Rows in which these fields can be relied on."""
        if not self.unsound:
            yield from self.rows[table]
            return
        for row in self.rows[table]:
            bad = self.unsound.get(id(row))
            if bad is None or bad.isdisjoint(fields):
                yield row

    def get(self, table: str, token: str, *fields: str) -> Row | None:
        """Row of a token, if it exists and these fields of it can be relied on; a token that is no text has none."""
        row = self.by_token[table].get(token) if isinstance(token, str) else None
        if row is None or not self.unsound:
            return row
        bad = self.unsound.get(id(row))
        return row if bad is None or bad.isdisjoint(fields) else None


def read_checked(folder: Path, faults: FaultList) -> CheckedTables:
    """Read all 13 tables and check their rows; ``faults`` gets missing and unreadable tables too."""
    rows: dict[str, list[Row]] = {}
    unsound: dict[int, frozenset[str]] = {}
    unreadable = set()
    for table in NUSCENES_TABLES:
        content = _content(folder / f"{table}.json", table, faults)
        if content is None:
            unreadable.add(table)
        rows[table], unsound_fields = ([], {}) if content is None else check_table(table, content, faults)
        unsound |= unsound_fields
    by_token = {table: {row["token"]: row for row in rows[table]} for table in rows}
    return CheckedTables(rows, by_token, frozenset(unreadable), unsound)


def _content(path: Path, table: str, faults: FaultList) -> list[Row] | None:
    """Rows in a file, read as for opening the data set; ``None``, and a fault, where it cannot be read."""
    if not path.exists():
        faults.add("missing table", table, "", f"{path.name} is missing; a data set needs all 13 tables, even if empty")
        return None
    try:
        return list(chain.from_iterable(TableScan(path).batches()))
    except InputError as error:
        faults.add("unreadable table", table, "", f"{path.name} cannot be read: {error}")
        return None
