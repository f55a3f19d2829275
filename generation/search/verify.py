"""Verification of adversarial scenes: challenging, drivable, and passable for the recorded ego in official protocols.

Paper section 3 (last paragraph of "Multi-round Trajectory Refinement") and appendix "The Adv-nuSc Dataset".
"""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.constants import FRAMES_PER_KEYFRAME, PLAN_STEPS
from benchmark.datasets.annotated_objects import interpolate_tracks
from benchmark.datasets.sample_truth import compute_truth
from benchmark.dynamics.bicycle import DriverLimits, find_broken_limit
from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap, to_local
from benchmark.protocols import NATIVE_PROTOCOLS, find_masking_protocols, find_protocol
from benchmark.protocols.raster import RasterProtocol
from benchmark.protocols.stacked_truths import stack
from benchmark.records.attempts import MaskedSteps
from benchmark.records.scene_assessment import SceneAssessment, is_unsolvable
from benchmark.scene import Scene
from generation.labels.labelling import compute_body_gaps, compute_ego_speed, read_agent_boxes
from generation.search.hyperparameters import DiscardRules, HyperParameters
from generation.search.recorded_motion import find_log_replay_contacts, is_in_canvas, is_vulnerable
from generation.search.threat_settings import CandidateProposal
from generation.splits.format import METRE_DIGITS, YAW_DIGITS


def find_recorded_contacts(
    scene: Scene, instances: Collection[str], protocols: Iterable[str]
) -> dict[str, tuple[Bools, Bools]]:
    """Contacts of the recorded ego at key frames, by protocol, with these instances and with anything else.

    Each is (K, 6) verdicts for K samples and the steps after them, False where the recording has ended.
    """
    known = find_masking_protocols()
    truths = stack(compute_truth(scene, [""] * len(scene.keyframes)))
    own = np.array([name in instances for name in truths.instances], np.bool_)
    return {
        name: (known[name].recorded_contacts(truths, own), known[name].recorded_contacts(truths, ~own))
        for name in protocols
    }


def count_masked_steps(scene: Scene) -> dict[str, MaskedSteps]:
    """Steps that each protocol's ground-truth check takes from every planner, for an adversary or for others alone."""
    return {
        name: MaskedSteps(adversary=int(own.sum()), others=int((others & ~own).sum()))
        for name, (own, others) in find_recorded_contacts(scene, scene.adversaries, find_masking_protocols()).items()
    }


def sum_masked_steps(scenes: Iterable[Mapping[str, MaskedSteps]]) -> dict[str, dict[str, int]]:
    """Masked steps of several scenes: by protocol those of ``adversary`` and of ``others``, as JSON values."""
    sums: dict[str, Counter[str]] = {}
    for by_protocol in scenes:
        for name, steps in by_protocol.items():
            sums.setdefault(name, Counter()).update(adversary=steps.adversary, others=steps.others)
    return {name: dict(counts) for name, counts in sums.items()}


def format_masked_steps(sums: Mapping[str, Mapping[str, int]]) -> str:
    """`sum_masked_steps` for people."""
    counts = ", ".join(f"{name} {of['adversary']} / {of['others']}" for name, of in sums.items())
    return f"steps masked for every plan, because of adversaries / of others: {counts}"


def compute_raster_footprints(scene: Scene, frames: NDArray[np.int64]) -> Floats:
    """The recorded ego as the rasters of the native protocols show it, wherever key frames may lie.

    At a frame that a plan reaches at its k-th step the ego looks as it did k half seconds before. (S, 6, 5) boxes, one
    for each step of (S,) frames: what any of the rasters covers on average.
    """
    rasters = [known for known in map(find_protocol, NATIVE_PROTOCOLS) if isinstance(known, RasterProtocol)]
    ends = np.stack([raster.mean_ends_m for raster in rasters])
    rear, front, right, left = ends[:, 0].min(), ends[:, 1].max(), ends[:, 2].min(), ends[:, 3].max()
    pose = scene.ego.pose
    heading = pose[frames, 2, None]
    lidar = pose[frames, None, :2] + scene.lidar.translation[0] * _compute_direction(heading)
    step = FRAMES_PER_KEYFRAME * np.arange(1, PLAN_STEPS + 1)
    yaw = pose[np.maximum(frames[:, None] - step, 0), 2]
    ahead, aside = _compute_direction(yaw), _compute_direction(yaw + np.pi / 2)
    center = lidar + 0.5 * ((rear + front) * ahead + (right + left) * aside)
    size = np.broadcast_to([front - rear, left - right], center.shape)
    return np.concatenate([center, size, yaw[..., None]], axis=-1)


