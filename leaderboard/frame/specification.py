"""A table as a specification: columns, each with a head and a format, over rows of named values."""

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from benchmark.report.cells import PERCENT, UNDEFINED, Cell, Origin, Shown
from benchmark.report.table import Brief, LatexForm, Table, table_of

Value = Cell | Shown | str | None
Values = Mapping[str, Value]
"""A row: what stands in it, by name; a dash where there is nothing."""


@dataclass(frozen=True, slots=True)
class Column:
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

    def shown(self, row: Values) -> str | Shown:
        """Text or number that a row shows here."""
        value = row.get(self.name)
        if value is None:
            return UNDEFINED
        if not isinstance(value, Cell):
            return value
        return (
            value.interval(self.digits)
            if self.interval
            else value.shown(self.digits, signed=self.signed, after=self.after)
        )


Columns = list[Column]


def texts(*heads: str) -> Columns:
    """Leading columns of text."""
    return [Column(head, head, text=True) for head in heads]


def numbers(*heads: str, digits: int = 0, after: str = "") -> Columns:
    """Columns of numbers; the value has the name of the head."""
    return [Column(head, head, digits=digits, after=after) for head in heads]


def intervals(heads: Mapping[str, str], digits: int = 1) -> Columns:
    """Columns of the intervals of numbers: name of the value by head."""
    return [Column(head, name, digits=digits, interval=True) for head, name in heads.items()]


def estimates(*heads: str, digits: int = 1, ends: int = 1, beside: str = "95 % of {}", signed: bool = False) -> Columns:
    """Columns of numbers, each with its interval beside it."""
    return [
        column
        for head in heads
        for column in (
            Column(head, head, digits=digits, signed=signed),
            Column(beside.format(head), head, digits=ends, interval=True),
        )
    ]


def places(heads: Iterable[str], digits: int = 0) -> Columns:
    """A column for each head, whatever it is called: the values have the names ``#0``, ``#1`` ..."""
    return [Column(head, f"#{place}", digits=digits) for place, head in enumerate(heads)]


def under(group: str, *columns: Columns) -> Columns:
    """Columns with one label above their heads."""
    return [replace(column, group=group) for column in itertools.chain(*columns)]


def tabulate(
    name: str,
    title: str,
    columns: Sequence[Column],
    rows: Iterable[Values],
    notes: Sequence[str] = (),
    *,
    brief: Collection[str] | None = None,
    brief_title: str = "",
    brief_notes: Sequence[str] | None = None,
    sources: Sequence[str] = (),
    latex_form: LatexForm | None = None,
) -> Table:
    """Table that a specification gives.

    `brief` are keys of the columns that a terminal shows, if not all, `brief_title` and `brief_notes` what it says
    above and below them, if not the same; `sources` say where quoted numbers come from.
    """
    groups = [(label, len(list(same))) for label, same in itertools.groupby(columns, lambda column: column.group)]
    shown = None
    if brief is not None:
        places = [place for place, column in enumerate(columns) if column.key in brief]
        said = tuple(notes if brief_notes is None else brief_notes)
        shown = Brief(brief_title or title, tuple(places), said, sum(columns[place].text for place in places))
    return table_of(
        name,
        title,
        [column.head for column in columns],
        [[column.shown(row) for column in columns] for row in rows],
        notes=notes,
        text_columns=sum(column.text for column in columns),
        groups=groups if any(label for label, _ in groups) else (),
        sources=sources,
        brief=shown,
        latex_form=latex_form,
    )


def share(origin: Origin, count: int, among: int, of: str) -> Cell:
    """A count as a percentage of all."""
    return origin.cell(count / among if among else None, PERCENT, among, of, scale=100.0)
