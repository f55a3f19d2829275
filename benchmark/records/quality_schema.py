"""The files of a quality record, checked at the edge."""

import math
from collections.abc import Sequence
from typing import Any, Final, Self

from pydantic import Field, field_validator

from benchmark.records.run_schema import DataFacts, RateRow, ReviewFacts, SceneFacts
from benchmark.records.stored import Stored

QUALITY_SCHEMA: Final = 1
"""Version of the format and of the numbers: raised whenever either changes."""


class Sum(Stored):
    """Values added up, exactly rounded once, so that the order does not matter.

    Attributes:
        total: Their sum.
        count: How many.
    """

    total: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """Add values up."""
        return cls(total=math.fsum(values), count=len(values))


class SubjectRow(Stored):
    """One vehicle in one camera of one scene: a line of ``subjects.jsonl``.

    Attributes:
        scene: Scene name.
        camera: Camera name.
        instance: Annotated instance.
        category: Its nuScenes category.
        adversary: Whether the scene was generated around it.
        appearances: Frames with a mask.
        returns: How often it came back after frames without one.
        first_us: Time of the first appearance.
        last_us: Time of the last one.
        mean_area_px: Mean area of the masks.
        consistency: VBench's values of the appearances after the first.
        imaging: MUSIQ's scores of the appearances, 0 to 1.
    """

    scene: str
    camera: str
    instance: str
    category: str
    adversary: bool
    appearances: int
    returns: int
    first_us: int
    last_us: int
    mean_area_px: float
    consistency: Sum
    imaging: Sum


class VideoRow(Stored):
    """One camera of one scene: a line of ``videos.jsonl``.

    Attributes:
        scene: Scene name.
        camera: Camera name.
        frames: How many were looked at.
        width: Of the frames as they were scored, pixels.
        height: Of the frames as they were scored.
        formats: Frames by file format.
        imaging: MUSIQ's scores of whole frames, 0 to 1.
    """

    scene: str
    camera: str
    frames: int
    width: int
    height: int
    formats: dict[str, int]
    imaging: Sum


class SceneRows(Stored):
    """What one unit of work gives."""

    scene: str
    subjects: list[SubjectRow]
    videos: list[VideoRow]


class WeightsFacts(Stored):
    """Weights that were used.

    Attributes:
        repository: Where they are published.
        revision: Which of its versions.
        content: Hash of the files that were used (`benchmark.weights.folders.content_hash`).
    """

    repository: str
    revision: str
    content: str


class GroupSummary(Stored):
    """Numbers of a group of subjects.

    Attributes:
        subjects: How many, each camera for itself.
        appearances: How many.
        consistency: Subject consistency.
        imaging: Imaging quality of their regions.
    """

    subjects: int
    appearances: int
    consistency: RateRow
    imaging: RateRow


class SceneSummary(Stored):
    """Numbers of one scene; ``None`` where it has no subject, or none that appears twice."""

    consistency: float | None
    imaging: float | None
    frames_imaging: float | None


class QualitySummary(Stored):
    """Numbers of a split.

    Attributes:
        groups: ``all`` subjects; ``adversary`` and ``others`` where scenes have an adversary.
        frames: How many.
        frames_imaging: Imaging quality of whole frames.
        scenes: By scene.
    """

    groups: dict[str, GroupSummary]
    frames: int
    frames_imaging: RateRow
    scenes: dict[str, SceneSummary]


class QualityFacts(Stored):
    """``quality.json``.

    Attributes:
        schema_version: Version of format and numbers.
        data: Which data set.
        split: Which split.
        scenes: Scenes that were scored, in order.
        scenes_in_split: How many the split has.
        scene_facts: Where each scene comes from.
        definition: Every choice that changes a number (`benchmark.extensions.quality.definition`).
        weights: By name.
        device: ``cpu`` or ``cuda``.
        environment: Packages, processor, commit.
        review: What inspectors said of the split's scenes; null where no verdict stands, and in older records.
        files: SHA-256 of the files of rows.
        summary: Derived from the rows alone.
    """

    schema_version: int = Field(alias="schema")
    data: DataFacts
    split: str
    scenes: list[str]
    scenes_in_split: int
    scene_facts: dict[str, SceneFacts]
    definition: dict[str, Any]
    weights: dict[str, WeightsFacts]
    device: str
    environment: dict[str, Any]
    review: ReviewFacts | None = None
    files: dict[str, str]
    summary: QualitySummary

    @field_validator("definition")
    @classmethod
    def _says_what_tables_ask(cls, definition: dict[str, Any]) -> dict[str, Any]:
        for name in ("masks", "frames"):
            if not isinstance(definition.get(name), str):
                raise ValueError(f"its definition does not say {name!r}")
        return definition
