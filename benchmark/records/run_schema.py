"""The schema of ``run.json`` and ``summary.json``, checked at the edge; rows are `benchmark.records.row_schema`."""

from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator

from benchmark.constants import LARGEST_SEED
from benchmark.metrics.rates import Rate
from benchmark.records.caveats import Caveat
from benchmark.records.scene_assessment import AssessmentSummary, SplitRealism
from benchmark.records.stored import Stored

SCHEMA = 6
"""Version of the format; raised whenever a field changes, with an upgrade in `benchmark.records.store`."""

AS_PUBLISHED: Final = "as_published"
"""Setting of a planner that does something as in its published runs: what, joined by ``+`` (docs/models.md)."""
MOST_ADVERSARIES: Final = 1000
"""Of one scene; a larger number in a record is damage, as are larger ones of the next."""
Seed = Annotated[int, Field(strict=True, ge=0, le=LARGEST_SEED)]
Version = Annotated[int, Field(strict=True, ge=0, le=1000)]
MachineValue = str | int | float | bool | None
"""Values of machine metadata: a record with any other type is damaged."""
Name = Annotated[str, Field(max_length=200)]
"""Of something that files are named after, and text wherever it is shown."""
SceneCount = Annotated[int, Field(strict=True, ge=0, le=10_000_000)]
BoxCount = Annotated[int, Field(strict=True, ge=0)]
LightName = Literal["day", "dusk", "night", "rain"]


PlannerInput = Literal["map", "motion", "images"]
"""Optional inputs of planners: lanes of the map, measured motion (CAN bus), cameras."""


class PlannerFacts(Stored):
    """Which planner ran.

    Attributes:
        name: Shown in tables.
        privileged: Whether it saw boxes, the map or the recorded future.
        weights_sha256: Of its weights, if it has any.
        code_sha256: Of the code that its plans depend on (`benchmark.runs.code_identity`).
        settings: Plain values that its plans depend on.
        seed: Of its noise.
        native_protocol: Protocol of the planner's own repository, if it has one.
        published_as: What the paper calls it, if it ran it.
        miniature: Whether it is a small network that shows the pipeline and ranks nothing (docs/miniatures.md).
        wants: What its plans depend on beside boxes, as far as it is known; empty in older records.
    """

    name: str
    privileged: bool
    weights_sha256: str | None = None
    code_sha256: str | None = None
    settings: dict[str, Any] = Field(default_factory=dict)
    seed: Seed = 0
    native_protocol: str | None = None
    published_as: str | None = None
    miniature: bool = False
    wants: list[PlannerInput] = Field(default_factory=list)


BASELINES: Final = frozenset(
    (
        "constant-velocity",
        "constant-velocity-on-path",
        "ego-status",
        "idm",
        "log-replay",
        "noisy-log",
        "noisy-log-published",
        "stop",
    )
)
"""Planners that show what numbers mean and are no candidates; tests compare them with the planners of `adapters`."""


def is_baseline(planner: PlannerFacts) -> bool:
    """Whether a planner is a reference: a baseline of ours, or one that sees what no car sees."""
    return planner.privileged or planner.name in BASELINES


LABELS: Final = {"native_protocol", "published_as", "miniature", "wants"}
"""Labels of a planner that do not affect its plans."""


class InputFacts(Stored):
    """Inputs of a scene beside annotations, and those among them that make no sense.

    Attributes:
        samples: Number of its samples.
        lanes: Lanes of the map around the ego; 0 where the map has none, or there is no map.
        off_road: Samples at which the recorded ego is off the drivable area; null where the map has none.
        cameras: Number of its cameras.
        lidar: Whether the data set says where the lidar sits; if not, it is taken to sit as on nuScenes' cars.
        jumps: Boxes that went faster than anything on a road since their last annotation.
        moving: Objects that move fast enough to tell their direction.
        across: Those of them whose boxes lie across it.
        turned_quaternions: Whether rotations make sense only if read as x, y, z, w.
    """

    samples: Annotated[int, Field(strict=True, ge=0)]
    lanes: Annotated[int, Field(strict=True, ge=0)]
    off_road: Annotated[int, Field(strict=True, ge=0)] | None
    cameras: Annotated[int, Field(strict=True, ge=0)]
    lidar: bool
    jumps: Annotated[int, Field(strict=True, ge=0)]
    moving: Annotated[int, Field(strict=True, ge=0)]
    across: Annotated[int, Field(strict=True, ge=0)]
    turned_quaternions: bool


