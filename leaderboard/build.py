"""From run records to the files of a leaderboard; the same records give the same bytes."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from benchmark.errors import InputError
from benchmark.quality.records import QualityRecord
from benchmark.records import RunRecord
from benchmark.storage import file_name, write_bytes, writing_to
from leaderboard.collision import published_table
from leaderboard.contents import DataSetTables, data_set_tables
from leaderboard.figures import NamedFigure, data_set_figures
from leaderboard.heat_map import heat_map
from leaderboard.quality_table import published_quality_table, quality_tables
from leaderboard.selection import one_run_each
from leaderboard.tables import Table, escape_markdown

Files = dict[str, bytes]
"""Bytes of each file by its path below the leaderboard's folder."""
TABLES_FOLDER, FIGURES_FOLDER = "tables", "figures"
"""Hold one folder for each data set and nothing else, so that what is no longer made there can be told."""
OURS = (".tex", ".csv", ".md", ".png", ".svg")


def leaderboard_tables(records: Sequence[RunRecord]) -> list[DataSetTables]:
    """Every table that the records allow.

    Args:
        records: Run records of any data sets, splits and planners, in any order; `one_run_each` says which of them
            count.

    Returns:
        The tables of each data set, by its name.

    Raises:
        InputError: If there are no records, two records of one planner and split would share a row, or records of one
            split saw different data.
    """
    if not records:
        raise InputError("there are no run records to make tables of; run challenger-bench eval first")
    chosen = one_run_each(records)
    return [
        data_set_tables(name, [record for record in chosen if record.run.data.name == name])
        for name in sorted({record.run.data.name for record in chosen})
    ]


def leaderboard_files(records: Sequence[RunRecord], quality: Sequence[QualityRecord] = ()) -> Files:
    """The leaderboard's files.

    Args:
        records: See `leaderboard_tables`; none only if there are quality records.
        quality: Records of video quality.

    Returns:
        ``README.md`` with the tables under ``exact`` and the planners' own protocols first; per table, LaTeX and CSV,
        and per other protocol a page, below ``tables/<data set>/``; heat maps and the other figures (PNG and SVG) below
        ``figures/<data set>/``; the
        published numbers apart from ours below ``published/``.
    """
    found = leaderboard_tables(records) if records or not quality else []
    published = published_table()
    text: dict[str, str] = _table_files("published", [published])
    sections = ["# Leaderboard", "", "Made from run records by `challenger-bench leaderboard`; do not edit.", ""]
    sections += ["What each number is: `docs/metrics.md` of challenger-bench.", ""]
    files: Files = {}
    for data_set in found:
        folder = file_name(data_set.data_name)
        text |= _table_files(f"{TABLES_FOLDER}/{folder}", data_set.tables)
        text |= {_page(folder, name): _page_text(data_set, name) for name in data_set.others}
        for name, matrix in data_set.matrices.items():
            files[_picture(folder, name)] = heat_map(matrix, ".png")
        figures = data_set_figures(data_set.data_name, data_set.records)
        for figure in figures:
            files[_picture(folder, figure.name)] = figure.png
            files[_picture(folder, figure.name, ".svg")] = figure.svg
        sections += _section(data_set, figures, folder)
    sections += _quality(quality, text)
    text["README.md"] = "\n".join([*sections, "## Published", "", published.markdown()])
    return files | {name: content.encode() for name, content in text.items()}


def write_leaderboard(records: Sequence[RunRecord], folder: Path, quality: Sequence[QualityRecord] = ()) -> list[Path]:
    """Write the leaderboard; what an earlier one had and the records no longer give is removed.

    Args:
        records: See `leaderboard_tables`.
        folder: Where to.
        quality: Records of video quality.

    Returns:
        The files written.
    """
    files = leaderboard_files(records, quality)
    for name, content in files.items():
        write_bytes(folder / name, content)
    for path in _left_over(files, folder):
        with writing_to(path):
            path.unlink()
    return [folder / name for name in files]


