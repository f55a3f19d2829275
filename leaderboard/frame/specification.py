"""Specification of a table: columns with heads and formats over rows of named values; splits of scene sheets."""

import itertools
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from benchmark.records.scene_pages import ScenePages, SplitPage
from benchmark.report.cells import PERCENT, UNDEFINED, CellSource, TableCell, ValueSource, format_record_name
from benchmark.report.table import LatexForm, Table, TableExcerpt, build_table
from leaderboard.frame.rows import split_sort_key

Value = CellSource | TableCell | str | None
Values = Mapping[str, Value]
"""A row: what stands in it, by name; a dash where there is nothing."""


@dataclass(frozen=True, slots=True)
class TableColumn:
    """One column, with its `head` and the `group` above the heads of neighbours.

    `text` columns lead; `signed` numbers have a sign when positive, `interval` ones show theirs.
    """

    head: str
    name: str
    group: str = ""
    text: bool = False
    digits: int = 0
    after: str = ""
    signed: bool = False
    interval: bool = False

    @property
    def key(self) -> str:
        """Key of the column in a table, where it is not called by its head."""
        return f"95 % of {self.name}" if self.interval else self.name

    def shown(self, row: Values) -> str | TableCell:
        """Text or number that a row shows here."""
        value = row.get(self.name)
        if value is None:
            return UNDEFINED
        if not isinstance(value, CellSource):
            return value
        return (
            value.interval(self.digits)
            if self.interval
            else value.shown(self.digits, signed=self.signed, after=self.after)
        )


Columns = list[TableColumn]


def text_columns(*heads: str) -> Columns:
    """Leading columns of text."""
    return [TableColumn(head, head, text=True) for head in heads]


def number_columns(*heads: str, digits: int = 0, after: str = "") -> Columns:
    """Columns of numbers; the value has the name of the head."""
    return [TableColumn(head, head, digits=digits, after=after) for head in heads]


def interval_columns(heads: Mapping[str, str], digits: int = 1) -> Columns:
    """Columns of the intervals of numbers: name of the value by head."""
    return [TableColumn(head, name, digits=digits, interval=True) for head, name in heads.items()]


def estimate_columns(
    *heads: str, digits: int = 1, ends: int = 1, beside: str = "95 % of {}", signed: bool = False
) -> Columns:
    """Columns of numbers, each with its interval beside it."""
    return [
        column
        for head in heads
        for column in (
            TableColumn(head, head, digits=digits, signed=signed),
            TableColumn(beside.format(head), head, digits=ends, interval=True),
        )
    ]


def numbered_columns(heads: Iterable[str], digits: int = 0) -> Columns:
    """A column for each head, under any title: the values have the names ``#0``, ``#1`` ..."""
    return [TableColumn(head, f"#{place}", digits=digits) for place, head in enumerate(heads)]


def group_columns(group: str, *columns: Columns) -> Columns:
    """Columns with one label above their heads."""
    return [replace(column, group=group) for column in itertools.chain(*columns)]


def tabulate(
    name: str,
    title: str,
    columns: Sequence[TableColumn],
    rows: Iterable[Values],
    notes: Sequence[str] = (),
    *,
    brief: Collection[str] | None = None,
    brief_title: str = "",
    brief_notes: Sequence[str] | None = None,
    sources: Sequence[str] = (),
    latex_form: LatexForm | None = None,
) -> Table:
    """Table of a specification, with its `brief` form for the terminal and the `sources` of quoted numbers.

    ``brief_notes`` are the notes that its rows need, without what columns mean.
    """
    groups = [(label, len(list(same))) for label, same in itertools.groupby(columns, lambda column: column.group)]
    brief_form = None
    if brief is not None or brief_notes is not None:
        places = [place for place, column in enumerate(columns) if brief is None or column.key in brief]
        shown_notes = tuple(notes if brief_notes is None else brief_notes)
        brief_form = TableExcerpt(
            brief_title or title, tuple(places), shown_notes, sum(columns[place].text for place in places)
        )
    return build_table(
        name,
        title,
        [column.head for column in columns],
        [[column.shown(row) for column in columns] for row in rows],
        notes=notes,
        text_columns=sum(column.text for column in columns),
        groups=groups if any(label for label, _ in groups) else (),
        sources=sources,
        brief=brief_form,
        latex_form=latex_form,
    )


def share_cell(origin: ValueSource, count: int, among: int, of: str) -> CellSource:
    """A count as a percentage of all."""
    return origin.cell(count / among if among else None, PERCENT, among, of, scale=100.0)


SplitTables = Callable[[str, Sequence[SplitPage]], Iterable[Table | None]]
"""Tables of the splits of one data set, by its name; ``None`` where there is nothing to show."""


def group_by_data_set(sheets: ScenePages, tables: SplitTables) -> dict[str, tuple[Table, ...]]:
    """Tables by name of the data set, in the order of the names; the paper's three splits come first."""
    splits: dict[str, list[SplitPage]] = {}
    for sheet in sorted(sheets.splits.values(), key=lambda sheet: (sheet.data.name, split_sort_key(sheet.split))):
        splits.setdefault(sheet.data.name, []).append(sheet)
    tables_by_name = {
        name: tuple(table for table in tables(name, own) if table is not None) for name, own in splits.items()
    }
    return {name: own_tables for name, own_tables in tables_by_name.items() if own_tables}


def merge_by_data_set(parts: Iterable[Mapping[str, Sequence[Table]]]) -> dict[str, tuple[Table, ...]]:
    """Tables of several kinds by name of the data set, in the order of the names."""
    mappings = list(parts)
    names = sorted({name for part in mappings for name in part})
    return {name: tuple(table for part in mappings for table in part.get(name, ())) for name in names}


def find_origin(sheet: SplitPage) -> ValueSource:
    """Origin of the numbers of a split: the data set's fingerprint stands for a record."""
    return ValueSource(record=format_record_name(sheet.data.fingerprint[:12], sheet.data.name, sheet.split))


def build_count_cells(splits: Sequence[SplitPage], of: str, count: Callable[[SplitPage], int]) -> dict[str, Value]:
    """A count of each split, for `leaderboard.frame.specification.numbered_columns`."""
    counts = [(split, count(split)) for split in splits]
    return {f"#{at}": TableCell(f"{n:,}", find_origin(split).count(n, of)) for at, (split, n) in enumerate(counts)}
