"""From run records to the files of a leaderboard; the same records give the same bytes."""

import filecmp
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import quote

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, is_leftover, sanitise_file_name, write_bytes, writing_to
from benchmark.records.run import RunRecord
from benchmark.report.plots import compute_page_size
from benchmark.report.table import escape_markdown, stack_csv
from leaderboard.frame.results import LeaderboardResults, build_frames
from leaderboard.page.contents import PAPER_FOLDER, SECTIONS, TABLES_FOLDER
from leaderboard.page.sections import NamedFigure, Section, SectionItem, find_kind
from leaderboard.site.index_data import PlacedFigure, PlacedTable
from leaderboard.site.site import INDEX_PATH, build_site_files
from leaderboard.tables.contents import DataSetTables, build_data_set_tables
from leaderboard.tables.slices import SLICES

Files = dict[str, bytes]
"""Bytes of each file by its path below the leaderboard's folder."""
FIGURES_FOLDER: Final = "figures"
_DARK_FIGURES: Final = "figures-dark"
"""Of the site alone."""
SITE_FOLDER: Final = "site"
"""Holds the site and nothing else."""
PUBLISHED: Final = "published"
OURS = (".tex", ".csv", ".json", ".md", ".png", ".svg")


def build_leaderboard_tables(records: Sequence[RunRecord]) -> list[DataSetTables]:
    """Every table that the records allow, as `leaderboard.frame.results.build_frames` reads them, by data set."""
    return [build_data_set_tables(frame) for frame in build_frames(records)]


def build_leaderboard_files(results: LeaderboardResults, *, figures: bool = False) -> Files:
    """The leaderboard's files without the site.

    ``README.md`` with the tables under ``exact`` and the planners' own protocols first; every table in ``tables.json``,
    ``tables.tex`` and, those of a kind in one file, ``tables/<kind>.csv``; published numbers apart from ours in
    ``published.csv``; the paper's tables as a LaTeX document below ``paper/<data set>/``; `figures` (PNG and SVG) below
    ``figures/<data set>/``.
    """
    return _build_contents(results, figures=figures).files


@dataclass(slots=True)
class _LeaderboardContents:
    """The leaderboard's files, and the tables, in reading order, and figures that the site shows of them.

    `of_site` draws files that only the site has; `page` are the lines of ``README.md``, which shows pictures of the
    folder `pictures`.
    """

    pictures: str
    files: Files = field(default_factory=dict)
    tables: list[PlacedTable] = field(default_factory=list)
    figures: list[PlacedFigure] = field(default_factory=list)
    of_site: dict[str, Callable[[], bytes]] = field(default_factory=dict)
    of_figures: Files = field(default_factory=dict)
    page: list[str] = field(default_factory=list)

    def add(self, section: Section) -> None:
        """Add a section, its files and those of its figures."""
        for group, tables in section.tables:
            self.tables += [PlacedTable(table, section.data_name, group) for table in tables]
        for figure in section.figures:
            self._draw(section.data_name, figure)
        self.files |= section.files
        self.page += [f"## {section.heading}", ""] if section.heading else []
        for item in section.shown:
            self.page += self._format_item(section.data_name, item)

    def _draw(self, data_name: str, figure: NamedFigure) -> None:
        stem = _name_picture(data_name, figure)
        light, dark = f"{FIGURES_FOLDER}/{stem}.svg", f"{_DARK_FIGURES}/{stem}.svg"
        self.of_figures |= {f"{FIGURES_FOLDER}/{stem}.png": figure.png, light: figure.svg}
        self.of_site |= {light: lambda: figure.svg, dark: figure.dark}
        size = compute_page_size(figure.png)
        self.figures.append(PlacedFigure(data_name, figure.name, figure.title, light, dark, size))

    def _format_item(self, data_name: str, item: SectionItem) -> list[str]:
        """Lines of the page for an item of a section."""
        if not isinstance(item, NamedFigure):
            return [item if isinstance(item, str) else item.markdown()]
        path = quote(f"{self.pictures}/{_name_picture(data_name, item)}.svg")
        return [f"![{escape_markdown(item.title)}]({path})", ""] if self.pictures else []


def _name_picture(data_name: str, figure: NamedFigure) -> str:
    return f"{sanitise_file_name(data_name)}/{sanitise_file_name(figure.name)}"


def _format_table_files(tables: Sequence[PlacedTable]) -> Files:
    """Tables as data: CSV, a file a kind, and all of them as JSON and as LaTeX."""
    kinds: dict[str, list[PlacedTable]] = {}
    for placed in tables:
        kind = f"{TABLES_FOLDER}/{sanitise_file_name(find_kind(placed.table.name))}" if placed.data_name else PUBLISHED
        kinds.setdefault(kind, []).append(placed)
    facts = [
        canonical_json({"data set": placed.data_name, "group": placed.group, **placed.table.as_json()})
        for placed in tables
    ]
    return {
        name: text.encode()
        for name, text in {
            **{f"{kind}.csv": stack_csv((each.data_name, each.table) for each in of) for kind, of in kinds.items()},
            "tables.json": "[\n" + ",\n".join(facts) + "\n]\n",
            "tables.tex": "\n".join(placed.table.latex() for placed in tables),
        }.items()
    }


