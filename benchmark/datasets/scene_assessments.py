"""``judgements.json`` beside the tables: the assessment of each scene of a generated root.

It is no part of the data set's fingerprint: a better definition makes no other data set. Roots without it are assessed
on demand from the tracks (`benchmark.fairness.data_set_assessment`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from benchmark.datasets.tables import find_variant_folders
from benchmark.machine.storage import canonical_json, read_json
from benchmark.records.scene_assessment import DEFINITION, SceneAssessment, SplitRealism
from benchmark.records.store import validate_stored
from benchmark.records.stored import Stored
from benchmark.untrusted.files import RECORD

ASSESSMENTS_FILE: Final = "judgements.json"

AssessmentsByScene = Mapping[str, tuple[SceneAssessment, ...]]
"""By scene name, one for each adversary."""


class AssessmentsFile(Stored):
    """File of judgements, by scene name, one for each adversary; ``realism`` is that of all adversaries together.

    Attributes:
        schema_version: Version of the format.
        scenes: One judgement for each adversary, by scene.
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    scenes: dict[str, tuple[SceneAssessment, ...]]
    realism: SplitRealism | None = None


def format_assessments(scenes: AssessmentsByScene, realism: SplitRealism | None = None) -> str:
    """Content of the file, the same for the same judgements."""
    scenes_json = {
        name: [assessment.model_dump(mode="json") for assessment in judged] for name, judged in scenes.items()
    }
    realism_json = None if realism is None else realism.model_dump(mode="json")
    return canonical_json({"schema": 1, "scenes": scenes_json, "realism": realism_json}) + "\n"


def read_assessments(folder: Path) -> dict[str, tuple[SceneAssessment, ...]]:
    """Judgements of one root by scene name, without those by other definitions; none where there is no file."""
    stored = read_assessments_file(folder)
    return {
        name: judged
        for name, judged in (stored.scenes if stored is not None else {}).items()
        if judged and all(assessment.definition == DEFINITION for assessment in judged)
    }


def read_assessments_file(folder: Path) -> AssessmentsFile | None:
    """Read the whole file of one root, ``None`` where there is none."""
    path = folder / ASSESSMENTS_FILE
    if not path.is_file():
        return None
    return validate_stored(
        AssessmentsFile.model_validate,
        read_json(path, RECORD),
        lambda where, why: f"{path} is damaged at {where}: {why}; delete it, and data stats assesses them again",
    )


def collect_assessments(root: Path, version: str) -> dict[str, tuple[SceneAssessment, ...]]:
    """Judgements of a data set in one root or in several, by the names that it gives its scenes."""
    folders = find_variant_folders(root)
    if not folders:
        return read_assessments(root / version)
    return {
        f"{folder}/{name}": judged
        for folder in folders
        for name, judged in read_assessments(root / folder / version).items()
    }


def collect_realism(root: Path, version: str) -> SplitRealism | None:
    """Realism of a data set's adversaries, as its builder found it; ``None`` where it was not measured."""
    folders = find_variant_folders(root)
    # Every variant has the same values for all of them.
    stored = read_assessments_file((root / folders[0] if folders else root) / version)
    return None if stored is None else stored.realism
