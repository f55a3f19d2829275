"""The schema of records of drives: ``drive.json``, a line a drive in ``drives.jsonl``, ``summary.json``."""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal, Self, get_args

from pydantic import ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from benchmark.machine.storage import content_key
from benchmark.metrics.rates import Rate
from benchmark.records.encounter_window import EncounterWindow, WindowName
from benchmark.records.fault import NUPLAN_FAULT, FaultVerdict, StoredFault, blames_ego
from benchmark.records.run_schema import Name, RecordFacts, Version
from benchmark.records.scene_assessment import KindName, NotNegative
from benchmark.records.stored import Stored

SCHEMA: Final = 1
"""Version of the format of records of drives; raised whenever a field changes."""
MOST_RUNS: Final = 10_000
REASONS: Final = ("raised", "no plan", "unusable plan", "timeout", "died")
StopCondition = Literal["contact", "fault@1", "fault@nuplan", "fault"]
"""Event that ends a drive early: any contact, or one that is the ego's fault, by our rule or by nuPlan's, which older
records call ``fault``."""
ScenariosName = Literal["recorded", "own", "official", "file"]
"""Scenarios of NeuroNCAP's engine: none, ours, NeuroNCAP's own, or one of a file."""
SCENARIOS: Final[tuple[ScenariosName, ...]] = get_args(ScenariosName)
RECORDED, OWN, OFFICIAL, OF_FILE = SCENARIOS
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Fraction = Share | None


class ClosedLoopDefinition(Stored):
    """Settings of a measurement, apart from the planner: two records that differ in it never share a table.

    Attributes:
        engine: Which engine drove.
        agents: How the others behave; ``replay`` in NeuroNCAP's engine.
        sensor: How pictures were made; ``none`` without any.
        sensor_facts: What else the pictures depend on.
        latency_ms: How much later than it was made a plan took effect.
        scenarios: What scenes were driven with, in NeuroNCAP's engine: as they are, ours, NeuroNCAP's own, or a file's.
        scenario_facts: What else that is: ``file``, its name, and ``scenario``, what stands in it; ``target`` ``none``
            where no adversary was the target. Not written where there is nothing.
        agents_facts: What else they depend on: budget, knowledge and version of an adversary, and the policy of those
            beside it. Not written where there is nothing.
        until: What ended a drive before its time. Not written where it is any contact.
        window: Part of each scene that was driven. Not written where it is all of it.
        windows_of: Of recordings that are driven as an adversarial split is: its name, and the hash of its windows. Not
            written of all others.
        plan_hz: How often planners were asked in a second. Not written where it is 2.
    """

    engine: Name
    agents: Name
    sensor: Name
    sensor_facts: dict[str, Any] = Field(default_factory=dict)
    latency_ms: Annotated[int, Field(ge=0, le=600_000)] = 0
    scenarios: ScenariosName = "recorded"
    scenario_facts: dict[str, Any] = Field(default_factory=dict)
    agents_facts: dict[str, Any] = Field(default_factory=dict)
    until: StopCondition = "contact"
    window: WindowName = "scene"
    windows_of: dict[str, str] = Field(default_factory=dict)
    plan_hz: Literal[2, 10] = 2

    @model_serializer(mode="wrap")
    def _as_written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written = _without_empty(write(self), "agents_facts", "windows_of", "scenario_facts")
        usual = (("until", "contact"), ("window", "scene"), ("plan_hz", 2))
        return {name: value for name, value in written.items() if (name, value) not in usual}

    @property
    def world(self) -> str:
        """Engine, agents, latency, window and end of a drive: what records of one table share, with any sensor."""
        facts = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in sorted(self.agents_facts.items()))
        agents = f", agents {self.agents}{f' ({facts})' if facts else ''}" if self.engine == "default" else ""
        late = f", latency {self.latency_ms} ms" if self.latency_ms else ""
        late += f", plans at {self.plan_hz} Hz" if self.plan_hz != 2 else ""
        of = f"{' of' if self.window == 'encounter' else ', as'} {self.windows_of['split']}" if self.windows_of else ""
        window = f"{', window encounter' if self.window == 'encounter' else ''}{of}"
        return f"{self.engine}{self._scenarios}{agents}{late}{window}{f', until {self.rule}' if self.rule else ''}"

    @property
    def until_words(self) -> list[str]:
        """What names of files and tables say of `rule`; none where there is none."""
        return [f"until-{self.rule.replace('@', '-')}"] if self.rule else []

    @property
    def rule(self) -> str | None:
        """Rule of fault by which a contact ends a drive; ``None`` where any contact does."""
        return None if self.until == "contact" else NUPLAN_FAULT if self.until == "fault" else self.until

    @property
    def _scenarios(self) -> str:
        if self.scenarios == "file":
            content = content_key(self.scenario_facts.get("scenario"))[:8]
            return f", scenario {self.scenario_facts.get('file')} ({content})"
        target = f", target {self.scenario_facts['target']}" if "target" in self.scenario_facts else ""
        return target if self.scenarios == "recorded" else f", {self.scenarios} scenarios{target}"


