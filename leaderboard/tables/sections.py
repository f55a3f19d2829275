"""Sections of a leaderboard that extensions make of records of their own."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmark.machine.extension import OFFERS, from_extension
from benchmark.report.table import Table


@dataclass(frozen=True, slots=True)
class Section:
    """Tables under one heading.

    Attributes:
        data_name: The data set that they are of.
        group: What the site shows them under.
        heading: Of the page, in Markdown; empty where they go on under the one before.
        tables: The tables.
    """

    data_name: str
    group: str
    heading: str
    tables: Sequence[Table]


def sections_of(records: Mapping[str, Sequence[Any]]) -> Iterator[Section]:
    """Sections of records of every kind.

    Args:
        records: By kind; kinds without a record need no extension.

    Yields:
        The sections.

    Raises:
        InputError: If there are records of an extension that is not installed.
    """
    for kind in OFFERS["section"]:
        if records.get(kind):
            made: Iterable[Section] = from_extension("section", kind)(records[kind])
            yield from made
