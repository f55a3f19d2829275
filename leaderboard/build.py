"""From run records to the files of a leaderboard; the same records give the same bytes."""

import filecmp
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final
from urllib.parse import quote

from benchmark.errors import InputError
from benchmark.machine.storage import file_name, is_left_over, write_bytes, writing_to
from benchmark.records.ablation import AblationReport
from benchmark.records.challenge_scores import ChallengeScores
from benchmark.records.drives import DriveRecord
from benchmark.records.quality import QualityRecord
from benchmark.records.run import RunRecord
from benchmark.records.scenes import NO_SHEETS, Sheets
from benchmark.report.plots import page_size
from benchmark.report.table import Table, escape_markdown
from leaderboard.figures.attacks import attack_figures, nothing_drawn
from leaderboard.figures.charts import NamedFigure, data_set_figures
from leaderboard.figures.heat_map import heat_maps, lift_maps
from leaderboard.figures.pressure import pressure_figures
from leaderboard.figures.refinement import refinement_figures
from leaderboard.paper.contents import paper_tables
from leaderboard.paper.document import paper_document
from leaderboard.paper.runtime_chart import runtime_charts
from leaderboard.selection import one_run_each
from leaderboard.site.index_data import PlacedFigure, PlacedTable
from leaderboard.site.site import INDEX_PATH, site_files
from leaderboard.tables.contents import DataSetTables, data_set_tables, generation_tables
from leaderboard.tables.cost import drive_cost_table
from leaderboard.tables.drives import drive_tables
from leaderboard.tables.loops import DISAGREEMENTS, loop_tables
from leaderboard.tables.pages import CLOSED_LOOP, TABLES_FOLDER, group_of, page_path, page_text, table_files
from leaderboard.tables.pressure import pressure_tables
from leaderboard.tables.published import published_tables
from leaderboard.tables.sections import sections_of
from leaderboard.tables.slices import SLICES
from leaderboard.tables.standing import standing_tables

Files = dict[str, bytes]
"""Bytes of each file by its path below the leaderboard's folder."""
FIGURES_FOLDER: Final = "figures"
"""Holds one folder for each data set and nothing else, as `TABLES_FOLDER` does."""
_DARK_FIGURES: Final = "figures-dark"
"""Of the site alone."""
SITE_FOLDER: Final = "site"
"""Holds the site and nothing else."""
_ON_THE_SITE: Final = (".tex", ".csv", ".json")
OURS = (".tex", ".csv", ".json", ".md", ".png", ".svg")


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
        data_set_tables(name, [record for record in chosen if record.run.data.name == name], chosen)
        for name in sorted({record.run.data.name for record in chosen})
    ]


def leaderboard_files(
    records: Sequence[RunRecord],
    quality: Sequence[QualityRecord] = (),
    sheets: Sheets = NO_SHEETS,
    ablations: Sequence[AblationReport] = (),
    drives: Sequence[DriveRecord] = (),
    challenges: Sequence[ChallengeScores] = (),
) -> Files:
    """The leaderboard's files without the site.

    Args:
        records: Run records of any data sets, splits and planners; none only if there is anything else.
        quality: Records of video quality.
        sheets: Scene sheets: statistics, manoeuvres, search and runtime are made from them.
        ablations: Ablation studies.
        drives: Records of drives.
        challenges: Scores of entries of challenges.

    Returns:
        ``README.md`` with the tables under ``exact`` and the planners' own protocols first; per table, LaTeX, CSV and
        JSON, and per other protocol a page, below ``tables/<data set>/``; heat maps and the other figures (PNG and SVG)
        below ``figures/<data set>/``; the published numbers apart from ours below ``published/``.
    """
    return _made(records, quality, sheets, ablations, drives, challenges).files


@dataclass(slots=True)
class _Made:
    """The leaderboard's files, and what the site shows of them.

    Attributes:
        files: Files without the site.
        tables: Tables in the order in which they are read.
        figures: Figures, with their place below the leaderboard's folder.
        records: Run records that stand in tables.
        of_site: Files that only the site has.
    """

    files: Files = field(default_factory=dict)
    tables: list[PlacedTable] = field(default_factory=list)
    figures: list[PlacedFigure] = field(default_factory=list)
    records: list[RunRecord] = field(default_factory=list)
    of_site: Files = field(default_factory=dict)

    def draw(self, data_name: str, figure: NamedFigure) -> None:
        """Add a figure and its files."""
        folder = file_name(data_name)
        vector = _picture(folder, figure.name, ".svg")
        dark = f"{_DARK_FIGURES}{vector.removeprefix(FIGURES_FOLDER)}"
        self.files |= {_picture(folder, figure.name): figure.png, vector: figure.svg}
        self.of_site[dark] = figure.dark
        self.figures.append(PlacedFigure(data_name, figure.title, vector, dark, page_size(figure.png)))

    def place(self, data_name: str, group: str, tables: Sequence[Table]) -> None:
        """Add tables and their files; those of no data set are published ones."""
        folder = f"{TABLES_FOLDER}/{file_name(data_name)}" if data_name else "published"
        # Of other protocols the slices are files alone: a site with all of them would be several times as large.
        on_site = [table for table in tables if group == SLICES or not table.name.startswith(f"{SLICES}-")]
        self.tables += [PlacedTable(table, data_name, group, folder) for table in on_site]
        self.files |= {name: text.encode() for name, text in table_files(folder, tables).items()}


