"""Who sees whom: a free line from the ego's centre to the centre or a corner of an agent.

``docs/severity.md``, "What a driver sees".
"""

from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap, directions_of
from benchmark.interactions.tracks import Integers, Tracks

SIGHT_M: Final = 80.0
HIDING_M: Final = 90.0
"""Vehicles further from the eye hide no other."""


def visible(eyes: Floats, agents: Integers, boxes: Floats, present: Bools, hides: Bools) -> Bools:
    """(Q,) whether agents are seen from (Q, 2) places, among all (N, 5) boxes that are there at that time.

    ``hides`` says which of them can hide a car.
    """
    seen = np.zeros(len(agents), np.bool_)
    blockers = np.flatnonzero(present & hides)
    target = boxes[agents]
    near = np.hypot(*(target[:, :2] - eyes).T) <= SIGHT_M
    rows = np.flatnonzero(near)
    if not len(rows):
        return seen
    points = np.concatenate([target[rows, None, :2], box_corners(target[rows])], axis=1)
    lines = _lines(eyes[rows, None], points)
    block = boxes[blockers]
    offset = block[None, :, :2] - eyes[rows, None]
    eye_boxes = np.concatenate([eyes[rows], np.zeros((len(rows), 3))], axis=1)
    counts = (np.hypot(offset[..., 0], offset[..., 1]) <= HIDING_M) & (blockers[None] != agents[rows, None])
    counts &= ~boxes_overlap(eye_boxes[:, None], block[None])
    query, blocker = np.nonzero(counts)
    hidden = np.zeros(points.shape[:2], np.bool_)
    met = boxes_overlap(lines[query], block[blocker, None])
    np.logical_or.at(hidden, query, met)
    seen[rows] = ~hidden.all(axis=1)
    return seen


def first_visible(tracks: Tracks, agent: int, times: Floats) -> float | None:
    """First of the rising instants asked at which the recorded ego sees an agent, or ``None``."""
    boxes, present = tracks.agents_at(times)
    eyes, hides = tracks.ego_at(times)[:, :2], tracks.hides
    for instant in np.flatnonzero(present[agent]).tolist():
        found = visible(eyes[instant, None], np.array([agent]), boxes[:, instant], present[:, instant], hides)
        if found[0]:
            return float(times[instant])
    return None


def _lines(first: Floats, second: Floats) -> Floats:
    """Segments between points as boxes without width."""
    step = second - first
    zero = np.zeros(step.shape[:-1])
    length, heading = np.hypot(step[..., 0], step[..., 1]), directions_of(step)
    return np.concatenate([first + 0.5 * step, np.stack([length, zero, heading], axis=-1)], axis=-1)
