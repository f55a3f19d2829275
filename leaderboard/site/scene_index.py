"""Scenes in the site's index: enough to browse and filter them without loading any, and the page of each."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

from benchmark.machine.storage import sanitise_file_name
from benchmark.records.quality import QualityRecord
from benchmark.records.run import RunRecord
from benchmark.records.scene_pages import ScenePages
from benchmark.report.cells import format_number
from leaderboard.frame.rows import sort_for_tables
from leaderboard.site.scene_facts import SceneName, SceneSummary, scene_key, summarise_scenes
from leaderboard.site.scene_words import (
    build_facts,
    count_marks,
    describe_samples,
    describe_tally,
    judge_entry,
    list_marks,
    severity_table,
    verdict_table,
)
from leaderboard.site.table_entries import sort_protocols, table_entry


def build_scene_index(
    records: Sequence[RunRecord],
    sheets: ScenePages,
    quality: Sequence[QualityRecord],
    written: frozenset[str],
    abilities: Sequence[Any] = (),
) -> list[dict[str, Any]]:
    """One entry for each scene of a record or sheet, by data set, split (the paper's three first) and name.

    ``written`` are paths of the site's figures. The ``page`` of each, its
    ``facts`` and ``tables``, belongs in the scene's script.
    """
    qualities = _group_quality(quality)
    further = [ability.list_scene_facts() for ability in abilities]
    summaries = summarise_scenes(records, sheets)
    planners = {record.planner: record.run.planner for record in sort_for_tables(records)}
    protocols = sort_protocols(protocol for record in records for protocol in record.summary.protocols)
    entries = {
        name: _build_entry(name, summary, sheets, qualities.get(name, []), written)
        for name, summary in summaries.items()
    }
    by_source: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for entry in entries.values():
        by_source[entry["data"], entry["source"]].append(entry)
    for name, entry in entries.items():
        summary = summaries[name]
        siblings = [each for each in by_source[entry["data"], entry["source"]] if each is not entry]
        tables = verdict_table(summary, planners, protocols), severity_table(summary, planners)
        entry["page"] = {
            "facts": [
                *build_facts(entry, summary.judgement, siblings),
                *([of[name][0], [[of[name][1]]]] for of in further if name in of),
            ],
            "tables": [table_entry(table, table.name) for table in tables if table is not None],
        }
    for entry in entries.values():
        for member in ("source", "description", "labels", "seconds", "quality"):
            del entry[member]
    return list(entries.values())


def _build_entry(
    name: SceneName,
    summary: SceneSummary,
    sheets: ScenePages,
    quality: list[tuple[str, str, str]],
    written: frozenset[str],
) -> dict[str, Any]:
    data_name, split, scene = name
    stored = sheets.scenes.get(name)
    sheet = stored.sheet if stored else None
    key = scene_key(name)
    has_thumbnail = sheet is not None and bool(sheet.timestamps_us)
    rounds = f"figures/{sanitise_file_name(data_name)}/{sanitise_file_name(f'refinement-{split}-{scene}')}.svg"
    marks = list_marks(summary)
    by_protocol: dict[str, list[str]] = defaultdict(list)
    for protocol, mark in (pair for of_planner in marks.values() for pair in of_planner.items()):
        by_protocol[protocol].append(mark)
    labels = [describe_label(label) for label in sheet.labels] if sheet else []
    description = sheet.description if sheet else ""
    texts = [scene, summary.source, data_name, split, summary.manoeuvre or "", description, *labels]
    samples = {planner: describe_samples(summary, planner) for planner in marks}
    return {
        "key": key,
        "data": data_name,
        "split": split,
        "scene": scene,
        "source": summary.source,
        "manoeuvre": summary.manoeuvre,
        "description": description,
        "text": " ".join(texts).lower(),
        "hasSheet": sheet is not None,
        "drawnBy": sheet.drawn_by if sheet else None,
        "thumb": f"media/{key}/thumb.webp" if has_thumbnail else None,
        "thumbDark": f"media/{key}/thumb-dark.webp" if has_thumbnail else None,
        "rounds": quote(rounds) if rounds in written else None,
        "marks": marks,
        "tally": {
            protocol: describe_tally(found, adversarial=summary.adversarial) for protocol, found in by_protocol.items()
        },
        "counts": {protocol: count_marks(found) for protocol, found in by_protocol.items()},
        "samples": {name: [summary.colliding.get(name) or 0, text] for name, text in samples.items() if text},
        **judge_entry(summary.judgement, summary.severity),
        "labels": labels,
        "seconds": summary.seconds,
        "quality": quality,
    }


def describe_label(label: Mapping[str, Any]) -> str:
    """Words for the labels (docs/manoeuvres.md) of one adversary, without those that a foreign one lacks.

    For example ``cut-in-left; on: straight; closest 0.40 m, left, at 9.2 s; also blocking``.
    """
    manoeuvre, place = label.get("manoeuvre"), label.get("place")
    words = [manoeuvre if isinstance(manoeuvre, str) else "", f"on: {place}" if isinstance(place, str) else ""]
    closest = label.get("closest_approach")
    if isinstance(closest, Mapping):
        words.append(_describe_approach(closest))
    occurred = label.get("occurred")
    if isinstance(occurred, list | tuple):
        kinds = [str(each["kind"]) for each in occurred if isinstance(each, Mapping) and "kind" in each]
        others = [kind for kind in dict.fromkeys(kinds) if kind != manoeuvre]
        words.append(f"also {', '.join(others)}" if others else "")
    return "; ".join(word for word in words if word)


def _describe_approach(closest: Mapping[str, Any]) -> str:
    gap, side, time = closest.get("gap_m"), closest.get("side"), closest.get("time_s")
    words = [
        f"closest {gap:.2f} m" if isinstance(gap, float | int) else "",
        str(side) if isinstance(side, str) else "",
        f"at {time:.1f} s" if isinstance(time, float | int) else "",
    ]
    return ", ".join(word for word in words if word)


def _group_quality(records: Sequence[QualityRecord]) -> dict[SceneName, list[tuple[str, str, str]]]:
    """Masks, consistency and imaging quality of each scene, in words."""
    quality_rows: dict[SceneName, list[tuple[str, str, str]]] = defaultdict(list)
    for record in sorted(records, key=lambda record: (record.masks, record.directory.as_posix())):
        for scene, summary in record.facts.summary.scenes.items():
            quality_rows[record.facts.data.name, record.facts.split, scene].append(
                (record.masks, format_number(summary.consistency, 4), format_number(summary.imaging, 4))
            )
    return quality_rows