def _made(
    records: Sequence[RunRecord],
    quality: Sequence[QualityRecord],
    sheets: Sheets,
    ablations: Sequence[AblationReport],
    drives: Sequence[DriveRecord],
    challenges: Sequence[ChallengeScores],
    *,
    site: bool = False,
) -> _Made:
    """Tables and figures; ``README.md`` names the site if there is one."""
    others = bool(quality or sheets.splits or ablations or drives or challenges)
    found = leaderboard_tables(records) if records or not others else []
    made = _Made()
    sections = ["# Leaderboard", "", "Made from run records by `challenger-bench leaderboard`; do not edit.", ""]
    if site:
        page = f"{SITE_FOLDER}/index.html"
        sections += [f"To sort, to filter, and every scene to play: [{page}]({page}), which any browser opens.", ""]
    sections += ["What each number is: `docs/metrics.md` of challenger-bench.", ""]
    for data_set in found:
        sections += _add_data_set(made, data_set, sheets, [record for each in found for record in each.records])
    sections += _add_closed_loop(made, drives)
    for section in sections_of({"challenges": challenges, "quality": quality}):
        made.place(section.data_name, section.group, section.tables)
        sections += [*((f"## {section.heading}", "") if section.heading else ())]
        sections += [table.markdown() for table in section.tables]
    sections += _add_paper(made, found, sheets, ablations)
    for name, tables in generation_tables(sheets, ablations).items():
        made.place(name, "scenes and their generation", tables)
        sections += [f"## {escape_markdown(name)}: scenes and their generation", ""]
        sections += [table.markdown() for table in tables]
    published = (*published_tables(), *standing_tables(made.records))
    made.place("", "published", published)
    sections += ["## Published", "", *(table.markdown() for table in published)]
    made.files["README.md"] = "\n".join(sections).encode()
    return made


def _add_data_set(made: _Made, data_set: DataSetTables, sheets: Sheets, every_record: Sequence[RunRecord]) -> list[str]:
    """Add tables, pages and pictures of one data set; its section of ``README.md``.

    ``every_record`` is of all data sets: generator settings are compared with one another.
    """
    name, folder = data_set.data_name, file_name(data_set.data_name)
    made.records += data_set.records
    for group in dict.fromkeys(map(group_of, data_set.front)):
        made.place(name, group, [table for table in data_set.front if group_of(table) == group])
    made.place(name, SLICES, data_set.slices)
    if data_set.slices:
        made.files[page_path(folder, SLICES)] = page_text(
            f"{escape_markdown(name)}: {SLICES}", data_set.slices
        ).encode()
    for protocol, tables in data_set.others.items():
        made.place(name, f"protocol {protocol}", tables)
        made.files[page_path(folder, protocol)] = page_text(
            f"{escape_markdown(name)}: protocol {escape_markdown(protocol)}", tables
        ).encode()
    titles = {table.name: table.title for table in data_set.front}
    for draw, matrices in ((heat_maps, data_set.matrices), (lift_maps, data_set.lifts)):
        for table_name, matrix in matrices.items():
            made.draw(name, NamedFigure(table_name, titles[table_name], *draw(matrix)))
    charts = (*data_set_figures(name, data_set.records), *attack_figures(name, every_record))
    figures = (*charts, *refinement_figures(name, sheets))
    for figure in figures:
        made.draw(name, figure)
    missing = nothing_drawn(name, data_set.records)
    if missing is not None:
        data_set = replace(data_set, notes=(*data_set.notes, missing))
    return _section(data_set, figures, folder)