class TruthFacts(Stored):
    """Truth that the data set holds of a scene.

    Attributes:
        annotations: Boxes at its samples; without any there is no truth, and nothing can be said of contacts.
        unlabelled: Samples of which nothing can be said of contacts because labels are missing now or within 3 s
            (`benchmark.datasets.annotated_objects`).
        without_size: Boxes without length, width or height; they are ignored.
        unknown: Boxes of categories that nuScenes does not have, by name.
        motionless: Whether the ego pose is the same number at every sample of a scene of 5 s and more.
        irregular: Samples some of whose key frames ahead are not half a second apart.
        cut_short: Of these those whose recording goes on for 3 s, with a gap in it that leaves steps unknown.
        interval_s: Median interval of its key frames where that is not 0.5 s.
        inputs: Null in older records.
    """

    annotations: BoxCount
    unlabelled: BoxCount = 0
    without_size: BoxCount = 0
    unknown: dict[Name, BoxCount] = Field(default_factory=dict)
    motionless: bool = False
    irregular: Annotated[int, Field(strict=True, ge=0)] = 0
    cut_short: Annotated[int, Field(strict=True, ge=0)] = 0
    interval_s: Annotated[float, Field(gt=0)] | None = None
    inputs: InputFacts | None = None


class SceneFacts(Stored):
    """Facts of a scene beside its samples, from the data set.

    Attributes:
        source: Name of the recorded scene that it was made from; its own name if it is a recording.
        manoeuvre: What its first adversary does, if it has one and labels.
        adversaries: How many vehicles were made to be adversaries; null where the data set does not say, and in older
            records.
        light: Light and weather that its description names, none where it names none; null in older records.
        judgement: Null of recordings, where it was not judged, and in older records.
        truth: Null in older records until they are judged anew.
    """

    source: str
    manoeuvre: str | None = None
    adversaries: int | None = Field(default=None, ge=0, le=MOST_ADVERSARIES)
    light: list[LightName] | None = None
    judgement: AssessmentSummary | None = None
    truth: TruthFacts | None = None


def find_source(scene: str, known: Mapping[str, SceneFacts]) -> str:
    """Name of the recording that a scene was made from; its own where nothing is known of it."""
    return known[scene].source if scene in known else scene


class DataFacts(Stored):
    """Which data set: its name and the hash of its content.

    Attributes:
        name: Of the data set.
        version: Its version folder.
        fingerprint: Hash of its content.
    """

    name: Name
    version: str
    fingerprint: str


class ReviewFacts(Stored):
    """Verdicts of inspectors on the scenes of a split (`benchmark.records.review`); ``content`` is their hash.

    Rejected scenes are not judged; scenes without a verdict are.

    Attributes:
        accepted: Number of scenes.
        rejected: Number of scenes.
        not_reviewed: Number of scenes without a verdict.
    """

    content: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    accepted: SceneCount
    rejected: SceneCount
    not_reviewed: SceneCount


class GeneratedFacts(Stored):
    """Which search the scenes of a generated split come from: its seed, and the hash of what else decided it.

    ``search`` is null where the data set does not say (`benchmark.records.attempts`).

    Attributes:
        seed: Of the search.
    """

    seed: Seed
    search: Annotated[str, Field(max_length=64)] | None = None


SampleOrder = Literal["tokens", "proven", "consistent", "assumed"]
"""How it is known which sample a plan of a file belongs to."""


class PlanFileFacts(Stored):
    """Plans that were not made here: what the files say, and what they do not (docs/your-results.md).

    Attributes:
        format: Of which repository.
        files: SHA-256 of each file.
        order: How it is known which sample a plan belongs to.
        shown_by: Evidence for the order.
        plans: Samples with a plan in the files.
        samples: Samples of the split.
        steps: Waypoints of a plan in the files.
        skipped: Samples whose plan cannot be read, and why, by token.
        duplicates: Entries left out because they repeat another one.
        repaired: Plans that the repository itself completes because the answer was too short or too long.
        mirrored: Whether x of the files is mirrored, where files may be either.
        checks: What tests of unit, frame and origin measured, or that they were not testable.
        lacks: What files of this format never hold.
    """

    format: str
    files: dict[str, str]
    order: SampleOrder
    shown_by: str
    plans: int
    samples: int
    steps: int
    skipped: dict[str, str] = Field(default_factory=dict)
    duplicates: int = 0
    repaired: int = 0
    mirrored: bool | None = None
    checks: dict[str, str] = Field(default_factory=dict)
    lacks: list[str] = Field(default_factory=list)