def _compute_direction(yaw_rad: Floats) -> Floats:
    return np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=-1)


class DiscardReason(StrEnum):
    """Why a scene is not kept."""

    NEVER_LAUNCHED = "never-launched"
    ORIGINAL_COLLIDES = "original-scene-collides"
    NO_SAFE_CANDIDATE = "no-candidate-without-collision"
    NOTHING_TO_DRAW = "scores-underflow"
    HITS_OBJECT = "hits-an-object"
    HITS_EGO = "hits-the-ego"
    EGO_BLOCKED = "blocks-the-ego-at-the-end"
    LEAVES_AREA = "leaves-the-area-around-the-ego"
    LEAVES_ROAD = "leaves-the-drivable-area"
    NEVER_CLOSE = "never-gets-close"
    UNDRIVEABLE = "motion-no-driver-could-drive"
    TOUCHES_UNIAD = "touches-under-uniad"
    TOUCHES_VAD = "touches-under-vad"
    TOUCHES_SPARSEDRIVE = "touches-under-sparsedrive"
    TOUCHES_DIFFUSIONDRIVE = "touches-under-diffusiondrive"
    CAREFUL_COLLIDES = "a-careful-human-collides"
    EGO_COLLIDES = "the-driven-ego-collides"
    EGO_HARSH = "the-driven-ego-is-harsh"
    EGO_LEAVES = "the-driven-ego-leaves-its-path"
    EGO_INERT = "the-driven-ego-does-not-react"
    SCORES_TOO_HIGH = "best-score-above-the-limit"
    UNSOLVABLE = "unsolvable"
    ANOTHER_MANOEUVRE = "another-manoeuvre-than-asked"
    AGAINST_TRAFFIC = "against-traffic"
    ACROSS_ROAD = "turns-across-the-whole-road"
    PRESSING = "presses-a-leader"
    RIDING_BESIDE = "rides-beside-another"
    STICKING = "sticks-to-another"
    CIRCLING = "circles"
    OFF_ROAD = "off-the-road"
    HEAD_ON = "at-rest-head-on-in-the-ego's-lane"
    WEAVING = "weaves"

    @classmethod
    def touches(cls, protocol: str) -> "DiscardReason":
        """The reason for a contact that the ground-truth check of a native protocol finds."""
        return cls(f"touches-under-{protocol}")


@dataclass(frozen=True, slots=True)
class VerificationFailure:
    """A reason to discard a scene, and the first frame at which it shows; ``other`` was touched, or is ``ego``.

    ``quantity`` has its unit, ``limit`` is what was allowed or needed.
    """

    reason: DiscardReason
    frame: int | None = None
    other: str | None = None
    quantity: str | None = None
    value: float | None = None
    limit: float | None = None

    def as_json(self) -> dict[str, Any]:
        """The fields that say something."""
        fields: dict[str, Any] = {"frame": self.frame, "other": self.other, "quantity": self.quantity}
        fields |= {"value": self.value, "limit": self.limit}
        return {"reason": self.reason.value, **{name: value for name, value in fields.items() if value is not None}}


EGO = "ego"
"""Stands for the recording car where an instance identifier would stand."""


def verify(
    scene: Scene, agent: int, start: int, hyper: HyperParameters, limits: DriverLimits | None
) -> VerificationFailure | None:
    """First reason to discard an adversarial scene, ``None`` to keep it: all of ours, or those that the paper names.

    ``start`` is the first frame of the adversarial track; without ``limits`` of planning the usual ones are asked for.
    """
    boxes = read_agent_boxes(scene, agent)[start:]
    if not np.isfinite(boxes).all():
        return VerificationFailure(DiscardReason.UNDRIVEABLE)
    ours = hyper.discards is DiscardRules.OURS
    broken = find_broken_limit(boxes, limits or DriverLimits()) if ours else None
    if broken is not None:
        quantity, value, limit = broken
        return VerificationFailure(DiscardReason.UNDRIVEABLE, quantity=quantity, value=value, limit=limit)
    return (
        _find_contact(scene, agent, start, boxes)
        or (VerificationFailure(DiscardReason.EGO_BLOCKED) if ours and is_blocking_ego(scene, boxes, hyper) else None)
        or _check_area(scene, agent, start, hyper)
        or (_check_road(scene, start, boxes, hyper) if ours and not is_vulnerable(scene, agent) else None)
        or _check_closeness(scene, agent, start, hyper)
        or _check_masked_steps(scene, agent, start)
    )


