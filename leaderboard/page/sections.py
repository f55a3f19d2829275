"""Sections of a leaderboard: tables and figures under one heading, and the places of their files."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from benchmark.machine.extension import import_from_extension, list_offers
from benchmark.records.driving import PDM
from benchmark.report.table import Table

COST: Final = "cost"
"""Name of the table of latency and memory."""
CLOSED_LOOP: Final = "closed loop"
"""Heading above tables of drives."""
GENERATION: Final = "scenes and their generation"
_RATES: Final = "collision rates"
_GROUPS: Final = {
    "effect of the adversary": ("effect",),
    "severity": ("attack", "severity"),
    "causes": ("diagnosis",),
    "driving scores": (PDM,),
    "cost": (COST,),
    "transfer": ("transfer", "lift", "agreement"),
    "pairs of planners": ("planners",),
    "adversaries": ("ladder", "validity", "realism"),
    "protocols against exact": ("disagreement",),
}
"""Groups of tables on the site, by the first word of a table's name; all others are `_RATES`."""
TABS: Final = ("results", "transfer", "scenes", "planners", "generation", "protocols")
"""Tabs of the site."""
_TABS_OF: Final = {
    **dict.fromkeys(("transfer", "pairs of planners", "lift"), "transfer"),
    **dict.fromkeys(("adversaries", GENERATION, "video quality", "runtime"), "generation"),
    **dict.fromkeys(("protocols against exact", "disagreement"), "protocols"),
    "refinement": "scenes",
}
"""Tabs of groups of tables, and of figures by the first word of their names; all others are results."""


def find_group(table: Table) -> str:
    """Group that a table under ``exact`` and the planners' own protocols is shown in."""
    return next((group for group, kinds in _GROUPS.items() if find_kind(table.name) in kinds), _RATES)


def find_tab(shown: str) -> str:
    """Tab of the site that a group of tables, or a figure with this first word, is shown in."""
    return "protocols" if shown.startswith("protocol ") else _TABS_OF.get(shown, TABS[0])


def find_kind(name: str) -> str:
    """First word of the name of a table or figure: one of a kind stand in one CSV file."""
    return name.partition("-")[0]


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

    `tables` are written as data too, by their group on the site; `files` are further ones, by path below the
    leaderboard's folder; `data_name` is empty for published numbers.
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
