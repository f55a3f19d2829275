"""How much a track presses the ego: the share of an ego's inexact plans that would touch it within 1, 2 and 3 s."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, PLAN_ERROR_M, PLAN_STEP_S
from benchmark.geometry import Bools, Floats, boxes_overlap, to_local
from benchmark.scene import Scene
from generation.search.recorded_ego_path import get_ego_path

INSTANTS: Final = 3 * np.arange(1, 13)
"""Frames after a key frame, every quarter of a second of a plan."""
HORIZONS_S: Final = (1.0, 2.0, 3.0)
LEAST_PRESSURE: Final = 0.001
MOST_PRESSURE: Final = 0.1
LEVEL: Final = 1.1
"""Shares of an ego's plans that an edit should touch, at least, and enough; so many times more is worth a larger edit.
"""
_QUARTERS: Final = np.pi / 2 * np.arange(4)
ERRORS: Final = np.concatenate(
    [
        0.76 * np.column_stack([np.cos(_QUARTERS + np.pi / 4), np.sin(_QUARTERS + np.pi / 4)]),
        1.67 * np.column_stack([np.cos(_QUARTERS), np.sin(_QUARTERS)]),
    ]
)
"""(8, 2) errors along and across, in standard deviations: the quartiles of their size, in four directions each."""
LEAST_SPEED_M_S: Final = 1.0
NEAR_M: Final = 8.0
"""A track whose centre never comes so near a moving ego's presses nobody."""


@dataclass(frozen=True, slots=True)
class EgoPlans:
    """Plans of an ego: (K, P, I, 5) boxes of P plans from each of K key frames at (K, I) frames.

    One keeps its speed along its path; the others drive as recorded, but off by an error that grows with time.
    ``moving`` (F,) are the frames at which the ego moves.
    """

    boxes: Floats
    frames: NDArray[np.int64]
    counts: Bools
    ego: Floats
    moving: Bools

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Those of a recorded ego."""
        way = get_ego_path(scene)
        last = len(way.station) - 1
        start = scene.keyframes[:, None]
        at = start + INSTANTS
        counts = (at <= last) & (way.speed[start] >= LEAST_SPEED_M_S)
        frames = np.minimum(at, last)
        seconds = INSTANTS * PLAN_STEP_S / 6
        grown = (seconds / HORIZONS_S[-1]) ** 1.5 * np.minimum(1.0, 0.2 + way.speed[start] / 6.0)
        along, across = (
            metres * errors[:, None] * grown[:, None] for metres, errors in zip(PLAN_ERROR_M, ERRORS.T, strict=True)
        )
        kept_speed = way.station[start] + way.speed[start] * seconds
        stations = np.concatenate([kept_speed[:, None], way.station[frames][:, None] + along], axis=1)
        aside = np.concatenate([np.zeros_like(kept_speed)[:, None], across], axis=1)
        points = np.stack([np.interp(stations, way.stations, way.points[:, axis]) for axis in range(2)], axis=-1)
        yaw = np.interp(stations, way.stations, np.unwrap(way.headings))
        points += aside[..., None] * np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
        size = np.broadcast_to([way.length_m, way.width_m], points.shape)
        boxes = np.concatenate([points, size, yaw[..., None]], axis=-1)
        return cls(boxes, frames, counts, scene.ego.boxes, way.speed >= LEAST_SPEED_M_S)

    def are_near(self, poses: Floats, start: int) -> Bools:
        """(B,) whether (B, F, 3) tracks from a frame on come near the ego while it moves."""
        away = poses[..., :2] - self.ego[start:, :2]
        near = (away[..., 0] ** 2 + away[..., 1] ** 2 <= NEAR_M**2) & self.moving[start:]
        return np.asarray(near.any(axis=1))

    def measure_pressure(self, boxes: Floats, start: int) -> Floats:
        """(B,) share of all plans that touch (B, F, 5) tracks from a frame on, mean over the horizons; 0 to 1."""
        counts = self.counts & (self.frames >= start)
        sample, instant = np.nonzero(counts)
        at = self.frames[sample, instant] - start
        soon = (INSTANTS[:, None] <= np.array(HORIZONS_S) * FRAME_HZ).mean(axis=1)
        touched = np.zeros((len(boxes), *self.boxes.shape[:2]))
        plans = self.boxes[sample, :, instant]
        size = 0.5 * (np.hypot(*plans[0, 0, 2:4]) + np.hypot(*boxes[0, 0, 2:4])) if len(sample) else 0.0
        for plan in range(self.boxes.shape[1]):
            away = boxes[:, at, :2] - plans[:, plan, :2]
            row, column = np.nonzero(away[..., 0] ** 2 + away[..., 1] ** 2 <= size**2)
            hit = boxes_overlap(boxes[row, at[column]], plans[column, plan])
            # Who is run into from behind did not run into anybody.
            ahead = to_local(boxes[row, at[column], :2], plans[column, plan][:, [0, 1, 4]])[..., 0]
            hit &= ahead > -0.5 * plans[column, plan, 2]
            column = column[hit]
            np.maximum.at(touched[:, :, plan], (row[hit], sample[column]), soon[instant[column]])
        return np.asarray(touched.mean(axis=(1, 2)))


def count_levels(pressure: float) -> int:
    """How many levels a pressure has climbed, each so many times the one before; 0 where it is too low."""
    if pressure < LEAST_PRESSURE:
        return 0
    return 1 + int(np.log(min(pressure, MOST_PRESSURE) / LEAST_PRESSURE) / np.log(LEVEL))
