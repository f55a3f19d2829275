"""Every number of the generator: the paper's hyper-parameter table, and what the paper leaves open."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from difflib import get_close_matches
from enum import StrEnum
from typing import Any, Final, Self

import numpy as np

from benchmark.constants import FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import MotionModel
from benchmark.dynamics.reference_path import WAYPOINTS
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_key
from generation.search.threat_settings import NEUTRAL, CandidateProposal, EgoDriver, ThreatSettings, parse_setting

CANDIDATE_FRAMES = WAYPOINTS * FRAMES_PER_KEYFRAME
"""Frames that a candidate lasts: 8 s at 12 Hz."""
REFERENCE_POSES = 81
"""Poses of a candidate in the reference code, the planning frame's among them."""
MOST_CANDIDATES = 65536
"""Beyond this a batch fills the memory of a worker."""
MOST_ROUNDS = 1000
"""Far more than there are levels of noise."""
_AT_LEAST_1 = (
    "candidates", "horizon", "lookahead_stride", "first_noise_level", "candidate_limit", "tries",
    "shortest_drive_frames", "timestep_frames",
)  # fmt: skip
_POSITIVE = ("half_extent_m", "stopping_m_s2")
_NOT_NEGATIVE = (
    "rounds", "lookahead_frames", "clearance_m", "headway_s", "temperature", "history_frames", "staying_preference",
    "init_scale", "corner_weight", "dac_weight", "cr_weight", "ac_weight", "road_and_collision_last_weight",
    "challenge_first_weight", "lookahead_weight", "lookahead_challenge_weight", "init_least", "manoeuvre_weight",
    *(each.name for each in fields(ThreatSettings)),
)  # fmt: skip
_VERDICT_SETTINGS = ("solvable",)
"""Settings that no track depends on, and so no random number either: never a part of the fingerprint."""


class CollisionReading(StrEnum):
    """Meaning of the appendix's three-way collision test; the readings differ in what they do with near misses.

    ``GEOMETRY``: boxes that intersect, which is what the three steps compute when their bounds are valid ones.
    ``LITERAL``: the words: centres nearer than the sum of the short edges collide, farther than the sum of the long
    edges do not, boxes decide in between. A car 3.5 m to the side then "collides".
    ``HALF``: half edges in both places, as the reference code computes; corner contacts beyond half the long edges
    are missed.
    """

    GEOMETRY = "geometry"
    LITERAL = "literal"
    HALF = "half"


class ScoreDefinition(StrEnum):
    """Source of the score: the appendix (`generation.search.scoring`), or the code (`reference_scoring` beside it)."""

    APPENDIX = "appendix"
    REFERENCE = "reference"


class ExecutionModel(StrEnum):
    """Motion of a planned vehicle.

    ``DRIVER``: `MotionModel.si`, within what a driver does. ``UNLIMITED``: the same tracker and bicycle without a
    driver's limits, of which the paper has none. ``REFERENCE``: `MotionModel.reference`, a frame counting as a second,
    each planning frame starting from the two last positions.
    """

    DRIVER = "driver"
    UNLIMITED = "unlimited"
    REFERENCE = "reference"


class VehicleChoiceRule(StrEnum):
    """Source of the rules for vehicles that may become adversaries: ours, with our limits, or the reference code's."""

    OURS = "ours"
    REFERENCE = "reference"


class LaunchRule(StrEnum):
    """When an adversary takes over.

    ``NEAR``: once it is near the ego, after a history, driving forwards on the road. ``START``: at the first frame at
    which it is there and in the area around the ego (Algorithm 1 begins at frame 0). ``REFERENCE``: the code's.
    ``REACH``: when it can get in the ego's way and stay near it (`generation.search.candidates`); who never can is not
    tried.
    """

    NEAR = "near"
    START = "start"
    REFERENCE = "reference"
    REACH = "reach"


class DiscardRules(StrEnum):
    """Reasons for which a scene is dropped.

    ``OURS``: all of `generation.search.verify`. ``PAPER``: of it, what the paper names. ``REFERENCE``: what the code
    asks, which does not look for contact again (`generation.search.planning`).
    """

    OURS = "ours"
    PAPER = "paper"
    REFERENCE = "reference"