def _find_contact(scene: Scene, agent: int, start: int, boxes: Floats) -> VerificationFailure | None:
    """Contact with an object or the ego, at 12 Hz and as a reader of the data set sees it."""
    read = _interpolate_annotations(scene)
    stretches = ((scene, np.arange(start, start + len(boxes))), (read, np.arange(start, read.agents.yaw.shape[1])))
    for view, at in stretches:
        step, other = find_contacts(read_agent_boxes(view, agent)[at], view, agent, at)
        if len(step):
            return VerificationFailure(DiscardReason.HITS_OBJECT, int(at[step[0]]), view.agents.ids[other[0]])
    touched = np.flatnonzero(boxes_overlap(boxes, scene.ego.boxes[start:]))
    if len(touched) or find_log_replay_contacts(scene, np.array([agent]))[agent]:
        return VerificationFailure(DiscardReason.HITS_EGO, start + int(touched[0]) if len(touched) else None, EGO)
    return None


def _check_area(scene: Scene, agent: int, start: int, hyper: HyperParameters) -> VerificationFailure | None:
    """The area is what the diffusion model sees; who follows a path may leave it, as oncoming traffic does."""
    if hyper.proposal is not CandidateProposal.SAMPLED:
        return None
    out = np.flatnonzero(~is_in_canvas(scene, scene.agents.position[agent, :, :2], hyper.half_extent_m)[start:])
    return VerificationFailure(DiscardReason.LEAVES_AREA, start + int(out[0])) if len(out) else None


def _check_closeness(scene: Scene, agent: int, start: int, hyper: HyperParameters) -> VerificationFailure | None:
    moving = compute_ego_speed(scene)[start:] >= hyper.moving_ego_m_s
    if not moving.any():
        return VerificationFailure(
            DiscardReason.NEVER_CLOSE, quantity="speed of the ego, m/s", value=0.0, limit=hyper.moving_ego_m_s
        )
    gap = float(compute_body_gaps(scene, agent, start)[moving].min())
    if gap <= hyper.close_gap_m:
        return None
    return VerificationFailure(
        DiscardReason.NEVER_CLOSE, quantity="smallest gap, m", value=gap, limit=hyper.close_gap_m
    )


def _check_masked_steps(scene: Scene, agent: int, start: int) -> VerificationFailure | None:
    """A step that a native protocol counts for no planner, because the recorded ego touches the adversary in its eyes.

    Frozen splits hold the track to the millimetre, which is enough for a corner to be drawn in another cell.
    """
    name, frames = scene.agents.ids[agent], slice(start, scene.agents.yaw.shape[1])
    track = np.column_stack([scene.agents.position[agent, frames, :2], scene.agents.yaw[agent, frames]])
    frozen = np.column_stack([np.round(track[:, :2], METRE_DIGITS), np.round(track[:, 2], YAW_DIGITS)])
    for view in (scene, scene.with_adversary(agent, frames, frozen)):
        for native, (own, _) in find_recorded_contacts(view, {name}, NATIVE_PROTOCOLS).items():
            if own.any():
                sample, step = np.nonzero(own)
                first = int(scene.keyframes[(sample + step).min() + 1])
                return VerificationFailure(
                    DiscardReason.touches(native), first, EGO, f"steps masked under {native}", float(own.sum()), 0.0
                )
    return None


def check_fairness(
    scene: Scene, judgements: Sequence[SceneAssessment], hyper: HyperParameters
) -> VerificationFailure | None:
    """Why a scene that passed everything else asks too much of its driver (``docs/severity.md``), if it does.

    Either no driver could have avoided it, or the careful and competent human touches something: no planner is to blame
    for what that driver does not avoid. There is one judgement for each adversary.
    """
    if hyper.solvable and is_unsolvable(judgements):
        return VerificationFailure(DiscardReason.UNSOLVABLE)
    contact = judgements[0].drivers["cc"].contact
    if contact is None or not hyper.careful_survives:
        return None
    return VerificationFailure(
        DiscardReason.CAREFUL_COLLIDES, int(np.searchsorted(scene.seconds, contact.time_s)), contact.instance
    )


