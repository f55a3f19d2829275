"""Edits that let the ego come up to a vehicle: speed laws that keep a gap in front of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import REAR_AXLE_BEHIND_CENTER
from benchmark.geometry import Floats, wrap_angle
from generation.extensions.effect.edits import LAG_SHARE, MOST_FASTER_M_S2, MOST_SLOWER_M_S2, compute_bend_speeds
from generation.extensions.effect.paths import SPACING_M, VehiclePath

GAPS_M: Final = (1.1, 1.6, 2.4)
"""Between the bodies; nearer than 1 m for long is a fault of behaviour."""
CLOSER_SHARE: Final = 0.5
CLOSER_S, CHANGING_S = 1.8, 0.6
TIMES_CLOSER: Final = (0, 1, 2, 3, 4)
"""Share of the gap that is left for so long, how fast that changes, and how often, evenly over the remaining time."""
LEAVING_S, LEAVING_M = 2.5, 3.0
"""Before the end it leaves the ego behind, so far."""
ON_M: Final = 1.6
ON_RAD: Final = np.deg2rad(45.0)
LEAST_ON_S: Final = 2.0
"""An ego drives a path where its centre is so near and its heading so alike, for so long at least."""
BY_DISTANCE: Final = 1.2
BY_SPEED: Final = 1.6
"""1/s^2 and 1/s, of the acceleration that closes a gap."""
SETTLING_M_S2: Final = 1.0
"""With which a difference of speeds ends where the gap is reached."""
FASTER: Final = 1.2
"""Times the ego's highest speed, at most."""


@dataclass(frozen=True, slots=True)
class LeadLaw:
    """A gap of ``gap_m`` in front of the ego that is smaller for a moment so many ``times``."""

    gap_m: float
    times: int


@dataclass(frozen=True, slots=True)
class LedEgo:
    """An ego on a path: (F,) metres of its centre along it, its length, and its highest speed, m/s."""

    station: Floats
    length_m: float
    fastest: float


LEAD_LAWS: Final = tuple(LeadLaw(gap, times) for gap in GAPS_M for times in TIMES_CLOSER)


def find_led_ego(path: VehiclePath, boxes: Floats) -> LedEgo | None:
    """The ego of (F, 5) boxes on a path; ``None`` where it hardly drives on it."""
    away = np.hypot(*np.moveaxis(boxes[:, None, :2] - path.points, -1, 0))
    nearest = away.argmin(axis=1)
    turn = np.abs(wrap_angle(path.headings[nearest] - boxes[:, 4]))
    on = (away.min(axis=1) <= ON_M) & (nearest > 0) & (nearest < len(path.points) - 1) & (turn <= ON_RAD)
    if on.sum() < LEAST_ON_S * FRAME_HZ:
        return None
    heading = path.headings[nearest]
    ahead = np.column_stack([np.cos(heading), np.sin(heading)])
    station = SPACING_M * nearest + ((boxes[:, :2] - path.points[nearest]) * ahead).sum(axis=1)
    moved = np.hypot(*np.diff(boxes[:, :2], axis=0, prepend=boxes[:1, :2]).T)
    way, frames = np.cumsum(moved), np.flatnonzero(on)
    first, last = frames[0], frames[-1]
    known = np.interp(np.arange(len(boxes)), frames, station[on])
    known[:first] = station[first] - (way[first] - way[:first])
    known[last:] = station[last] + (way[last:] - way[last])
    return LedEgo(np.maximum.accumulate(known), float(boxes[0, 2]), FRAME_HZ * float(moved.max()))


def compute_leading_stations(
    paths: Sequence[VehiclePath], egos: Sequence[LedEgo], laws: Sequence[LeadLaw], start_speed: float, length_m: float
) -> Floats:
    """(B, F) metres along B paths of rear axles that keep gaps to an ego, within +2 and -4 m/s^2, slower in bends.

    The ego of each path is in ``egos``; ``length_m`` is the vehicle's, ``start_speed`` its speed, m/s.
    """
    station = np.stack([ego.station for ego in egos])
    frames, step = station.shape[1], 1.0 / FRAME_HZ
    bodies = np.array([0.5 * (ego.length_m + length_m) for ego in egos]) - REAR_AXLE_BEHIND_CENTER * length_m
    target = station + bodies[:, None] + np.stack([_compute_gaps(law, frames) for law in laws])
    led = np.gradient(target, step, axis=1) if frames > 1 else np.zeros_like(target)
    felt = np.gradient(led, step, axis=1) if frames > 1 else np.zeros_like(target)
    most = np.array([max(FASTER * ego.fastest, start_speed) for ego in egos])
    bends, rows = compute_bend_speeds(paths), np.arange(len(paths))
    speed, acceleration, driven = np.full(len(laws), start_speed), np.zeros(len(laws)), np.zeros(target.shape)
    for frame in range(1, frames):
        at = np.minimum((driven[:, frame - 1] / SPACING_M).astype(np.int64), bends.shape[1] - 1)
        left = target[:, frame - 1] - driven[:, frame - 1]
        closing = np.minimum(BY_DISTANCE * np.abs(left) / BY_SPEED, np.sqrt(2.0 * SETTLING_M_S2 * np.abs(left)))
        wanted = np.clip(led[:, frame] + np.sign(left) * closing, 0.0, np.minimum(most, bends[rows, at]))
        asked = np.clip(felt[:, frame] + BY_SPEED * (wanted - speed), -MOST_SLOWER_M_S2, MOST_FASTER_M_S2)
        acceleration = acceleration + LAG_SHARE * (asked - acceleration)
        speed = np.maximum(speed + acceleration * step, 0.0)
        driven[:, frame] = driven[:, frame - 1] + speed * step
    return driven


def _compute_gaps(law: LeadLaw, frames: int) -> Floats:
    """(F,) metres between the bodies that a law asks for, without corners."""
    left = np.arange(frames)[::-1] / FRAME_HZ
    gap = np.full(frames, law.gap_m) + LEAVING_M * np.clip(1.0 - left / LEAVING_S, 0.0, 1.0)
    since = np.arange(frames) / FRAME_HZ
    for middle in since[-1] * np.arange(1, law.times + 1) / (law.times + 1):
        near = np.clip(1.0 - (np.abs(since - middle) - 0.5 * CLOSER_S) / CHANGING_S, 0.0, 1.0)
        gap -= (1.0 - CLOSER_SHARE) * law.gap_m * near
    return np.asarray(gap)