@dataclass(frozen=True, slots=True)
class HyperParameters(ThreatSettings):
    """Settings of the search for one adversary; defaults are the paper's wherever it names a value.

    `paper` gives the paper's text, `reference` the public code. Frames are 1/12 s. The first block is the paper's
    appendix ("Hyperparameters"); everything after it is open in the paper and says why it is there.

    Attributes:
        candidates: Batch size of each round.
        rounds: Refinement rounds after the initial batch.
        horizon: H, timesteps that are scored and executed before the next planning frame.
        init_scale: Upper end of the random initial score.
        corner_weight: Weight of a corner off the road relative to the centre.
        dac_weight: Weight of drivable area compliance.
        cr_weight: Weight of collisions.
        ac_weight: Weight of adversarial challenge.
        road_and_collision_last_weight: Step weights of both fall from 1 to this, quadratically.
        challenge_first_weight: Step weights of the challenge rise from this to 1, linearly.
        temperature: Of the resampling softmax.
        first_noise_level: Diffusion steps added in the first refinement round; falls linearly to 1.
        multi_round: False is the ablation "- MTR": only the initial batch.
        scored: False is the ablation "- TS": uniform resampling and a random choice.
        candidate_limit: Vehicles tried in one scene ("up to 10 background vehicles").
        staying_preference: Where more qualify, the random choice weighs each by the share of its recorded frames
            after the launch that it spends in the area around the ego, to this power. An oncoming car behind a
            median leaves the area in any case, and is discarded for that. 0 is the paper.
        tries: Searches for one vehicle, each with randomness of its own, until a result is kept or leaves the area
            around the ego. The paper does not say; 1 is one search for each vehicle.
        proximity_m: A candidate comes at least this close to the ego, centre to centre (reference code).
        launch_distance_m: The adversary takes over once it is this close (reference code).
        history_frames: Frames of recorded presence before the launch, which fix its state of motion.
        shortest_drive_frames: An adversary that would act for less is not worth a scene.
        least_drivable_share: Share of a candidate's frames near the ego on the drivable area (reference code).
        least_motion_m: A candidate moves at least this far; less is a parked car, see ``parked``.
        parked: Whether cars that never move may be chosen.
        half_extent_m: Half the side of the square around the ego (100 m x 100 m in the paper).
        lookahead_frames: Frames after ``horizon`` in which collisions and leaving the road still count a little.
            The reference code has such a tail; without it a car is committed to a crash before it can see it.
        lookahead_stride: Every how many frames the tail is sampled.
        lookahead_weight: Step weight of one tail frame (0.03 in the reference code).
        lookahead_challenge_weight: Step weight of one tail frame in the challenge; the reference code has such a tail
            too. Who looks one second ahead stops dead to let the ego come near and then sees it drive away. The paper
            names no tail.
        clearance_m: Bodies closer than this count as touching while planning; drivers keep some air, and the
            2 Hz annotations that a metric sees cut corners by a few centimetres. The paper names none.
        headway_s: Time gap to what is ahead or behind, at the candidate's own speed, kept while planning. Even a
            pushy driver keeps some; without it cars sit 25 cm from a bumper at 50 km/h. The paper names
            none.
        raster_ego: While planning, the ego is also where the rasters of UniAD and VAD show it: 4.5 m x 2 m, half a
            metre to its left, and looking as it did half a second to three seconds before. An adversary in there would
            touch the recorded ego in their eyes, and `verify` discards it. False is the paper.
        close_gap_m: "Gets close" means body to body at most this far, at some frame at which the ego drives.
        moving_ego_m_s: Speed from which on the ego drives; nothing beside a standing car challenges it.
        most_off_road_share: Share of driven frames with the centre off the drivable area that is tolerated.
        most_corner_off_road_share: The same for any corner.
        stopping_m_s2: Braking that must save the ego if the scene went on after its last frame.
        collision_reading: Definition of a collision while planning; verification always means contact.
        best_of_all_rounds: Execute the best candidate of all rounds; the reference forgets all but the last round.
        stable_softmax: Subtract the smallest score before the exponential. The reference does not, in single
            precision: where every score is beyond about 103 it can draw nothing and stops.
        timestep_frames: Frames of one timestep of ``horizon``; the paper does not say how long one lasts.
        varied: Whether the speeds of the first batch are spread (the reference's ``aug_traj``, which the paper does not
            mention).
        init_least: Lower end of the random initial score.
        manoeuvre_weight: Weight of what is missing to a manoeuvre that was asked for (``generate --manoeuvre``), until
            the driven track has it; it counts only where one was asked for.
        score: Source of the score.
        motion: How a planned vehicle moves.
        choice: Source of the rules that choose vehicles.
        launch: When an adversary takes over.
        discards: Reasons to drop a scene.
        proposal: Where tracks come from; of the others than ``sampled`` at most ``tries`` of a vehicle are judged.
        ego: Who drives the ego. Where it reacts, all ``tries`` are made, and the one that presses it most is kept.
        solvable: Whether a scene that no driver could have avoided is dropped (``docs/severity.md``, "What solvable
            means"). Neither the paper nor the code asks. No track depends on it.
    """

    candidates: int = 256
    rounds: int = 5
    horizon: int = 12
    init_scale: float = 1e-3
    corner_weight: float = 0.2
    dac_weight: float = 5.0
    cr_weight: float = 10.0
    ac_weight: float = 1.0
    road_and_collision_last_weight: float = 0.85
    challenge_first_weight: float = 0.7
    temperature: float = 1.0
    first_noise_level: int = 5
    multi_round: bool = True
    scored: bool = True

    candidate_limit: int = 10
    staying_preference: float = 2.0
    tries: int = 2
    proximity_m: float = 20.0
    launch_distance_m: float = 25.0
    history_frames: int = 12
    shortest_drive_frames: int = 60
    least_drivable_share: float = 0.7
    least_motion_m: float = 3.0
    parked: bool = False
    half_extent_m: float = 50.0
    lookahead_frames: int = 24
    lookahead_stride: int = 2
    lookahead_weight: float = 0.03
    lookahead_challenge_weight: float = 0.3
    clearance_m: float = 0.25
    headway_s: float = 0.15
    raster_ego: bool = True
    close_gap_m: float = 4.0
    moving_ego_m_s: float = 1.0
    most_off_road_share: float = 0.02
    most_corner_off_road_share: float = 0.15
    stopping_m_s2: float = 5.0

    collision_reading: CollisionReading = CollisionReading.GEOMETRY
    best_of_all_rounds: bool = True
    stable_softmax: bool = True

    timestep_frames: int = 1
    varied: bool = True
    init_least: float = 0.0
    manoeuvre_weight: float = 2.0
    score: ScoreDefinition = ScoreDefinition.APPENDIX
    motion: ExecutionModel = ExecutionModel.DRIVER
    choice: VehicleChoiceRule = VehicleChoiceRule.OURS
    launch: LaunchRule = LaunchRule.NEAR
    discards: DiscardRules = DiscardRules.OURS
    proposal: CandidateProposal = CandidateProposal.SAMPLED
    ego: EgoDriver = EgoDriver.RECORDED
    solvable: bool = True

    @classmethod
    def paper(cls) -> Self:
        """The text of the paper; what it leaves open is read as `generation.search.differences_from_paper` says."""
        return cls(
            staying_preference=0.0,
            tries=1,
            shortest_drive_frames=12,
            least_drivable_share=0.0,
            raster_ego=False,
            moving_ego_m_s=0.0,
            best_of_all_rounds=False,
            varied=False,
            motion=ExecutionModel.UNLIMITED,
            launch=LaunchRule.START,
            discards=DiscardRules.PAPER,
            solvable=False,
        )

    @classmethod
    def reference(cls) -> Self:
        """What the public code does; what cannot be is in `generation.search.differences_from_paper`."""
        return cls(
            staying_preference=0.0,
            tries=1,
            lookahead_frames=0,
            lookahead_challenge_weight=0.0,
            clearance_m=0.0,
            headway_s=0.0,
            raster_ego=False,
            best_of_all_rounds=False,
            stable_softmax=False,
            init_least=0.02,
            score=ScoreDefinition.REFERENCE,
            motion=ExecutionModel.REFERENCE,
            choice=VehicleChoiceRule.REFERENCE,
            launch=LaunchRule.REFERENCE,
            discards=DiscardRules.REFERENCE,
            solvable=False,
        )

    def changed(self, assignments: Sequence[str]) -> Self:
        """The same settings with some of them changed by text, as from a command line.

        Args:
            assignments: ``name=value``; switches are ``true`` or ``false``.

        Returns:
            The changed settings.

        Raises:
            InputError: If there is no setting of that name or the value does not fit.
        """
        kinds = {field.name: type(getattr(self, field.name)) for field in fields(self)}
        values: dict[str, Any] = {}
        for assignment in assignments:
            name, equals, text = assignment.partition("=")
            name, text = name.strip(), text.strip()
            if name not in kinds or not equals:
                near = get_close_matches(name, kinds, n=1) if name not in kinds else []
                hint = (
                    f"did you mean {near[0]}?" if near else "names are the fields of generation.search.hyperparameters"
                )
                raise InputError(f"{assignment!r} is not NAME=VALUE of a hyper-parameter; {hint}")
            values[name] = parse_setting(name, text, kinds[name])
        return replace(self, **values)

    def __post_init__(self) -> None:
        for name in _AT_LEAST_1:
            if getattr(self, name) < 1:
                raise InputError(f"hyper-parameter {name} must be at least 1, got {getattr(self, name)}")
        for name in _POSITIVE:
            if not getattr(self, name) > 0:
                raise InputError(f"hyper-parameter {name} must be positive, got {getattr(self, name)}")
        for name in _NOT_NEGATIVE:
            if not getattr(self, name) >= 0:
                raise InputError(f"hyper-parameter {name} must not be negative, got {getattr(self, name)}")
        if self.candidates > MOST_CANDIDATES:
            raise InputError(f"hyper-parameter candidates must be at most {MOST_CANDIDATES}, got {self.candidates}")
        if self.rounds > MOST_ROUNDS:
            raise InputError(f"hyper-parameter rounds must be at most {MOST_ROUNDS}, got {self.rounds}")
        if self.executed_frames + self.lookahead_frames > CANDIDATE_FRAMES:
            raise InputError(
                f"hyper-parameters horizon and lookahead_frames must not be more than {CANDIDATE_FRAMES} together, the "
                f"frames of a candidate, got {self.executed_frames} and {self.lookahead_frames}"
            )

    @property
    def fingerprint(self) -> str:
        """Content key of all values but those of younger settings that change nothing, so that kept work stays found.

        Settings that no track depends on are left out: random numbers are seeded by it.
        """
        values = {name: value for name, value in asdict(self).items() if name not in _VERDICT_SETTINGS}
        return content_key(
            {
                name: values[name]
                for name in values
                if name not in _LATER_SETTINGS or values[name] != _LATER_SETTINGS[name]
            }
        )

    @property
    def executed_frames(self) -> int:
        """Frames that are executed before the next planning frame."""
        return self.horizon * self.timestep_frames

    @property
    def scored_frames(self) -> tuple[int, ...]:
        """Frames after the planning frame that are scored: H timesteps and the sampled tail; the reference's 0..80."""
        if self.score is ScoreDefinition.REFERENCE:
            return tuple(range(REFERENCE_POSES))
        last, step = self.executed_frames, self.timestep_frames
        tail = range(last + self.lookahead_stride, last + self.lookahead_frames + 1)
        return (*range(step, last + 1, step), *tail[:: self.lookahead_stride])

    def safety_step_weights(self) -> Floats:
        """Step weights of drivable area compliance and collisions at ``scored_frames``.

        Appendix: "quadratically decreasing from 1.0 to 0.85" over the horizon; a constant over the tail.
        """
        head = np.linspace(1.0, np.sqrt(self.road_and_collision_last_weight), self.horizon) ** 2
        tail = len(self.scored_frames) - self.horizon
        return np.concatenate([head, np.full(tail, self.lookahead_weight * self.lookahead_stride)])

    def challenge_step_weights(self) -> Floats:
        """Step weights of the challenge at ``scored_frames``: "linearly increasing from 0.7 to 1.0", then the tail."""
        head = np.linspace(self.challenge_first_weight, 1.0, self.horizon)
        tail = len(self.scored_frames) - self.horizon
        return np.concatenate([head, np.full(tail, self.lookahead_challenge_weight * self.lookahead_stride)])

    def motion_model(self) -> MotionModel:
        """The physics that executes plans."""
        match self.motion:
            case ExecutionModel.DRIVER:
                return MotionModel.si()
            case ExecutionModel.UNLIMITED:
                return replace(MotionModel.si(), limits=None)
            case ExecutionModel.REFERENCE:
                return MotionModel.reference()

    def noise_levels(self) -> tuple[int, ...]:
        """Noise level of each refinement round: 5, 4, 3, 2, 1 by default; none without refinement."""
        if not self.multi_round:
            return ()
        return tuple(int(level) for level in np.rint(np.linspace(self.first_noise_level, 1, self.rounds)))


_LATER_SETTINGS: Final[dict[str, Any]] = {
    "timestep_frames": 1, "varied": True, "init_least": 0.0, "score": ScoreDefinition.APPENDIX, "manoeuvre_weight": 2.0,
    "motion": ExecutionModel.DRIVER, "choice": VehicleChoiceRule.OURS, "launch": LaunchRule.NEAR,
    "discards": DiscardRules.OURS, "proposal": CandidateProposal.SAMPLED, "ego": EgoDriver.RECORDED,
    **asdict(NEUTRAL),
}  # fmt: skip
"""Settings that came when searches had been kept already, as searches had them then: so they are no part of the key."""
