"""The schema of ``samples.jsonl``, a line a sample, checked at the edge."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

from pydantic import Field, model_validator

from benchmark.pdm.totals import DrivenPlan
from benchmark.protocols.raster import touches_adversary
from benchmark.records.scene_assessment import CollisionSeverity, NotNegative, Text
from benchmark.records.stored import Stored

Waypoints = list[list[float]]
PlaceName = Literal["roundabout", "car-park", "junction", "bend", "straight", "unknown"]


class ForecastRow(Stored):
    """A planner's expectation of the others, as it gave it.

    Attributes:
        boxes: x, y, length, width, yaw of each object now, frame of the plan.
        trajectories: By object and mode, waypoints at 0.5 s steps.
        scores: By object and mode.
    """

    boxes: list[list[float]]
    trajectories: list[list[Waypoints]]
    scores: list[list[float]]


class PlanRow(Stored):
    """A plan as the planner gave it, in its own frame.

    Attributes:
        frame: Axes and reference point of the waypoints.
        waypoints: 6 to 16 points at 0.5 s steps, metres.
        modes: Alternatives, as the planner gave them.
        mode_scores: One for each alternative.
        forecasts: Of the others, if it makes any.
    """

    frame: Literal["lidar", "ego"]
    waypoints: Waypoints
    modes: list[Waypoints] | None = None
    mode_scores: list[float] | None = None
    forecasts: ForecastRow | None = None


class OutcomeRow(Stored):
    """The verdict of one protocol on one sample (`benchmark.protocols.ProtocolOutcomes`).

    ``collision`` is null where the data do not say whom a plan could touch; what ``steps`` has of contacts is no
    verdict then. ``l2`` is in metres, null past the end of the scene; ``counted`` is whether the sample is in
    denominators.

    Attributes:
        facts: Further values of the protocol, such as what is touched first.
    """

    collision: list[bool] | None
    l2: list[float | None]
    counted: bool
    steps: dict[str, list[Any]]
    facts: dict[str, Any]

    @property
    def cut_short(self) -> bool:
        """Whether some of its steps are unknown although it counts; asked of ``exact`` alone."""
        return self.counted and None in self.l2

    @property
    def touches_adversary(self) -> bool | None:
        """Whether the first contact is with an adversary (`benchmark.protocols.raster.touches_adversary`)."""
        return touches_adversary(self.collision or (), self.facts)


Cause = Literal["unseen", "misforecast", "misplanned", "not attributable"]
CAUSES: Final[tuple[Cause, ...]] = get_args(Cause)
"""Verdicts of a diagnosis."""
NOT_NEAR: Final = "no forecast near"
"""The case of the rule that is verdict ``unseen``; the first versions counted it as misplanning."""


class DiagnosisRow(Stored):
    """Why a colliding plan collides (`benchmark.metrics.diagnosis`).

    ``reason`` is the case of the rule, ``hit`` the instance that is touched first.

    Attributes:
        cause: Verdict of the diagnosis.
        first_contact_s: Time of the contact after the sample.
    """

    cause: Cause
    reason: str
    hit: str
    first_contact_s: float

    @model_validator(mode="before")
    @classmethod
    def _of_two_causes(cls, stored: Any) -> Any:
        """Records of the first versions: their two words, and what no forecast was near is a cause of its own."""
        if not isinstance(stored, dict) or stored.get("cause") not in ("misforecasting", "misplanning"):
            return stored
        if stored["cause"] == "misforecasting":
            return {**stored, "cause": "misforecast"}
        return {**stored, "cause": "unseen" if stored.get("reason") == NOT_NEAR else "misplanned"}


class LongerPlanRow(Stored):
    """Verdict of ``exact`` on a plan that goes on beyond 3 s: all its steps up to 6 s, judged as one plan.

    ``collision`` is null where the data do not say whom a plan could touch; ``l2`` is in metres from the recorded ego,
    null past the end of the scene.
    """

    collision: list[bool] | None
    l2: list[float | None]


class PlanCollision(CollisionSeverity):
    """The first contact of a plan in open loop (`benchmark.fairness.plan_severity`); its time is since the sample.

    Attributes:
        agent: Instance that is touched.
        adversary: Whether it is an adversary.
    """

    agent: Text
    adversary: bool


class PlanNearRow(Stored):
    """Nearness of a plan without contact to the adversaries; of several, each number is that of the worst.

    ``least_ttc_s`` is null where they never head for one another. ``tet_s`` is how long the time to contact is below
    1.5 s, ``tit_s2`` by how much, summed over time. ``pet_s`` is the post-encroachment time, null where the ways do not
    meet within the plan's 3 s, and ``max_btn`` the largest braking threat number.

    Attributes:
        least_gap_m: Smallest distance of the bodies.
    """

    least_gap_m: NotNegative
    least_ttc_s: NotNegative | None
    tet_s: NotNegative
    tit_s2: NotNegative
    pet_s: NotNegative | None
    max_btn: NotNegative


class PlanSeverityRow(Stored):
    """Severity of a plan in open loop: its first contact with anything, or how ``near`` it comes to the adversaries.

    ``near`` is null with a contact, and where no adversary is there.

    Attributes:
        contact: The first contact, if there is one.
    """

    contact: PlanCollision | None = None
    near: PlanNearRow | None = None


class SampleRow(Stored):
    """One line of ``samples.jsonl``.

    Attributes:
        scene: Name of its scene.
        sample_token: Token of the sample.
        index: Place of the sample in its scene, from 0.
        timestamp_us: Time of the sample.
        status: ``failed`` where the planner raised; such a row has no plan and no outcomes and is never a zero.
        command: 0 right, 1 left, 2 straight.
        ego_motion: ``measured`` on the CAN bus or ``derived`` from poses.
        lidar_ahead_m: Lidar origin ahead of the rear axle: what turns an ``ego`` plan into a ``lidar`` one.
        complete: Whether the recording goes on for 3 s.
        recorded_future: (6, 3) x, y, yaw of the recorded lidar origin, null past the end of the scene.
        plan: The plan, null where the planner failed.
        error: Traceback of a failure.
        outcomes: Verdicts by protocol.
        diagnosis: Why the plan collides, or null where it does not under ``exact``.
        disagreements: For each protocol whose verdict on the sample differs from that of ``exact``, the cause
            (`benchmark.metrics.disagreement`).
        driving: Sub-scores of the plan, or null where there is no plan, the recording ends within 3 s, there is no map
            with lanes or the surroundings are not annotated; null in records of schema 1 and 2.
        longer: Verdicts beyond 3 s, or null where the plan ends there.
        place: What kind of place the recorded car is on (docs/manoeuvres.md); null in older records.
        speed_m_s: Its speed; null in older records.
        severity: How severe the plan is (docs/severity.md); null where there is no plan or the surroundings are not
            annotated, and in older records.
        note: What was peculiar in the planner's answer, which was taken all the same; not written where nothing was.
    """

    scene: str
    sample_token: str
    index: int
    timestamp_us: int
    status: Literal["ok", "failed"]
    command: int
    ego_motion: str
    lidar_ahead_m: float
    complete: bool
    recorded_future: list[list[float] | None]
    plan: PlanRow | None
    error: str | None
    outcomes: dict[str, OutcomeRow]
    diagnosis: DiagnosisRow | None = None
    disagreements: dict[str, str] = Field(default_factory=dict)
    driving: DrivenPlan | None = None
    longer: LongerPlanRow | None = None
    place: PlaceName | None = None
    speed_m_s: float | None = Field(default=None, ge=0)
    severity: PlanSeverityRow | None = None
    note: str = ""


@dataclass(frozen=True, slots=True)
class BriefRow:
    """A `SampleRow` less plan, recorded motion and verdicts; ``judged`` are the protocols that have one.

    ``recorded`` is whether the recording goes on for a step at least.
    """

    scene: str
    sample_token: str
    index: int
    timestamp_us: int
    status: Literal["ok", "failed"]
    command: int
    complete: bool
    recorded: bool
    place: PlaceName | None
    speed_m_s: float | None
    judged: frozenset[str]
    diagnosis: DiagnosisRow | None
    disagreements: Mapping[str, str]
    driven: bool
    longer: LongerPlanRow | None
    severity: PlanSeverityRow | None
