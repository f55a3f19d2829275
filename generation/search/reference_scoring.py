"""The score of the public reference code, beside the paper's, and its rules before: choice, launch, initial motion.

It looks at all 81 poses of a candidate, weighs the far ones little, squares distances to the ego, inflates the
candidate where boxes are intersected, and gives candidates that would touch the ego the worst challenge of the batch
(`generation.search.differences_from_paper`). Lower is better.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.dynamics.bicycle import VehicleState, compute_rear_axle
from benchmark.geometry import Bools, Floats, axes_overlap, to_local, wrap_angle
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.search.hyperparameters import REFERENCE_POSES, CollisionReading
from generation.search.scoring import (
    ScoreTerms,
    ScoringSurroundings,
    build_columns,
    build_surroundings,
    find_near_pairs,
)

SOON_POSES: Final = 14
"""Poses whose boxes are all intersected and whose road weighs in full: the planning frame, H frames and one more."""
COLLISION_POSES: Final = 13
"""Poses whose collisions weigh in full."""
CHECKED_LATER: Final = (16, 20, 24)
"""Later poses at which boxes are intersected."""
TAIL_WEIGHT: Final = 0.03
CORNER_PENALTY: Final = (0.0, 1.0, 1.1, 1.2, 1.3)
"""By number of corners off the road."""
CORNER_WEIGHT: Final = 0.2
INFLATION: Final = 1.2
EGO_LENGTH_WIDTH_M: Final = (7.0, 3.5)
"""Of the ego that is collided with; its centre is the lidar."""
SPREAD_FLOOR: Final = 1e-7
"""Added to the spread of the challenge before it divides."""
CALM_FRAMES: Final = 36
"""Frames after the launch in which the challenge is always on."""
NEAR_M: Final = 5.0
"""Smoothed distance to the ego below which the challenge is switched off in half of the planning frames."""
KEPT_SHARE: Final = 0.7
"""Of the smoothed distance from one frame to the next."""


@dataclass(frozen=True, slots=True)
class ReferenceTerms(ScoreTerms):
    """The terms of the reference code's score at S poses, the planning frame's among them.

    ``corners_off`` (B, S) counts the four points that pass for corners. ``hits_ego`` (B,) marks an inflated box that
    touches the ego's soon: it gets the worst challenge. ``challenged`` is `is_challenge_on`.
    """

    corners_off: NDArray[np.int64]
    hits_ego: Bools
    challenged: bool

    @classmethod
    def challenges(cls, batches: Sequence[Self]) -> Floats:
        """The challenge mapped to [0, 1] over R batches together, (R, B); zeros where it is switched off.

        Candidates that hit the ego count where the smallest value is looked for, and then get the largest.
        """
        raw, finite, hits = (
            np.stack([getattr(b, name) for b in batches]) for name in ("challenge", "finite", "hits_ego")
        )
        if not batches[0].challenged or not finite.any():
            return np.zeros_like(raw)
        low, high = raw[finite].min(), raw[finite].max()
        return np.where(finite, (np.where(hits, high, raw) - low) / (high - low + SPREAD_FLOOR), 0.0)


def compute_road_weights(poses: int) -> Floats:
    """Weights (S,) of leaving the road: they fall faster where fewer poses are left of the scene."""
    weight = np.linspace(1.0, 0.5, poses) ** 2
    weight[SOON_POSES:] *= TAIL_WEIGHT
    return np.asarray(weight)


def compute_collision_weights(poses: int) -> Floats:
    """Weights (S,) of collisions."""
    weight = np.linspace(1.0, 0.5, REFERENCE_POSES) ** 2
    weight[COLLISION_POSES:] *= TAIL_WEIGHT
    return np.asarray(weight[:poses])


def compute_distance_weights(poses: int) -> Floats:
    """Weights (S,) of the distance to the ego, before squaring."""
    head = np.linspace(0.7, 1.0, COLLISION_POSES)
    tail = np.linspace(0.2, 0.05, REFERENCE_POSES - COLLISION_POSES) ** 2
    return np.asarray(np.concatenate([head, tail])[:poses])


def build_reference_surroundings(
    scene: Scene, agent: int, frames: tuple[int, ...], raster: DrivableRaster
) -> ScoringSurroundings:
    """Everything but one agent as the reference code sees it, the ego 7 m long around its lidar.

    ``ego_center`` is the rear axle. Objects that are absent in a frame are left out. In the reference code they are
    boxes without a size at the ego's lidar, well inside the ego's box: touching one is touching the ego, so that no
    verdict changes. The first of the S frames is the planning frame, of which ``raster`` is.
    """
    around = build_surroundings(scene, agent, frames, raster)
    pose = scene.ego.pose[np.asarray(frames)]
    around.boxes[:, -1] = np.column_stack(
        [compute_lidar_positions(scene)[np.asarray(frames)], np.tile(EGO_LENGTH_WIDTH_M, (len(pose), 1)), pose[:, 2]]
    )
    return ScoringSurroundings(around.boxes, around.present, pose[:, :2], raster)


def compute_lidar_positions(scene: Scene) -> Floats:
    """(T, 2) of the ego's lidar, metres, global."""
    pose = scene.ego.pose
    ahead = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)
    return np.asarray(pose[:, :2] + scene.lidar.translation[0] * ahead)


