"""Trajectory scorer: drivable area compliance, collisions, adversarial challenge; lower is better.

Paper section 3 "Trajectory Scorer" and appendix "Trajectory Scoring". Vectorised over candidates, frames and objects.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.hyperparameters import HyperParameters

ROUNDING_M2 = 1e-6
"""Slack of the broad phase, far above rounding: boxes that touch corner to corner must reach the exact test."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a candidate can hit, leave and approach; S scored frames, M objects.

    Attributes:
        boxes: (S, M, 5) boxes of everything but the candidate; the ego's body is among them.
        present: (S, M) whether the object is there.
        ego_center: (S, 2) centre of the ego's body.
        raster: Drivable area around the ego at the planning frame.
    """

    boxes: Floats
    present: Bools
    ego_center: Floats
    raster: DrivableRaster


@dataclass(frozen=True, slots=True)
class Terms:
    """The three terms of B candidates before weighting.

    Attributes:
        center_off_road: (B, S) centre off the drivable area.
        corner_off_road: (B, S) any corner off the drivable area.
        collision: (B, S) contact with any object.
        distance: (B, S) centre to centre distance to the ego.
        dac: (B,) drivable area compliance score.
        cr: (B,) collision score.
        challenge: (B,) ACScore' of the appendix, not yet normalised.
        finite: (B,) False for candidates that must never be chosen.
    """

    center_off_road: Bools
    corner_off_road: Bools
    collision: Bools
    distance: Floats
    dac: Floats
    cr: Floats
    challenge: Floats
    finite: Bools


def surroundings(scene: Scene, agent: int, frames: tuple[int, ...], raster: DrivableRaster) -> Surroundings:
    """Everything but one agent at some frames; the ego comes last.

    Args:
        scene: The scene.
        agent: Index of the agent that is being planned.
        frames: S frame indices.
        raster: Drivable area around the ego at the planning frame.

    Returns:
        The surroundings, without objects that are absent throughout.
    """
    at = np.asarray(frames)
    others = scene.agents.valid[:, at].any(axis=1)
    others[agent] = False
    rows = np.flatnonzero(others)
    ego = scene.ego.boxes[at]
    boxes = np.concatenate([_boxes_at(scene, rows, at), ego[:, None]], axis=1)
    present = np.concatenate([scene.agents.valid[np.ix_(rows, at)].T, np.ones((len(at), 1), dtype=np.bool_)], axis=1)
    return Surroundings(boxes, present, ego[:, :2], raster)


def _boxes_at(scene: Scene, rows: NDArray[np.int64], at: NDArray[np.int64]) -> Floats:
    """(S, M, 5) boxes of some agents at some frames."""
    agents = scene.agents
    grid = np.ix_(rows, at)
    size = np.broadcast_to(agents.size[rows, None, :2], (len(rows), len(at), 2))
    boxes = np.concatenate([agents.position[grid][..., :2], size, agents.yaw[grid][..., None]], axis=-1)
    return np.ascontiguousarray(boxes.transpose(1, 0, 2))


def score_terms(
    center: Floats, size: Floats, around: Surroundings, hyper: HyperParameters, *, speed: Floats | None = None
) -> Terms:
    """The three terms (appendix: DACScore, CRScore, ACScore').

    Args:
        center: (B, S, 3) poses of the candidates' box centres at ``hyper.scored_frames``, or at fewer of them where
            the scene ends.
        size: (2,) length and width of the vehicle.
        around: Surroundings at the same S frames.
        hyper: Weights.
        speed: (B, S) of the candidates, metres per second; needed for a headway.

    Returns:
        The terms.
    """
    finite = np.isfinite(center).all(axis=(1, 2))
    safe = np.where(finite[:, None, None], center, 0.0)
    boxes = np.concatenate([safe[..., :2], np.broadcast_to(size, (*safe.shape[:2], 2)), safe[..., 2:]], axis=-1)
    count = center.shape[1]
    step_weight = hyper.safety_step_weights()[:count]
    center_off = ~around.raster.look_up(boxes[..., :2])
    corner_off = ~around.raster.look_up(box_corners(boxes)).all(axis=-1)
    grown = boxes.copy()
    grown[..., 2:4] += 2.0 * hyper.clearance_m
    if speed is not None and hyper.headway_s > 0.0:
        grown[..., 2] += 2.0 * hyper.headway_s * np.where(finite[:, None], speed, 0.0)
    collision = collisions(grown, around)
    distance = np.linalg.norm(boxes[..., :2] - around.ego_center[None], axis=-1)
    return Terms(
        center_off_road=center_off,
        corner_off_road=corner_off,
        collision=collision,
        distance=distance,
        dac=((center_off + hyper.corner_weight * corner_off) * step_weight).sum(axis=1),
        cr=(collision * step_weight).sum(axis=1),
        challenge=(distance * hyper.challenge_step_weights()[:count]).sum(axis=1),
        finite=finite,
    )


def collisions(boxes: Floats, around: Surroundings) -> Bools:
    """Whether candidates touch any present object ("geometry" reading: contact means intersecting boxes).

    The broad phase rejects pairs whose circumscribed circles are apart, so it never changes the answer.

    Args:
        boxes: (B, S, 5) boxes of the candidates.
        around: Objects at the same S frames.

    Returns:
        (B, S) verdicts.
    """
    reach = 0.5 * np.hypot(boxes[..., 2], boxes[..., 3])
    other_reach = 0.5 * np.hypot(around.boxes[..., 2], around.boxes[..., 3])
    hit = np.zeros(boxes.shape[:2], dtype=np.bool_)
    for step in range(boxes.shape[1]):
        low = (boxes[:, step, :2] - reach[:, step, None]).min(axis=0)
        high = (boxes[:, step, :2] + reach[:, step, None]).max(axis=0)
        others = around.boxes[step]
        slack = other_reach[step, :, None]
        near = around.present[step] & ((others[:, :2] + slack >= low) & (others[:, :2] - slack <= high)).all(axis=1)
        others, slack = others[near], slack[near]
        offset = boxes[:, step, None, :2] - others[None, :, :2]
        limit = reach[:, step, None] + slack[None, :, 0]
        first, second = np.nonzero((offset**2).sum(axis=-1) <= limit**2 + ROUNDING_M2)
        contact = boxes_overlap(boxes[first, step], others[second])
        hit[first[contact], step] = True
    return hit


def normalised(challenge: Floats, finite: Bools) -> Floats:
    """ACScore of the appendix: ACScore' mapped to [0, 1] over the batch.

    Args:
        challenge: (B,) raw scores.
        finite: (B,) which take part.

    Returns:
        (B,) zeros where all are equal.
    """
    if not finite.any():
        return np.zeros_like(challenge)
    low, high = challenge[finite].min(), challenge[finite].max()
    return np.where(finite, (challenge - low) / (high - low), 0.0) if high > low else np.zeros_like(challenge)


def final_scores(terms: Terms, start: Floats, hyper: HyperParameters) -> Floats:
    """FinalScore of the appendix.

    Args:
        terms: Of the batch.
        start: (B,) random initial scores.
        hyper: Weights.

    Returns:
        (B,) scores, lower is better; infinity for candidates that must never be chosen.
    """
    challenge = normalised(terms.challenge, terms.finite)
    score = start + hyper.dac_weight * terms.dac + hyper.cr_weight * terms.cr + hyper.ac_weight * challenge
    return np.where(terms.finite, score, np.inf)
