"""Where scenes come from and what is done in them, from ``challenger.json`` or from a scene's name."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from benchmark.records.attempts import list_stored_labels
from benchmark.records.run_schema import SceneFacts, TruthFacts
from benchmark.records.scene_assessment import AssessmentSummary, SceneAssessment
from benchmark.scene import Conditions

_PUBLISHED: Final = re.compile(r"(scene-\d{4})-.+")
"""Names of the published Adv-nuSc, which has no provenance file: the recorded scene and a suffix."""


def build_scene_facts(
    name: str,
    made: Mapping[str, Any],
    description: str | None = None,
    judgements: Sequence[SceneAssessment] = (),
) -> SceneFacts:
    """Facts of one scene, from what ``challenger.json`` says of it, its description and judgements of its adversaries.

    Source: as the file says, else the ``scene-0001`` of ``scene-0001-suffix``, else the scene itself. Manoeuvre: the
    primary one of the first adversary that has labels. Adversaries: as many as the file lists; none in a recording;
    unknown in a scene that was made from another one and is not in the file. Light: what the description names.
    """
    published = _PUBLISHED.fullmatch(name)
    source = made.get("source_scene") or (published[1] if published else name)
    manoeuvres = (
        labels.get("manoeuvre") for labels in list_stored_labels(made.get("report")) if isinstance(labels, dict)
    )
    listed = made.get("adversaries")
    return SceneFacts(
        source=source,
        manoeuvre=next((manoeuvre for manoeuvre in manoeuvres if isinstance(manoeuvre, str)), None),
        adversaries=len(listed) if isinstance(listed, list) else 0 if source == name else None,
        judgement=AssessmentSummary.of(judgements) if judgements else None,
        light=None if description is None else [look.value for look in Conditions.find_in(description)],
    )


def find_frozen_split(made: Mapping[str, Any] | None) -> str | None:
    """Name of the frozen split that ``challenger.json`` says a data set was built from, or ``None``."""
    frozen = None if made is None else made.get("frozen")
    name = frozen.get("name") if isinstance(frozen, dict) else None
    return name if isinstance(name, str) else None


def add_truth_facts(facts: Mapping[str, SceneFacts], truths: Mapping[str, TruthFacts]) -> dict[str, SceneFacts]:
    """Facts of scenes with what the data set holds of their truth; scenes without truths stay as they are."""
    return {
        name: fact.model_copy(update={"truth": truths[name]}) if name in truths else fact
        for name, fact in facts.items()
    }
