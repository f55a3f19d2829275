"""Where files of tables lie, what is in them, and what is shown together."""

from collections.abc import Sequence
from typing import Final

from benchmark.machine.storage import file_name
from benchmark.records.driving import PDM
from benchmark.report.table import Table

COST: Final = "cost"
"""What planners take; name of its table."""
TABLES_FOLDER: Final = "tables"
"""Holds one folder for each data set and nothing else, so that what is no longer made there can be told."""

CLOSED_LOOP: Final = "closed loop"
"""What tables of drives are shown under."""
_RATES: Final = "collision rates"
_GROUPS: Final = {
    "planners and transfer": ("planners", "transfer", "lift", "agreement"),
    "attacks and scenes": ("attack", "severity", "ladder", "validity", "realism"),
    "causes and protocols": ("diagnosis", "disagreement"),
    "driving scores": (PDM,),
    "cost": (COST,),
}
"""What the site shows together, by the first word of a table's name; all others are `_RATES`."""


def group_of(table: Table) -> str:
    """Group that a table under ``exact`` and the planners' own protocols is shown in."""
    kind = table.name.partition("-")[0]
    return next((group for group, kinds in _GROUPS.items() if kind in kinds), _RATES)


def page_text(heading: str, tables: Sequence[Table]) -> bytes:
    """A page of tables, in Markdown, as its heading is."""
    return "\n".join([f"# {heading}", "", *(table.markdown() for table in tables)]).encode()


def page_path(data_name: str, name: str) -> str:
    """Path of a page of a data set below the leaderboard's folder."""
    return f"{TABLES_FOLDER}/{file_name(data_name)}/{file_name(name)}.md"


def table_files(folder: str, tables: Sequence[Table]) -> dict[str, bytes]:
    """LaTeX, CSV and JSON of tables, by path."""
    named = {f"{folder}/{file_name(table.name)}": table for table in tables}
    latex = {f"{name}.tex": table.latex().encode() for name, table in named.items()}
    facts = {f"{name}.json": table.json().encode() for name, table in named.items()}
    return latex | facts | {f"{name}.csv": table.csv().encode() for name, table in named.items()}