def write_leaderboard(
    records: Sequence[RunRecord],
    folder: Path,
    quality: Sequence[QualityRecord] = (),
    sheets: Sheets = NO_SHEETS,
    ablations: Sequence[AblationReport] = (),
    drives: Sequence[DriveRecord] = (),
    *,
    challenges: Sequence[ChallengeScores] = (),
    site: bool = True,
) -> list[Path]:
    """Write the leaderboard; what an earlier one had and the records no longer give is removed.

    Args:
        records: Run records of any data sets, splits and planners.
        folder: Where to.
        quality: Records of video quality.
        sheets: Scene sheets.
        ablations: Ablation studies.
        drives: Records of drives.
        challenges: Scores of entries of challenges.
        site: Whether to write the site too.

    Returns:
        The files written.

    Raises:
        InputError: If a file cannot be written, or the site's folder holds something else.
    """
    files = _all_files(records, quality, sheets, ablations, drives, challenges, site=site)
    if site:
        _require_own(folder / SITE_FOLDER)
    for name, content in files.items():
        data = content.read_bytes() if isinstance(content, Path) else content
        # A site has thousands of files, and every run of the command writes them all again.
        write_bytes(folder / name, data, durable=not name.startswith(f"{SITE_FOLDER}/"))
    for path in _left_over(files, folder):
        with writing_to(path):
            path.unlink()
    return [folder / name for name in files]


def stale_files(
    records: Sequence[RunRecord],
    folder: Path,
    quality: Sequence[QualityRecord] = (),
    sheets: Sheets = NO_SHEETS,
    ablations: Sequence[AblationReport] = (),
    drives: Sequence[DriveRecord] = (),
    *,
    challenges: Sequence[ChallengeScores] = (),
    site: bool = True,
) -> list[str]:
    """Files of a leaderboard that differ from what the records say.

    Args:
        records: Run records of any data sets, splits and planners.
        folder: A leaderboard written earlier.
        quality: Records of video quality.
        sheets: Scene sheets.
        ablations: Ablation studies.
        drives: Records of drives.
        challenges: Scores of entries of challenges.
        site: Whether the site belongs to it.

    Returns:
        One sentence for each file that is missing, differs or is left over; empty if the leaderboard is current.
    """
    found, files = [], _all_files(records, quality, sheets, ablations, drives, challenges, site=site)
    for name, content in files.items():
        path = folder / name
        if not path.is_file():
            found.append(f"{path} is missing")
        elif not _same(path, content):
            found.append(f"{path} differs from what the run records say")
    return [
        *found,
        *(f"{path} is a file that the run records no longer give" for path in _left_over(files, folder)),
    ]


def _section(data_set: DataSetTables, figures: Sequence[NamedFigure], folder: str) -> list[str]:
    """A data set in ``README.md``; what is said below one table is not said again below the next."""
    said: set[str] = set()

    def shown(table: Table) -> str:
        fresh = _without(table, said)
        said.update(fresh.notes)
        return fresh.markdown()

    lines = [f"## {escape_markdown(data_set.data_name)}", ""]
    lines += [*(f"- {escape_markdown(note)}" for note in data_set.notes), ""] if data_set.notes else []
    for table in data_set.front:
        lines.append(shown(table))
        if table.name in {**data_set.matrices, **data_set.lifts}:
            lines += [f"![{escape_markdown(table.title)}]({quote(_picture(folder, table.name))})", ""]
    for figure in figures:
        lines += [f"![{escape_markdown(figure.title)}]({quote(_picture(folder, figure.name))})", ""]
    if data_set.slices:
        page = quote(page_path(folder, SLICES))
        lines += [f"The same by place, light, manoeuvre of the adversary, speed and command: [{SLICES}]({page}).", ""]
    if data_set.others:
        links = [f"[{escape_markdown(name)}]({quote(page_path(folder, name))})" for name in data_set.others]
        lines += [f"Changes, planners and transfer under the other protocols: {', '.join(links)}.", ""]
        lines += [shown(collision) for collision, *_ in data_set.others.values()]
    return lines


def _add_paper(
    made: _Made, found: Sequence[DataSetTables], sheets: Sheets, ablations: Sequence[AblationReport]
) -> list[str]:
    """Add the paper's tables in its own layout and one document of them for each data set; their sections."""
    lines: list[str] = []
    for data_name, tables in paper_tables({each.data_name: each.records for each in found}, sheets, ablations).items():
        folder, charts = file_name(data_name), runtime_charts(data_name, sheets)
        made.place(data_name, "the paper's layout", tables)
        beside = [(f"paper-runtime-{number}.png", chart.title) for number, chart in enumerate(charts)]
        for (name, _), chart in zip(beside, charts, strict=True):
            made.draw(data_name, chart)
            made.files[f"{TABLES_FOLDER}/{folder}/{name}"] = chart.png
        made.files[f"{TABLES_FOLDER}/{folder}/paper.tex"] = paper_document(data_name, tables, beside).encode()
        lines += [f"## {escape_markdown(data_name)}: the paper's layout", ""]
        lines += [f"As one document: `{TABLES_FOLDER}/{folder}/paper.tex`, which any LaTeX compiles.", ""]
        said = {note for each in found if each.data_name == data_name for table in each.front for note in table.notes}
        lines += [_without(table, said).markdown() for table in tables]
        for chart in charts:
            lines += [f"![{escape_markdown(chart.title)}]({quote(_picture(folder, chart.name))})", ""]
    return lines


