"""An ego that gets off its path and comes back without a jump: what an imitator has to see before it can be driven.

The rear axle follows the planned path at a lateral offset d(s) that depends on the station, and at a station that runs
ahead of the planned one by e(t). Its heading is that of its own motion, the path's and atan(d' / (1 - curvature d)), so
that it never slips sideways, at any speed. Offsets are quintic: away from the path, and back to it, without a jump of
velocity or acceleration.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import DriverLimits, find_broken_limit
from benchmark.geometry import Floats, wrap_angle
from benchmark.records.off_path import Excursion
from generation.sources.town.curves import interpolate_grid
from generation.sources.town.paths import EGO_BODY, STATION_M, VehiclePath, compute_body_boxes
from generation.sources.town.speed import FRAMES
from generation.sources.town.world import TownWorld


def evaluate_quintic(
    where: Floats, first: float, last: float, start: tuple[float, float], goal: tuple[float, float]
) -> tuple[Floats, Floats]:
    """(N,) values and (N,) slopes of the quintic between two values and slopes, its second derivatives zero.

    Outside ``first`` to ``last``, which is greater, it is held with the value and without slope: excursions begin and
    end with neither. ``start`` and ``goal`` are value and slope at both ends.
    """
    length = last - first
    u = np.clip((where - first) / length, 0.0, 1.0)
    inside = (where > first) & (where < last)
    (p0, v0), (p1, v1) = start, goal
    v0, v1 = v0 * length, v1 * length
    a = 10 * (p1 - p0) - 6 * v0 - 4 * v1
    b = -15 * (p1 - p0) + 8 * v0 + 7 * v1
    c = 6 * (p1 - p0) - 3 * v0 - 3 * v1
    value = p0 + u * (v0 + u**2 * (a + u * (b + u * c)))
    slope = (v0 + u**2 * (3 * a + u * (4 * b + u * 5 * c))) / length
    return value, np.where(inside, slope, 0.0)


def compute_curvature(path: VehiclePath, stations: Floats) -> Floats:
    """(N,) curvature of a path, 1/m, at stations (steps of `STATION_M`)."""
    step = 0.5
    yaw = path.rear[:, 2:]
    turn = interpolate_grid(yaw, stations + step) - interpolate_grid(yaw, stations - step)
    return np.asarray(turn[:, 0] / (2 * step * STATION_M))


def compute_offset_poses(path: VehiclePath, metres: Floats, aside: Floats, slope: Floats) -> Floats:
    """Rear-axle poses, (N, 3), of a drive beside a path without slip: the heading is that of its own motion.

    (N,) metres along the path and ``aside`` to its left, with the ``slope`` of ``aside`` over a metre.
    """
    stations = metres / STATION_M
    pose = interpolate_grid(path.rear, stations)
    heading = pose[:, 2] + np.arctan2(slope, 1 - compute_curvature(path, stations) * aside)
    return np.column_stack([pose[:, 0] - aside * np.sin(pose[:, 2]), pose[:, 1] + aside * np.cos(pose[:, 2]), heading])


Kind = Literal["lateral", "heading", "fast", "slow", "late-braking"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
KEPT_ON_PATH_EVERY: Final = 4
"""Of the training scenes, the last of so many stays on its path."""
_FIRST_S: Final = (0.0, 1.5)
_PAUSE_S: Final = (0.5, 2.0)
_DEPARTING_S: Final = (0.8, 1.6)
_RETURNING_S: Final = (2.5, 4.0)
_LEAST_ROOM_M: Final = 6.0
_LATERAL_M: Final = (0.4, 1.6)
_LATERAL_ASIDE_M: Final = 0.4
_HEADING_RAD: Final = (0.05, 0.2)
_HEADING_ASIDE_RAD: Final = 0.06
_SPEED_MPS: Final = (0.8, 3.0)
_FASTER: Final[dict[Kind, float]] = {"fast": 1.0, "late-braking": 1.0, "slow": -1.0}
_TRIES: Final = 6
_SMALLER: Final = 0.7
_BRAKING_FRAMES: Final = FRAME_HZ
_BRAKING_MPS2: Final = -0.8
_GAP_M: Final = 0.25


@dataclass(frozen=True, slots=True)
class PlannedEgo:
    """The ego as it would drive: its path, and the (FRAMES,) places on it at 12 Hz, in steps of `STATION_M`."""

    path: VehiclePath
    stations: Floats


@dataclass(frozen=True, slots=True)
class _ExcursionPlan:
    """Seconds and sizes of one excursion before it is known whether it can be driven."""

    kind: Kind
    begin_s: float
    departing_s: float
    returning_s: float
    lateral_m: float
    heading_rad: float
    ahead_m: float
    faster_mps: float

    def shrink(self) -> "_ExcursionPlan":
        return _ExcursionPlan(
            self.kind,
            self.begin_s,
            self.departing_s,
            self.returning_s,
            *(_SMALLER * size for size in (self.lateral_m, self.heading_rad, self.ahead_m, self.faster_mps)),
        )


def drive_off_path(
    world: TownWorld, planned: PlannedEgo, rng: np.random.Generator
) -> tuple[Floats, tuple[Excursion, ...]]:
    """(FRAMES, 3) rear-axle poses of an ego that departs from its path and comes back, and the excursions in order.

    As many as the scene has time for. An excursion is taken where the ego can drive it within a driver's limits, stays
    on the road and touches none; it is made smaller until it can, or left out.
    """
    others = TownWorld(world.town, tracks=world.tracks)
    taken: list[_ExcursionPlan] = []
    rear = _compute_rear(planned, taken)
    # Conflicts of the planned motion itself do not count against an excursion.
    begin = float(rng.uniform(*_FIRST_S))
    while begin + _DEPARTING_S[1] + _RETURNING_S[0] < FRAMES / FRAME_HZ:
        wanted = _draw_excursion(planned, begin, rng)
        begin = wanted.begin_s + float(rng.uniform(*_PAUSE_S))
        for _ in range(_TRIES):
            candidate = _compute_rear(planned, [*taken, wanted])
            if _is_drivable(others, candidate):
                taken.append(wanted)
                rear = candidate
                begin += wanted.departing_s + wanted.returning_s
                break
            wanted = wanted.shrink()
    return rear, tuple(_build_excursion(planned, taken, excursion) for excursion in taken)


def _draw_excursion(planned: PlannedEgo, begin: float, rng: np.random.Generator) -> _ExcursionPlan:
    """An excursion that begins then, or, where the ego brakes later on, before that."""
    kind: Kind = KINDS[int(rng.integers(len(KINDS)))]
    departing, returning = float(rng.uniform(*_DEPARTING_S)), float(rng.uniform(*_RETURNING_S))
    if kind == "late-braking":
        braking = _find_braking_start_s(planned, begin + departing)
        # Without braking on the path, the excursion becomes lateral.
        kind, begin = ("lateral", begin) if braking is None else (kind, braking - 0.5 * departing)
    lateral = _draw_size(_LATERAL_M, _LATERAL_ASIDE_M, rng, main=kind == "lateral")
    heading = _draw_size(_HEADING_RAD, _HEADING_ASIDE_RAD, rng, main=kind == "heading")
    faster = _FASTER.get(kind, 0.0) * float(rng.uniform(*_SPEED_MPS))
    return _ExcursionPlan(kind, begin, departing, returning, lateral, heading, 0.5 * departing * faster, faster)


def _draw_size(main_range: tuple[float, float], aside: float, rng: np.random.Generator, *, main: bool) -> float:
    """Distance to one of the sides: within a range where it is the main thing, else anything up to a little."""
    side = float(rng.choice([-1.0, 1.0]))
    return side * float(rng.uniform(*main_range) if main else rng.uniform(0.0, aside))


def _find_braking_start_s(planned: PlannedEgo, earliest_s: float) -> float | None:
    speed = np.diff(planned.stations) * STATION_M * FRAME_HZ
    change = (speed[_BRAKING_FRAMES:] - speed[:-_BRAKING_FRAMES]) * FRAME_HZ / _BRAKING_FRAMES
    earliest = int(np.ceil(earliest_s * FRAME_HZ))
    braking_frames = np.flatnonzero(change[earliest:] < _BRAKING_MPS2)
    latest = (FRAMES / FRAME_HZ - _DEPARTING_S[1] - _RETURNING_S[0]) * FRAME_HZ
    return (
        None
        if not len(braking_frames) or earliest + braking_frames[0] > latest
        else (earliest + int(braking_frames[0])) / FRAME_HZ
    )


def _compute_rear(planned: PlannedEgo, wanted: Sequence[_ExcursionPlan]) -> Floats:
    """(FRAMES, 3) rear-axle poses with all excursions."""
    seconds = np.arange(FRAMES) / FRAME_HZ
    ahead = sum((_compute_ahead(excursion, seconds) for excursion in wanted), np.zeros(FRAMES))
    metres = planned.stations * STATION_M + ahead
    aside, slope = np.zeros(FRAMES), np.zeros(FRAMES)
    for excursion in wanted:
        left, rising = _compute_aside(planned, excursion, metres)
        aside, slope = aside + left, slope + rising
    return compute_offset_poses(planned.path, metres, aside, slope)


def _compute_ahead(excursion: _ExcursionPlan, seconds: Floats) -> Floats:
    """(FRAMES,) metres by which the ego is ahead of where it would be."""
    worst, end = (
        excursion.begin_s + excursion.departing_s,
        excursion.begin_s + excursion.departing_s + excursion.returning_s,
    )
    departing = evaluate_quintic(
        seconds, excursion.begin_s, worst, (0.0, 0.0), (excursion.ahead_m, excursion.faster_mps)
    )[0]
    returning = evaluate_quintic(seconds, worst, end, (excursion.ahead_m, excursion.faster_mps), (0.0, 0.0))[0]
    return np.asarray(np.where(seconds < worst, departing, returning))


def _compute_aside(planned: PlannedEgo, excursion: _ExcursionPlan, metres: Floats) -> tuple[Floats, Floats]:
    """(FRAMES,) metres to the left of the path, and their slope over the station."""
    begin, worst, end = _compute_places(planned, excursion)
    slope = float(np.tan(excursion.heading_rad))
    departing = evaluate_quintic(metres, begin, worst, (0.0, 0.0), (excursion.lateral_m, slope))
    returning = evaluate_quintic(metres, worst, end, (excursion.lateral_m, slope), (0.0, 0.0))
    return (
        np.where(metres < worst, departing[0], returning[0]),
        np.where(metres < worst, departing[1], returning[1]),
    )


def _compute_places(planned: PlannedEgo, excursion: _ExcursionPlan) -> tuple[float, float, float]:
    """Metres along the path at which the ego departs sideways, is furthest off, and is back."""
    seconds = np.arange(FRAMES) / FRAME_HZ
    metres = planned.stations * STATION_M
    times = np.cumsum([excursion.begin_s, excursion.departing_s, excursion.returning_s])
    begin, worst, end = (float(np.interp(time, seconds, metres)) for time in times)
    worst = max(worst, begin + _LEAST_ROOM_M)
    return begin, worst, max(end, worst + 2 * _LEAST_ROOM_M)


def _is_drivable(others: TownWorld, rear: Floats) -> bool:
    boxes = compute_body_boxes(rear, EGO_BODY)
    return find_broken_limit(boxes, DriverLimits()) is None and others.is_free(boxes, EGO_BODY, gap_m=_GAP_M)


def _build_excursion(planned: PlannedEgo, taken: Sequence[_ExcursionPlan], excursion: _ExcursionPlan) -> Excursion:
    """An excursion as it came out: sideways it lasts as long as its metres take."""
    seconds = np.arange(FRAMES) / FRAME_HZ
    ahead = sum((_compute_ahead(other, seconds) for other in taken), np.zeros(FRAMES))
    metres = planned.stations * STATION_M + ahead
    _, worst_m, end_m = _compute_places(planned, excursion)
    worst = max(excursion.begin_s + excursion.departing_s, _find_time_at(metres, worst_m))
    end = max(
        worst + 1 / FRAME_HZ,
        excursion.begin_s + excursion.departing_s + excursion.returning_s,
        _find_time_at(metres, end_m),
    )
    return Excursion(
        kind=excursion.kind,
        begin_s=round(excursion.begin_s, 6),
        worst_s=round(worst, 6),
        end_s=round(end, 6),
        lateral_m=round(excursion.lateral_m, 6),
        heading_rad=round(float(wrap_angle(np.array(excursion.heading_rad))), 6),
        ahead_m=round(excursion.ahead_m, 6),
        faster_mps=round(excursion.faster_mps, 6),
    )


def _find_time_at(metres: Floats, place: float) -> float:
    """When the ego gets there; the end of the scene where it does not."""
    frames = np.flatnonzero(metres >= place)
    return (int(frames[0]) if len(frames) else FRAMES) / FRAME_HZ
