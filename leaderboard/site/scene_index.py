"""What the site's index says of scenes: enough to browse and filter them without loading any."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, file_name
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import FirstTouches, attributes, first_touches, touched_scenes
from benchmark.metrics.scores import registered_version, source_of_scenes
from benchmark.records.quality import QualityRecord
from benchmark.records.run import RunRecord
from benchmark.records.scenes import Sheet, Sheets
from benchmark.report.words import split_of
from leaderboard.frame.rows import split_place
from leaderboard.site.scene_judgements import judgement_entry, severity_entries

SceneName = tuple[str, str, str]
"""Data set, split and scene."""
_MICROSECONDS: Final = 1e6
_QUALITY_DIGITS: Final = 4


@dataclass(slots=True)
class _Seen:
    """What run records say of one scene, by planner where it is of one.

    Attributes:
        source: The recording that it was made from.
        manoeuvre: Of its adversary.
        seconds: Its length.
        adversarial: Whether its split has adversaries, so that contacts with others are counted by themselves.
        verdicts: By protocol whether the planner fails it (`benchmark.metrics.effect.touched_scenes`).
        others: Protocols under which a plan touches somebody else first.
        unsaid: Protocols under which a plan collides and nobody says with whom.
        causes: Of attributed collisions.
        colliding: Samples that touch the adversary first under ``exact``, anybody without adversaries; ``None`` where
            that is not said. What has none is left out.
        bystanders: The same of samples that touch somebody else first.
        failed: Samples on which the planner failed.
        judgement: Who survives it.
        severity: How severe the planner's plans are.
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


def scene_index(
    records: Sequence[RunRecord], sheets: Sheets, quality: Sequence[QualityRecord], written: frozenset[str]
) -> list[dict[str, Any]]:
    """One entry for each scene that a record or a sheet names, by data set, split (the paper's three first) and name.

    ``written`` are paths of the site's files; they tell which scenes have a thumbnail.

    Raises:
        InputError: If a sheet was made from other content than a record of its split.
    """
    seen: dict[SceneName, _Seen] = {}
    for record in records:
        _add_record(seen, record)
    _require_same_content(records, sheets)
    qualities = _qualities(quality)
    names = sorted({*seen, *sheets.scenes}, key=lambda name: (name[0], split_place(name[1]), name[2]))
    return [_entry(name, seen.get(name), sheets, qualities.get(name, []), written) for name in names]