def stale_files(records: Sequence[RunRecord], folder: Path, quality: Sequence[QualityRecord] = ()) -> list[str]:
    """Files of a leaderboard that differ from what the records say.

    Args:
        records: See `leaderboard_tables`.
        folder: A leaderboard written earlier.
        quality: Records of video quality.

    Returns:
        One sentence for each file that is missing, differs or is left over; empty if the leaderboard is current.
    """
    found, files = [], leaderboard_files(records, quality)
    for name, content in files.items():
        path = folder / name
        if not path.is_file():
            found.append(f"{path} is missing")
        elif path.read_bytes() != content:
            found.append(f"{path} differs from what the run records say")
    return [
        *found,
        *(f"{path} is a table or figure that the run records no longer give" for path in _left_over(files, folder)),
    ]


def _section(data_set: DataSetTables, figures: Sequence[NamedFigure], folder: str) -> list[str]:
    """A data set in ``README.md``; what is said below one table is not said again below the next."""
    said: set[str] = set()

    def shown(table: Table) -> str:
        new = tuple(note for note in table.notes if note not in said)
        said.update(new)
        return replace(table, notes=new).markdown()

    lines = [f"## {escape_markdown(data_set.data_name)}", ""]
    lines += [*(f"- {escape_markdown(note)}" for note in data_set.notes), ""] if data_set.notes else []
    for table in data_set.front:
        lines.append(shown(table))
        if table.name in data_set.matrices:
            lines += [f"![{escape_markdown(table.title)}]({quote(_picture(folder, table.name))})", ""]
    for figure in figures:
        lines += [f"![{escape_markdown(figure.title)}]({quote(_picture(folder, figure.name))})", ""]
    if data_set.others:
        links = [f"[{escape_markdown(name)}]({quote(_page(folder, name))})" for name in data_set.others]
        lines += [f"Changes, planners and transfer under the other protocols: {', '.join(links)}.", ""]
        lines += [shown(collision) for collision, *_ in data_set.others.values()]
    return lines


def _quality(records: Sequence[QualityRecord], text: dict[str, str]) -> list[str]:
    """The section on video quality; its LaTeX and CSV files are added to ``text``."""
    if not records:
        return []
    lines = ["## Video quality", ""]
    for data_name in sorted({record.facts.data.name for record in records}):
        tables = quality_tables([record for record in records if record.facts.data.name == data_name])
        text |= _table_files(f"{TABLES_FOLDER}/{file_name(data_name)}", tables)
        lines += [table.markdown() for table in tables]
    text |= _table_files("published", [published_quality_table()])
    return lines


def _page_text(data_set: DataSetTables, protocol: str) -> str:
    heading = f"# {escape_markdown(data_set.data_name)}: protocol {escape_markdown(protocol)}"
    return "\n".join([heading, "", *(table.markdown() for table in data_set.others[protocol])])


def _table_files(folder: str, tables: Sequence[Table]) -> dict[str, str]:
    named = {f"{folder}/{file_name(table.name)}": table for table in tables}
    latex = {f"{name}.tex": table.latex() for name, table in named.items()}
    return latex | {f"{name}.csv": table.csv() for name, table in named.items()}


def _page(folder: str, protocol: str) -> str:
    return f"{TABLES_FOLDER}/{folder}/{file_name(protocol)}.md"


def _picture(folder: str, name: str, suffix: str = ".png") -> str:
    return f"{FIGURES_FOLDER}/{folder}/{file_name(name)}{suffix}"


def _left_over(files: Files, folder: Path) -> list[Path]:
    """Tables and figures in a leaderboard's folder that are not among its files."""
    found = [path for place in (TABLES_FOLDER, FIGURES_FOLDER) for path in sorted((folder / place).glob("*/*"))]
    return [path for path in found if path.suffix in OURS and path.relative_to(folder).as_posix() not in files]
