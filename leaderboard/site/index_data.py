"""The site's index: everything that is shown without loading a scene, with planners' runs, rates and scores."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote

from benchmark.machine.storage import sanitise_file_name
from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.records.driving import PDM
from benchmark.records.planner_versions import list_file_notes
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import is_baseline
from benchmark.records.scene_pages import ScenePages
from benchmark.report.cells import MINIATURE_WORDS
from benchmark.report.table import Table
from benchmark.report.words import ABBREVIATIONS, pluralise
from leaderboard.frame.results import LeaderboardResults
from leaderboard.frame.rows import count_recordings, name_cell, sort_for_tables
from leaderboard.frame.runs import DataSetRuns
from leaderboard.page.sections import find_kind, find_tab
from leaderboard.site.drive_data import build_drive_index
from leaderboard.site.scene_facts import scene_key
from leaderboard.site.scene_index import build_scene_index
from leaderboard.site.scene_words import LEGEND, list_filters, list_orders
from leaderboard.site.start_page import build_starts
from leaderboard.site.table_entries import OriginTable, pivot_pairs, shade_pairs, sort_protocols, table_entry, take_part
from leaderboard.tables.collision import collision_table
from leaderboard.tables.effect import effect_table


def build_model_index(records: Sequence[RunRecord]) -> list[dict[str, Any]]:
    """Planners in the order of tables, of at most one record for each data set, split and planner.

    ``name``, ``shown`` (with its marks), ``lead`` (sentences), ``data`` (data sets), ``facts`` and ``runs`` (a title
    and facts each); a fact is a term and a text, and ``code`` where it is a hash.
    """
    runs_of: dict[str, list[RunRecord]] = {}
    for record in sort_for_tables(records):
        runs_of.setdefault(record.planner, []).append(record)
    return [
        {
            "name": name,
            "shown": name_cell(name, runs[0].run.planner).text,
            "lead": _describe_planner(runs[0]),
            "data": list(dict.fromkeys(run.run.data.name for run in runs)),
            "facts": [
                ["weights, SHA-256", runs[0].run.planner.weights_sha256 or "none", "code"],
                ["seed", str(runs[0].run.planner.seed)],
                *_list_known("settings", "; ", ": ", runs[0].run.planner.settings),
            ],
            "runs": [_run_entry(record) for record in runs],
        }
        for name, runs in runs_of.items()
    ]


def _describe_planner(record: RunRecord) -> list[str]:
    facts = record.run.planner
    own = facts.native_protocol
    return [
        *(["A reference: it is privileged (sees boxes, the map or the recorded future)."] if facts.privileged else []),
        *([f"{MINIATURE_WORDS}."] if facts.miniature else []),
        f"Protocol of its own repository: {own}."
        if own
        else "It has no repository of its own, so that its own protocol is exact.",
    ]


def _run_entry(record: RunRecord) -> dict[str, Any]:
    """One run, with code, commit and machine: two runs of a planner may differ in them."""
    run, summary = record.run, record.summary
    environment = run.environment
    source = _to_texts(environment.get("source") or {})
    commit = source.get("commit")
    changes = " with changes" if source.get("dirty") == "true" else ""
    samples, scenes = pluralise(summary.samples, "sample"), pluralise(len(run.scenes), "scene")
    return {
        "title": f"{run.data.name}, {run.split}: {samples} of {scenes}",
        "facts": [
            ["record", record.content_id, "code"],
            ["data, fingerprint", run.data.fingerprint, "code"],
            *([["code, SHA-256", run.planner.code_sha256, "code"]] if run.planner.code_sha256 else []),
            ["commit", f"{commit}{changes}", "code"] if commit else ["commit", "not known"],
            ["scenes", f"{len(run.scenes)} of {run.scenes_in_split}, from {count_recordings(record)} recordings"],
            ["samples without a plan", str(summary.failed)],
            *([] if run.plans_from is None else [["plans", list_file_notes([record])[0]]]),
            ["judged anew since", "no" if run.rescored is None else "yes"],
            *_list_known("machine", "; ", ": ", environment.get("hardware") or {}),
            *_list_known("packages", ", ", " ", environment.get("packages") or {}),
        ],
    }


def _list_known(term: str, between: str, after: str, facts: Any) -> list[list[str]]:
    """The fact of many in one line, if there are any."""
    words = between.join(f"{name}{after}{value}" for name, value in _to_texts(facts).items())
    return [[term, words]] if words else []


def _to_texts(facts: Any) -> dict[str, str | None]:
    """Facts of a foreign record as text: they may hold anything that JSON can, NaN too."""
    if not isinstance(facts, Mapping):
        return {}
    return {str(name): _to_text(value) for name, value in facts.items()}


def _to_text(value: Any) -> str | None:
    return value if value is None or isinstance(value, str) else json.dumps(value)


TITLE: Final = "challenger-bench"
_OF_PLANNER: Final = ("collision-", "effect", "diagnosis", PDM)
"""First words of the names of tables whose rows a planner's page shows."""
_MOVED: Final = {
    "planners and transfer": "transfer",
    "attacks and scenes": "results",
    "causes and protocols": "protocols",
    "figures": "results",
}
"""Tabs in which groups of tables of earlier sites are now; links to these groups lead there."""


