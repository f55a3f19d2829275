"""The judgement of a scene: one for each of its adversaries, from the tracks that are at hand, with fault and severity.

On a map, nuPlan's rule has the ego at fault in a lateral contact in several lanes or off the road.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal, TypeVar, cast

import numpy as np

from benchmark.fairness.contact_fault import attribute_contact, trace_recorded_contact
from benchmark.fairness.severity_series import measure_severity
from benchmark.fairness.validity import find_track_defects
from benchmark.geometry import Floats
from benchmark.interactions.contacts import (
    KINDS,
    NOT_AT_FAULT_KINDS,
    ContactKind,
    ContactPairs,
    compute_delta_v,
    compute_fatal_probability,
    is_agent_category,
    is_at_fault,
    mass_kg,
)
from benchmark.interactions.driver_outcomes import DriverOutcome, EgoCollision
from benchmark.interactions.reaction import Driver
from benchmark.interactions.solvability import SceneReferenceDrivers
from benchmark.interactions.tracks import STEP_S, ContinuousTracks
from benchmark.pdm.road_polygons import RoadPolygons, build_road_polygons, build_route
from benchmark.records.fault import StoredFault
from benchmark.records.scene_assessment import (
    DEFINITION,
    DRIVER_NAMES,
    Avoidability,
    CollisionSeverity,
    InteractionSeverity,
    Party,
    ReferenceDriverCollision,
    ReferenceDriverRun,
    SceneAssessment,
    StoredTrackDefects,
)
from benchmark.scene import Scene

DIGITS: Final = 6
"""Numbers are rounded, so that they are the same on every machine."""


def compute_impact(
    contact: EgoCollision, category: str, at_fault: bool | None, fault: StoredFault | None = None
) -> CollisionSeverity:
    """The numbers of the first contact of a run with an agent of a category, and whether the ego is to blame."""
    ego, other = compute_delta_v(np.asarray(contact.impact_speed), np.asarray(mass_kg(category)))
    numbers = {
        "time_s": contact.time,
        "impact_speed_m_s": contact.impact_speed,
        "delta_v_ego_m_s": float(ego),
        "delta_v_other_m_s": float(other),
        "fatal_probability": float(compute_fatal_probability(ego)),
    }
    # Adding zero makes -0.0 plain.
    rounded = {name: round(value, DIGITS) + 0.0 for name, value in numbers.items()}
    return CollisionSeverity(kind=contact.kind.value, at_fault=at_fault, fault=fault, **rounded)


def build_collision_at(tracks: ContinuousTracks, agent: int, time: float) -> EgoCollision:
    """The ego and an agent at the moment at which they touch, independent of earlier touches of either.

    The ego may be the recorded one or one that follows a plan; seconds are inside the tracks. Speeds are those of the
    last 0.2 s (`ContinuousTracks.velocities_at`), the ego's along its heading.
    """
    at = np.array([time])
    ego, other = tracks.ego_at(at), tracks.agents_at(at)[0][agent]
    pair = ContactPairs(
        ego=ego,
        ego_speed=np.hypot(*tracks.ego_velocities_at(at).T),
        other=other,
        other_velocity=tracks.velocities_at(at, np.array([agent]))[0],
        is_agent=np.array([is_agent_category(tracks.categories[agent])]),
    )
    return EgoCollision(
        time=time,
        step=round((time - float(tracks.seconds[0])) / STEP_S),
        agent=agent,
        kind=KINDS[pair.kinds[0]],
        ego_speed=float(pair.ego_speed[0]),
        other_speed=float(pair.other_speed[0]),
        impact_speed=float(pair.impact_speed[0]),
        ego=ego[0],
        other=other[0],
    )


class SceneFaultAttribution:
    """Blame for contacts of one scene by nuPlan's rule; the map is only looked at for lateral ones."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.has_map = not scene.road_map.drivable_area.is_empty

    def at_fault(self, kind: ContactKind, ego: Floats) -> bool | None:
        """Whether the ego is to blame for a first contact; ``None`` for a lateral one without a map."""
        if kind is not ContactKind.LATERAL:
            return is_at_fault(kind, unsure=False)
        return is_at_fault(kind, bool(self._road.unsure(ego[None])[0])) if self.has_map else None

    @cached_property
    def _road(self) -> RoadPolygons:
        return build_road_polygons(self._scene.road_map, build_route(self._scene.ego.pose))


FEWEST_FRAMES: Final = 2
Number = TypeVar("Number", float, None, float | None)


@dataclass(frozen=True, slots=True)
class AdversaryProvenance:
    """Provenance of a scene's adversaries.

    ``generated`` is whether it has their 12 Hz tracks, not what a reader interpolates between keyframes. ``launches``
    are first frames of the adversarial stretch by instance; of others it is the whole scene, and reference drivers
    drive all of it. Positions may be ``rounded_m`` from where they were generated.
    """

    generated: bool
    launches: Mapping[str, int] = field(default_factory=dict)
    rounded_m: float = 0.0


def assess_scene(scene: Scene, known: AdversaryProvenance) -> tuple[SceneAssessment, ...]:
    """One judgement for each adversary of a scene; one where none is in it, none for a scene of a single frame."""
    if len(scene.timestamps_us) < FEWEST_FRAMES:
        return ()
    ids = scene.agents.ids
    adversaries = [ids.index(name) for name in scene.adversaries if name in ids]
    judge = _SceneAssessor.of(scene, known, frozenset(adversaries))
    return tuple(judge.judgement(agent) for agent in adversaries) or (judge.judgement(None),)


