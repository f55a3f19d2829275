"""Trajectory scorer: drivable area compliance, collisions, adversarial challenge; lower is better.

Paper section 3 "Trajectory Scorer" and appendix "Trajectory Scoring".
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, axes_overlap, box_corners
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.search.hyperparameters import CollisionReading, HyperParameters
from generation.search.verify import compute_raster_footprints

ROUNDING_M2, UNDERSTATED = 1e-6, 1.0 - 1e-12
"""Slack of the broad phase, far above rounding: boxes that touch corner to corner must reach the exact test."""


@dataclass(frozen=True, slots=True)
class ScoringSurroundings:
    """Objects and road that a candidate can hit, leave and approach; S scored frames, M objects.

    ``boxes`` (S, M, 5) are of everything but the candidate; the ego's body is among them, with raster footprints of it
    if asked for. ``ego_center`` is (S, 2); ``raster`` is around the ego at the planning frame.
    """

    boxes: Floats
    present: Bools
    ego_center: Floats
    raster: DrivableRaster


@dataclass(frozen=True, slots=True)
class ScoreTerms:
    """The three terms of B candidates at S frames before weighting.

    ``distance`` is centre to centre to the ego, metres; ``dac`` and ``cr`` are the (B,) scores of drivable area and
    collision. ``challenge`` (ACScore' of the appendix) and ``asked`` (metres missing to the requested manoeuvre,
    `generation.search.manoeuvre_conditions`) are not yet normalised. Candidates that are not ``finite`` must never be
    chosen; ``further`` is the weighted sum of `generation.search.threat`, ``None`` where none has a weight.
    """

    center_off_road: Bools
    corner_off_road: Bools
    collision: Bools
    distance: Floats
    dac: Floats
    cr: Floats
    challenge: Floats
    finite: Bools
    asked: Floats | None = field(default=None, kw_only=True)
    further: Floats | None = field(default=None, kw_only=True)

    def compute_safety(self, start: Floats, hyper: HyperParameters) -> Floats:
        """(B,) all of a score but the challenge, from (B,) random initial scores on."""
        score = start + hyper.dac_weight * self.dac + hyper.cr_weight * self.cr
        return np.asarray(score if self.further is None else score + self.further)

    @classmethod
    def challenges(cls, batches: "Sequence[Self]") -> Floats:
        """ACScore of the appendix, normalised over R batches together, (R, B)."""
        return normalise_challenge(
            np.stack([batch.challenge for batch in batches]), np.stack([batch.finite for batch in batches])
        )

    @classmethod
    def requests(cls, batches: "Sequence[Self]") -> Floats:
        """Distance to the manoeuvre that was asked for, normalised in the same way, (R, B); zeros where nothing was."""
        distances = [np.zeros_like(batch.challenge) if batch.asked is None else batch.asked for batch in batches]
        return normalise_challenge(np.stack(distances), np.stack([batch.finite for batch in batches]))


def build_surroundings(
    scene: Scene, agent: int, frames: tuple[int, ...], raster: DrivableRaster, *, raster_ego: bool = False
) -> ScoringSurroundings:
    """Everything but one agent at some frames, without objects that are absent throughout; the ego comes last.

    With ``raster_ego`` the ego is there as the rasters of protocols show it, too (`HyperParameters.raster_ego`).
    """
    at = np.asarray(frames)
    is_present = scene.agents.valid[:, at].any(axis=1)
    is_present[agent] = False
    rows = np.flatnonzero(is_present)
    ego = scene.ego.boxes[at]
    egos = [*([compute_raster_footprints(scene, at)] if raster_ego else []), ego[:, None]]
    boxes = np.concatenate([_select_boxes(scene, rows, at), *egos], axis=1)
    present = np.ones(boxes.shape[:2], dtype=np.bool_)
    present[:, : len(rows)] = scene.agents.valid[np.ix_(rows, at)].T
    return ScoringSurroundings(boxes, present, ego[:, :2], raster)


def _select_boxes(scene: Scene, rows: NDArray[np.int64], at: NDArray[np.int64]) -> Floats:
    agents = scene.agents
    grid = np.ix_(rows, at)
    size = np.broadcast_to(agents.size[rows, None, :2], (len(rows), len(at), 2))
    boxes = np.concatenate([agents.position[grid][..., :2], size, agents.yaw[grid][..., None]], axis=-1)
    return np.ascontiguousarray(boxes.transpose(1, 0, 2))


def compute_score_terms(
    center: Floats, size: Floats, around: ScoringSurroundings, hyper: HyperParameters, *, speed: Floats | None = None
) -> ScoreTerms:
    """The three terms (appendix: DACScore, CRScore, ACScore') of (B, S, 3) poses of box centres.

    S are ``hyper.scored_frames``, or fewer where the scene ends; (B, S) ``speed`` in m/s is needed for a headway.
    """
    finite = np.isfinite(center).all(axis=(1, 2))
    if speed is not None:
        finite &= np.isfinite(speed).all(axis=1)
    boxes = _arrange_by_step(center, size, finite)
    count = center.shape[1]
    safety_weight = hyper.safety_step_weights()[:count]
    center_off = ~around.raster.look_up(boxes[..., :2])
    corner_off = _is_any_corner_off(boxes, around.raster)
    # Overflows are marked as not finite, because they would spoil the normalisation of the whole batch.
    with np.errstate(over="ignore"):
        offset = boxes[..., :2] - around.ego_center[:, None]
        distance = np.sqrt(offset[..., 0] ** 2 + offset[..., 1] ** 2)
        challenge = hyper.challenge_step_weights()[:count] @ distance
    finite &= np.isfinite(challenge)
    boxes[..., 2:4] += 2.0 * hyper.clearance_m
    if speed is not None and hyper.headway_s > 0.0:
        boxes[..., 2] += 2.0 * hyper.headway_s * np.where(finite, speed.T, 0.0)
    collision = find_collisions(boxes.transpose(1, 0, 2), around, hyper.collision_reading)
    return ScoreTerms(
        center_off_road=center_off.T,
        corner_off_road=corner_off.T,
        collision=collision,
        distance=distance.T,
        dac=safety_weight @ (center_off + hyper.corner_weight * corner_off),
        cr=collision @ safety_weight,
        challenge=challenge,
        finite=finite,
    )


def _arrange_by_step(center: Floats, size: Floats, finite: Bools) -> Floats:
    """(S, B, 5) boxes, one contiguous row of B numbers for each quantity; zeros stand in for what is not finite."""
    candidates, steps = center.shape[:2]
    rows = np.empty((5, steps, candidates))
    rows[[0, 1, 4]] = center.transpose(2, 1, 0)
    rows[2:4] = size[:, None, None]
    rows[:, :, ~finite] = 0.0
    return rows.transpose(1, 2, 0)


def _is_any_corner_off(boxes: Floats, raster: DrivableRaster) -> Bools:
    on_road = raster.look_up(box_corners(boxes))
    return np.asarray(~on_road.all(axis=-1))


def find_collisions(
    boxes: Floats, around: ScoringSurroundings, reading: CollisionReading = CollisionReading.GEOMETRY
) -> Bools:
    """(B, S) whether (B, S, 5) boxes collide with any present object (appendix, CollisionScore; see `build_columns`).

    With ``GEOMETRY`` this is contact: the broad phase rejects pairs whose circumscribed circles are apart, which never
    changes the answer. Clearance or headway that boxes were grown by counts in all three steps: a grown vehicle has
    grown edges, too.
    """
    own = build_columns(boxes.transpose(1, 0, 2), reading)
    other = build_columns(around.boxes, reading)
    hit = np.zeros(own.shape[1:], dtype=np.bool_)
    # Where a square overflows the candidate is nowhere near anything.
    with np.errstate(over="ignore", invalid="ignore"):
        candidate, object_ = find_near_pairs(own, other, around.present)
        rows = 6 if reading is CollisionReading.GEOMETRY else 8
        # "clip" only spares the test of every index.
        first = np.take(own[:rows].reshape(rows, -1), candidate, axis=1, mode="clip")
        second = np.take(other[:rows].reshape(rows, -1), object_, axis=1, mode="clip")
        dx, dy = second[0] - first[0], second[1] - first[1]
        cos = first[4] * second[4] + first[5] * second[5]
        sin = first[4] * second[5] - first[5] * second[4]
        contact = axes_overlap(dx, dy, first[2:6], second[2:6], cos, sin)
        if rows == 8:
            distance = np.hypot(dx, dy)
            contact &= distance <= first[7] + second[7]
            contact |= distance < first[6] + second[6]
    hit.ravel()[candidate[contact]] = True
    return hit.T


def build_columns(boxes: Floats, reading: CollisionReading) -> Floats:
    """Columns for collisions of (S, N, 5) boxes, (8, S, N): x, y, half sizes, cosine and sine, inner and outer bound.

    The bounds of two boxes add up. Nearer than the inner one is a collision, farther than the outer one is none, and
    boxes decide in between. `GEOMETRY` has the circles inside and around a box, which agree with the boxes.
    """
    length, width = boxes[..., 2], boxes[..., 3]
    short, long = np.minimum(length, width), np.maximum(length, width)
    columns = np.empty((8, *boxes.shape[:2]))
    columns[0], columns[1], columns[2], columns[3] = boxes[..., 0], boxes[..., 1], 0.5 * length, 0.5 * width
    np.cos(boxes[..., 4], out=columns[4])
    np.sin(boxes[..., 4], out=columns[5])
    match reading:
        case CollisionReading.LITERAL:
            columns[6], columns[7] = short, long
        case CollisionReading.HALF:
            columns[6], columns[7] = 0.5 * short, 0.5 * long
        case CollisionReading.GEOMETRY:
            columns[6], columns[7] = 0.5 * short, 0.5 * np.sqrt(length**2 + width**2)
    return columns


def find_near_pairs(own: Floats, other: Floats, present: Bools) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs (P,) of candidate and object, counted over steps and boxes, that are not farther than the outer bound.

    Squared distances minus squared bounds are one matrix product a step; understated a little, which only adds pairs.
    """
    (x, y, reach), (other_x, other_y, other_reach) = own[[0, 1, 7]], other[[0, 1, 7]]
    near = present.copy()
    for at, other_at in ((x, other_x), (y, other_y)):
        near &= other_at + other_reach >= np.fmin.reduce(at - reach, axis=1, keepdims=True, initial=np.inf)
        near &= other_at - other_reach <= np.fmax.reduce(at + reach, axis=1, keepdims=True, initial=-np.inf)
    kept = np.flatnonzero(near.any(axis=0))
    if not len(kept):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    near = near[:, kept]
    other_x, other_y, other_reach = (np.where(near, row[:, kept], 0.0) for row in (other_x, other_y, other_reach))
    middle_x, middle_y = other_x.sum() / near.sum(), other_y.sum() / near.sum()
    x, y, other_x, other_y = x - middle_x, y - middle_y, other_x - middle_x, other_y - middle_y
    squared = (x**2 + y**2) * UNDERSTATED - reach**2
    other_squared = (other_x**2 + other_y**2) * UNDERSTATED - other_reach**2 - ROUNDING_M2
    mine = np.stack([squared, -2.0 * x, -2.0 * y, -2.0 * reach, np.ones_like(x)], axis=1)
    theirs = np.stack(
        [np.ones_like(other_x), other_x, other_y, other_reach, np.where(near, other_squared, np.inf)], axis=2
    )
    pairs = np.flatnonzero(theirs @ mine <= 0.0)
    at_object, candidate = np.divmod(pairs, x.shape[1])
    step, object_ = np.divmod(at_object, len(kept))
    return step * x.shape[1] + candidate, step * present.shape[1] + kept[object_]


def normalise_challenge(challenge: Floats, finite: Bools) -> Floats:
    """ACScore of the appendix: (B,) ACScore' mapped to [0, 1] over the finite candidates, zeros where all are equal."""
    if not finite.any():
        return np.zeros_like(challenge)
    low, high = challenge[finite].min(), challenge[finite].max()
    return np.where(finite, (challenge - low) / (high - low), 0.0) if high > low else np.zeros_like(challenge)


def compute_final_scores(terms: ScoreTerms, start: Floats, hyper: HyperParameters) -> Floats:
    """FinalScore of the appendix: (B,), lower is better, infinity for candidates that must never be chosen."""
    (challenge,) = terms.challenges([terms])
    # The requested manoeuvre replaces the challenge until it is done.
    wanted = hyper.ac_weight * challenge
    if terms.asked is not None:
        wanted = hyper.manoeuvre_weight * terms.requests([terms])[0]
    score = terms.compute_safety(start, hyper) + wanted
    return np.where(terms.finite, score, np.inf)