def _interpolate_annotations(scene: Scene) -> Scene:
    """The scene as a reader of the data set gets it: 2 Hz annotations and straight lines, which cut corners."""
    tracks = interpolate_tracks(scene.agents.ids, scene.agents.categories, scene.annotations, scene.keyframes)
    return replace(scene, agents=tracks)


def find_contacts(
    boxes: Floats, scene: Scene, agent: int, frames: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Step of each contact, ascending, of a track ((F, 5) boxes) with another present agent, and that agent's index."""
    at = frames
    present = scene.agents.valid[:, at].copy()
    present[agent] = False
    center = scene.agents.position[:, at, :2]
    reach = 0.5 * (np.hypot(*scene.agents.size[:, :2].T)[:, None] + np.hypot(boxes[:, 2], boxes[:, 3]))
    near = present & (np.hypot(center[..., 0] - boxes[:, 0], center[..., 1] - boxes[:, 1]) <= reach)
    step, other = np.nonzero(near.T)
    others = np.column_stack([center[other, step], scene.agents.size[other, :2], scene.agents.yaw[other, at[step]]])
    hit = boxes_overlap(boxes[step], others)
    return step[hit], other[hit]


def is_blocking_ego(scene: Scene, boxes: Floats, hyper: HyperParameters) -> bool:
    """Whether the ego would hit the adversary after the last frame although it brakes hard on its heading.

    The recorded ego needs no way out while the recording lasts; this asks for one where it ends. An adversary behind
    the ego is itself the one to brake.
    """
    ego = scene.ego.boxes
    if to_local(boxes[-1, :2], ego[-1, [0, 1, 4]])[0] <= 0.0:
        return False
    seconds = scene.seconds
    span = float(seconds[-1] - seconds[-2])
    velocity = (ego[-1, :2] - ego[-2, :2]) / span
    speed = float(np.hypot(*velocity))
    time = np.arange(0.0, speed / hyper.stopping_m_s2 + 0.1, 0.1)
    braking = np.minimum(time, speed / hyper.stopping_m_s2)
    travelled = speed * braking - 0.5 * hyper.stopping_m_s2 * braking**2
    stopping = np.repeat(ego[-1:], len(time), axis=0)
    stopping[:, :2] += travelled[:, None] * np.array([np.cos(ego[-1, 4]), np.sin(ego[-1, 4])])
    other = np.repeat(boxes[-1:], len(time), axis=0)
    other[:, :2] += time[:, None] * (boxes[-1, :2] - boxes[-2, :2]) / span
    return bool(boxes_overlap(stopping, other).any())


def measure_off_road(scene: Scene, boxes: Floats, hyper: HyperParameters) -> tuple[Bools, Bools]:
    """Whether the centre, and any corner, of (F, 5) boxes is off the road at each frame.

    With ``behaviour`` the way out of a driveway or from a kerb does not count: up to the first frame at which all of
    the body is on the road, if that comes.
    """
    shapely.prepare(scene.road_map.drivable_area)
    center_off = ~scene.road_map.is_drivable(boxes[:, :2])
    corner_off = ~scene.road_map.is_drivable(box_corners(boxes)).all(axis=-1)
    if hyper.behaviour and not corner_off.all():
        first = int(np.argmin(corner_off))
        center_off[:first] = corner_off[:first] = False
    return center_off, corner_off


def _check_road(scene: Scene, start: int, boxes: Floats, hyper: HyperParameters) -> VerificationFailure | None:
    center_off, corner_off = measure_off_road(scene, boxes, hyper)
    for quantity, off, most in (
        ("share of frames with the centre off the road", center_off, hyper.most_off_road_share),
        ("share of frames with a corner off the road", corner_off, hyper.most_corner_off_road_share),
    ):
        if off.mean() > most:
            first = start + int(np.argmax(off))
            return VerificationFailure(
                DiscardReason.LEAVES_ROAD, first, quantity=quantity, value=float(off.mean()), limit=most
            )
    return None
