"""Which sections a leaderboard has, and in which order they are read."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

from benchmark.machine.extension import list_offers
from benchmark.machine.storage import sanitise_file_name
from benchmark.report.table import Table, escape_markdown
from leaderboard.figures.contents import data_set_figures, matrix_figures, missing_figures
from leaderboard.figures.pressure import pressure_figures
from leaderboard.frame.results import LeaderboardResults
from leaderboard.page.sections import (
    CLOSED_LOOP,
    GENERATION,
    Section,
    SectionItem,
    build_extension_sections,
    drop_repeated_notes,
    find_group,
    find_kind,
)
from leaderboard.paper.document import build_paper_tables, format_paper_document
from leaderboard.paper.runtime_chart import runtime_charts
from leaderboard.tables.contents import build_data_set_tables, closed_loop_tables, generation_tables, missing_notes
from leaderboard.tables.drives import DISAGREEMENTS
from leaderboard.tables.published import published_comparison_tables, published_tables
from leaderboard.tables.slices import SLICES

TABLES_FOLDER: Final = "tables"
PAPER_FOLDER: Final = "paper"
"""Hold files of the leaderboard and nothing else, so that what is no longer made there can be told."""


def data_set_sections(results: LeaderboardResults) -> Iterator[Section]:
    """Runs of each data set: tables, pages and pictures."""
    for frame in results.frames:
        name, set_tables = frame.data_name, frame.once(build_data_set_tables)
        heading, of_tables = escape_markdown(name), {figure.name: figure for figure in matrix_figures(frame)}
        figures, notes = data_set_figures(frame, results.sheets), [*missing_notes(frame), *missing_figures(frame)]
        items: list[SectionItem] = [*(f"- {escape_markdown(note)}" for note in notes), ""] if notes else []
        for table in set_tables.front:
            items += [table, *([of_tables[table.name]] if table.name in of_tables else [])]
        items += figures
        if set_tables.slices:
            items += [f"By place, light, manoeuvre of the adversary, speed and command: {_name_file(SLICES)}.", ""]
        if set_tables.others:
            files = ", ".join(map(_name_file, ("changes", "planners", "transfer")))
            items += [f"Changes, planners and transfer under other protocols: {files}.", ""]
        items += [tables[0] for tables in set_tables.others.values()]
        groups = dict.fromkeys(map(find_group, set_tables.front))
        yield Section(
            name,
            heading,
            list(drop_repeated_notes(items)),
            [
                *((group, [table for table in set_tables.front if find_group(table) == group]) for group in groups),
                *([(SLICES, set_tables.slices)] if set_tables.slices else []),
                *((f"protocol {judge}", tables) for judge, tables in set_tables.others.items()),
            ],
            [*of_tables.values(), *figures],
        )


def _name_file(kind: str) -> str:
    return f"`{TABLES_FOLDER}/{kind}.csv`"


def closed_loop_sections(results: LeaderboardResults) -> Iterator[Section]:
    """Drives through each data set, beside open loop where the planners ran there too."""
    for name in sorted({record.facts.data.name for record in results.drives}):
        own = [record for record in results.drives if record.facts.data.name == name]
        tables, figures = closed_loop_tables(name, own, results.runs), pressure_figures(own)
        scenes = [table for table in tables if table.name.startswith(DISAGREEMENTS)]
        engines = {record.facts.measured.engine for record in own} - {"default", *list_offers("engine")}
        items: list[SectionItem] = [
            *(f"Engine {engine}: of an extension that is not installed here.\n" for engine in sorted(engines)),
            *(table for table in tables if table not in scenes),
        ]
        if scenes:
            items += [f"Scenes on which the two loops disagree: {_name_file(find_kind(scenes[0].name))}.", ""]
        heading = f"{escape_markdown(name)}: {CLOSED_LOOP}"
        yield Section(name, heading, [*items, *figures], [(CLOSED_LOOP, tables)], figures)


def extension_sections(results: LeaderboardResults) -> Iterator[Section]:
    """Sections that extensions make of records of their own."""
    return build_extension_sections(
        {"abilities": results.abilities, "challenges": results.challenges, "quality": results.quality}
    )


def paper_sections(results: LeaderboardResults) -> Iterator[Section]:
    """The paper's tables in its own layout, and one document of them, for each data set."""
    frames = {frame.data_name: frame for frame in results.frames}
    records = {name: frame.given for name, frame in frames.items()}
    for name, tables in build_paper_tables(records, results.sheets, results.ablations).items():
        folder, charts = f"{PAPER_FOLDER}/{sanitise_file_name(name)}", runtime_charts(name, results.sheets)
        beside = {f"paper-runtime-{number}.png": chart for number, chart in enumerate(charts)}
        document = format_paper_document(name, tables, [(path, chart.title) for path, chart in beside.items()])
        front: Iterable[Table] = frames[name].once(build_data_set_tables).front if name in frames else ()
        yield Section(
            name,
            f"{escape_markdown(name)}: the paper's layout",
            [
                f"As one LaTeX document: `{folder}/paper.tex`.",
                "",
                *(
                    item
                    for table in tables
                    for item in drop_repeated_notes([table], (n for t in front for n in t.notes))
                ),
                *charts,
            ],
            [("the paper's layout", tables)],
            charts,
            {
                **{f"{folder}/{path}": chart.png for path, chart in beside.items()},
                f"{folder}/paper.tex": document.encode(),
            },
        )


def generation_sections(results: LeaderboardResults) -> Iterator[Section]:
    """Scenes and how they were generated, for each data set."""
    for name, tables in generation_tables(results.sheets, results.ablations).items():
        yield Section.of_tables(name, GENERATION, f"{escape_markdown(name)}: {GENERATION}", tables)


def published_sections(results: LeaderboardResults) -> Iterator[Section]:
    """Numbers of others, apart from ours."""
    yield Section.of_tables(
        "", "published", "Published", [*published_tables(), *published_comparison_tables(results.runs)]
    )


SECTIONS: Final[Sequence[Callable[[LeaderboardResults], Iterable[Section]]]] = (
    data_set_sections,
    closed_loop_sections,
    extension_sections,
    paper_sections,
    generation_sections,
    published_sections,
)
