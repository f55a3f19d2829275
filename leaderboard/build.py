"""From run records to the files of a leaderboard; the same records give the same bytes."""

import filecmp
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import quote

from benchmark.errors import InputError
from benchmark.machine.storage import is_leftover, sanitise_file_name, write_bytes, writing_to
from benchmark.records.run import RunRecord
from benchmark.report.plots import compute_page_size
from benchmark.report.table import Table, escape_markdown
from leaderboard.frame.results import LeaderboardResults, build_frames
from leaderboard.page.contents import SECTIONS
from leaderboard.page.sections import TABLES_FOLDER, NamedFigure, Section, SectionItem, format_table_files
from leaderboard.site.index_data import PlacedFigure, PlacedTable
from leaderboard.site.site import INDEX_PATH, build_site_files
from leaderboard.tables.contents import DataSetTables, build_data_set_tables
from leaderboard.tables.slices import SLICES

Files = dict[str, bytes]
"""Bytes of each file by its path below the leaderboard's folder."""
FIGURES_FOLDER: Final = "figures"
"""Holds one folder for each data set and nothing else, as `TABLES_FOLDER` does."""
_DARK_FIGURES: Final = "figures-dark"
"""Of the site alone."""
SITE_FOLDER: Final = "site"
"""Holds the site and nothing else."""
_SITE_NOTE: Final = (".tex", ".csv", ".json")
OURS = (".tex", ".csv", ".json", ".md", ".png", ".svg")


def build_leaderboard_tables(records: Sequence[RunRecord]) -> list[DataSetTables]:
    """Every table that the records allow, as `leaderboard.frame.results.build_frames` reads them, by data set."""
    return [build_data_set_tables(frame) for frame in build_frames(records)]


def build_leaderboard_files(results: LeaderboardResults) -> Files:
    """The leaderboard's files without the site.

    ``README.md`` with the tables under ``exact`` and the planners' own protocols first; per table, LaTeX, CSV and JSON,
    and per other protocol a page, below ``tables/<data set>/``; figures (PNG and SVG) below ``figures/<data set>/``;
    the published numbers apart from ours below ``published/``.
    """
    return _build_contents(results).files


@dataclass(slots=True)
class _LeaderboardContents:
    """The leaderboard's files, and the tables, in reading order, and figures that the site shows of them.

    `of_site` draws files that only the site has; `page` are the lines of ``README.md``.
    """

    files: Files = field(default_factory=dict)
    tables: list[PlacedTable] = field(default_factory=list)
    figures: list[PlacedFigure] = field(default_factory=list)
    of_site: dict[str, Callable[[], bytes]] = field(default_factory=dict)
    page: list[str] = field(default_factory=list)

    def add(self, section: Section) -> None:
        """Add a section, its files and those of its tables and figures."""
        folder = sanitise_file_name(section.data_name) if section.data_name else ""
        for group, tables in section.tables:
            self._place(section.data_name, f"{TABLES_FOLDER}/{folder}" if folder else "published", group, tables)
        for figure in section.figures:
            self._draw(section.data_name, figure)
        self.files |= section.files
        self.page += [f"## {section.heading}", ""] if section.heading else []
        for item in section.shown:
            self.page += _format_item(folder, item)

    def _draw(self, data_name: str, figure: NamedFigure) -> None:
        folder = sanitise_file_name(data_name)
        vector = _format_picture(folder, figure.name, ".svg")
        dark = f"{_DARK_FIGURES}{vector.removeprefix(FIGURES_FOLDER)}"
        self.files |= {_format_picture(folder, figure.name): figure.png, vector: figure.svg}
        self.of_site[dark] = figure.dark
        self.figures.append(PlacedFigure(data_name, figure.title, vector, dark, compute_page_size(figure.png)))

    def _place(self, data_name: str, folder: str, group: str, tables: Sequence[Table]) -> None:
        # Slices of other protocols are only files: a site with all of them would be several times as large.
        on_site = [table for table in tables if group == SLICES or not table.name.startswith(f"{SLICES}-")]
        self.tables += [PlacedTable(table, data_name, group, folder) for table in on_site]
        self.files |= format_table_files(folder, tables)


def _format_item(folder: str, item: SectionItem) -> list[str]:
    """Lines of the page for an item of a section."""
    if isinstance(item, NamedFigure):
        return [f"![{escape_markdown(item.title)}]({quote(_format_picture(folder, item.name))})", ""]
    return [item if isinstance(item, str) else item.markdown()]


def _format_picture(folder: str, name: str, suffix: str = ".png") -> str:
    return f"{FIGURES_FOLDER}/{folder}/{sanitise_file_name(name)}{suffix}"


def _build_contents(results: LeaderboardResults, *, site: bool = False) -> _LeaderboardContents:
    """Tables and figures; ``README.md`` names the site if there is one."""
    contents = _LeaderboardContents()
    contents.page += ["# Leaderboard", "", "Made from run records by `challenger-bench leaderboard`; do not edit.", ""]
    if site:
        page = f"{SITE_FOLDER}/index.html"
        contents.page += [
            f"Interactive tables and a player of every scene: open [{page}]({page}) in a browser.",
            "",
        ]
    contents.page += ["Definitions of all numbers: `docs/metrics.md` of challenger-bench.", ""]
    for sections in SECTIONS:
        for section in sections(results):
            contents.add(section)
    contents.files["README.md"] = "\n".join(contents.page).encode()
    return contents


def write_leaderboard(results: LeaderboardResults, folder: Path, *, site: bool = True) -> list[Path]:
    """Write the leaderboard, and the site if asked; what an earlier one had and the records no longer give is removed.

    An unwritable file, or foreign content in the site's folder, is an `InputError`.
    """
    files = _all_files(results, site=site)
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


def find_stale_files(results: LeaderboardResults, folder: Path, *, site: bool = True) -> list[str]:
    """One sentence for each file that is missing, left over or not as `write_leaderboard` would write it there."""
    sentences, files = [], _all_files(results, site=site)
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


def _all_files(results: LeaderboardResults, *, site: bool) -> dict[str, bytes | Path]:
    """Every file; a path as value means a copy of that file, so that pictures are not all held at once."""
    contents = _build_contents(results, site=site)
    if not site:
        return dict(contents.files)
    shown_paths = {figure.path for figure in contents.figures}
    downloads = {
        name: data for name, data in contents.files.items() if name in shown_paths or name.endswith(_SITE_NOTE)
    }
    downloads |= {name: draw() for name, draw in contents.of_site.items()}
    pages = build_site_files(results, contents.tables, contents.figures, downloads)
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
    paths = [path for place in (TABLES_FOLDER, FIGURES_FOLDER) for path in sorted((folder / place).glob("*/*"))]
    paths = [path for path in paths if path.suffix in OURS]
    if f"{SITE_FOLDER}/{INDEX_PATH}" in files and (folder / SITE_FOLDER / INDEX_PATH).is_file():
        paths += [path for path in sorted((folder / SITE_FOLDER).rglob("*")) if path.is_file()]
    return [path for path in paths if path.relative_to(folder).as_posix() not in files]