@dataclass(frozen=True, slots=True)
class PlacedTable:
    """A table of a data set, or of none if its name is empty; `group` is for example ``protocol vad``."""

    table: Table
    data_name: str
    group: str


@dataclass(frozen=True, slots=True)
class PlacedFigure:
    """A figure among the site's files, by paths below its folder.

    `size_px` is (width, height) at which its letters are as large as the page's; a page leaves that room before
    loading.
    """

    data_name: str
    name: str
    title: str
    path: str
    dark_path: str
    size_px: tuple[int, int]


def build_index(
    results: LeaderboardResults, tables: Sequence[PlacedTable], figures: Sequence[PlacedFigure], written: frozenset[str]
) -> dict[str, Any]:
    """The value of ``window.CHALLENGER`` in the order of pages; ``written`` are paths of tables and figures.

    The ``page`` of each of its ``scenes`` belongs in the scene's script.
    """
    ids, origins = _table_ids(tables), OriginTable()
    index: dict[str, Any] = {
        "title": TITLE,
        "legend": LEGEND,
        "abbreviations": ABBREVIATIONS,
        "protocols": sort_protocols(name for frame in results.frames for name in frame.protocols),
        "tables": [_table_entry(placed, ids[number], origins) for number, placed in enumerate(tables)],
        "tabs": {**_MOVED, **{placed.group: find_tab(placed.group) for placed in tables}},
        "mainTables": [
            {**table_entry(table, f"main-{number}", origins), "data": name, "apart": apart, "sorted": column}
            for number, (name, table, column, apart) in enumerate(build_main_tables(results.frames))
        ],
        "figures": [_figure_entry(figure, written) for figure in figures if figure.path in written],
        **{name: say(results, written) for name, say in LISTS.items()},
        "origins": origins.found,
        "words": origins.words,
    }
    scenes, planners = index["scenes"], [model["name"] for model in index["models"]]
    outcomes = Counter(sorted(attempt["reason"] for attempt in index["attempts"]))
    listed = [
        (name, label, list(dict.fromkeys(attempt[name] for attempt in index["attempts"])))
        for name, label in (("data", "Data set"), ("split", "Split"))
    ]
    return index | {
        "starts": build_starts(index, results.runs),
        "sceneFilters": list_filters(scenes, planners),
        "sceneOrders": list_orders(scenes),
        "attemptFilters": [
            {"name": name, "label": label, "any": "all", "choices": choices}
            for name, label, choices in (*listed, ("reason", "Outcome", list(outcomes)))
        ],
        "attemptTally": outcomes.most_common(),
    }