def _build_contents(results: LeaderboardResults, *, site: bool = False, figures: bool = False) -> _LeaderboardContents:
    """Tables and figures; ``README.md`` names the site if there is one."""
    contents = _LeaderboardContents(FIGURES_FOLDER if figures else f"{SITE_FOLDER}/{FIGURES_FOLDER}" if site else "")
    contents.page += ["# Leaderboard", "", "Made from run records by `challenger-bench leaderboard`; do not edit.", ""]
    if site:
        page = f"{SITE_FOLDER}/index.html"
        contents.page += [
            f"Interactive tables and a player of every scene: open [{page}]({page}) in a browser.",
            "",
        ]
    contents.page += [
        "Definitions of all numbers: `docs/metrics.md` of challenger-bench. Every table as data: "
        f"`{TABLES_FOLDER}/`, a CSV file a kind; [tables.json](tables.json), with what stands behind each number; "
        "[tables.tex](tables.tex).",
        "",
    ]
    for sections in SECTIONS:
        for section in sections(results):
            contents.add(section)
    contents.files |= _format_table_files(contents.tables) | (contents.of_figures if figures else {})
    contents.files["README.md"] = "\n".join(contents.page).encode()
    return contents


def write_leaderboard(
    results: LeaderboardResults, folder: Path, *, site: bool = True, figures: bool = False
) -> list[Path]:
    """Write the leaderboard, and the site and figures if asked; what an earlier one had and this has not is removed.

    An unwritable file, or foreign content in the site's folder, is an `InputError`.
    """
    files = _all_files(results, site=site, figures=figures)
    if site:
        _require_own_site(folder / SITE_FOLDER)
    for name, content in files.items():
        data = content.read_bytes() if isinstance(content, Path) else content
        # A site has thousands of files, and every run of the command writes them all again.
        write_bytes(folder / name, data, durable=not name.startswith(f"{SITE_FOLDER}/"))
    for path in _find_left_over(files, folder):
        with writing_to(path):
            path.unlink()
    return [folder / name for name in files]


def find_stale_files(
    results: LeaderboardResults, folder: Path, *, site: bool = True, figures: bool = False
) -> list[str]:
    """One sentence for each file that is missing, left over or not as `write_leaderboard` would write it there."""
    sentences, files = [], _all_files(results, site=site, figures=figures)
    for name, content in files.items():
        path = folder / name
        if not path.is_file():
            sentences.append(f"{path} is missing")
        elif not _is_same_file(path, content):
            sentences.append(f"{path} differs from the run records")
    return [
        *sentences,
        *(f"{path} is no longer produced from the run records" for path in _find_left_over(files, folder)),
    ]


def _all_files(results: LeaderboardResults, *, site: bool, figures: bool) -> dict[str, bytes | Path]:
    """Every file; a path as value means a copy of that file, so that pictures are not all held at once."""
    contents = _build_contents(results, site=site, figures=figures)
    if not site:
        return dict(contents.files)
    # Slices of other protocols are only data: a site with all of them would be several times as large.
    shown = [each for each in contents.tables if each.group == SLICES or find_kind(each.table.name) != SLICES]
    drawn = {name: draw() for name, draw in contents.of_site.items()}
    pages = build_site_files(results, shown, contents.figures, drawn)
    return contents.files | {f"{SITE_FOLDER}/{name}": content for name, content in pages.items()}


def _require_own_site(folder: Path) -> None:
    """Refuse to write into, and later clear, a folder that is not a site of ours.

    Empty folders and unfinished files count as ours: a run killed before a first site has its first file leaves some.
    """
    if not (folder / INDEX_PATH).is_file() and any(
        not path.is_dir() and not is_leftover(path) for path in folder.rglob("*")
    ):
        raise InputError(
            f"{folder} holds files of no leaderboard (it has no {INDEX_PATH}); move it away, name another "
            "folder with --to, or leave the site out with --no-site"
        )


def _is_same_file(path: Path, content: bytes | Path) -> bool:
    if isinstance(content, Path):
        return filecmp.cmp(path, content, shallow=False)
    return path.read_bytes() == content


def _find_left_over(files: Mapping[str, bytes | Path], folder: Path) -> list[Path]:
    """Files in a leaderboard's folder that are no longer among its own: tables, figures, anything in a site of ours."""
    places = (TABLES_FOLDER, FIGURES_FOLDER, PAPER_FOLDER, PUBLISHED)
    paths = [path for place in places for path in sorted((folder / place).rglob("*")) if path.suffix in OURS]
    if f"{SITE_FOLDER}/{INDEX_PATH}" in files and (folder / SITE_FOLDER / INDEX_PATH).is_file():
        paths += sorted((folder / SITE_FOLDER).rglob("*"))
    return [path for path in paths if path.is_file() and path.relative_to(folder).as_posix() not in files]
