"""The judgement of a scene: one for each of its adversaries, from the tracks that are at hand."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, TypeVar, cast

import numpy as np

from benchmark.fairness.blame import Blame
from benchmark.fairness.encounter import severity_of
from benchmark.fairness.impact import DIGITS, contact_at, impact_of
from benchmark.fairness.validity import faults_of
from benchmark.interactions.contacts import BLAMELESS, KINDS
from benchmark.interactions.outcomes import Outcome
from benchmark.interactions.reaction import Driver
from benchmark.interactions.solvability import SceneLadder
from benchmark.interactions.tracks import Tracks
from benchmark.records.judgement import (
    DEFINITION,
    DRIVER_NAMES,
    Chance,
    DriverContact,
    DriverRun,
    EncounterSeverity,
    Impact,
    Party,
    SceneJudgement,
    TrackFaults,
)
from benchmark.scene import Scene

FEWEST_FRAMES: Final = 2
Number = TypeVar("Number", float, None, float | None)


@dataclass(frozen=True, slots=True)
class TracksAtHand:
    """What is known of how a scene's adversaries were made.

    Attributes:
        generated: Whether the scene has their 12 Hz tracks, and not what a reader interpolates between keyframes.
        launches: First frame of the adversarial stretch by instance identifier; of others it is the whole scene, and
            reference drivers drive all of it.
        rounded_m: How far each position may be from where it was generated.
    """

    generated: bool
    launches: Mapping[str, int] = field(default_factory=dict)
    rounded_m: float = 0.0


def judge_scene(scene: Scene, known: TracksAtHand) -> tuple[SceneJudgement, ...]:
    """Judge a scene.

    One judgement for each of its adversaries; one without an adversary where it names none that is in it; none for
    a scene of a single frame.
    """
    if len(scene.timestamps_us) < FEWEST_FRAMES:
        return ()
    ids = scene.agents.ids
    adversaries = [ids.index(name) for name in scene.adversaries if name in ids]
    judge = _Judge.of(scene, known, frozenset(adversaries))
    return tuple(judge.judgement(agent) for agent in adversaries) or (judge.judgement(None),)


@dataclass(frozen=True, slots=True)
class _Judge:
    scene: Scene
    known: TracksAtHand
    adversaries: frozenset[int]
    tracks: Tracks
    acts: float | None
    ladder: SceneLadder
    blame: Blame

    @classmethod
    def of(cls, scene: Scene, known: TracksAtHand, adversaries: frozenset[int]) -> "_Judge":
        tracks, blame = Tracks.of_scene(scene), Blame(scene)
        drivable = scene.road_map.drivable_area if blame.has_map else None
        acts = _acts(scene, known, adversaries)
        return cls(scene, known, adversaries, tracks, acts, SceneLadder.of(tracks, None, acts, drivable), blame)

    def judgement(self, agent: int | None) -> SceneJudgement:
        ladder = self.ladder if agent is None else self.ladder.about(agent)
        first = ladder.first_visible
        return SceneJudgement(
            definition=DEFINITION,
            adversary=None if agent is None else self.scene.agents.ids[agent],
            category=None if agent is None else self.scene.agents.categories[agent],
            tracks="generated" if self.known.generated else "annotated",
            has_map=self.blame.has_map,
            acts_s=_rounded(self.acts),
            drivers={name: self._run(ladder.outcomes[Driver(name)], agent) for name in DRIVER_NAMES},
            first_visible_s=None if first is None else _rounded(first),
            chance=_chance(ladder),
            last_chance_s=_rounded(ladder.last_chance.time),
            margin_s=_rounded(ladder.margin_s),
            unsolvable=None if agent is None else ladder.unsolvable,
            encounter=None if agent is None else self._encounter(agent),
            faults=None if agent is None else self._faults(agent),
        )

    def _run(self, outcome: Outcome, judged: int | None) -> DriverRun:
        contact, reason = outcome.contact, outcome.reason
        return DriverRun(
            survives=outcome.survives,
            contact=None
            if contact is None
            else DriverContact(
                time_s=_rounded(contact.time),
                party=self._party(contact.agent, judged),
                instance=self.scene.agents.ids[contact.agent],
                category=self.scene.agents.categories[contact.agent],
                kind=contact.kind.value,
                ego_speed_m_s=_rounded(contact.ego_speed),
                other_speed_m_s=_rounded(contact.other_speed),
                impact_speed_m_s=_rounded(contact.impact_speed),
            ),
            reacted_s=_rounded(outcome.reacted),
            reacted_to=None if reason is None else self._party(reason, judged),
            reacted_to_instance=None if reason is None else self.scene.agents.ids[reason],
            beyond_end=outcome.beyond_end,
        )

    def _party(self, agent: int, judged: int | None) -> Party:
        if agent == judged:
            return "adversary"
        return "another_adversary" if agent in self.adversaries else "other"

    def _encounter(self, agent: int) -> EncounterSeverity:
        found = severity_of(self.tracks, agent)
        return EncounterSeverity(
            least_gap_m=_rounded(found.min_gap),
            least_ttc_s=_rounded(found.min_ttc),
            tet_s=_rounded(found.tet),
            tit_s2=_rounded(found.tit),
            pet_s=_rounded(found.pet),
            pet_first=cast(Literal["ego", "other", "none"] | None, found.first),
            max_btn=_rounded(found.max_btn),
            contact=None if found.contact_s is None else self._impact(agent, found.contact_s),
        )

    def _impact(self, agent: int, time: float) -> Impact:
        contact = contact_at(self.tracks, agent, time)
        blamed = self.blame.at_fault(contact.kind, contact.ego)
        return impact_of(contact, self.tracks.categories[agent], blamed)

    def _faults(self, agent: int) -> TrackFaults:
        known, scene = self.known, self.scene
        launch = known.launches.get(scene.agents.ids[agent], 0)
        frames = np.arange(launch, len(scene.timestamps_us)) if known.generated else scene.keyframes
        return faults_of(
            self.tracks,
            agent,
            frames[frames >= launch],
            scene.road_map if self.blame.has_map else None,
            at_keyframes=not known.generated,
            rounded_m=known.rounded_m,
        )


def _acts(scene: Scene, known: TracksAtHand, adversaries: frozenset[int]) -> float | None:
    """When the first adversary acts, seconds: at its launch; unknown where one of them has none."""
    launches = [known.launches.get(scene.agents.ids[agent]) for agent in adversaries]
    frames = [launch for launch in launches if launch is not None]
    return float(scene.seconds[min(frames)]) if frames and len(frames) == len(launches) else None


def _chance(ladder: SceneLadder) -> Chance:
    contact = ladder.last_chance.contact
    if contact is None:
        return "not_threatened"
    if KINDS.index(contact.kind) in BLAMELESS:
        return "not_to_blame"
    return "never" if ladder.last_chance.time is None else "until"


def _rounded(value: Number) -> Number:
    # Adding zero makes -0.0 plain.
    return None if value is None else round(value, DIGITS) + 0.0