def compute_reference_terms(
    center: Floats, size: Floats, around: ScoringSurroundings, *, challenged: bool = True
) -> ReferenceTerms:
    """The terms of the reference code's score, of (B, S, 3) box centres from the planning frame on.

    S is 81, or as many as the scene has left, in ``around`` too, the ego last (`build_reference_surroundings`). Poses
    beyond the ends of the raster are read at its border, as the reference code does.
    """
    poses = center.shape[1]
    finite = np.isfinite(center).all(axis=(1, 2))
    safe = np.where(finite[:, None, None], center, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        off = ~is_drivable_at_border(around.raster, safe[..., :2])
        corners = (~is_drivable_at_border(around.raster, compute_corner_points(safe, size))).sum(axis=-1)
        offset = safe[..., :2] - around.ego_center
        distance = np.sqrt(offset[..., 0] ** 2 + offset[..., 1] ** 2)
        challenge = ((distance * compute_distance_weights(poses)) ** 2).sum(axis=1)
    finite &= np.isfinite(challenge)
    contacts = find_reference_collisions(safe, size, around)
    penalty = np.asarray(CORNER_PENALTY)[corners]
    return ReferenceTerms(
        center_off_road=off,
        corner_off_road=corners > 0,
        collision=contacts.collision,
        distance=distance,
        dac=(off + CORNER_WEIGHT * penalty) @ compute_road_weights(poses),
        cr=contacts.collision @ compute_collision_weights(poses),
        challenge=challenge,
        finite=finite,
        corners_off=corners,
        hits_ego=contacts.hits_ego,
        challenged=challenged,
    )


def is_drivable_at_border(raster: DrivableRaster, points: Floats) -> Bools:
    """Whether points (..., 2) are drivable; those outside the raster are read at its border."""
    cos, sin = np.cos(raster.pose[2]), np.sin(raster.pose[2])
    dx, dy = points[..., 0] - raster.pose[0], points[..., 1] - raster.pose[1]
    count = len(raster.cells)
    right, forward = (
        np.clip(np.rint(along / raster.resolution_m + count / 2), 0, count - 1).astype(np.int64)
        for along in (dx * sin - dy * cos, dx * cos + dy * sin)
    )
    return np.asarray(raster.cells[right, forward])


def compute_corner_points(center: Floats, size: Floats) -> Floats:
    """The points (B, S, 4, 2), metres, global, that the reference code takes for the corners of a box.

    Half the width along x times the cosine, half the length along y times the sine of the heading: no rotation. Heading
    along x, all four lie on a line through the middle of the vehicle.
    """
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    half = 0.5 * size[::-1] * np.stack([np.cos(center[..., 2]), np.sin(center[..., 2])], axis=-1)
    return np.asarray(center[..., None, :2] + signs * half[..., None, :])


@dataclass(frozen=True, slots=True)
class ReferenceContacts:
    """Collisions as the reference code counts them.

    ``sure`` (B, S) are nearer than half the short edges; ``collision`` (B, S) those, and those whose inflated box is
    met; ``hits_ego`` (B,) has a box that meets the ego's and no other object's at one of the first 14 poses.
    """

    sure: Bools
    collision: Bools
    hits_ego: Bools
    tests: int


def find_reference_collisions(center: Floats, size: Floats, around: ScoringSurroundings) -> ReferenceContacts:
    """Collisions as the reference code counts them, of (B, S, 3) finite poses; the ego is last in ``around``.

    At every pose: nearer than half the short edges collides. Nearer than half the long edges, at poses 0 to 13, 16, 20
    and 24: the candidate's box, 1.2 times its size, is intersected.
    """
    boxes = np.empty((center.shape[1], center.shape[0], 5))
    boxes[..., [0, 1, 4]] = center.transpose(1, 0, 2)
    boxes[..., 2:4] = size
    own, other = build_columns(boxes, CollisionReading.HALF), build_columns(around.boxes, CollisionReading.HALF)
    poses, count = boxes.shape[:2]
    # Where a square overflows the candidate is nowhere near anything.
    with np.errstate(over="ignore", invalid="ignore"):
        candidate, object_ = find_near_pairs(own, other, around.present)
    first, second = own.reshape(8, -1)[:, candidate], other.reshape(8, -1)[:, object_]
    distance = np.hypot(second[0] - first[0], second[1] - first[1])
    sure = np.zeros(poses * count, dtype=np.bool_)
    sure[candidate[distance < first[6] + second[6]]] = True
    step = candidate // count
    checked = (step < SOON_POSES) | np.isin(step, CHECKED_LATER)
    checked &= ~sure[candidate] & (distance <= first[7] + second[7])
    meets = _do_inflated_meet(first[:, checked], second[:, checked])
    at, objects = candidate[checked][meets], around.boxes.shape[1]
    ego = object_[checked][meets] % objects == objects - 1
    collision, hits_other = sure.copy(), np.zeros_like(sure)
    collision[at], hits_other[at[~ego]] = True, True
    soon = at[ego]
    soon = soon[~hits_other[soon] & (soon // count < SOON_POSES)]
    hits_ego = np.zeros(count, dtype=np.bool_)
    hits_ego[soon % count] = True
    shape = (poses, count)
    return ReferenceContacts(sure.reshape(shape).T, collision.reshape(shape).T, hits_ego, int(checked.sum()))


def _do_inflated_meet(first: Floats, second: Floats) -> Bools:
    """(P,) whether boxes meet, (8, P) columns each, the first of them inflated."""
    first[2:4] *= INFLATION
    cos = first[4] * second[4] + first[5] * second[5]
    sin = first[4] * second[5] - first[5] * second[4]
    return axes_overlap(second[0] - first[0], second[1] - first[1], first[2:6], second[2:6], cos, sin)


def is_challenge_on(distance_m: Floats, launch: int, frame: int, rng: np.random.Generator) -> bool:
    """Whether the challenge counts at a planning frame: off in half of those, after 3 s, at which it is near.

    ``distance_m`` (T,) is from the adversary's centre to the ego's rear axle, from the frame before the launch to the
    one before this at least. The reference draws from a stream that other draws shift; here the search's own generator
    is asked once in any case, so that chance does not hang on distances.
    """
    drawn = rng.random()
    smoothed = 0.0
    for before in distance_m[: frame - launch + 1]:
        smoothed = KEPT_SHARE * smoothed + (1.0 - KEPT_SHARE) * float(before)
    return not (frame > launch + CALM_FRAMES and smoothed < NEAR_M and drawn < 0.5)


CAR: Final = "vehicle.car"
CHOSEN_WITHIN_M: Final = 20.0
LEAST_DRIVABLE_SHARE: Final = 0.7
LAUNCH_WITHIN_M: Final = 25.0
PRESENT_FRAMES: Final = 4
"""Frames in a row, up to the one before, in which a vehicle must have been there to be launched."""
LAST_LAUNCH: Final = 140
HISTORY_FRAMES: Final = 16
FIRST_LAUNCH: Final = 20
"""Frames are waited for before anything is planned: the model is told of 16 frames."""
AREA_M: Final = 50.0
"""Half the side of the area around the lidar in which a vehicle counts as near."""
STEP_FRAMES: Final = 4
"""Frames that the model takes for half a second."""
SPEED_FRAMES: Final = 2
"""Frames over which the speed is taken."""


def compute_lidar_distance(scene: Scene, agent: int) -> Floats:
    """Distance (T,) from the ego's lidar to an agent's box centre, metres."""
    return np.asarray(np.linalg.norm(scene.agents.position[agent, :, :2] - compute_lidar_positions(scene), axis=-1))


def is_in_reference_canvas(scene: Scene, agent: int) -> Bools:
    """(T,) whether an agent is there and in the square around the ego's lidar."""
    pose = np.column_stack([compute_lidar_positions(scene), scene.ego.pose[:, 2]])
    local = to_local(scene.agents.position[agent, :, :2], pose)
    return np.asarray((np.abs(local) <= AREA_M).all(axis=-1) & scene.agents.valid[agent])


def is_near_and_on_road(scene: Scene, agent: int) -> tuple[bool, bool]:
    """Whether the reference code would edit a vehicle: within 20 m of the lidar at some time, and on the road then."""
    canvas = is_in_reference_canvas(scene, agent)
    if not canvas.any():
        return False, False
    shapely.prepare(scene.road_map.drivable_area)
    on_road = scene.road_map.is_drivable(scene.agents.position[agent, canvas, :2]).mean() >= LEAST_DRIVABLE_SHARE
    return bool(compute_lidar_distance(scene, agent)[canvas].min() <= CHOSEN_WITHIN_M), bool(on_road)


def find_reference_launch(scene: Scene, agent: int) -> int | None:
    """First frame, from 20 to 140, at which the reference code takes a vehicle over, or ``None``.

    ``None`` too where the history is missing, which that code does not ask: it goes on with positions of nothing.
    """
    valid = scene.agents.valid[agent]
    near = valid & (compute_lidar_distance(scene, agent) < LAUNCH_WITHIN_M)
    for frame in np.flatnonzero(near[: LAST_LAUNCH + 1]):
        if frame >= PRESENT_FRAMES and valid[frame - PRESENT_FRAMES : frame].all():
            start = max(int(frame), FIRST_LAUNCH)
            is_present = start < len(valid) - 1 and bool(valid[start - HISTORY_FRAMES : start + 1].all())
            return start if is_present else None
    return None


def compute_reference_state(before: Floats, now: Floats, length_m: float) -> VehicleState:
    """Motion that the reference code plans from: its speed has lost its sign, everything else is zero.

    (3,) poses of the box centre two frames ago and now; the speed, at the rear axle, is in metres a frame.
    """
    speed = float(np.hypot(*(now[:2] - before[:2]))) / SPEED_FRAMES
    return VehicleState(compute_rear_axle(now, length_m), speed)


def compute_reference_previous(before: Floats, now: Floats) -> Floats:
    """Pose (3,) that the reference code tells the model: the centre four frames ago in the frame of the centre now."""
    return np.concatenate([to_local(before[:2], now), wrap_angle(before[2:] - now[2])])
