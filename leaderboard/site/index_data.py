"""The site's index: everything that is shown without loading a scene, with planners' runs, rates and scores."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote

from benchmark.machine.storage import sanitise_file_name
from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import attributes_contacts, find_touched_scenes, knows_contact_partners
from benchmark.metrics.rates import Rate
from benchmark.metrics.scores import find_protocol_version
from benchmark.records.driving import SUB_SCORES, TOTALS, VERSION
from benchmark.records.planner_versions import list_file_notes
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import DrivingSummary, ProtocolSummary
from benchmark.records.scene_assessment import DRIVER_NAMES
from benchmark.records.scene_pages import ScenePages
from benchmark.report.cells import MINIATURE_WORDS, CellSource, TableCell, format_number
from benchmark.report.table import Table
from leaderboard.frame.results import LeaderboardResults
from leaderboard.frame.rows import PRIVILEGED_NOTE, count_recordings, list_splits, name_cell, sort_for_tables
from leaderboard.frame.runs import DataSetRuns
from leaderboard.frame.specification import TableColumn, Value, group_columns, number_columns, tabulate, text_columns
from leaderboard.site.drive_data import build_drive_index
from leaderboard.site.scene_index import build_scene_index, scene_key
from leaderboard.tables.collision import collision_table
from leaderboard.tables.effect import effect_table
from leaderboard.tables.scenario_assessment import DRIVER_HEADS

_SHOWN_COLUMNS: Final = ("collision", "l2")
_DIGITS: Final = 6
"""Decimals of rates: pages show two of a percentage."""


def build_model_index(records: Sequence[RunRecord]) -> list[dict[str, Any]]:
    """Planners in the order of tables, of at most one record for each data set, split and planner."""
    runs_of: dict[str, list[RunRecord]] = {}
    for record in sort_for_tables(records):
        runs_of.setdefault(record.planner, []).append(record)
    return [
        {
            "name": name,
            "privileged": runs[0].run.planner.privileged,
            "miniature": runs[0].run.planner.miniature,
            "nativeProtocol": runs[0].run.planner.native_protocol,
            "facts": {
                "seed": runs[0].run.planner.seed,
                "settings": _to_texts(runs[0].run.planner.settings),
                "weights": runs[0].run.planner.weights_sha256,
            },
            "runs": [_run_entry(record) for record in runs],
        }
        for name, runs in runs_of.items()
    ]


def _run_entry(record: RunRecord) -> dict[str, Any]:
    """One run, with code, commit and machine: two runs of a planner may differ in them."""
    run, summary = record.run, record.summary
    environment = run.environment
    source = _to_texts(environment.get("source") or {})
    return {
        "record": record.content_id,
        "data": run.data.name,
        "split": run.split,
        "fingerprint": run.data.fingerprint,
        "code": run.planner.code_sha256,
        "commit": source.get("commit"),
        "dirty": source.get("dirty"),
        "hardware": _to_texts(environment.get("hardware") or {}),
        "packages": _to_texts(environment.get("packages") or {}),
        "rescored": run.rescored is not None,
        "samples": summary.samples,
        "failed": summary.failed,
        "coverage": summary.coverage,
        "scenes": len(run.scenes),
        "scenesInSplit": run.scenes_in_split,
        "recordings": count_recordings(record),
        "protocols": {
            name: {
                **_protocol_entry(of_protocol, stale=name in record.stale_protocols),
                "scenesHit": _count_scenes_hit(record, name),
            }
            for name, of_protocol in summary.protocols.items()
        },
        "driving": None if summary.driving is None else _driving_entry(summary.driving),
        **({} if run.plans_from is None else {"plansFrom": list_file_notes([record])[0]}),
    }


def _driving_entry(summary: DrivingSummary) -> dict[str, Any]:
    return {
        "version": summary.version,
        "stale": summary.version != VERSION,
        "counted": summary.counted,
        "means": {name: _rate_entry(summary.columns[name]["mean"]) for name in (*TOTALS, *SUB_SCORES)},
    }


def _count_scenes_hit(record: RunRecord, protocol: str) -> list[int] | None:
    """Numbers of scenes that touch the adversary first, and of scenes where that is said."""
    is_known = (
        attributes_contacts(record)
        and find_protocol_version(protocol) is not None
        and knows_contact_partners(record, protocol)
    )
    if not is_known:
        return None
    verdicts = find_touched_scenes(record, protocol).values()
    return [sum(failed is True for failed in verdicts), sum(failed is not None for failed in verdicts)]


def _protocol_entry(summary: ProtocolSummary, *, stale: bool) -> dict[str, Any]:
    shown_columns = {name: summary.columns[name] for name in _SHOWN_COLUMNS if name in summary.columns}
    return {
        "version": summary.version,
        "stale": stale,
        "counted": summary.counted,
        "scenesFailed": summary.scenes_failed,
        "scenesDecided": summary.scenes_decided,
        **{
            name: {horizon: _rate_entry(rate) for horizon, rate in by_horizon.items()}
            for name, by_horizon in shown_columns.items()
        },
    }


def _rate_entry(rate: Rate) -> dict[str, float | int | None]:
    return {
        "value": _round_value(rate.value),
        "low": _round_value(rate.low),
        "high": _round_value(rate.high),
        "n": rate.denominator,
    }


def _to_texts(facts: Any) -> dict[str, str | None]:
    """Facts of a foreign record as text: they may hold anything that JSON can, NaN too."""
    if not isinstance(facts, Mapping):
        return {}
    return {str(name): _to_text(value) for name, value in facts.items()}


def _to_text(value: Any) -> str | None:
    return value if value is None or isinstance(value, str) else json.dumps(value)


def _round_value(value: float | None) -> float | None:
    return None if value is None else round(value, _DIGITS)


TITLE: Final = "challenger-bench"
_FORMATS: Final = (".csv", ".tex", ".json")
RATES: Final = {"average": "col. avg", "95 %": "95 % of avg"}
"""Columns here, and of the table of collision rates that they are taken from."""
EFFECT: Final = {"adversary": "adversary 3s", "difference": "difference", "95 %": "95 % of difference"}
"""The same of the table of the effect of adversaries."""
NOTES: Final = (
    "Average of the collision rates at 1, 2 and 3 s in per cent, protocol exact; brackets: 95 % bootstrap interval "
    "over recorded scenes.",
    "Adversary: samples of adv whose plan touches the adversary before anything else within 3 s. Difference: contacts "
    "with anything within 3 s, in points, beside the same recordings unchanged; its interval is over recordings.",
)


@dataclass(frozen=True, slots=True)
class PlacedTable:
    """A table and the `folder` of its files below the leaderboard's; `group` is for example ``protocol vad``."""

    table: Table
    data_name: str
    group: str
    folder: str