def _entry(
    name: SceneName,
    seen: _Seen | None,
    sheets: Sheets,
    quality: list[dict[str, Any]],
    written: frozenset[str],
) -> dict[str, Any]:
    data_name, split, scene = name
    stored = sheets.scenes.get(name)
    sheet = stored.sheet if stored else None
    known = seen or _Seen(scene)
    key = scene_key(name)
    thumbnail, dark = f"media/{key}/thumb.webp", f"media/{key}/thumb-dark.webp"
    rounds = f"figures/{file_name(data_name)}/{file_name(f'refinement-{split}-{scene}')}.svg"
    return {
        "key": key,
        "data": data_name,
        "split": split,
        "scene": scene,
        "source": sheet.source if sheet else known.source,
        "manoeuvre": sheet.manoeuvre if sheet else known.manoeuvre,
        "description": sheet.description if sheet else "",
        "labels": [label_words(label) for label in sheet.labels] if sheet else [],
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


def _duration_s(sheet: Sheet) -> float:
    return (sheet.timestamps_us[-1] - sheet.timestamps_us[0]) / _MICROSECONDS if sheet.timestamps_us else 0.0


def _add_record(seen: dict[SceneName, _Seen], record: RunRecord) -> None:
    """Add what one record says of its scenes."""
    data_name, split, planner = record.run.data.name, record.run.split, record.planner
    columns = record.columns
    rows_of = columns.places_of_scenes
    sources = source_of_scenes(record)
    for scene in (*record.run.scenes, *rows_of):
        facts = record.run.scene_facts.get(scene)
        found = seen.setdefault((data_name, split, scene), _Seen(sources.get(scene, scene)))
        found.adversarial |= attributes(record)
        if facts is not None:
            found.source, found.manoeuvre = facts.source, facts.manoeuvre
            found.judgement = found.judgement or judgement_entry(facts.judgement)
    for protocol in sorted(record.summary.protocols):
        # A newer version's protocol cannot be asked what a failed scene is; the tables below it say so.
        if registered_version(protocol) is None:
            continue
        verdicts = touched_scenes(record, protocol)
        touches = first_touches(record, protocol)
        for scene, failed in verdicts.items():
            found = seen[data_name, split, scene]
            found.verdicts.setdefault(planner, {})[protocol] = failed
            for kept, samples in ((found.others, touches.others), (found.unsaid, touches.unsaid)):
                if samples[rows_of[scene]].any():
                    kept.setdefault(planner, []).append(protocol)
    judged = columns.values("judged")
    everywhere = all(EXACT in judged[place] for place in columns.planned.tolist())
    touches_exact = first_touches(record) if everywhere else None
    for scene, places in rows_of.items():
        _add_samples(seen[data_name, split, scene], record, places, touches_exact)
    for scene, severity in severity_entries(record).items():
        seen[data_name, split, scene].severity[planner] = severity


def _add_samples(found: _Seen, record: RunRecord, places: NDArray[np.int64], touches: FirstTouches | None) -> None:
    """Add one planner's samples of a scene."""
    rows, planner = record.columns.brief_at(places.tolist()), record.planner
    times = [row.timestamp_us for row in rows]
    found.seconds = max(found.seconds, (max(times) - min(times)) / _MICROSECONDS)
    failed = sum(row.status == "failed" for row in rows)
    if failed:
        found.failed[planner] = failed
    if touches is None:
        found.colliding[planner] = found.bystanders[planner] = None
        return
    attributed = (touches.adversary | touches.unsaid)[places].tolist()
    causes: Counter[str] = Counter(
        row.diagnosis.cause for row, own in zip(rows, attributed) if own and row.diagnosis is not None
    )
    if causes:
        found.causes[planner] = dict(causes)
    unsaid = bool(touches.unsaid[places].any())
    for counts, samples in ((found.colliding, touches.adversary), (found.bystanders, touches.others)):
        if unsaid or samples[places].any():
            counts[planner] = None if unsaid else int(samples[places].sum())


def label_words(label: Mapping[str, Any]) -> str:
    """What labels (docs/manoeuvres.md) say of one adversary; what a stranger's labels lack is left out.

    For example ``cut-in-left; on: straight; closest 0.40 m, left, at 9.2 s; also blocking``.
    """
    manoeuvre, place = label.get("manoeuvre"), label.get("place")
    words = [manoeuvre if isinstance(manoeuvre, str) else "", f"on: {place}" if isinstance(place, str) else ""]
    closest = label.get("closest_approach")
    if isinstance(closest, Mapping):
        words.append(_approach(closest))
    occurred = label.get("occurred")
    if isinstance(occurred, list | tuple):
        kinds = [str(each["kind"]) for each in occurred if isinstance(each, Mapping) and "kind" in each]
        others = [kind for kind in dict.fromkeys(kinds) if kind != manoeuvre]
        words.append(f"also {', '.join(others)}" if others else "")
    return "; ".join(word for word in words if word)


def _approach(closest: Mapping[str, Any]) -> str:
    gap, side, time = closest.get("gap_m"), closest.get("side"), closest.get("time_s")
    words = [
        f"closest {gap:.2f} m" if isinstance(gap, float | int) else "",
        str(side) if isinstance(side, str) else "",
        f"at {time:.1f} s" if isinstance(time, float | int) else "",
    ]
    return ", ".join(word for word in words if word)


def _qualities(records: Sequence[QualityRecord]) -> dict[SceneName, list[dict[str, Any]]]:
    found: dict[SceneName, list[dict[str, Any]]] = defaultdict(list)
    for record in sorted(records, key=lambda record: (record.masks, record.directory.as_posix())):
        for scene, summary in record.facts.summary.scenes.items():
            found[record.facts.data.name, record.facts.split, scene].append(
                {
                    "masks": record.masks,
                    "consistency": _rounded(summary.consistency),
                    "imaging": _rounded(summary.imaging),
                }
            )
    return found


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, _QUALITY_DIGITS)


def _require_same_content(records: Sequence[RunRecord], sheets: Sheets) -> None:
    """Plans drawn over other content than they were made on would be a picture of nothing."""
    content = {(record.run.data.name, record.run.split): record for record in records}
    for (data_name, split, scene), stored in sheets.scenes.items():
        record = content.get((data_name, split))
        if record is not None and record.run.data.fingerprint != stored.sheet.data.fingerprint:
            raise InputError(
                f"the sheet of {scene} ({stored.directory}) shows other content of {split_of(split, data_name)} than "
                "the run records saw (the data fingerprints differ); run challenger-bench sheets again, or eval again "
                "if the data is newer"
            )