def _without(table: Table, said: Collection[str]) -> Table:
    """A table less the notes that a reader has read."""
    return replace(table, notes=tuple(note for note in table.notes if note not in said))


def _add_closed_loop(made: _Made, drives: Sequence[DriveRecord]) -> list[str]:
    """Add the tables of drives, beside open loop where the planners ran there too; their sections of ``README.md``."""
    lines: list[str] = []
    for name in sorted({record.facts.data.name for record in drives}):
        own = [record for record in drives if record.facts.data.name == name]
        tables = [*drive_tables(own), *loop_tables(own, made.records), *pressure_tables(own)]
        cost = drive_cost_table(name, own)
        tables += [] if cost is None else [cost]
        made.place(name, CLOSED_LOOP, tables)
        page, path = f"{escape_markdown(name)}: {CLOSED_LOOP}", page_path(file_name(name), "closed-loop")
        made.files[path] = page_text(page, tables).encode()
        scenes = [table for table in tables if table.name.startswith(DISAGREEMENTS)]
        lines += [f"## {page}", "", *(table.markdown() for table in tables if table not in scenes)]
        if scenes:
            lines += [f"Scenes on which the two loops disagree, by name: [{CLOSED_LOOP}]({quote(path)}).", ""]
        for figure in pressure_figures(own):
            made.draw(name, figure)
            lines += [f"![{escape_markdown(figure.title)}]({quote(_picture(file_name(name), figure.name))})", ""]
    return lines


def _picture(folder: str, name: str, suffix: str = ".png") -> str:
    return f"{FIGURES_FOLDER}/{folder}/{file_name(name)}{suffix}"


def _all_files(
    records: Sequence[RunRecord],
    quality: Sequence[QualityRecord],
    sheets: Sheets,
    ablations: Sequence[AblationReport],
    drives: Sequence[DriveRecord],
    challenges: Sequence[ChallengeScores],
    *,
    site: bool,
) -> dict[str, bytes | Path]:
    """Every file; a path as value means a copy of that file, so that pictures are not all held at once."""
    made = _made(records, quality, sheets, ablations, drives, challenges, site=site)
    if not site:
        return dict(made.files)
    shown = {figure.path for figure in made.figures}
    downloads = {name: data for name, data in made.files.items() if name in shown or name.endswith(_ON_THE_SITE)}
    pages = site_files(made.records, made.tables, quality, sheets, made.figures, downloads | made.of_site, drives)
    return made.files | {f"{SITE_FOLDER}/{name}": content for name, content in pages.items()}


def _require_own(folder: Path) -> None:
    """Refuse to write into, and later clear, a folder that is not a site of ours.

    Empty folders and unfinished files are nobody's: who is killed before a first site has its first file leaves some.
    """
    if not (folder / INDEX_PATH).is_file() and any(
        not path.is_dir() and not is_left_over(path) for path in folder.rglob("*")
    ):
        raise InputError(
            f"{folder} holds files that are not the leaderboard's (it has no {INDEX_PATH}); move it away, name another "
            "folder with --to, or leave the site out with --no-site"
        )


def _same(path: Path, content: bytes | Path) -> bool:
    if isinstance(content, Path):
        return filecmp.cmp(path, content, shallow=False)
    return path.read_bytes() == content


def _left_over(files: Mapping[str, bytes | Path], folder: Path) -> list[Path]:
    """Files in a leaderboard's folder that are no longer among its own: tables, figures, anything in a site of ours."""
    found = [path for place in (TABLES_FOLDER, FIGURES_FOLDER) for path in sorted((folder / place).glob("*/*"))]
    found = [path for path in found if path.suffix in OURS]
    if f"{SITE_FOLDER}/{INDEX_PATH}" in files and (folder / SITE_FOLDER / INDEX_PATH).is_file():
        found += [path for path in sorted((folder / SITE_FOLDER).rglob("*")) if path.is_file()]
    return [path for path in found if path.relative_to(folder).as_posix() not in files]