@dataclass(frozen=True, slots=True)
class PlacedFigure:
    """A figure among the site's files, by paths below its folder.

    `size_px` is (width, height) at which its letters are as large as the page's; a page leaves that room before
    loading.
    """

    data_name: str
    title: str
    path: str
    dark_path: str
    size_px: tuple[int, int]


def build_index(
    results: LeaderboardResults, tables: Sequence[PlacedTable], figures: Sequence[PlacedFigure], written: frozenset[str]
) -> dict[str, Any]:
    """The value of ``window.CHALLENGER`` in the order of pages; ``written`` are paths of the site's other files."""
    protocols = {name for frame in results.frames for name in frame.protocols}
    ids, origins = _table_ids(tables), _OriginTable()
    return {
        "title": TITLE,
        "tables": [_table_entry(placed, ids[index], origins, written) for index, placed in enumerate(tables)],
        "keyTables": _key_tables(results.frames, origins, written),
        "figures": [_figure_entry(figure, written) for figure in figures if figure.path in written],
        "drivers": [[name, DRIVER_HEADS[name]] for name in DRIVER_NAMES],
        **{name: say(results, written) for name, say in LISTS.items()},
        "origins": origins.found,
        "words": origins.words,
        "protocols": sorted(protocols, key=lambda name: (name != EXACT, name)),
    }


def _figure_entry(figure: PlacedFigure, written: frozenset[str]) -> dict[str, Any]:
    dark = figure.dark_path if figure.dark_path in written else figure.path
    return {
        "data": figure.data_name,
        "title": figure.title,
        "path": quote(figure.path),
        "dark": quote(dark),
        "size": figure.size_px,
    }


def _key_tables(
    frames: Sequence[DataSetRuns], origins: "_OriginTable", written: frozenset[str]
) -> list[dict[str, Any]]:
    """Table of the first page of each data set."""
    key_tables = [(frame.data_name, build_key_table(frame)) for frame in frames]
    placed = [PlacedTable(table, name, "", "") for name, table in key_tables if table is not None]
    return [_table_entry(placed_table, f"key-{number}", origins, written) for number, placed_table in enumerate(placed)]


def _table_ids(tables: Iterable[PlacedTable]) -> list[str]:
    """Names for addresses, unique over all data sets and splits."""
    ids: list[str] = []
    for placed in tables:
        base = "-".join(sanitise_file_name(part) for part in (placed.data_name, placed.table.name) if part)
        same = [name for name in ids if name == base or name.startswith(f"{base}~")]
        ids.append(f"{base}~{len(same) + 1}" if same else base)
    return ids


