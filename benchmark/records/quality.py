"""Quality records: one directory for one split under one definition, checked as they are read, and their summary.

``subjects.jsonl`` and ``videos.jsonl`` hold the rows, ``quality.json`` says what was measured, names the hashes of the
other two and is written last. ``scenes/`` beside them is what a repeated command goes on from.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, TypeVar

import numpy as np
from pydantic import Field, field_validator

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, file_sha256, read_json, read_json_lines, write_json, write_json_lines
from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.records.caveats import Caveat
from benchmark.records.run_schema import DataFacts, ReviewFacts, SceneFacts, find_source
from benchmark.records.store import read_records, validate_stored
from benchmark.records.stored import Stored
from benchmark.report.words import pluralise

QUALITY_SCHEMA: Final = 1
"""Version of the format and of the numbers: raised whenever either changes."""


class ExactSum(Stored):
    """Values added up, exactly rounded once, so that the order does not matter.

    Attributes:
        total: The sum.
        count: How many were added.
    """

    total: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """Add values up."""
        return cls(total=math.fsum(values), count=len(values))


class SubjectRow(Stored):
    """One vehicle in one camera of one scene: a line of ``subjects.jsonl``.

    ``adversary`` is whether the scene was generated around it, ``appearances`` its frames with a mask, ``returns`` how
    often it came back after frames without one. ``consistency`` sums VBench's values of the appearances after the
    first, ``imaging`` MUSIQ's scores, 0 to 1.

    Attributes:
        scene: Its scene.
        camera: Its camera.
        instance: Its instance.
        category: In nuScenes' words.
        first_us: Time of the first appearance.
        last_us: Time of the last one.
        mean_area_px: Mean area of its masks.
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
    consistency: ExactSum
    imaging: ExactSum


class VideoRow(Stored):
    """One camera of one scene: a line of ``videos.jsonl``.

    ``width`` and ``height`` are in pixels, of the frames as they were scored; ``formats`` counts frames by file format.
    ``imaging`` sums MUSIQ's scores of whole frames, 0 to 1.

    Attributes:
        scene: Its scene.
        camera: Its camera.
        frames: Frames that were scored.
    """

    scene: str
    camera: str
    frames: int
    width: int
    height: int
    formats: dict[str, int]
    imaging: ExactSum


class SceneQualityRows(Stored):
    """Result of one unit of work."""

    scene: str
    subjects: list[SubjectRow]
    videos: list[VideoRow]


class WeightsFacts(Stored):
    """Weights that were used, with the hash of their files (`benchmark.weights.folders.compute_content_hash`).

    Attributes:
        repository: Where they are published.
        revision: Commit, branch or tag.
        content: Hash of the files.
    """

    repository: str
    revision: str
    content: str


class GroupSummary(Stored):
    """Numbers of a group of subjects, each camera for itself; ``imaging`` is the quality of their regions.

    Attributes:
        subjects: Vehicles, each camera counted by itself.
        appearances: Frames with a mask.
        consistency: Mean of VBench's subject consistency.
    """

    subjects: int
    appearances: int
    consistency: Rate
    imaging: Rate


class SceneSummary(Stored):
    """Numbers of one scene; ``None`` where it has no subject, or none that appears twice.

    Attributes:
        consistency: Of its subjects.
        imaging: Of their regions.
        frames_imaging: Of whole frames.
    """

    consistency: float | None
    imaging: float | None
    frames_imaging: float | None


class QualitySummary(Stored):
    """Quality of a split: of ``all`` subjects, ``adversary`` and ``others`` where there is one, and whole frames.

    Attributes:
        groups: Numbers by group.
        frames: Frames that were scored.
        frames_imaging: Quality of whole frames.
        scenes: Numbers by scene.
    """

    groups: dict[str, GroupSummary]
    frames: int
    frames_imaging: Rate
    scenes: dict[str, SceneSummary]