def _figure_entry(figure: PlacedFigure, written: frozenset[str]) -> dict[str, Any]:
    dark = figure.dark_path if figure.dark_path in written else figure.path
    return {
        "data": figure.data_name,
        "tab": find_tab(find_kind(figure.name)),
        "title": figure.title,
        "path": quote(figure.path),
        "dark": quote(dark),
        "size": figure.size_px,
    }


def _table_ids(tables: Iterable[PlacedTable]) -> list[str]:
    """Names for addresses, unique over all data sets and splits."""
    ids: list[str] = []
    for placed in tables:
        base = "-".join(sanitise_file_name(part) for part in (placed.data_name, placed.table.name) if part)
        same = [name for name in ids if name == base or name.startswith(f"{base}~")]
        ids.append(f"{base}~{len(same) + 1}" if same else base)
    return ids


def _table_entry(placed: PlacedTable, name: str, origins: OriginTable) -> dict[str, Any]:
    table = placed.table
    pairs = pivot_pairs(table) if find_kind(table.name) == "planners" else None
    return {
        **table_entry(pairs or table, name, origins),
        "heat": pairs and shade_pairs(pairs),
        "data": placed.data_name,
        "group": placed.group,
        "judge": table.name.removeprefix("collision-") if table.name.startswith("collision-") else None,
        "ofPlanner": table.name.startswith(_OF_PLANNER),
    }


def _attempt_entries(sheets: ScenePages) -> list[dict[str, Any]]:
    """Vehicles that the search tried; empty members are left out, because there are many."""
    attempts = []
    for (data_name, split), sheet in sorted(sheets.splits.items()):
        for attempt in sheet.attempts:
            facts = {
                "data": data_name,
                "split": split,
                "source": attempt.source,
                "agent": attempt.agent,
                "scene": attempt.scene,
                "key": scene_key((data_name, split, attempt.scene)) if attempt.scene is not None else None,
                "reason": attempt.discarded or ("kept" if attempt.scene is not None else "not said"),
                "manoeuvre": attempt.manoeuvre,
            }
            attempts.append({name: value for name, value in facts.items() if value is not None})
    return attempts


LISTS: Final[dict[str, Callable[[LeaderboardResults, frozenset[str]], list[dict[str, Any]]]]] = {
    "models": lambda results, _: build_model_index(results.runs),
    "scenes": lambda results, written: build_scene_index(
        results.runs, results.sheets, results.quality, written, results.abilities
    ),
    "attempts": lambda results, _: _attempt_entries(results.sheets),
    "drives": lambda results, _: build_drive_index(results.drives, results.sheets),
}
"""Lists shown on pages, by their names in the index."""


def build_main_tables(frames: Iterable[DataSetRuns]) -> Iterator[tuple[str, Table, int, int]]:
    """The table that the site opens with: data set, table, the column that it is sorted by, first row of a baseline.

    A row a planner on a split with adversaries, by the paired difference, in the columns that a terminal shows of the
    effect table; where there are no adversaries, those of the collision rates under ``exact``.
    """
    for frame in frames:
        table, head, runs = frame.once(effect_table), "difference", list(filter(has_adversaries, frame.runs))
        if table is None and EXACT in frame.protocols:
            table, head = frame.once(collision_table, EXACT), "col. avg"
            runs = [row.record for row in frame.judged(EXACT)]
        if table is None or table.brief is None or table.cells is None:
            continue
        column, baselines = table.columns.index(head), [is_baseline(run.run.planner) for run in runs]
        found = [cell.value if cell else None for cell in (row[column] for row in table.cells)]
        keys = [(last, value is None, value or 0.0) for last, value in zip(baselines, found, strict=True)]
        rows = sorted(range(len(runs)), key=keys.__getitem__)
        places = [
            place for place, name in enumerate(table.columns) if place in table.brief.columns or name == "any, adv"
        ]
        if len({run.run.split for run in runs}) == 1:
            places.remove(table.columns.index("split"))
        yield frame.data_name, take_part(table, rows, places), places.index(column), baselines.count(False)