def _without_empty(written: dict[str, Any], *names: str) -> dict[str, Any]:
    """Without fields that say nothing: they are younger than records that must stay the same bytes."""
    return {name: value for name, value in written.items() if name not in names or value}


class DriveFacts(RecordFacts):
    """``drive.json``.

    ``runs`` is the number of runs of each scene, 1 where nothing is drawn. ``rescored`` is the environment of the last
    `challenger-bench rescore`, if the drives were scored anew since.

    Attributes:
        measured: Settings of the measurement.
        scoring: Version of the scores.
    """

    measured: ClosedLoopDefinition
    runs: Annotated[int, Field(strict=True, ge=1, le=MOST_RUNS)]
    scoring: Version
    rescored: dict[str, Any] | None = None


class EpisodePlan(Stored):
    """A plan as the planner gave it, in its own frame; of what else it said, nothing is driven or kept.

    Attributes:
        frame: Axes and reference point of the waypoints.
        waypoints: At 0.5 s steps, metres.
    """

    frame: Literal["lidar", "ego"]
    waypoints: list[list[float]]


class FailureRow(Stored):
    """Why a drive failed: in a word, and what was raised.

    Attributes:
        reason: Kind of failure.
        text: Traceback or message.
    """

    reason: Literal["raised", "no plan", "unusable plan", "timeout", "died"]
    text: str


@dataclass(frozen=True, slots=True)
class ScoredContact:
    """Contact in numbers; kinds, blame and masses are in `benchmark.fairness.scene_assessment` and docs/severity.md.

    ``seconds`` counts from the drive's first driven instant, ``agent`` is the touched instance, and ``adversary``
    whether it was made to be one. Speeds are in m/s: ``impact_speed`` is the size of the difference of velocities,
    ``delta_v_ego`` the ego's change of velocity in a plastic impact.

    Attributes:
        category: Of the other.
        kind: Kind of contact, as nuPlan classifies it.
        at_fault: Whether it is the ego's fault by nuPlan's rule.
        delta_v_other: Change of velocity of the other.
        fault: Whose fault it is by ``fault@1``; null in older records.
    """

    seconds: float
    agent: str
    category: Name
    adversary: bool
    kind: KindName
    at_fault: bool
    impact_speed: NotNegative
    delta_v_ego: NotNegative
    delta_v_other: NotNegative
    fault: StoredFault | None = None


@dataclass(frozen=True, slots=True)
class NuplanTerms:
    """nuPlan's terms of one drive, 0 to 1, and their score.

    Attributes:
        score: Product and weighted mean of the terms.
        nc: No contact at fault: 1/2 at fault with a thing, 0 with a road user.
        dac: No corner 0.3 m outside the drivable area.
        mp: At least a fifth of the recorded way.
        ddc: Not against the direction of the lanes of the route.
        p: Progress beside the recorded ego's in the same time.
        ttc: Time to collision above 0.95 s throughout.
        c: Comfort; ``None`` of a drive shorter than 1.5 s, which counts as 1.
        off_road_s: When a corner first is off the road, seconds.
        least_ttc_s: The smallest time to collision, ``None`` above 2.9 s.
    """

    score: Share
    nc: Share
    dac: Share
    mp: Share
    ddc: Share
    p: Share
    ttc: Share
    c: Fraction
    off_road_s: float | None
    least_ttc_s: float | None


@dataclass(frozen=True, slots=True)
class HdScore:
    """HD-Score's formula with our terms, of one drive: a product of two shares.

    ``plans`` is the mean over planning instants of NC DAC (5 TTC + 2 C) / 7, ``completed`` the share of the route.

    Attributes:
        score: Product of the two shares.
    """

    score: Share
    plans: Share
    completed: Share


@dataclass(frozen=True, slots=True)
class NeuroncapScore:
    """Score of a run by NeuroNCAP's engine, 0 to 5; ``None`` where it is nothing of nothing. Speeds are in m/s.

    Attributes:
        score: 5 without contact, less the faster the impact.
        impact_speed: Speed at the contact; 0 without one.
        reference_speed: Impact speed of an ego that does not react.
    """

    score: Annotated[float, Field(ge=0.0, le=5.0)] | None
    impact_speed: float
    reference_speed: float