def _table_entry(placed: PlacedTable, name: str, origins: "_OriginTable", written: frozenset[str]) -> dict[str, Any]:
    table = placed.table
    stem = f"{placed.folder}/{sanitise_file_name(table.name)}"
    return {
        "id": name,
        "data": placed.data_name,
        "group": placed.group,
        "title": table.title,
        "columns": table.columns,
        "textColumns": table.text_columns,
        "rows": table.rows,
        "groups": table.groups,
        "cells": None if table.cells is None else [[origins.cell(cell) for cell in row] for row in table.cells],
        "notes": table.remarks,
        "files": {suffix[1:]: quote(stem + suffix) for suffix in _FORMATS if stem + suffix in written},
    }


class _OriginTable:
    """Common parts of many cells, written once: cells name its place as ``record``.

    `found` has for each origin the places of its unit, of what is counted, of its protocol, record and source among the
    words; -1 where there is none.
    """

    def __init__(self) -> None:
        self._origins: dict[tuple[int, ...], int] = {}
        self._words: dict[str, int] = {}

    @property
    def found(self) -> list[list[int]]:
        """Places of the facts of each origin among the words."""
        return [list(origin) for origin in self._origins]

    @property
    def words(self) -> list[str]:
        """Texts, each once."""
        return list(self._words)

    def cell(self, cell: CellSource | None) -> dict[str, Any] | None:
        """The facts behind a number, whose text is in the row; what there is none of is left out."""
        if cell is None:
            return None
        origin_values = (cell.unit, cell.of, cell.protocol, cell.record, cell.source)
        origin = tuple(-1 if word is None else self._words.setdefault(word, len(self._words)) for word in origin_values)
        numbers = {"low": cell.low, "high": cell.high, "n": cell.n}
        rounded = {name: _round_significant(value) for name, value in numbers.items() if value is not None}
        return {**rounded, "record": self._origins.setdefault(origin, len(self._origins))}


def _round_significant(value: float) -> float | int | str:
    """Four digits: more than pages show."""
    if isinstance(value, int):
        return value
    if not math.isfinite(value):
        return format_number(value)
    short = float(f"{value:.4g}")
    return int(short) if short.is_integer() else short


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
                "reason": attempt.discarded,
                "manoeuvre": attempt.manoeuvre,
            }
            attempts.append({name: value for name, value in facts.items() if value is not None})
    return attempts


LISTS: Final[dict[str, Callable[[LeaderboardResults, frozenset[str]], list[dict[str, Any]]]]] = {
    "models": lambda results, _: build_model_index(results.runs),
    "scenes": lambda results, written: build_scene_index(results.runs, results.sheets, results.quality, written),
    "attempts": lambda results, _: _attempt_entries(results.sheets),
    "drives": lambda results, _: build_drive_index(results.drives, results.sheets),
}
"""Lists shown on pages, by their names in the index."""


def build_key_table(frame: DataSetRuns) -> Table | None:
    """Averages with their intervals under ``exact``, a row a planner; ``None`` where nothing was judged by it."""
    judged = [row.record for row in frame.judged(EXACT)]
    if not judged:
        return None
    collisions, effect = frame.once(collision_table, EXACT), frame.once(effect_table)
    row_numbers = {(run.planner, run.run.split): row for row, run in enumerate(judged)}
    attacked = enumerate(filter(has_adversaries, frame.runs))
    caused = {run.planner: row for row, run in attacked if run.run.split == "adv" and EXACT in run.summary.protocols}
    planners, splits = {run.planner: run.run.planner for run in judged}, list_splits(judged)
    of_adversary = EFFECT if effect is not None and caused else {}
    rows: list[dict[str, Value]] = []
    for name, facts in planners.items():
        rows.append({"planner": name_cell(name, facts).text})
        for split in splits:
            averages = {
                head: _take_cell(collisions, row_numbers.get((name, split)), column) for head, column in RATES.items()
            }
            rows[-1] |= {f"{head} on {split}": value for head, value in averages.items()}
        if effect is not None:
            rows[-1] |= {head: _take_cell(effect, caused.get(name), column) for head, column in of_adversary.items()}
    columns = [
        *text_columns("planner"),
        *(TableColumn(head, f"{head} on {split}", split) for split in splits for head in RATES),
        *group_columns("effect of the adversary", number_columns(*of_adversary)),
    ]
    notes = (
        *(NOTES if of_adversary else NOTES[:1]),
        *((PRIVILEGED_NOTE,) if any(facts.privileged for facts in planners.values()) else ()),
        *((f"{MINIATURE_WORDS}.",) if any(facts.miniature for facts in planners.values()) else ()),
    )
    return tabulate("key", f"{frame.data_name}: collision rates (%), protocol exact", columns, rows, notes)


def _take_cell(table: Table, row: int | None, column: str) -> TableCell | None:
    if row is None or table.cells is None:
        return None
    place = table.columns.index(column)
    return TableCell(table.rows[row][place], table.cells[row][place])
