"""The files of a quality record, checked at the edge."""

import math
from collections.abc import Sequence
from typing import Any, Final, Self

from pydantic import Field, field_validator

from benchmark.metrics.rates import Rate
from benchmark.records.run_schema import DataFacts, ReviewFacts, SceneFacts
from benchmark.records.stored import Stored

QUALITY_SCHEMA: Final = 1
"""Version of the format and of the numbers: raised whenever either changes."""


class Sum(Stored):
    """Values added up, exactly rounded once, so that the order does not matter."""

    total: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """Add values up."""
        return cls(total=math.fsum(values), count=len(values))


class SubjectRow(Stored):
    """One vehicle in one camera of one scene: a line of ``subjects.jsonl``.

    Attributes:
        adversary: Whether the scene was generated around it.
        appearances: Frames with a mask.
        returns: How often it came back after frames without one.
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
        width: Of the frames as they were scored, pixels, as ``height``.
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
    """Weights that were used, by repository and revision.

    Attributes:
        content: Hash of the files that were used (`benchmark.weights.folders.content_hash`).
    """

    repository: str
    revision: str
    content: str


class GroupSummary(Stored):
    """Numbers of a group of subjects.

    Attributes:
        subjects: How many, each camera for itself.
        imaging: Imaging quality of their regions.
    """

    subjects: int
    appearances: int
    consistency: Rate
    imaging: Rate


class SceneSummary(Stored):
    """Numbers of one scene; ``None`` where it has no subject, or none that appears twice."""

    consistency: float | None
    imaging: float | None
    frames_imaging: float | None


class QualitySummary(Stored):
    """Quality of a split.

    Attributes:
        groups: ``all`` subjects; ``adversary`` and ``others`` where scenes have an adversary.
        frames_imaging: Imaging quality of whole frames.
    """

    groups: dict[str, GroupSummary]
    frames: int
    frames_imaging: Rate
    scenes: dict[str, SceneSummary]


class QualityFacts(Stored):
    """``quality.json``; rows are in the files whose SHA-256 it has, and the summary is derived from them alone.

    Attributes:
        definition: Every choice that changes a number (`benchmark.extensions.quality.definition`).
        weights: By name.
        device: ``cpu`` or ``cuda``.
        review: What inspectors said of the split's scenes; null where no verdict stands, and in older records.
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
