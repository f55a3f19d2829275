"""Sections of a leaderboard: tables and figures under one heading, and the places of their files."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from benchmark.machine.extension import import_from_extension, list_offers
from benchmark.machine.storage import sanitise_file_name
from benchmark.records.driving import PDM
from benchmark.report.table import Table

COST: Final = "cost"
"""Name of the table of latency and memory."""
TABLES_FOLDER: Final = "tables"
"""Holds one folder for each data set and nothing else, so that what is no longer made there can be told."""

CLOSED_LOOP: Final = "closed loop"
"""Heading above tables of drives."""
_RATES: Final = "collision rates"
_GROUPS: Final = {
    "planners and transfer": ("planners", "transfer", "lift", "agreement"),
    "attacks and scenes": ("attack", "severity", "ladder", "validity", "realism"),
    "causes and protocols": ("diagnosis", "disagreement"),
    "driving scores": (PDM,),
    "cost": (COST,),
}
"""Groups of tables on the site, by the first word of a table's name; all others are `_RATES`."""


def find_group(table: Table) -> str:
    """Group that a table under ``exact`` and the planners' own protocols is shown in."""
    kind = table.name.partition("-")[0]
    return next((group for group, kinds in _GROUPS.items() if kind in kinds), _RATES)


def format_page(heading: str, tables: Sequence[Table]) -> bytes:
    """A page of tables, in Markdown, as its heading is."""
    return "\n".join([f"# {heading}", "", *(table.markdown() for table in tables)]).encode()


def find_page_path(data_name: str, name: str) -> str:
    """Path of a page of a data set below the leaderboard's folder."""
    return f"{TABLES_FOLDER}/{sanitise_file_name(data_name)}/{sanitise_file_name(name)}.md"


def format_table_files(folder: str, tables: Sequence[Table]) -> dict[str, bytes]:
    """LaTeX, CSV and JSON of tables, by path."""
    named = {f"{folder}/{sanitise_file_name(table.name)}": table for table in tables}
    latex = {f"{name}.tex": table.latex().encode() for name, table in named.items()}
    facts = {f"{name}.json": table.json().encode() for name, table in named.items()}
    return latex | facts | {f"{name}.csv": table.csv().encode() for name, table in named.items()}


@dataclass(frozen=True, slots=True)
class NamedFigure:
    """One picture: PNG for screens, SVG for print and light pages; `dark` draws the SVG for sites' dark pages."""

    name: str
    title: str
    png: bytes
    svg: bytes
    dark: Callable[[], bytes] = field(compare=False)


SectionItem = str | Table | NamedFigure


@dataclass(frozen=True, slots=True)
class Section:
    """Contents under one heading, in Markdown; it is empty where it goes on under the one before.

    `tables` have files, by their group on the site; `files` are further ones, by path below the leaderboard's folder;
    `data_name` is empty for published numbers.
    """

    data_name: str
    heading: str
    shown: Sequence[SectionItem]
    tables: Sequence[tuple[str, Sequence[Table]]]
    figures: Sequence[NamedFigure] = ()
    files: Mapping[str, bytes] = field(default_factory=dict)

    @classmethod
    def of_tables(cls, data_name: str, group: str, heading: str, tables: Sequence[Table]) -> "Section":
        """A section that shows tables and nothing else."""
        return cls(data_name, heading, tables, [(group, tables)])


def drop_repeated_notes(shown: Iterable[SectionItem], said: Iterable[str] = ()) -> Iterator[SectionItem]:
    """The same, without the notes below a table that a reader has read, or reads below one before."""
    known = set(said)
    for item in shown:
        if isinstance(item, Table):
            item = replace(item, notes=tuple(note for note in item.notes if note not in known))
            known.update(item.notes)
        yield item


def build_extension_sections(records: Mapping[str, Sequence[Any]]) -> Iterator[Section]:
    """Sections that extensions make of records by kind; kinds without a record need no extension."""
    for kind in list_offers("section"):
        if records.get(kind):
            extension_sections: Iterable[Section] = import_from_extension("section", kind)(records[kind])
            yield from extension_sections
