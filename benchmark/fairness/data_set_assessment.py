"""Judgements of a data set's scenes, from beside its tables or made when asked, and facts of scenes with them.

What is read of a data set is linear between 2 Hz keyframes, so that judgements that are made here know less than those
of the generator of the scenes (`SceneAssessment.tracks`).
"""

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.datasets.scene_assessments import (
    ASSESSMENTS_FILE,
    collect_assessments,
    format_assessments,
    read_assessments,
)
from benchmark.fairness.scene_assessment import AdversaryProvenance, assess_scene
from benchmark.geometry import Floats
from benchmark.machine.storage import write_bytes
from benchmark.machine.workers import Executor
from benchmark.records.attempts import list_adversary_reports
from benchmark.records.run_schema import SceneFacts
from benchmark.records.scene_assessment import AssessmentSummary, SceneAssessment
from benchmark.scene import Scene

MOVED_M: Final = 0.1
"""An object that is further than this from every recorded one at some keyframe was generated."""

Launches = Mapping[str, int]


def assess_data_set(
    data: DataSet, names: Sequence[str], executor: Executor, recordings: DataSet | None = None
) -> dict[str, tuple[SceneAssessment, ...]]:
    """Judgements of scenes of a data set, by name and in the order of the names; nothing depends on ``executor``.

    ``recordings``, which its scenes were made from, tell the adversaries of a data set that does not name them.
    """
    stored = collect_assessments(data.root, data.version)
    missing = [name for name in names if name not in stored]

    def scenes() -> Iterator[tuple[Scene, Launches]]:
        for name in missing:
            scene = read_adversarial_scene(data, name, recordings)
            yield scene, read_launches(data, scene)

    computed = executor.map(_assess_scene, scenes(), total=len(missing), label="judging scenes")
    assessments = {**stored, **dict(zip(missing, computed, strict=True))}
    return {name: assessments[name] for name in names}


def read_adversarial_scene(data: DataSet, name: str, recordings: DataSet | None) -> Scene:
    """Scene with its adversaries: those that no recording has, where the data set does not name them."""
    scene = data.scene(name)
    if scene.adversaries or (recorded := find_recording(data, name, recordings)) is None:
        return scene
    return functools.reduce(_mark_adversary, find_generated_agents(scene, recorded), scene)


def find_recording(data: DataSet, name: str, recordings: DataSet | None) -> Scene | None:
    """What a scene was made from, as ``recordings`` have it; ``None`` where it is not at hand, and of a recording."""
    source = data.scene_facts([name])[name].source
    if recordings is None or source not in recordings.scene_names(None):
        return None
    return None if source == name and recordings.root == data.root else recordings.scene(source)


def read_launches(data: DataSet, scene: Scene) -> dict[str, int]:
    """Launch frames of a scene's adversaries by identifier, where the data set says when: of several the earliest.

    It lists launches as they were planned and adversaries as they stand in the scene: whose is whose is not said.
    """
    provenance = ((data.provenance() or {}).get("scenes") or {}).get(scene.name, {})
    reports = list_adversary_reports(provenance.get("report")) if isinstance(provenance, dict) else []
    launches: list[Any] = [entry.get("launch_frame") for entry in reports]
    frames = [entry for entry in launches if type(entry) is int and 0 <= entry < len(scene.timestamps_us)]
    known = frames and len(frames) == len(launches) == len(scene.adversaries)
    return dict.fromkeys(scene.adversaries, min(frames)) if known else {}


def find_generated_agents(scene: Scene, recorded: Scene) -> tuple[int, ...]:
    """Indices of vehicles of a generated scene that at some keyframe are further than 0.1 m from each recorded object.

    None if the two scenes have no keyframe times in common.
    """
    mine, theirs = _compute_keyframe_times(scene), _compute_keyframe_times(recorded)
    _, here, there = np.intersect1d(mine, theirs, return_indices=True)
    places, known = scene.annotations.position[:, here, :2], scene.annotations.valid[:, here]
    others = np.where(recorded.annotations.valid[:, there, None], recorded.annotations.position[:, there, :2], np.inf)
    moved = []
    for agent, category in enumerate(scene.agents.categories):
        if not category.startswith("vehicle.") or not len(here):
            continue
        away = np.hypot(*np.moveaxis(others - places[agent], -1, 0)).min(axis=0, initial=np.inf)
        if (away[known[agent]] > MOVED_M).any():
            moved.append(agent)
    return tuple(moved)


def _mark_adversary(scene: Scene, agent: int) -> Scene:
    return replace(scene, adversaries=(*scene.adversaries, scene.agents.ids[agent]))


def _compute_keyframe_times(scene: Scene) -> Floats:
    """Microseconds since the first keyframe: copies may have other dates."""
    at = scene.timestamps_us[scene.keyframes]
    return np.asarray(at - at[0])


def _assess_scene(work: tuple[Scene, Launches]) -> tuple[SceneAssessment, ...]:
    scene, launches = work
    return assess_scene(scene, AdversaryProvenance(generated=False, launches=launches))


CACHE_FOLDER: Final = ".judgements"
"""Below the folder of runs: what is said of data sets that bring no judgements, a folder for each content."""


def collect_scene_facts(data: DataSet, names: Sequence[str], kept: Path, executor: Executor) -> dict[str, SceneFacts]:
    """Facts of scenes as records have them, by name; scenes with adversaries are judged, recordings without are not.

    Judgements of data sets without their own are kept in the folder of runs ``kept``; nothing depends on ``executor``.
    """
    facts = data.scene_facts(names)
    open_ = [name for name in names if facts[name].judgement is None and facts[name].adversaries != 0]
    if not open_:
        return facts
    folder = kept / CACHE_FOLDER / data.fingerprint()[:16]
    known = read_assessments(folder)
    missing = [name for name in open_ if name not in known]
    if missing:
        known = {**known, **assess_data_set(data, missing, executor)}
        write_bytes(folder / ASSESSMENTS_FILE, format_assessments(known).encode())
    return {name: _add_assessments(facts[name], known.get(name, ())) for name in names}


def _add_assessments(facts: SceneFacts, judgements: Sequence[SceneAssessment]) -> SceneFacts:
    summary = AssessmentSummary.of(judgements) if judgements and facts.judgement is None else facts.judgement
    return facts.model_copy(update={"judgement": summary})