class ScoreRow(Stored):
    """Scores of a drive that did not fail.

    ``recorded_progress_m`` is the recorded ego's in the same time. ``route_share`` is of the recorded way to its end,
    ``None`` where the recorded car hardly moves; ``comfortable`` is within nuPlan's bounds, ``None`` of less than 1.5
    s. ``nuplan`` and ``hd`` are of the default engine on a map with lanes, ``neuroncap`` is of NeuroNCAP's engine.

    Attributes:
        progress_m: Driven along the route.
        further: Parts of scores of extensions, by score, one of them ``score``; not written where there are none.
    """

    progress_m: float
    recorded_progress_m: float
    route_share: Fraction
    comfortable: Fraction
    nuplan: NuplanTerms | None
    hd: HdScore | None
    neuroncap: NeuroncapScore | None
    further: dict[Name, dict[Name, float | None]] = Field(default_factory=dict)

    @model_serializer(mode="wrap")
    def _as_written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return _without_empty(write(self), "further")


class TickRows(Stored):
    """The planning instants, column by column.

    ``ego`` has x, y, yaw, speed, acceleration, yaw rate and angle of the road wheels. ``command`` (0 right, 1 left,
    2 straight) and ``station`` (metres along the route) have one value for each instant that was planned from.

    Attributes:
        time_us: Time of each instant.
    """

    time_us: list[int]
    ego: list[Annotated[list[float], Field(min_length=7, max_length=7)]]
    command: list[Literal[0, 1, 2]]
    station: list[float]


class TrafficTrack(Stored):
    """An agent in another simulator's traffic.

    Attributes:
        agent: Its index in the scene.
        first: Number of steps of the drive before it left its recording.
        poses: x, y and yaw of its box centre after each 0.1 s from then on, null where it is gone.
    """

    agent: Annotated[int, Field(ge=0)]
    first: Annotated[int, Field(ge=0)]
    poses: list[Annotated[list[float], Field(min_length=3, max_length=3)] | None]


class AdversaryRow(Stored):
    """Track of an adversary (`benchmark.closed_loop.adversary.AdversaryTrack`).

    ``poses`` are x, y, yaw of its box centre from frame ``start`` on, where it left its recording. ``replanned`` are
    frames, none of a track that was given; ``scores`` are of what was chosen there, null where it braked because no
    candidate was allowed.

    Attributes:
        agent: Its index in the scene.
        uuid: Its instance identifier.
        traffic: Agents that left their recordings in another simulator's traffic. Not written where there are none.
    """

    agent: Annotated[int, Field(ge=0)]
    uuid: str
    start: Annotated[int, Field(ge=0)]
    poses: list[Annotated[list[float], Field(min_length=3, max_length=3)]]
    replanned: list[int] = Field(default_factory=list)
    scores: list[float | None] = Field(default_factory=list)
    traffic: list[TrafficTrack] = Field(default_factory=list)

    @model_serializer(mode="wrap")
    def _as_written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return _without_empty(write(self), "traffic")


@dataclass(frozen=True, slots=True)
class LadderOutcome:
    """Outcome of a reference driver in the same encounter; it survives if it touches nothing.

    ``seconds`` is from the start of the drive to its first contact, ``agent`` the touched instance, and ``at_fault`` by
    nuPlan's rule, as if the driver kept to one lane.

    Attributes:
        survives: Whether it touches nothing.
        kind: Kind of contact.
    """

    __pydantic_config__: ClassVar[ConfigDict] = Stored.model_config
    survives: bool
    seconds: float | None = None
    agent: str | None = None
    kind: str | None = None
    at_fault: bool | None = None


CAREFUL: Final = "cc"
"""The careful and competent human: whom an encounter is fair to."""


