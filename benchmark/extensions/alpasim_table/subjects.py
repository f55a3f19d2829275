"""Subjects of AlpaSim's table: from its files of results, or from records of drives with its scene score."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord
from benchmark.untrusted.text_files import read_json

SUMMARY: Final = "aggregate/results-summary.json"
"""Of a subject, below its folder."""
DISTANCE: Final = "avg_dist_between_incidents_at_fault"
MISMATCH: Final = "scenario_set_mismatch"


@dataclass(frozen=True, slots=True)
class Subject:
    """A policy: mean score by scene, and kilometres between incidents that are its fault, if there are any."""

    name: str
    scores: Mapping[str, float]
    km_between: float | None
    summary_path: str


def read_subjects(runs: Path) -> list[Subject]:
    """Subjects of the folders below one, by name.

    Raises:
        InputError: If there is none, a file is damaged, a score is outside [0, 1], or a subject has no score.
    """
    paths = sorted(runs.glob(f"*/{SUMMARY}"))
    if not paths:
        raise InputError(f"{runs} holds no */{SUMMARY}; give the folder that holds a folder of results a subject")
    return [read_subject(path, path.parents[1].name, path.relative_to(runs.parent).as_posix()) for path in paths]


def read_subject(path: Path, name: str, shown: str) -> Subject:
    """A subject from its file; items without a scene or a number for a score are passed over, as AlpaSim does."""
    stored = read_json(path)
    if not isinstance(stored, dict):
        raise InputError(f"{path} is no summary of results: it is no object; give AlpaSim's file")
    if stored.get("scene_score_enabled", True) is False:
        raise InputError(f"{path} has scene scoring disabled; evaluate the subject with scene scores")
    of_scene: dict[str, list[float]] = {}
    rollouts = stored.get("rollouts")
    for rollout in rollouts if isinstance(rollouts, list) else ():
        scene, score = _read_rollout(rollout)
        if scene is None or score is None:
            continue
        if not 0.0 <= score <= 1.0:
            raise InputError(f"{path}: the score {score:g} of {scene} is outside [0, 1]; evaluate the subject again")
        of_scene.setdefault(scene, []).append(score)
    if not of_scene:
        raise InputError(f"{path} contains no valid scene scores; evaluate the subject again")
    means = {scene: sum(scores) / len(scores) for scene, scores in of_scene.items()}
    return Subject(name, means, _read_distance(stored), shown)


def _read_rollout(rollout: Any) -> tuple[str | None, float | None]:
    if not isinstance(rollout, dict):
        return None, None
    scene = rollout.get("clipgt_id") or rollout.get("scene_id")
    return (scene if isinstance(scene, str) else None), _read_number(rollout.get("score"))


def _read_number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _read_distance(stored: Mapping[str, Any]) -> float | None:
    results = stored.get("metrics_results")
    first = results[0] if isinstance(results, list) and results else None
    value = _read_number(first.get(DISTANCE)) if isinstance(first, dict) else None
    return value if value is not None and math.isfinite(value) else None


def collect_subjects(records: Sequence[DriveRecord], rules: str) -> list[Subject]:
    """Subjects of records of drives in one world, by name; a drive that failed counts 0, as AlpaSim has it.

    Raises:
        InputError: If records differ in what was measured, two are of one planner, or one lacks the scores.
    """
    worlds = {_name_world(record) for record in records}
    if len(worlds) != 1:
        found = "; ".join(sorted(worlds)) or "none"
        raise InputError(f"one table needs records of drives of one setting, found {found}; choose with --records")
    names = Counter(record.planner for record in records)
    if (twice := [name for name, count in names.items() if count > 1]) != []:
        raise InputError(f"two records are of {', '.join(sorted(twice))}; choose one with --records")
    return sorted((_summarise_record(record, rules) for record in records), key=lambda subject: subject.name)


def _name_world(record: DriveRecord) -> str:
    facts = record.facts
    return f"{facts.data.name} {facts.data.fingerprint[:8]} {facts.split}, {facts.measured.world}"


def _summarise_record(record: DriveRecord, rules: str) -> Subject:
    of_scene: dict[str, list[float]] = {}
    km = incidents = 0.0
    for row in record.rows:
        score, parts = _score_row(record, row, rules)
        of_scene.setdefault(row.scene, []).append(score)
        km += parts.get("km") or 0.0
        incidents += max(parts.get(name) or 0.0 for name in ("front", "lateral", "off_road"))
    means = {scene: float(np.mean(scores)) for scene, scores in of_scene.items()}
    return Subject(record.planner, means, km / incidents if incidents else None, str(record.directory))


def _score_row(record: DriveRecord, row: EpisodeRow, rules: str) -> tuple[float, Mapping[str, float | None]]:
    parts = {} if row.scores is None else row.scores.further.get(rules, {})
    score = 0.0 if row.status == "failed" else parts.get("score")
    if score is None:
        raise InputError(f"{record.directory} has no {rules} of {row.scene}; run challenger-bench rescore first")
    return score, parts
