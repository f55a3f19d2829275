"""When a vehicle is where on its path: the cheapest speed profile that touches no other.

Vehicles are planned one after another; each sees the whole motion of those before it. The plan is the exact optimum
over a lattice of whole metres per second and one-second steps, then smoothed so that acceleration is continuous.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ
from benchmark.geometry import Bools, Floats, boxes_overlap
from generation.sources.town.paths import STATION_M, VehiclePath

SECONDS = 20
FRAMES = SECONDS * FRAME_HZ
CHECKS_PER_SECOND = 4
TOP_SPEED_MPS = 14
_ACCELERATIONS = (0, 1, -1, 2, -2, -3)
_ACCELERATION_COST = 0.3
_SPEED_COST = 0.08
_SLOWEST_FELT_MPS = 4.0
"""Slower than liked by more costs the same: who must wait drives up to the queue and stands there."""
_SPEEDING_COST = 2.0
_CREEPING_COST = 0.5
_HEADWAY_COST = 0.25
_HEADWAY_AT_START_S = 0.6
_GAP_BEHIND_S = 0.8
_LIMIT_REACH_M = 5.0
_HARD_LIMIT = 1.15
_STANDING_GAP_M = 2.5
_LONGITUDINAL_MARGIN_M = 1.2
_LATERAL_MARGIN_M = 0.5
_FAR_M = 14.0


@dataclass(frozen=True, slots=True)
class DriverHabits:
    """How a driver likes to drive.

    Attributes:
        eagerness: Factor on the speed limit.
        pace: (SECONDS,) factors on that.
        headway_s: Time to the vehicle ahead, beside the gap when standing.
        ego_gap_s: Least seconds between the ego at a place and this vehicle there.
        gives_way_s: The same for others.
    """

    eagerness: float
    pace: Floats
    headway_s: float = 1.2
    ego_gap_s: float = 1.25
    gives_way_s: float = 1.0


def widen_in_time(blocked: Bools, seconds: float) -> Bools:
    """(Q, B) places that are blocked at most so long before or after each of Q quarter seconds."""
    reach = round(seconds * CHECKS_PER_SECOND)
    padded = np.concatenate([np.zeros((1, blocked.shape[1]), np.int32), np.cumsum(blocked, axis=0, dtype=np.int32)])
    steps = np.arange(len(blocked))
    last, first = np.minimum(steps + reach + 1, len(blocked)), np.maximum(steps - reach, 0)
    return np.asarray(padded[last] > padded[first])


def count_reachable_stations(path: VehiclePath) -> int:
    """Number of stations that matter within the scene."""
    return min(len(path.rear), (SECONDS + 1) * TOP_SPEED_MPS * round(1 / STATION_M))


def find_blocked_stations(path: VehiclePath, others: Floats, present: Bools) -> Bools:
    """Places, (Q, B), at which the vehicle would touch (J, Q, 5) boxes at quarter seconds, with a margin.

    B = `count_reachable_stations` of the path matter; Q = 1 for things that stand still.
    """
    count = count_reachable_stations(path)
    own = path.boxes(np.arange(0.0, count, 2.0))
    own[:, 2] += _LONGITUDINAL_MARGIN_M
    own[:, 3] += _LATERAL_MARGIN_M
    blocked = np.zeros((others.shape[1], len(own) + 1), dtype=np.bool_)
    coarse = own[::8, :2]
    which, when = np.nonzero(present)
    boxes = others[which, when]
    reach = _FAR_M + 5.0
    near = (np.hypot(boxes[:, None, 0] - coarse[:, 0], boxes[:, None, 1] - coarse[:, 1]) < reach).any(axis=1)
    boxes, when = boxes[near], when[near]
    distance = np.hypot(boxes[:, None, 0] - own[:, 0], boxes[:, None, 1] - own[:, 1])
    limit = 0.5 * (np.hypot(boxes[:, 2], boxes[:, 3])[:, None] + np.hypot(own[:, 2], own[:, 3]))
    row, station = np.nonzero(distance < limit)
    touched = boxes_overlap(boxes[row], own[station])
    blocked[when[row[touched]], station[touched]] = True
    fine = np.repeat(blocked, 2, axis=1)
    # Every second station was tested: a station between two is blocked by either.
    fine[:, 1:-1] |= fine[:, 2:]
    return np.asarray(fine[:, :count])


def plan_speed(
    path: VehiclePath, blocked: Bools, others: Bools, *, start_mps: int, habits: DriverHabits
) -> Floats | None:
    """The cheapest profile along a path: (FRAMES,) fractional stations, or ``None`` if every profile touches another.

    Both are (4 * SECONDS + 1, B): ``blocked`` where it may not be, ``others`` (`find_blocked_stations`) where others
    are to whom it keeps its distance.
    """
    room = round((_STANDING_GAP_M + _HEADWAY_AT_START_S * start_mps) / STATION_M)
    choices = None if blocked[0, :room].any() else _search(path, blocked, others, start_mps, habits)
    if choices is None:
        return None
    return _compute_smooth_motion(start_mps, choices) / STATION_M


def _search(path: VehiclePath, blocked: Bools, others: Bools, start_mps: int, habits: DriverHabits) -> list[int] | None:
    # Imported late: it takes half a second, which commands that make no town need not wait for.
    from scipy.ndimage import minimum_filter1d

    count = blocked.shape[1]
    index = np.arange(count)
    next_blocked = np.where(others, index, 10 * count)[:, ::-1]
    gap = (np.minimum.accumulate(next_blocked, axis=1)[:, ::-1] - index) * STATION_M
    behind = (index - np.maximum.accumulate(np.where(others, index, -10 * count), axis=1)) * STATION_M
    speeds = np.arange(TOP_SPEED_MPS + 1)[:, None]
    # A second passes between two states: limits a little further on or back must hold here too.
    limit = minimum_filter1d(path.speed_limit, 2 * round(_LIMIT_REACH_M / STATION_M) + 1)[:count]
    speeding = _SPEEDING_COST * np.maximum(speeds - limit - 0.5, 0.0) ** 2
    speeding = np.where((speeds > _HARD_LIMIT * limit + 0.5) & (speeds > start_mps), np.inf, speeding)
    cost = np.full((TOP_SPEED_MPS + 1) * count, np.inf)
    cost[start_mps * count] = 0.0
    chosen = []
    for second in range(SECONDS):
        wanted = np.minimum(habits.eagerness * path.speed_limit[:count] * habits.pace[second], limit)
        wish = speeding + _SPEED_COST * np.minimum(np.abs(speeds - wanted), _SLOWEST_FELT_MPS) ** 2
        wish = wish + _CREEPING_COST * ((wanted < 0.1) & (speeds > 0))
        now = CHECKS_PER_SECOND * (second + 1)
        missing = np.maximum(_STANDING_GAP_M + habits.headway_s * speeds - gap[now], 0.0)
        crowded = np.maximum(_STANDING_GAP_M + _GAP_BEHIND_S * speeds - behind[now], 0.0)
        company = np.minimum(missing, 10.0) + 0.5 * np.minimum(crowded, 10.0)
        here = (wish + _HEADWAY_COST * company * (speeds > 0)).ravel()
        cost, choice = _advance_one_second(cost, here, blocked[CHECKS_PER_SECOND * second :], count)
        chosen.append(choice)
    if not np.isfinite(cost).any():
        return None
    state = int(np.argmin(cost))
    accelerations: list[int] = []
    for choice in reversed(chosen):
        acceleration = int(choice[state])
        accelerations.append(acceleration)
        speed, station = state // count - acceleration, state % count
        state = speed * count + station - 2 * speed - acceleration
    return accelerations[::-1]


def _advance_one_second(cost: Floats, here: Floats, blocked: Bools, count: int) -> tuple[Floats, NDArray[np.int8]]:
    """Costs after one second of the search and the acceleration by which each state was reached."""
    after, choice = np.full_like(cost, np.inf), np.zeros(len(cost), dtype=np.int8)
    active = np.flatnonzero(np.isfinite(cost))
    speed, station = active // count, active % count
    for acceleration in _ACCELERATIONS:
        # Two stations a metre: v t + a t^2 / 2 metres are 2 v + a stations after one second.
        reached = station + 2 * speed + acceleration
        keep = (speed + acceleration >= 0) & (speed + acceleration <= TOP_SPEED_MPS) & (reached < count)
        for check in range(1, CHECKS_PER_SECOND + 1):
            t = check / CHECKS_PER_SECOND
            inside = station + np.floor(2 * speed * t + acceleration * t * t).astype(np.int64)
            keep &= ~blocked[check, np.clip(inside, 0, count - 1)]
        target = (speed + acceleration)[keep] * count + reached[keep]
        total = cost[active[keep]] + here[target] + _ACCELERATION_COST * acceleration**2
        better = total < after[target]
        after[target[better]] = total[better]
        choice[target[better]] = acceleration
    return after, choice


def _compute_smooth_motion(start_mps: int, accelerations: list[int]) -> Floats:
    """(FRAMES,) metres: the piecewise quadratic motion averaged over one and a half seconds."""
    margin = FRAME_HZ
    time = np.arange(-margin, FRAMES + margin) / FRAME_HZ
    edges = np.arange(SECONDS + 1)
    speed = np.concatenate([[start_mps], start_mps + np.cumsum(accelerations)]).astype(np.float64)
    where = np.concatenate([[0.0], np.cumsum(0.5 * (speed[:-1] + speed[1:]))])
    second = np.clip(np.floor(time).astype(np.int64), 0, SECONDS - 1)
    rate = np.where((time < 0) | (time >= SECONDS), 0.0, np.array(accelerations, np.float64)[second])
    base = np.where(time >= SECONDS, SECONDS, second)
    elapsed = time - edges[base]
    motion = where[base] + speed[base] * elapsed + 0.5 * rate * elapsed**2
    for half in (FRAME_HZ // 2, FRAME_HZ // 4):
        taps = np.ones(2 * half + 1)
        taps[0] = taps[-1] = 0.5
        length = len(motion) - 2 * half
        motion = sum(tap * motion[k : k + length] for k, tap in enumerate(taps / taps.sum()))
    lost = margin - FRAME_HZ // 2 - FRAME_HZ // 4
    return np.asarray(motion[lost : lost + FRAMES])