@dataclass(frozen=True, slots=True)
class _SceneAssessor:
    scene: Scene
    known: AdversaryProvenance
    adversaries: frozenset[int]
    tracks: ContinuousTracks
    acts: float | None
    ladder: SceneReferenceDrivers
    fault_attribution: SceneFaultAttribution

    @classmethod
    def of(cls, scene: Scene, known: AdversaryProvenance, adversaries: frozenset[int]) -> "_SceneAssessor":
        tracks, blame = ContinuousTracks.of_scene(scene), SceneFaultAttribution(scene)
        drivable = scene.road_map.drivable_area if blame.has_map else None
        acts = _find_action_time(scene, known, adversaries)
        return cls(
            scene, known, adversaries, tracks, acts, SceneReferenceDrivers.of(tracks, None, acts, drivable), blame
        )

    def judgement(self, agent: int | None) -> SceneAssessment:
        ladder = self.ladder if agent is None else self.ladder.for_adversary(agent)
        first = ladder.first_visible
        return SceneAssessment(
            definition=DEFINITION,
            adversary=None if agent is None else self.scene.agents.ids[agent],
            category=None if agent is None else self.scene.agents.categories[agent],
            tracks="generated" if self.known.generated else "annotated",
            has_map=self.fault_attribution.has_map,
            acts_s=_rounded(self.acts),
            drivers={name: self._describe_run(ladder.outcomes[Driver(name)], agent) for name in DRIVER_NAMES},
            first_visible_s=None if first is None else _rounded(first),
            chance=_classify_avoidability(ladder),
            last_chance_s=_rounded(ladder.last_chance.time),
            margin_s=_rounded(ladder.margin_s),
            unsolvable=None if agent is None else ladder.unsolvable,
            encounter=None if agent is None else self._measure_severity(agent),
            faults=None if agent is None else self._faults(agent),
        )

    def _describe_run(self, outcome: DriverOutcome, judged: int | None) -> ReferenceDriverRun:
        contact, reason = outcome.contact, outcome.reason
        return ReferenceDriverRun(
            survives=outcome.survives,
            contact=None
            if contact is None
            else ReferenceDriverCollision(
                time_s=_rounded(contact.time),
                party=self._describe_party(contact.agent, judged),
                instance=self.scene.agents.ids[contact.agent],
                category=self.scene.agents.categories[contact.agent],
                kind=contact.kind.value,
                ego_speed_m_s=_rounded(contact.ego_speed),
                other_speed_m_s=_rounded(contact.other_speed),
                impact_speed_m_s=_rounded(contact.impact_speed),
            ),
            reacted_s=_rounded(outcome.reacted),
            reacted_to=None if reason is None else self._describe_party(reason, judged),
            reacted_to_instance=None if reason is None else self.scene.agents.ids[reason],
            beyond_end=outcome.beyond_end,
        )

    def _describe_party(self, agent: int, judged: int | None) -> Party:
        if agent == judged:
            return "adversary"
        return "another_adversary" if agent in self.adversaries else "other"

    def _measure_severity(self, agent: int) -> InteractionSeverity:
        severity = measure_severity(self.tracks, agent)
        return InteractionSeverity(
            least_gap_m=_rounded(severity.min_gap),
            least_ttc_s=_rounded(severity.min_ttc),
            tet_s=_rounded(severity.tet),
            tit_s2=_rounded(severity.tit),
            pet_s=_rounded(severity.pet),
            pet_first=cast(Literal["ego", "other", "none"] | None, severity.first),
            max_btn=_rounded(severity.max_btn),
            contact=None if severity.contact_s is None else self._measure_impact(agent, severity.contact_s),
        )

    def _measure_impact(self, agent: int, time: float) -> CollisionSeverity:
        contact = build_collision_at(self.tracks, agent, time)
        blamed = self.fault_attribution.at_fault(contact.kind, contact.ego)
        fault = attribute_contact(self.scene, trace_recorded_contact(self.tracks, agent, time))
        return compute_impact(contact, self.tracks.categories[agent], blamed, fault)

    def _faults(self, agent: int) -> StoredTrackDefects:
        known, scene = self.known, self.scene
        launch = known.launches.get(scene.agents.ids[agent], 0)
        frames = np.arange(launch, len(scene.timestamps_us)) if known.generated else scene.keyframes
        return find_track_defects(
            self.tracks,
            agent,
            frames[frames >= launch],
            scene.road_map if self.fault_attribution.has_map else None,
            at_keyframes=not known.generated,
            rounded_m=known.rounded_m,
        )


def _find_action_time(scene: Scene, known: AdversaryProvenance, adversaries: frozenset[int]) -> float | None:
    """When the first adversary acts, seconds: at its launch; unknown where one of them has none."""
    launches = [known.launches.get(scene.agents.ids[agent]) for agent in adversaries]
    frames = [launch for launch in launches if launch is not None]
    return float(scene.seconds[min(frames)]) if frames and len(frames) == len(launches) else None


def _classify_avoidability(ladder: SceneReferenceDrivers) -> Avoidability:
    contact = ladder.last_chance.contact
    if contact is None:
        return "not_threatened"
    if KINDS.index(contact.kind) in NOT_AT_FAULT_KINDS:
        return "not_to_blame"
    return "never" if ladder.last_chance.time is None else "until"


def _rounded(value: Number) -> Number:
    # Adding zero makes -0.0 plain.
    return None if value is None else round(value, DIGITS) + 0.0
