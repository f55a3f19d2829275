"""Splits in numbers: what ``split.json`` stores, and the assessment of all scenes that ``data stats`` prints."""

from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, field_serializer, field_validator

from benchmark.metrics.rates import Rate
from benchmark.published import ADV_NUSC
from benchmark.records.scene_assessment import DriverName, SceneAssessment, SplitRealism, Text
from benchmark.records.stored import Stored

RENDERING: Final = "rendering"
"""The one stage of generation that is timed by scene; the others are by attempt."""


class _StatisticsModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class TableCounts(_StatisticsModel):
    """Numbers of table rows that belong to some scenes: the paper's table "Overview of the Adv-nuSc Dataset".

    ``instances`` have an annotation in the scenes, ``ego_poses`` are those that sensor data of the scenes name.

    Attributes:
        scenes: Rows of ``scene``.
        samples: Rows of ``sample``.
        sample_data: Rows of ``sample_data``.
        annotations: Rows of ``sample_annotation``.
    """

    instances: int
    ego_poses: int
    scenes: int
    samples: int
    sample_data: int
    annotations: int


class Quantiles(_StatisticsModel):
    """Quantiles of a distribution that has values.

    Attributes:
        least: Minimum.
        tenth: 10 %.
        median: 50 %.
        ninetieth: 90 %.
        most: Maximum.
    """

    least: float
    tenth: float
    median: float
    ninetieth: float
    most: float


class ManoeuvreRow(_StatisticsModel):
    """One kind of manoeuvre in a data set: adversaries whose primary kind it is, and those that did it at all.

    ``places`` and ``median_gap_m`` (the median smallest gap, ``None`` if there are none) are of the primary ones.

    Attributes:
        manoeuvre: Its name.
        primary: Adversaries whose primary manoeuvre it is.
        occurred: Adversaries that did it at all.
    """

    manoeuvre: str
    primary: int
    occurred: int
    places: dict[str, int]
    median_gap_m: float | None


class SplitStatistics(_StatisticsModel):
    """A split, or a whole data set (``split`` is ``None``), in numbers.

    Attributes:
        counts: Rows of tables.
        adversaries_per_scene: Number of scenes by number of adversaries; empty for recordings.
        labelled: Adversaries with labels.
        manoeuvres: Rows by falling number; empty without labels.
        places: Adversaries by place of the closest approach.
        gap_m: Smallest gap between the bodies; ``None``, stored as an empty object, without labels.
        time_to_collision_s: Of those that came within 5 s of a collision.
        within_5_s: How many came within 5 s of a collision.
        published_adv_nusc: What the paper prints for its own data set; quoted, not counted.
    """

    split: str | None = None
    counts: TableCounts
    adversaries_per_scene: dict[int, int]
    labelled: int
    manoeuvres: tuple[ManoeuvreRow, ...]
    places: dict[str, int]
    gap_m: Quantiles | None
    time_to_collision_s: Quantiles | None
    within_5_s: int
    published_adv_nusc: dict[str, int] = Field(default_factory=lambda: dict(ADV_NUSC))

    @field_validator("gap_m", "time_to_collision_s", mode="before")
    @classmethod
    def _of_nothing(cls, quantiles: Any) -> Any:
        return quantiles or None

    @field_serializer("gap_m", "time_to_collision_s")
    def _as_nothing(self, quantiles: Quantiles | None) -> dict[str, float]:
        return {} if quantiles is None else quantiles.model_dump()


class BuildRuntime(_StatisticsModel):
    """Processor seconds of a build, by stage, and how many attempts and rendered scenes are timed.

    Attributes:
        attempts: Attempts that were timed.
        scenes: Scenes whose rendering was timed.
        total_s: Seconds by stage.
    """

    attempts: int
    scenes: int
    total_s: dict[str, float]

    def each_s(self, stage: str) -> float | None:
        """Seconds of one attempt, or of one rendered scene; ``None`` where nothing was timed."""
        count = self.scenes if stage == RENDERING else self.attempts
        return self.total_s.get(stage, 0.0) / count if count else None


Count = Annotated[int, Field(ge=0)]


class ReferenceDriverSurvival(Stored):
    """One rung of the ladder: how many of the scenes one reference driver survives.

    ``hit_adversary`` scenes are those in which it touches an adversary first, ``beyond_end`` those in which it leaves
    the recorded path. In ``hit_from_behind`` another runs into it: agents replay their tracks and do not brake for it.
    """

    driver: DriverName
    survives: Count
    of: Count
    hit_adversary: Count
    hit_from_behind: Count
    beyond_end: Count

    @property
    def share(self) -> float | None:
        """Share of scenes that it survives."""
        return self.survives / self.of if self.of else None


class SeverityRow(Stored):
    """Distribution of one number, named with its unit, over the encounters with an adversary that have it."""

    name: Text
    of: Count
    quantiles: Quantiles | None


class SplitAssessment(Stored):
    """Judgements of a split's scenes, by name, and their summary.

    ``ladder_of_recordings`` is of the recordings that the scenes were made from, empty where they are not at hand.
    Agents replay their tracks there, too: what a driver does not survive there no adversary did. ``unsolvable`` scenes
    could not have been avoided by any driver. ``severity`` is of the recorded ego's encounters with adversaries, times
    to contact only of those without one; in ``contacts`` it touches an adversary.
    """

    scenes: dict[str, tuple[SceneAssessment, ...]]
    ladder: tuple[ReferenceDriverSurvival, ...]
    ladder_of_recordings: tuple[ReferenceDriverSurvival, ...] = ()
    unsolvable: tuple[Text, ...]
    severity: tuple[SeverityRow, ...]
    contacts: Count
    realism: SplitRealism


class TrafficFigure(Stored):
    """One figure of a data set's traffic (``docs/data.md``).

    ``value`` is over all samples that have it, ``samples`` of them, and ``scenes`` has it by scene; ``None`` where no
    sample has it. Shares are 0 to 1.
    """

    value: float | None
    samples: Count
    scenes: dict[str, float | None]


class PlannerTraffic(Stored):
    """A planner on a data set under ``exact``, over so many seeds (``draws``).

    ``collision`` and ``l2`` are by horizon, ``scenes`` the rate of collision within 3 s by scene.
    """

    draws: Count
    collision: dict[str, Rate]
    l2: dict[str, Rate]
    scenes: dict[str, float | None]


class TrafficStatistics(Stored):
    """What ``data stats --traffic`` measures, by name; scenes of a single frame are ``not_measured``."""

    figures: dict[str, TrafficFigure]
    planners: dict[str, PlannerTraffic]
    not_measured: tuple[Text, ...] = ()
