"""Sections of a leaderboard: tables and figures under one heading; extensions make some of records of their own."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from benchmark.machine.extension import OFFERS, from_extension
from benchmark.report.table import Table


@dataclass(frozen=True, slots=True)
class NamedFigure:
    """One picture: PNG for screens, SVG for print and light pages.

    `dark` draws the SVG for dark pages, which sites alone have.
    """

    name: str
    title: str
    png: bytes
    svg: bytes
    dark: Callable[[], bytes] = field(compare=False)


Item = str | Table | NamedFigure


@dataclass(frozen=True, slots=True)
class Section:
    """Contents under one heading.

    Attributes:
        data_name: The data set that it is of; empty for published numbers.
        heading: Of the page, in Markdown; empty where it goes on under the one before.
        tables: Tables that have files, by what the site shows them under.
        files: Further files, by path below the leaderboard's folder.
    """

    data_name: str
    heading: str
    shown: Sequence[Item]
    tables: Sequence[tuple[str, Sequence[Table]]]
    figures: Sequence[NamedFigure] = ()
    files: Mapping[str, bytes] = field(default_factory=dict)

    @classmethod
    def of_tables(cls, data_name: str, group: str, heading: str, tables: Sequence[Table]) -> "Section":
        """A section that shows tables and nothing else."""
        return cls(data_name, heading, tables, [(group, tables)])


def said_once(shown: Iterable[Item], said: Iterable[str] = ()) -> Iterator[Item]:
    """The same, without the notes below a table that a reader has read, or reads below one before."""
    known = set(said)
    for item in shown:
        if isinstance(item, Table):
            item = replace(item, notes=tuple(note for note in item.notes if note not in known))
            known.update(item.notes)
        yield item


def sections_of(records: Mapping[str, Sequence[Any]]) -> Iterator[Section]:
    """Sections that extensions make of records by kind; kinds without a record need no extension."""
    for kind in OFFERS["section"]:
        if records.get(kind):
            made: Iterable[Section] = from_extension("section", kind)(records[kind])
            yield from made
