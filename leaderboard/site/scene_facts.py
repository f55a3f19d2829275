"""Scenes as records and sheets give them: what planners did on each."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from benchmark.metrics.attacks import SceneAttack, collect_scene_attacks
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import FirstContactFlags, attributes_contacts, find_first_contacts, find_touched_scenes
from benchmark.metrics.scores import find_protocol_version, map_scenes_to_sources
from benchmark.records.row_schema import BriefRow
from benchmark.records.run import RunRecord
from benchmark.records.scene_assessment import AssessmentSummary
from benchmark.records.scene_pages import ScenePage, ScenePages
from benchmark.report.fault_words import describe_fault
from benchmark.report.words import format_split
from leaderboard.frame.rows import split_sort_key

SceneName = tuple[str, str, str]
"""Data set, split and scene."""
_MICROSECONDS: Final = 1e6


@dataclass(frozen=True, slots=True)
class SceneSeverity:
    """Severity of a planner's plans on one scene: `contacts` with an adversary (with anything without one) and others.

    Verdicts are on the scene; `kind` to `fatal` and `fault`, in words, are of the most severe contact, `ttc` and `gap`
    the least without one.
    """

    contacts: int
    bystanders: int | None
    at_fault: bool | None
    attributable: bool | None
    kind: str | None
    speed: float | None
    delta_v: float | None
    fatal: float | None
    ttc: float | None
    gap: float | None
    fault: str | None = None


@dataclass(slots=True)
class SceneSummary:
    """Facts of run records about one scene, by planner where they are of one.

    Attributes:
        adversarial: Whether its split has adversaries, so that contacts with others are counted by themselves.
        verdicts: By protocol whether the planner fails it (`benchmark.metrics.effect.find_touched_scenes`).
        others: Protocols under which a plan touches another road user first.
        unsaid: Protocols under which a plan collides with an unrecorded object.
        colliding: Samples that touch the adversary first under ``exact``, anything without adversaries; ``None`` where
            that is unknown. Planners without any are left out.
        bystanders: The same of samples that touch another road user first.
        judgement: What was said of its adversary, if anything.
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
    judgement: AssessmentSummary | None = None
    severity: dict[str, SceneSeverity] = field(default_factory=dict)


def scene_key(name: SceneName) -> str:
    """Key of a scene in addresses and file names, 16 hexadecimal digits."""
    return content_key(*name)[:16]


def summarise_scenes(records: Sequence[RunRecord], sheets: ScenePages) -> dict[SceneName, SceneSummary]:
    """Facts of every scene of a record or sheet, by data set, split (the paper's three first) and name."""
    summaries: dict[SceneName, SceneSummary] = {}
    for record in records:
        _add_record(summaries, record)
    _require_same_content(records, sheets)
    for name, stored in sheets.scenes.items():
        summary = summaries.setdefault(name, SceneSummary(stored.sheet.source))
        summary.source, summary.manoeuvre = stored.sheet.source, stored.sheet.manoeuvre
        summary.seconds = _duration_s(stored.sheet)
    names = sorted(summaries, key=lambda name: (name[0], split_sort_key(name[1]), name[2]))
    return {name: summaries[name] for name in names}


def _duration_s(sheet: ScenePage) -> float:
    return (sheet.timestamps_us[-1] - sheet.timestamps_us[0]) / _MICROSECONDS if sheet.timestamps_us else 0.0


def _add_record(summaries: dict[SceneName, SceneSummary], record: RunRecord) -> None:
    data_name, split, planner = record.run.data.name, record.run.split, record.planner
    columns = record.columns
    rows_of = columns.places_of_scenes
    sources = map_scenes_to_sources(record)
    for scene in (*record.run.scenes, *rows_of):
        facts = record.run.scene_facts.get(scene)
        summary = summaries.setdefault((data_name, split, scene), SceneSummary(sources.get(scene, scene)))
        summary.adversarial |= attributes_contacts(record)
        if facts is not None:
            summary.source, summary.manoeuvre = facts.source, facts.manoeuvre
            summary.judgement = summary.judgement or facts.judgement
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
    for scene, severity in _list_severity(record).items():
        summaries[data_name, split, scene].severity[planner] = severity


def _add_samples(
    summary: SceneSummary, record: RunRecord, places: NDArray[np.int64], touches: FirstContactFlags | None
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


def _list_severity(record: RunRecord) -> dict[str, SceneSeverity]:
    """Severity of a planner's plans, by scene; only of scenes with something to say."""
    attacks, rows_of, adversarial = collect_scene_attacks(record), _group_rows(record), attributes_contacts(record)
    return {
        scene: _measure_severity(rows, attacks[scene], adversarial)
        for scene, rows in rows_of.items()
        if any(row.severity is not None and (row.severity.contact or row.severity.near) for row in rows)
    }


def _group_rows(record: RunRecord) -> dict[str, list[BriefRow]]:
    rows_by_scene: dict[str, list[BriefRow]] = {}
    for row in record.columns.brief:
        if row.status == "ok" and row.complete and row.severity is not None:
            rows_by_scene.setdefault(row.scene, []).append(row)
    return rows_by_scene


def _measure_severity(rows: Sequence[BriefRow], attack: SceneAttack, adversarial: bool) -> SceneSeverity:
    severities = [row.severity for row in rows if row.severity is not None]
    touched = [item.contact for item in severities if item.contact is not None]
    contacts = [item for item in touched if item.adversary or not adversarial]
    near = [item.near for item in severities if item.near is not None]
    worst = max(contacts, key=lambda contact: (contact.delta_v_ego_m_s, contact.impact_speed_m_s), default=None)
    return SceneSeverity(
        contacts=len(contacts),
        bystanders=len(touched) - len(contacts) if adversarial else None,
        at_fault=attack.verdicts["at_fault"],
        attributable=attack.verdicts["attributable"],
        kind=None if worst is None else worst.kind.replace("_", " "),
        speed=None if worst is None else worst.impact_speed_m_s,
        delta_v=None if worst is None else worst.delta_v_ego_m_s,
        fatal=None if worst is None else worst.fatal_probability,
        ttc=min((item.least_ttc_s for item in near if item.least_ttc_s is not None), default=None),
        gap=min((item.least_gap_m for item in near), default=None),
        fault=None if worst is None else describe_fault(worst),
    )
