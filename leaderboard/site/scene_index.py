"""Scenes in the site's index: enough to browse and filter them without loading any."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, sanitise_file_name
from benchmark.metrics.attacks import SceneAttack, collect_scene_attacks
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import FirstContactFlags, attributes_contacts, find_first_contacts, find_touched_scenes
from benchmark.metrics.scores import find_protocol_version, map_scenes_to_sources
from benchmark.records.quality import QualityRecord
from benchmark.records.row_schema import BriefRow
from benchmark.records.run import RunRecord
from benchmark.records.scene_assessment import DRIVER_NAMES, AssessmentSummary
from benchmark.records.scene_pages import ScenePage, ScenePages
from benchmark.report.words import format_split
from leaderboard.frame.rows import split_sort_key

SceneName = tuple[str, str, str]
"""Data set, split and scene."""
_MICROSECONDS: Final = 1e6
_QUALITY_DIGITS: Final = 4
_DIGITS: Final = 3


@dataclass(slots=True)
class _SceneSummary:
    """Facts of run records about one scene, by planner where they are of one.

    Attributes:
        adversarial: Whether its split has adversaries, so that contacts with others are counted by themselves.
        verdicts: By protocol whether the planner fails it (`benchmark.metrics.effect.find_touched_scenes`).
        others: Protocols under which a plan touches another road user first.
        unsaid: Protocols under which a plan collides with an unrecorded object.
        colliding: Samples that touch the adversary first under ``exact``, anything without adversaries; ``None`` where
            that is unknown. Planners without any are left out.
        bystanders: The same of samples that touch another road user first.
        judgement: Drivers that survive it.
    """

    source: str
    manoeuvre: str | None = None
    seconds: float = 0.0
    verdicts: dict[str, dict[str, bool | None]] = field(default_factory=dict)
    causes: dict[str, dict[str, int]] = field(default_factory=dict)
    adversarial: bool = False
    others: dict[str, list[str]] = field(default_factory=dict)
    unsaid: dict[str, list[str]] = field(default_factory=dict)
    colliding: dict[str, int | None] = field(default_factory=dict)
    bystanders: dict[str, int | None] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    judgement: dict[str, Any] | None = None
    severity: dict[str, dict[str, Any]] = field(default_factory=dict)


def scene_key(name: SceneName) -> str:
    """Key of a scene in addresses and file names, 16 hexadecimal digits."""
    return content_key(*name)[:16]


def build_scene_index(
    records: Sequence[RunRecord], sheets: ScenePages, quality: Sequence[QualityRecord], written: frozenset[str]
) -> list[dict[str, Any]]:
    """One entry for each scene of a record or sheet, by data set, split (the paper's three first) and name.

    ``written`` are paths of the site's files; they tell which scenes have a thumbnail.
    """
    summaries: dict[SceneName, _SceneSummary] = {}
    for record in records:
        _add_record(summaries, record)
    _require_same_content(records, sheets)
    qualities = _group_quality(quality)
    names = sorted({*summaries, *sheets.scenes}, key=lambda name: (name[0], split_sort_key(name[1]), name[2]))
    return [_build_entry(name, summaries.get(name), sheets, qualities.get(name, []), written) for name in names]


def _build_entry(
    name: SceneName,
    summary: _SceneSummary | None,
    sheets: ScenePages,
    quality: list[dict[str, Any]],
    written: frozenset[str],
) -> dict[str, Any]:
    data_name, split, scene = name
    stored = sheets.scenes.get(name)
    sheet = stored.sheet if stored else None
    known = summary or _SceneSummary(scene)
    key = scene_key(name)
    thumbnail, dark = f"media/{key}/thumb.webp", f"media/{key}/thumb-dark.webp"
    rounds = f"figures/{sanitise_file_name(data_name)}/{sanitise_file_name(f'refinement-{split}-{scene}')}.svg"
    return {
        "key": key,
        "data": data_name,
        "split": split,
        "scene": scene,
        "source": sheet.source if sheet else known.source,
        "manoeuvre": sheet.manoeuvre if sheet else known.manoeuvre,
        "description": sheet.description if sheet else "",
        "labels": [describe_label(label) for label in sheet.labels] if sheet else [],
        "hasSheet": sheet is not None,
        "drawnBy": sheet.drawn_by if sheet else None,
        "thumb": thumbnail if thumbnail in written else None,
        "thumbDark": dark if dark in written else None,
        "rounds": quote(rounds) if rounds in written else None,
        "seconds": round(_duration_s(sheet) if sheet else known.seconds, 2),
        "adversarial": known.adversarial,
        "verdicts": known.verdicts,
        "others": known.others,
        "unsaid": known.unsaid,
        "causes": known.causes,
        "colliding": known.colliding,
        "bystanders": known.bystanders,
        "failed": known.failed,
        "judgement": known.judgement,
        "severity": known.severity,
        "quality": quality,
    }


def _duration_s(sheet: ScenePage) -> float:
    return (sheet.timestamps_us[-1] - sheet.timestamps_us[0]) / _MICROSECONDS if sheet.timestamps_us else 0.0


def _add_record(summaries: dict[SceneName, _SceneSummary], record: RunRecord) -> None:
    data_name, split, planner = record.run.data.name, record.run.split, record.planner
    columns = record.columns
    rows_of = columns.places_of_scenes
    sources = map_scenes_to_sources(record)
    for scene in (*record.run.scenes, *rows_of):
        facts = record.run.scene_facts.get(scene)
        summary = summaries.setdefault((data_name, split, scene), _SceneSummary(sources.get(scene, scene)))
        summary.adversarial |= attributes_contacts(record)
        if facts is not None:
            summary.source, summary.manoeuvre = facts.source, facts.manoeuvre
            summary.judgement = summary.judgement or assessment_entry(facts.judgement)
    for protocol in sorted(record.summary.protocols):
        # A protocol of a newer version cannot define failed scenes here; the tables below state it.
        if find_protocol_version(protocol) is None:
            continue
        verdicts = find_touched_scenes(record, protocol)
        touches = find_first_contacts(record, protocol)
        for scene, failed in verdicts.items():
            summary = summaries[data_name, split, scene]
            summary.verdicts.setdefault(planner, {})[protocol] = failed
            for lists, samples in ((summary.others, touches.others), (summary.unsaid, touches.unsaid)):
                if samples[rows_of[scene]].any():
                    lists.setdefault(planner, []).append(protocol)
    judged = columns.values("judged")
    everywhere = all(EXACT in judged[place] for place in columns.planned.tolist())
    touches_exact = find_first_contacts(record) if everywhere else None
    for scene, places in rows_of.items():
        _add_samples(summaries[data_name, split, scene], record, places, touches_exact)
    for scene, severity in severity_entries(record).items():
        summaries[data_name, split, scene].severity[planner] = severity


def _add_samples(
    summary: _SceneSummary, record: RunRecord, places: NDArray[np.int64], touches: FirstContactFlags | None
) -> None:
    rows, planner = record.columns.brief_at(places.tolist()), record.planner
    times = [row.timestamp_us for row in rows]
    summary.seconds = max(summary.seconds, (max(times) - min(times)) / _MICROSECONDS)
    failed = sum(row.status == "failed" for row in rows)
    if failed:
        summary.failed[planner] = failed
    if touches is None:
        summary.colliding[planner] = summary.bystanders[planner] = None
        return
    attributed = (touches.adversary | touches.unsaid)[places].tolist()
    causes: Counter[str] = Counter(
        row.diagnosis.cause for row, own in zip(rows, attributed) if own and row.diagnosis is not None
    )
    if causes:
        summary.causes[planner] = dict(causes)
    unsaid = bool(touches.unsaid[places].any())
    for counts, samples in ((summary.colliding, touches.adversary), (summary.bystanders, touches.others)):
        if unsaid or samples[places].any():
            counts[planner] = None if unsaid else int(samples[places].sum())


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
        kinds = [
            str(occurrence["kind"])
            for occurrence in occurred
            if isinstance(occurrence, Mapping) and "kind" in occurrence
        ]
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


def _group_quality(records: Sequence[QualityRecord]) -> dict[SceneName, list[dict[str, Any]]]:
    quality_rows: dict[SceneName, list[dict[str, Any]]] = defaultdict(list)
    for record in sorted(records, key=lambda record: (record.masks, record.directory.as_posix())):
        for scene, summary in record.facts.summary.scenes.items():
            quality_rows[record.facts.data.name, record.facts.split, scene].append(
                {
                    "masks": record.masks,
                    "consistency": _round_value(summary.consistency),
                    "imaging": _round_value(summary.imaging),
                }
            )
    return quality_rows


def _round_value(value: float | None) -> float | None:
    return None if value is None else round(value, _QUALITY_DIGITS)


def _require_same_content(records: Sequence[RunRecord], sheets: ScenePages) -> None:
    """Plans drawn over other content than they were made on would be a picture of nothing."""
    content = {(record.run.data.name, record.run.split): record for record in records}
    for (data_name, split, scene), stored in sheets.scenes.items():
        record = content.get((data_name, split))
        if record is not None and record.run.data.fingerprint != stored.sheet.data.fingerprint:
            raise InputError(
                f"the sheet of {scene} ({stored.directory}) shows other content of {format_split(split, data_name)} "
                "than the run records saw (the data fingerprints differ); run challenger-bench sheets again, or eval "
                "again if the data is newer"
            )


def assessment_entry(judgement: AssessmentSummary | None) -> dict[str, Any] | None:
    """Judgement of a scene; null where there is nothing to say.

    ``survives`` (names of drivers), ``unsolvable``, ``margin``, ``gap``, ``ttc``, ``tet``, ``pet``, ``btn`` of the
    recorded ego, ``faults`` (words), ``unknown`` (words), ``map``.
    """
    if judgement is None:
        return None
    return {
        "survives": [name for name in DRIVER_NAMES if judgement.survives.get(name)],
        "unsolvable": judgement.unsolvable is True,
        "margin": _round_short(judgement.margin_s),
        "gap": _round_short(judgement.least_gap_m),
        "ttc": _round_short(judgement.least_ttc_s),
        "tet": _round_short(judgement.tet_s),
        "pet": _round_short(judgement.pet_s),
        "btn": _round_short(judgement.max_btn),
        "faults": [name.replace("_", " ") for name in judgement.faults],
        "unknown": [name.replace("_", " ") for name in judgement.unknown_faults],
        "map": judgement.has_map,
    }


def severity_entries(record: RunRecord) -> dict[str, dict[str, Any]]:
    """Severity of a planner's plans, by scene; only of scenes with something to say.

    ``contacts`` (samples whose first contact is with an adversary, with any object on a split without them),
    ``bystanders`` (samples whose first contact is with another; null on a split without adversaries), ``atFault`` and
    ``attributable`` (verdicts on the scene, null if unknown), of the most severe of ``contacts`` its ``kind``,
    ``speed``, ``deltaV`` and ``fatal``, and of samples without contact ``ttc`` and ``gap``.
    """
    attacks, rows_of, adversarial = collect_scene_attacks(record), _group_rows(record), attributes_contacts(record)
    return {
        scene: _severity_entry(rows, attacks[scene], adversarial)
        for scene, rows in rows_of.items()
        if any(row.severity is not None and (row.severity.contact or row.severity.near) for row in rows)
    }


def _group_rows(record: RunRecord) -> dict[str, list[BriefRow]]:
    rows_by_scene: dict[str, list[BriefRow]] = {}
    for row in record.columns.brief:
        if row.status == "ok" and row.complete and row.severity is not None:
            rows_by_scene.setdefault(row.scene, []).append(row)
    return rows_by_scene


def _severity_entry(rows: Sequence[BriefRow], attack: SceneAttack, adversarial: bool) -> dict[str, Any]:
    severities = [row.severity for row in rows if row.severity is not None]
    touched = [item.contact for item in severities if item.contact is not None]
    contacts = [item for item in touched if item.adversary or not adversarial]
    near = [item.near for item in severities if item.near is not None]
    worst = max(contacts, key=lambda contact: (contact.delta_v_ego_m_s, contact.impact_speed_m_s), default=None)
    return {
        "contacts": len(contacts),
        "bystanders": len(touched) - len(contacts) if adversarial else None,
        "atFault": attack.verdicts["at_fault"],
        "attributable": attack.verdicts["attributable"],
        "kind": None if worst is None else worst.kind.replace("_", " "),
        "speed": None if worst is None else _round_short(worst.impact_speed_m_s),
        "deltaV": None if worst is None else _round_short(worst.delta_v_ego_m_s),
        "fatal": None if worst is None else float(f"{worst.fatal_probability:.3g}"),
        "ttc": _round_short(min((item.least_ttc_s for item in near if item.least_ttc_s is not None), default=None)),
        "gap": _round_short(min((item.least_gap_m for item in near), default=None)),
    }


def _round_short(value: float | None) -> float | None:
    return None if value is None else round(value, _DIGITS)