class EpisodeRow(Stored):
    """One line of ``drives.jsonl``: one scene, one run.

    Attributes:
        scene: Name of the scene.
        family: Family of the scenario; empty where the scene was driven as it is.
        run: Index of the run, which is its seed.
        status: ``failed`` where the planner failed; such a drive has no scores and is never a zero.
        end: What ended it: a contact, the end of the scene, or a failure.
        primed: Planning instants at which the ego was the recorded one.
        ticks: States at the planning instants.
        plans: One for each instant that has one.
        contact: The contact that ended it.
        scores: Null of a failed drive.
        failure: Why the planner failed.
        adversary: Track of an adversary that answers; not written where there was none.
        ladder: Outcomes of reference drivers, by driver; not written where none drove.
        passed: Contacts before `contact` that did not end it, none the ego's fault by the rule that ends the drive; not
            written if none.
        unlabelled: Whether annotations are missing, or in a part of the scene: the drive says nothing of contacts then.
            Not written where it is labelled throughout.
        window: Part of the scene that was driven around an encounter; not written of drives without one.
        ttc_s: Smallest time to collision of each half second driven in a window, null above 2.9 s; not written of all
            others.
        between: Plans between two instants, of each, where the planner was asked more often; not written of all others.
        notes: What was peculiar in the planner's answers, which were taken all the same; not written where nothing was.
        terminated: Whether the planner ended the drive; not written where it did not.
    """

    scene: Name
    family: Literal["", "stationary", "frontal", "side"] = ""
    run: Annotated[int, Field(ge=0, lt=MOST_RUNS)]
    status: Literal["ok", "failed"]
    end: Literal["contact", "end", "failed"]
    primed: Annotated[int, Field(ge=1, le=10_000)]
    ticks: TickRows
    plans: list[EpisodePlan]
    contact: ScoredContact | None
    scores: ScoreRow | None
    failure: FailureRow | None
    adversary: AdversaryRow | None = None
    ladder: dict[str, LadderOutcome] | None = None
    passed: list[ScoredContact] = Field(default_factory=list)
    unlabelled: bool = False
    window: EncounterWindow | None = None
    ttc_s: list[NotNegative | None] = Field(default_factory=list)
    between: list[list[EpisodePlan]] = Field(default_factory=list)
    notes: list[str] = Field(default_factory=list)
    terminated: bool = False

    @model_serializer(mode="wrap")
    def _as_written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        optional = ("adversary", "ladder", "passed", "unlabelled", "window", "ttc_s", "between", "notes", "terminated")
        return _without_empty(write(self), *optional)

    @property
    def first_contact(self) -> ScoredContact | None:
        """The first contact, whether it ended the drive or not."""
        return self.passed[0] if self.passed else self.contact

    @property
    def touches(self) -> tuple[ScoredContact, ...]:
        """All contacts."""
        return (*self.passed, *(() if self.contact is None else (self.contact,)))

    @property
    def says_fault(self) -> bool:
        """Whether it says of all its contacts whose fault they are; older records do not."""
        return all(touch.fault is not None for touch in self.touches)

    @property
    def fault(self) -> FaultVerdict | None:
        """Whose fault its contacts are by ``fault@1``: the ego's if any is, else shared or unclear if any is.

        ``None`` without a contact.
        """
        verdicts = {touch.fault.verdict for touch in self.touches if touch.fault is not None}
        order = (FaultVerdict.EGO, FaultVerdict.SHARED, FaultVerdict.UNCLEAR, FaultVerdict.OTHER)
        return next((verdict for verdict in order if verdict in verdicts), None)

    @property
    def fair(self) -> bool | None:
        """Whether a careful human survives the same encounter; ``None`` where that was not asked."""
        return None if self.ladder is None or CAREFUL not in self.ladder else self.ladder[CAREFUL].survives

    @model_validator(mode="after")
    def _agree(self) -> Self:
        failed = self.status == "failed"
        if (
            failed != (self.failure is not None)
            or failed != (self.end == "failed")
            or failed == (self.scores is not None)
        ):
            raise ValueError("a failed drive needs a reason and no scores, any other drive needs scores")
        if (self.contact is not None) != (self.end == "contact"):
            raise ValueError("a drive needs a contact exactly if a contact ended it")
        if any(touch.at_fault and blames_ego(touch.fault) is not False for touch in self.passed):
            raise ValueError("a contact that is the ego's fault ends a drive")
        if len(self.ticks.time_us) != len(self.ticks.ego):
            raise ValueError("every planning instant needs a time and a state")
        return self


class PublishedTable(Stored):
    """NeuroNCAP's table as its published code makes it: means over runs, then over scenes, then over families.

    Each mean is rounded to three digits. A failed run is left out; a scene with a run without a score drops out.

    Attributes:
        nns: NeuroNCAP score.
        collision: Collision rate.
        nns_by_family: Score by family of scenarios.
        collision_by_family: Collision rate by family.
    """

    nns: float | None
    collision: Fraction
    nns_by_family: dict[str, float | None]
    collision_by_family: dict[str, Fraction]


class DriveSummary(Stored):
    """``summary.json``: derived from the rows alone.

    ``reasons`` says how often the planner failed for which reason; ``coverage`` is the share of drives that did not
    fail. ``columns`` are means and rates over those, with intervals over recorded scenes. ``published`` is of scenarios
    in ``neuroncap@code``, averaged and rounded as NeuroNCAP's published code does it; null of all else and in older
    records.

    Attributes:
        schema_version: Version of the format.
        drives: Number of drives.
        failed: Drives in which the planner failed.
    """

    schema_version: int = Field(alias="schema")
    drives: int
    failed: int
    reasons: dict[str, int]
    coverage: Share
    columns: dict[str, Rate]
    published: PublishedTable | None = None
