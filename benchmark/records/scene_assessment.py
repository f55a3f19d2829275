"""Assessment of an adversarial scene: avoidability by reference drivers, severity, and defects of its adversary.

``docs/severity.md`` and ``docs/realism.md`` define every word. A `SceneAssessment` is about one adversary of one scene,
`AssessmentSummary` about a scene as tables, cards and filters need it, `SplitRealism` about the adversaries of a split.
Times are seconds since the scene's first frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, Literal, Self, get_args

from pydantic import Field, model_validator

from benchmark.records.fault import StoredFault
from benchmark.records.stored import Stored

DEFINITION: Final = 2
"""Version of the definitions; raised whenever one of them gives another answer. By the first, drivers took over at
the first frame of every scene."""
DriverName = Literal["recorded", "constant", "idm", "r157", "cc", "fsm", "rss"]
DRIVER_NAMES: Final[tuple[DriverName, ...]] = get_args(DriverName)
"""The ladder, from the weakest statement to the most cautious driver."""
Party = Literal["adversary", "another_adversary", "other"]
"""Whom something is about: the adversary that is judged, another one of the scene, or anybody else."""
KindName = Literal["stopped_ego", "stopped_track", "front", "rear", "lateral"]
TrackDefectName = Literal["beyond_limits", "off_road", "contact", "against_traffic", "hovering", "teleport"]
TRACK_DEFECT_NAMES: Final[tuple[TrackDefectName, ...]] = get_args(TrackDefectName)
Avoidability = Literal["not_threatened", "not_to_blame", "never", "until"]
Text = Annotated[str, Field(max_length=500)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class ReferenceDriverCollision(Stored):
    """First contact of a reference driver; the impact speed is the size of the difference of the velocities.

    Attributes:
        time_s: Since the scene's first frame.
        party: Whether an adversary or another road user.
        instance: Of the other.
        category: Of the other.
        kind: Kind of contact.
        ego_speed_m_s: Of the driver.
        other_speed_m_s: Of the other.
        impact_speed_m_s: Of one relative to the other.
    """

    time_s: float
    party: Party
    instance: Text
    category: Text
    kind: KindName
    ego_speed_m_s: float
    other_speed_m_s: NotNegative
    impact_speed_m_s: NotNegative


class ReferenceDriverRun(Stored):
    """Fate of one reference driver; it survives if it hits nothing.

    ``reacted_s`` is when it first finds something unsafe, ``reacted_to`` the party; null where it never does, or is no
    driver that reacts. ``beyond_end`` is whether it leaves the recorded path, where no road is known.

    Attributes:
        survives: Whether it touches nothing.
        contact: Its first contact, if there is one.
        reacted_to_instance: Instance of that party.
    """

    survives: bool
    contact: ReferenceDriverCollision | None = None
    reacted_s: float | None = None
    reacted_to: Party | None = None
    reacted_to_instance: Text | None = None
    beyond_end: bool = False

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if self.survives != (self.contact is None):
            raise ValueError("a driver survives exactly if it has no contact")
        if (self.reacted_s is None) != (self.reacted_to is None) or (self.reacted_s is None) != (
            self.reacted_to_instance is None
        ):
            raise ValueError("a reaction needs both a time and an instance")
        return self


class CollisionSeverity(Stored):
    """A contact in numbers (`benchmark.fairness.scene_assessment`).

    ``at_fault`` is whether the ego is to blame by nuPlan's rule, null where only a map could tell and there is none.
    ``impact_speed_m_s`` is the size of the difference of the velocities, ``fatal_probability`` that of those in the
    ego.

    Attributes:
        time_s: When it begins.
        kind: Kind of contact, as nuPlan classifies it.
        delta_v_ego_m_s: Change of velocity of the ego.
        delta_v_other_m_s: Change of velocity of the other.
        fault: Whose fault it is by ``fault@1``; null in older records.
    """

    time_s: float
    kind: KindName
    at_fault: bool | None
    impact_speed_m_s: NotNegative
    delta_v_ego_m_s: NotNegative
    delta_v_other_m_s: NotNegative
    fatal_probability: Share
    fault: StoredFault | None = None


class InteractionSeverity(Stored):
    """Nearness of the recorded ego, or one that follows plans, and one other to a contact.

    Attributes:
        least_gap_m: Null where they are never there together.
        least_ttc_s: Least time to contact before a contact; null where they never head for one another.
        tet_s: How long the time to contact is below 1.5 s.
        tit_s2: By how much it is below, summed over time.
        pet_s: Post-encroachment time, 0 in contact; null where their ways do not meet within 5 s.
        pet_first: Who was there first; ``none`` in contact.
        max_btn: Largest braking threat number.
        contact: Their first contact, if there is one.
    """

    least_gap_m: NotNegative | None
    least_ttc_s: NotNegative | None
    tet_s: NotNegative
    tit_s2: NotNegative
    pet_s: NotNegative | None
    pet_first: Literal["ego", "other", "none"] | None
    max_btn: NotNegative | None
    contact: CollisionSeverity | None = None


class StoredTrackDefects(Stored):
    """Faults of one adversary's track; null where it cannot be told: without a map, or a 12 Hz track.

    Attributes:
        beyond_limits: It asks more of car or driver than `benchmark.dynamics.bicycle.DriverLimits`.
        off_road: A corner is more than 0.3 m off the drivable area.
        contact: It touches another object than the ego.
        against_traffic: It heads more than 90 degrees away from the lane below its centre for more than 1 s.
        hovering: It stays within 0.5 m of the same other object for more than 0.5 s.
        teleport: It moves or turns further between two frames than any car could.
        unknown: Why each of those that are null is.
    """

    beyond_limits: bool | None = None
    off_road: bool | None = None
    contact: bool | None = None
    against_traffic: bool | None = None
    hovering: bool | None = None
    teleport: bool | None = None
    unknown: dict[TrackDefectName, Text] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if set(self.unknown) != {name for name in TRACK_DEFECT_NAMES if getattr(self, name) is None}:
            raise ValueError("exactly the faults that are unknown need a reason")
        return self

    @property
    def found(self) -> tuple[TrackDefectName, ...]:
        """Names of those that it has."""
        return tuple(name for name in TRACK_DEFECT_NAMES if getattr(self, name))


class SceneAssessment(Stored):
    """Judgement of one adversary of one scene, or of a scene without a known adversary.

    Attributes:
        definition: `DEFINITION` by which it was judged.
        adversary: Its instance identifier, that of the recording in what this program makes; null where none is known,
            and then everything that needs one is null as well.
        category: Of the adversary.
        tracks: ``generated`` where its 12 Hz track was at hand, ``annotated`` where what a reader interpolates between
            keyframes was.
        has_map: Whether manoeuvres had to stay on the drivable area.
        acts_s: When the first adversary of the scene departs from its recording, and drivers take over; null where that
            is not known, and they do at the first frame.
        drivers: How each reference driver fares from then on, against all others.
        first_visible_s: When from then on the recorded ego first sees the adversary; null for never.
        chance: How the contact of the ego at constant speed can be avoided: it has none, it is not to blame, nothing
            avoids it from the start on, or something does until ``last_chance_s``.
        last_chance_s: Until when a sampled manoeuvre avoids it.
        margin_s: From 0.75 s after the adversary is first visible to the last chance.
        unsolvable: Whether no driver could have avoided it.
        encounter: With the recorded ego.
        faults: Of its track.
    """

    definition: Annotated[int, Field(ge=1)] = DEFINITION
    adversary: Text | None
    category: Text | None
    tracks: Literal["generated", "annotated"]
    has_map: bool
    acts_s: float | None = None
    drivers: dict[DriverName, ReferenceDriverRun]
    first_visible_s: float | None
    chance: Avoidability
    last_chance_s: float | None
    margin_s: float | None
    unsolvable: bool | None
    encounter: InteractionSeverity | None
    faults: StoredTrackDefects | None

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if set(self.drivers) != set(DRIVER_NAMES):
            raise ValueError(f"drivers must be {', '.join(DRIVER_NAMES)}")
        if (self.chance == "until") != (self.last_chance_s is not None):
            raise ValueError("a last chance needs a manoeuvre that avoids the contact, and the reverse")
        if self.margin_s is not None and (self.last_chance_s is None or self.first_visible_s is None):
            raise ValueError("a margin needs a first sight and a last chance")
        known = [value is not None for value in (self.category, self.unsolvable, self.encounter, self.faults)]
        if set(known) != {self.adversary is not None}:
            raise ValueError("category, solvability, encounter and faults need an adversary")
        return self


class AssessmentSummary(Stored):
    """Part of a scene's judgements for tables, cards and filters; of several adversaries the most severe values.

    ``unsolvable`` (`is_unsolvable`) and the numbers after it are null where no adversary is known. ``margin_s`` is the
    least time from 0.75 s after an adversary is first visible to the last chance, ``contact`` the recorded ego's first
    contact with an adversary. ``unknown_faults`` could not be told of some track.

    Attributes:
        definition: Version of the definition.
        tracks: ``generated`` or ``annotated``, as in `SceneAssessment`.
        has_map: Whether manoeuvres had to stay on the drivable area.
        survives: Whether each reference driver has no contact.
        least_gap_m: Smallest distance of the bodies.
        least_ttc_s: Least time to contact.
        tet_s: Time exposed: how long the time to contact is below 1.5 s.
        tit_s2: Time integrated: by how much, summed over time.
        pet_s: Post-encroachment time.
        max_btn: Largest braking threat number.
        faults: Faults of the adversaries' tracks.
    """

    definition: Annotated[int, Field(ge=1)] = DEFINITION
    tracks: Literal["generated", "annotated"]
    has_map: bool
    survives: dict[DriverName, bool]
    unsolvable: bool | None
    margin_s: float | None
    least_gap_m: NotNegative | None
    least_ttc_s: NotNegative | None
    tet_s: NotNegative | None
    tit_s2: NotNegative | None
    pet_s: NotNegative | None
    max_btn: NotNegative | None
    contact: CollisionSeverity | None = None
    faults: list[TrackDefectName] = Field(default_factory=list)
    unknown_faults: list[TrackDefectName] = Field(default_factory=list)

    @classmethod
    def of(cls, judgements: Sequence[SceneAssessment]) -> Self:
        """Sum a scene up from the judgements of its adversaries, at least one."""
        first = judgements[0]
        met = [item.encounter for item in judgements if item.encounter is not None]
        tracks = [item.faults for item in judgements if item.faults is not None]
        contacts = [item.contact for item in met if item.contact is not None]
        defects = {name for item in tracks for name in item.found}
        unknown = {name for item in tracks for name in item.unknown} - defects
        return cls(
            definition=first.definition,
            tracks=first.tracks,
            has_map=first.has_map,
            survives={name: first.drivers[name].survives for name in DRIVER_NAMES},
            unsolvable=is_unsolvable(judgements) if met else None,
            margin_s=_least([item.margin_s for item in judgements]),
            least_gap_m=_least([item.least_gap_m for item in met]),
            least_ttc_s=_least([item.least_ttc_s for item in met]),
            tet_s=max((item.tet_s for item in met), default=None),
            tit_s2=max((item.tit_s2 for item in met), default=None),
            pet_s=_least([item.pet_s for item in met]),
            max_btn=max((item.max_btn for item in met if item.max_btn is not None), default=None),
            contact=min(contacts, key=lambda contact: contact.time_s, default=None),
            faults=[name for name in TRACK_DEFECT_NAMES if name in defects],
            unknown_faults=[name for name in TRACK_DEFECT_NAMES if name in unknown],
        )


def is_unsolvable(judgements: Sequence[SceneAssessment]) -> bool:
    """Whether no driver could have avoided a scene, given the judgement of each adversary.

    The verdict on the adversary that the ego at constant speed hits; where it hits another, or none, whether all
    verdicts say so. With one adversary that is its verdict.
    """
    hits = [assessment.drivers["constant"].contact for assessment in judgements]
    hit = [contact is not None and contact.party == "adversary" for contact in hits]
    decisive = [assessment for assessment, decides in zip(judgements, hit, strict=True) if decides]
    relevant = decisive or judgements
    return bool(relevant) and all(assessment.unsolvable is True for assessment in relevant)


@dataclass(frozen=True, slots=True)
class FeatureRealism:
    """Realism of one feature.

    Attributes:
        name: Of the feature, with its unit.
        w1: Wasserstein-1 distance to the recordings, in the unit of the feature.
        w1_of_halves: The same between two halves of the recordings; null where one has no samples.
        w1_in_halves: How many times as far as the halves are from one another.
        realism: 1 - Jensen-Shannon divergence over quantile bins.
        realism_of_halves: The same between two halves: what zero looks like.
        interval: 95 % of bootstraps over scenes; null for a single scene.
    """

    name: Text
    w1: NotNegative
    w1_of_halves: NotNegative | None
    w1_in_halves: NotNegative | None
    realism: float
    realism_of_halves: float | None
    interval: tuple[float, float] | None


class CtgRow(Stored):
    """``ctg-realism@code``, which is quoted and never ranked by.

    ``normalisation`` is how scenes are put together, ``mask`` which agents count. The means are over the agents'
    histograms and over the relative ones, null where the code gives none.

    Attributes:
        version: Of the code that is reproduced.
        mean_real_dev: Mean over the agents' histograms.
        mean_real_dev_int: Mean over the relative histograms.
    """

    version: Text
    normalisation: Text
    mask: Text
    mean_real_dev: NotNegative
    mean_real_dev_int: NotNegative | None


class ValidityRow(Stored):
    """One kind of fault over all adversaries: how many have it, of how many could be asked, why not of the others.

    Attributes:
        fault: Kind of fault.
        count: Adversaries that have it.
        of: Adversaries of which it is known.
        unknown: Reasons why it is not known of others.
    """

    fault: TrackDefectName
    count: Annotated[int, Field(ge=0)]
    of: Annotated[int, Field(ge=0)]
    unknown: tuple[Text, ...] = ()


class SplitRealism(Stored):
    """Realism of the motion of a split's adversaries.

    ``reference`` are the recordings they are compared with, null where they are not and ``not_compared`` says why.
    ``samples`` counts those of adversaries, then of recordings. ``worst`` names the worst feature, which is the
    headline; ``ctg`` is for comparison with the literature.

    Attributes:
        adversaries: How many there are.
        validity: Faults of their tracks, by kind.
        features: Distance of each feature from the recordings.
    """

    adversaries: Annotated[int, Field(ge=0)]
    validity: tuple[ValidityRow, ...]
    reference: Text | None = None
    not_compared: Text | None = None
    samples: tuple[int, int] | None = None
    features: tuple[FeatureRealism, ...] = ()
    worst: Text | None = None
    ctg: CtgRow | None = None

    @property
    def headline(self) -> FeatureRealism | None:
        """The worst feature."""
        return next((row for row in self.features if row.name == self.worst), None)


def _least(values: Sequence[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)