class QualityFacts(Stored):
    """``quality.json``; rows are in the files whose SHA-256 it has, and the summary is derived from them alone.

    ``definition`` has every choice that changes a number (`benchmark.extensions.quality.definition`), ``device`` is
    ``cpu`` or ``cuda``, and ``review`` null where no verdict of an inspector stands, and in older records.

    Attributes:
        schema_version: Version of the format.
        data: Data set.
        split: Split of the data set.
        scenes: Names of the scenes that were scored.
        scenes_in_split: More than ``scenes`` means that a part was asked for.
        environment: Packages, processor, commit.
        files: SHA-256 of the rows' files.
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
                raise ValueError(f"its definition lacks {name!r}")
        return definition


_Read = TypeVar("_Read", bound=Stored)

QUALITY_FILE: Final = "quality.json"
_SUBJECTS_FILE, _VIDEOS_FILE = "subjects.jsonl", "videos.jsonl"


@dataclass(frozen=True, slots=True)
class QualityRecord:
    """Loaded quality record: a row for each subject and camera, and one for each scene and camera."""

    directory: Path
    facts: QualityFacts
    subjects: tuple[SubjectRow, ...]
    videos: tuple[VideoRow, ...]

    @property
    def covers_split(self) -> bool:
        """Whether all scenes of the split were scored."""
        return len(self.facts.scenes) == self.facts.scenes_in_split

    @property
    def content_id(self) -> str:
        """Twelve hexadecimal digits made of the facts and the results, the same on any machine and in any folder."""
        facts = self.facts
        return content_key(facts.data.name, facts.data.fingerprint, facts.split, facts.scenes, facts.files)[:12]

    @property
    def masks(self) -> str:
        """Source of masks."""
        return str(self.facts.definition["masks"])

    @property
    def caveats(self) -> tuple[Caveat, ...]:
        """Scenes without a mask, of any vehicle or of an adversary: they are in none of these numbers."""
        scenes, facts = self.facts.scenes, self.facts.scene_facts
        adversarial = [name for name in scenes if name in facts and facts[name].adversaries]
        scenes_with_mask = {row.scene for row in self.subjects}, {row.scene for row in self.subjects if row.adversary}
        missing = [
            (sum(name not in masked for name in of), len(of), subject)
            for masked, of, subject in zip(scenes_with_mask, (scenes, adversarial), ("a vehicle", "an adversary"))
        ]
        return tuple(
            Caveat(
                kind="masks",
                sentence=f"{count} of {pluralise(total, 'scene')} have no mask of {subject} from {self.masks}: "
                "they are in none of its numbers",
            )
            for count, total, subject in missing
            if count
        )


def summarise_quality(scenes: Sequence[SceneQualityRows], facts: Mapping[str, SceneFacts]) -> QualitySummary:
    """Add rows up: every number is a sum over appearances (or frames) divided by their number.

    VBench divides subject consistency likewise: each appearance of any subject after its first counts once. Intervals
    draw recorded scenes with everything made from them.
    """
    ordered = sorted(scenes, key=lambda rows: rows.scene)
    source = {rows.scene: find_source(rows.scene, facts) for rows in ordered}
    subjects = [row for rows in ordered for row in rows.subjects]
    videos = [row for rows in ordered for row in rows.videos]
    groups = {"all": subjects}
    if any(row.adversary for row in subjects):
        groups |= {
            "adversary": [row for row in subjects if row.adversary],
            "others": [row for row in subjects if not row.adversary],
        }
    return QualitySummary(
        groups={
            name: GroupSummary(
                subjects=len(rows),
                appearances=sum(row.appearances for row in rows),
                consistency=_ratio([(source[row.scene], row.consistency) for row in rows]),
                imaging=_ratio([(source[row.scene], row.imaging) for row in rows]),
            )
            for name, rows in groups.items()
        },
        frames=sum(row.frames for row in videos),
        frames_imaging=_ratio([(source[row.scene], row.imaging) for row in videos]),
        scenes={
            rows.scene: SceneSummary(
                consistency=_mean([row.consistency for row in rows.subjects]),
                imaging=_mean([row.imaging for row in rows.subjects]),
                frames_imaging=_mean([row.imaging for row in rows.videos]),
            )
            for rows in ordered
        },
    )


def write_quality(directory: Path, described: Mapping[str, Any], scenes: Sequence[SceneQualityRows]) -> QualityRecord:
    """Write a quality record; no other process may write to its directory.

    ``described`` is everything of `QualityFacts` but schema, files and summary.
    """
    ordered = sorted(scenes, key=lambda rows: rows.scene)
    subjects = tuple(row for rows in ordered for row in rows.subjects)
    videos = tuple(row for rows in ordered for row in rows.videos)
    write_json_lines(directory / _SUBJECTS_FILE, [row.model_dump(mode="json") for row in subjects])
    write_json_lines(directory / _VIDEOS_FILE, [row.model_dump(mode="json") for row in videos])
    facts = QualityFacts.model_validate(
        {
            **described,
            "schema": QUALITY_SCHEMA,
            "files": {name: file_sha256(directory / name) for name in (_SUBJECTS_FILE, _VIDEOS_FILE)},
            "summary": summarise_quality(ordered, described["scene_facts"]),
        }
    )
    write_json(directory / QUALITY_FILE, facts.model_dump(mode="json", by_alias=True))
    return QualityRecord(directory, facts, subjects, videos)


def load_quality(directory: Path) -> QualityRecord:
    """Read a quality record."""
    path = directory / QUALITY_FILE
    stored = read_json(path)
    schema = stored.get("schema") if isinstance(stored, dict) else None
    again = "run challenger-bench quality again (finished scenes are kept)"
    if schema != QUALITY_SCHEMA:
        raise InputError(f"{path} has schema {schema!r} and this version reads {QUALITY_SCHEMA}; {again}")

    damaged = f"the quality record in {directory} is damaged"

    def read(model: type[_Read], value: Any) -> _Read:
        return validate_stored(
            model.model_validate,
            value,
            lambda where, why: f"{damaged} ({model.__name__} {where}: {why}); {again}",
        )

    try:
        facts = read(QualityFacts, stored)
        for name in (_SUBJECTS_FILE, _VIDEOS_FILE):
            if file_sha256(directory / name) != facts.files.get(name):
                raise InputError(f"{directory / name} is not the file that {QUALITY_FILE} was written with; {again}")
        return QualityRecord(
            directory=directory,
            facts=facts,
            subjects=tuple(read(SubjectRow, row) for row in read_json_lines(directory / _SUBJECTS_FILE)),
            videos=tuple(read(VideoRow, row) for row in read_json_lines(directory / _VIDEOS_FILE)),
        )
    except OSError as error:
        raise InputError(f"{damaged} ({error}); {again}") from error


def find_quality(folder: Path) -> list[QualityRecord]:
    """Every quality record below a folder, in the order of their paths; none if the folder does not exist."""
    places = (path.parent for path in sorted(folder.rglob(QUALITY_FILE)))
    return read_records(places, load_quality, instead=" to do without this record")


def _ratio(sums: Sequence[tuple[str, ExactSum]]) -> Rate:
    values = np.array([[of.total] for _, of in sums], dtype=np.float64).reshape(-1, 1)
    weights = np.array([[of.count] for _, of in sums], dtype=np.float64).reshape(-1, 1)
    return compute_ratios_over_scenes(values, weights, [source for source, _ in sums], seed=0)[0]


def _mean(sums: Sequence[ExactSum]) -> float | None:
    count = sum(of.count for of in sums)
    return sum(of.total for of in sums) / count if count else None