class RecordFacts(Stored):
    """Facts in the first file of a record, of planning and of driving alike.

    Attributes:
        schema_version: Version of the format.
        planner: Which planner ran.
        data: On which data set.
        split: On which split of it.
        scenes: Names of the scenes that were run.
        scenes_in_split: More than ``scenes`` means that a part was asked for.
        scene_facts: Empty in run records of schema 1.
        frozen_split: Frozen split that the data were built from, if they were; null in older records.
        review: Null where no verdict stands, and in older records.
        generated: Which search the scenes come from; null of recordings and in older records.
        caveats: Empty in older records.
        status: ``partial`` if the planner failed on any sample, or in any drive.
        seed: Of the planner and the intervals.
        config: Settings of the command.
        environment: Packages, processor, commit: where the planner ran.
        files: SHA-256 of the other files of the record.
    """

    schema_version: int = Field(alias="schema")
    planner: PlannerFacts
    data: DataFacts
    split: Name
    scenes: list[Name]
    scenes_in_split: SceneCount
    scene_facts: dict[str, SceneFacts] = Field(default_factory=dict)
    frozen_split: str | None = None
    review: ReviewFacts | None = None
    generated: GeneratedFacts | None = None
    caveats: list[Caveat] = Field(default_factory=list)
    status: Literal["complete", "partial"]
    seed: Seed
    config: dict[str, Any]
    environment: dict[str, MachineValue | dict[str, MachineValue]]
    files: dict[str, str]

    @property
    def says_truth(self) -> bool:
        """Whether the record says what the data set holds of the truth of its scenes; older ones do not."""
        return all(name in self.scene_facts and self.scene_facts[name].truth is not None for name in self.scenes)

    @model_validator(mode="after")
    def _scenes_agree(self) -> Self:
        """Judging anew replaces much of this, so that damage in it would be gone without a word."""
        if len(set(self.scenes)) != len(self.scenes) or not self.scenes:
            raise ValueError("scenes must be names, each once")
        if not self.scene_facts.keys() <= set(self.scenes):
            raise ValueError("scene_facts must be of the scenes")
        return self


class UnchangedFacts(Stored):
    """The record of the same planner on the unchanged recordings of an adversarial split (docs/metrics.md).

    ``samples`` is the SHA-256 of its rows.

    Attributes:
        data: Its data set.
        split: Its split.
    """

    data: DataFacts
    split: Name
    samples: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class RunFacts(RecordFacts):
    """``run.json``.

    ``unchanged`` is the record that the effect of adversaries was taken against, null where there was none and of
    recordings; ``realism`` is null where it was not measured. ``plans_from`` says which result files the plans come
    from, if any; the environment is then that of the import. All three are null in older records. ``rescored`` is the
    environment of the last `challenger-bench rescore`.

    Attributes:
        protocols: Version of each protocol that judged.
    """

    unchanged: UnchangedFacts | None = None
    realism: SplitRealism | None = None
    plans_from: PlanFileFacts | None = None
    protocols: dict[str, Version]
    rescored: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _protocols_agree(self) -> Self:
        named = self.config.get("protocols", list(self.protocols))
        if not isinstance(named, list) or Counter(map(str, named)) != Counter(self.protocols.keys()):
            raise ValueError("the protocols of config must be those that judged")
        return self


class ProtocolSummary(Stored):
    """Summary of a run under one protocol.

    Attributes:
        version: Of the protocol.
        columns: Column name (``collision``, ``l2``, ...) to horizon (``1s``, ``2s``, ``3s``, ``avg``) to rate.
        counted: Samples in the denominators of collision rates at all horizons.
        incomplete: The other samples that were planned: the protocol does not count them, or not at every horizon, or
            nothing is known of their contacts.
        scenes_failed: Scenes with a counted sample that collides.
        scenes_decided: Scenes of which that can be said (see `benchmark.records.rows.find_scene_failures`).
        mask_removed_steps: Colliding steps that do not count because the recorded ego collides there too under the same
            protocol; null for protocols without such a mask, where no sample was planned, and in records of schema 1.
        mask_removed_for_adversary: Those of them at which the recorded ego touches an adversary; at the others it
            touches something else alone. Null where a scene's adversaries are not known, too, and in older records.
    """

    version: int
    columns: dict[str, dict[str, Rate]]
    counted: int
    incomplete: int
    scenes_failed: int
    scenes_decided: int
    mask_removed_steps: int | None = None
    mask_removed_for_adversary: int | None = None


class DrivingSummary(Stored):
    """Summary of a run under ``nuscenes-pdm`` (`benchmark.records.driving`).

    ``columns`` are by name (``score``, ``nc``, ``filtered_score``, ...), each with its ``mean`` and the share of plans
    that have ``ones`` there. Samples that were planned but have no sub-scores are ``incomplete``.

    Attributes:
        version: Of the definition.
        counted: Samples with driving scores.
    """

    version: int
    columns: dict[str, dict[str, Rate]]
    counted: int
    incomplete: int


class RunSummary(Stored):
    """``summary.json``: derived from the rows alone.

    The planner raised on ``failed`` samples; ``coverage`` is the share of the others. ``driving`` is null where no
    sample has driving scores.

    Attributes:
        schema_version: Version of the format.
        samples: Samples of the run.
        protocols: Rates by protocol.
    """

    schema_version: int = Field(alias="schema")
    samples: int
    failed: int
    coverage: float
    protocols: dict[str, ProtocolSummary]
    driving: DrivingSummary | None = None
