"""How far a candidate is from what the label of a manoeuvre asks for (docs/manoeuvres.md), condition by condition.

Each condition, in the frame of the ego's driven path, is turned into metres that are missing until it holds.
Bodies are rectangles of the straight path here, where labels project every corner: the label decides in the end.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np

from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.labels.interactions import MOVING_M_S
from generation.labels.manoeuvres import (
    ALONG_RAD,
    BESIDE_M,
    BLIND_SPOT_M,
    BLOCKING_S,
    BRAKING_M_S2,
    CLOSING_M_S,
    HORIZON_S,
    OVERTAKEN_M,
    SQUEEZING_M,
    TAILGATING_S,
    Manoeuvre,
)
from generation.search.recorded_ego_path import RecordedEgoPath

MOST_MISSING_M: Final = 30.0
"""Largest missing distance; larger ones are clipped to it."""
RADIAN_M: Final = 5.0
"""Metres that a radian of heading counts for, about the length of a car."""
SPEED_S: Final = 1.0
"""Seconds by which missing speed, and missing deceleration times a second, become metres."""
BEYOND_M: Final = 0.3
"""A candidate aims so far beyond the edge of a condition, because labels ask that it lasts."""
BEYOND_M_S2: Final = 1.0
"""Likewise for braking, whose label looks at a whole second."""
BESIDE_AIM_M: Final = 1.0
"""Free space to the ego's strip that a vehicle keeps while it gets into position."""
PAST_M: Final = 1.0
"""Free space along the path with which a vehicle that has passed another may come in."""
_PREPARING_M: Final = 5.0
"""Least missing distance of a vehicle out of position, so that being in position is always better."""
_SIDES: Final = {"left": 1.0, "right": -1.0}


@dataclass(frozen=True, slots=True)
class EgoAtFrames:
    """The ego at S frames: (S,) indices, times, stations of its centre, and speeds.

    ``soon`` is the (S,) station of its front 3 s later, beyond the scene's end as fast as at the end; ``recent`` that
    of its rear 3 s before, not before the first frame.
    """

    way: RecordedEgoPath
    frames: tuple[int, ...]
    seconds: Floats
    station: Floats
    speed: Floats
    soon: Floats
    recent: Floats
    half_length: float
    half_width: float

    @classmethod
    def of(cls, scene: Scene, frames: tuple[int, ...], way: RecordedEgoPath | None = None) -> Self:
        """The ego of a scene at S frame indices; ``way`` is its way, where that is known."""
        way = way or RecordedEgoPath.of(scene)
        seconds, at = scene.seconds, np.asarray(frames)
        half_length = 0.5 * way.length_m
        later, before = seconds[at] + HORIZON_S, seconds[at] - HORIZON_S
        after_end = np.maximum(later - seconds[-1], 0.0) * max(float(way.speed[-1]), 0.0)
        return cls(
            way=way,
            frames=frames,
            seconds=seconds[at],
            station=way.station[at],
            speed=way.speed[at],
            soon=np.interp(later, seconds, way.station) + after_end + half_length,
            recent=np.interp(before, seconds, way.station) - half_length,
            half_length=half_length,
            half_width=0.5 * way.width_m,
        )


@dataclass(frozen=True)
class ManoeuvrePlacement:
    """Candidates beside the ego, (B, S) each, in metres, radians and m/s.

    ``offset`` is of the centre, left of the path positive; ``turn`` is relative to the path. ``along`` is the speed
    along the path, ``braking`` the deceleration along it over the second around each frame, m/s^2. Half extents are
    along and across the path.
    """

    ego: EgoAtFrames
    station: Floats
    offset: Floats
    turn: Floats
    speed: Floats
    along: Floats
    braking: Floats
    half_length: Floats
    half_width: Floats

    @classmethod
    def of(cls, ego: EgoAtFrames, center: Floats, speed: Floats, size: Floats) -> "ManoeuvrePlacement":
        """Place (B, S, 3) poses of box centres, with (B, S) speeds and (2,) length and width, at the ego's S frames."""
        station, offset, turn = ego.way.places(center, ego.frames[0], ego.frames[-1])
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        along = speed * np.cos(turn)
        return cls(
            ego=ego,
            station=station,
            offset=offset,
            turn=turn,
            speed=speed,
            along=along,
            braking=_compute_braking(along, ego.seconds),
            half_length=0.5 * (size[0] * cos + size[1] * sin),
            half_width=0.5 * (size[0] * sin + size[1] * cos),
        )

    @cached_property
    def side_gap(self) -> Floats:
        """Free space to the ego's strip, negative inside."""
        return np.abs(self.offset) - self.half_width - self.ego.half_width

    @cached_property
    def room(self) -> Floats:
        """Metres between the ego's front and the vehicle's rear."""
        return self.station - self.half_length - (self.ego.station + self.ego.half_length)

    @cached_property
    def distance_behind(self) -> Floats:
        """Metres between the vehicle's front and the ego's rear."""
        return self.ego.station - self.ego.half_length - (self.station + self.half_length)

    @cached_property
    def closing(self) -> Floats:
        """Speed by which the ego is faster along the path, m/s."""
        return self.ego.speed - self.along

    def inside(self) -> Floats:
        """Metres missing to reach into the strip."""
        return _clip_missing(BEYOND_M + self.side_gap)

    def missing_outside(self, side: float) -> Floats:
        """Metres missing to be beside the strip, clear of it: on a side, or on the nearer one (0)."""
        to_side = np.abs(self.offset) if side == 0.0 else side * self.offset
        return _clip_missing(BESIDE_AIM_M - (to_side - self.half_width - self.ego.half_width))

    def missing_overtaken(self) -> Floats:
        """Metres missing for its rear to be clear of the ego's front."""
        return _clip_missing(PAST_M - self.room)

    def missing_fallen_back(self) -> Floats:
        """Metres missing for its front to be clear of the ego's rear."""
        return _clip_missing(PAST_M - self.distance_behind)

    def missing_near_side(self, side: float, gap_m: float) -> Floats:
        """Metres missing to be outside the strip on a side and at most so far from it."""
        own = side * self.offset - self.half_width - self.ego.half_width
        return _clip_missing(own - gap_m + BEYOND_M) + _clip_missing(-own)

    def ahead(self) -> Floats:
        """Metres missing to have the centre ahead of the ego's."""
        return _clip_missing(BEYOND_M + self.ego.station - self.station)

    def behind(self) -> Floats:
        """Metres missing to have it behind."""
        return _clip_missing(BEYOND_M + self.station - self.ego.station)

    def missing_reached(self) -> Floats:
        """Metres missing for the ego to be at the vehicle's place within 3 s."""
        return _clip_missing(self.station - self.half_length - self.ego.soon + BEYOND_M)

    def abreast(self) -> Floats:
        """Metres missing for the bodies to overlap along the path."""
        return _clip_missing(np.maximum(self.room, self.distance_behind) + BEYOND_M)

    def missing_heading(self, toward_rad: float) -> Floats:
        """Metres missing to head along, across or against the path, to either side."""
        off = np.abs(np.abs(self.turn) - toward_rad)
        return RADIAN_M * _clip_missing(off - ALONG_RAD)


def _clip_missing(value: Floats) -> Floats:
    return np.maximum(value, 0.0)


def _compute_braking(along: Floats, seconds: Floats) -> Floats:
    """(B, S) deceleration over the second around each frame, or what there is of it."""
    if len(seconds) < 2:
        return np.zeros_like(along)
    frames = np.arange(len(seconds))
    before, after = (np.interp(seconds + step, seconds, frames).round().astype(int) for step in (-0.5, 0.5))
    return np.asarray((along[:, before] - along[:, after]) / np.maximum(seconds[after] - seconds[before], 1e-9))


def _compute_missing_cut_in(placed: ManoeuvrePlacement, side: float) -> Floats:
    """From outside on one side into the strip, ahead, reached within 3 s; `ManoeuvreRequest` says when."""
    return placed.inside() + placed.ahead() + placed.missing_reached() + placed.missing_heading(0.0)


def _approach_cut_in(placed: ManoeuvrePlacement, side: float) -> Floats:
    """Past the ego on the outside: a vehicle behind it or abreast cannot come in."""
    return (
        _PREPARING_M
        + placed.missing_outside(side)
        + placed.missing_overtaken()
        + 0.5 * placed.missing_reached()
        + placed.missing_heading(0.0)
    )


def _let_ego_pass(placed: ManoeuvrePlacement) -> Floats:
    return _PREPARING_M + placed.missing_outside(0.0) + placed.missing_fallen_back() + placed.missing_heading(0.0)


def _compute_missing_braking_ahead(placed: ManoeuvrePlacement, side: float) -> Floats:
    position_m = placed.inside() + placed.ahead() + placed.missing_reached() + placed.missing_heading(0.0)
    return position_m + SPEED_S**2 * _clip_missing(BRAKING_M_S2 + BEYOND_M_S2 - placed.braking)


def _compute_missing_blocking(placed: ManoeuvrePlacement, side: float) -> Floats:
    late = _clip_missing(placed.room - BLOCKING_S * np.maximum(placed.closing, CLOSING_M_S))
    slow = SPEED_S * _clip_missing(CLOSING_M_S + BEYOND_M - placed.closing)
    turned = np.minimum(placed.missing_heading(0.0), SPEED_S * _clip_missing(placed.speed - MOVING_M_S))
    return np.asarray(placed.inside() + placed.ahead() + turned + slow + late)


def _compute_missing_oncoming(placed: ManoeuvrePlacement, side: float) -> Floats:
    facing = placed.ahead() + _clip_missing(placed.side_gap - SQUEEZING_M + BEYOND_M)
    late = _clip_missing(placed.room - HORIZON_S * np.maximum(placed.closing, MOVING_M_S))
    passing = placed.abreast() + _clip_missing(placed.side_gap - SQUEEZING_M)
    return np.asarray(placed.missing_heading(np.pi) + np.minimum(facing + late, passing))


def _compute_missing_crossing(placed: ManoeuvrePlacement, side: float) -> Floats:
    rear, front = placed.station - placed.half_length, placed.station + placed.half_length
    apart = _clip_missing(rear - placed.ego.soon) + _clip_missing(placed.ego.recent - front)
    return placed.missing_heading(0.5 * np.pi) + placed.inside() + apart


def _compute_missing_squeezing(placed: ManoeuvrePlacement, side: float) -> Floats:
    return placed.abreast() + placed.missing_near_side(side, SQUEEZING_M)


def _compute_missing_overtaking(placed: ManoeuvrePlacement, side: float) -> Floats:
    gained = _clip_missing(OVERTAKEN_M + 2.0 * BEYOND_M - (placed.station - placed.ego.station))
    return gained + placed.missing_near_side(side, BESIDE_M) + placed.missing_heading(0.0)


def _compute_missing_blind_spot(placed: ManoeuvrePlacement, side: float) -> Floats:
    front = placed.station + placed.half_length
    early = _clip_missing(placed.ego.station - placed.ego.half_length - BLIND_SPOT_M + BEYOND_M - front)
    late = _clip_missing(front - placed.ego.station + BEYOND_M)
    return early + late + placed.missing_near_side(side, BLIND_SPOT_M) + placed.missing_heading(0.0)


def _compute_missing_trailing(placed: ManoeuvrePlacement, gap_s: float) -> Floats:
    late = _clip_missing(placed.distance_behind - gap_s * np.maximum(placed.along, MOVING_M_S) + BEYOND_M)
    return placed.inside() + placed.behind() + late + placed.missing_heading(0.0)


def _compute_missing_tailgating(placed: ManoeuvrePlacement, side: float) -> Floats:
    return _compute_missing_trailing(placed, TAILGATING_S)


def _compute_missing_following(placed: ManoeuvrePlacement, side: float) -> Floats:
    return _compute_missing_trailing(placed, HORIZON_S)


def _compute_missing_leading(placed: ManoeuvrePlacement, side: float) -> Floats:
    return placed.inside() + placed.ahead() + placed.missing_reached() + placed.missing_heading(0.0)


_MISSING: Final[dict[str, Callable[[ManoeuvrePlacement, float], Floats]]] = {
    "oncoming": _compute_missing_oncoming,
    "crossing": _compute_missing_crossing,
    "cut-in": _compute_missing_cut_in,
    "braking-ahead": _compute_missing_braking_ahead,
    "blocking": _compute_missing_blocking,
    "squeezing": _compute_missing_squeezing,
    "overtaking": _compute_missing_overtaking,
    "tailgating": _compute_missing_tailgating,
    "blind-spot": _compute_missing_blind_spot,
    "leading": _compute_missing_leading,
    "following": _compute_missing_following,
}


IN_FRONT: Final = frozenset(("cut-in", "braking-ahead", "blocking", "leading"))
"""Families for which a vehicle must have got past the ego."""
BEHIND: Final = frozenset(("tailgating", "following"))
"""Families for which the ego must have got past the vehicle."""


def split_side(kind: Manoeuvre) -> tuple[str, float]:
    """Name of a kind without its side, and the side: 1 left, -1 right, 0 for kinds without."""
    family, _, side = kind.value.rpartition("-")
    return (family, _SIDES[side]) if side in _SIDES else (kind.value, 0.0)


def compute_missing(kind: Manoeuvre, placed: ManoeuvrePlacement, *, ready: bool = True) -> Floats:
    """Metres, (B, S) and at most `MOST_MISSING_M`, that are missing until the conditions of a kind hold.

    ``ready`` is for cut-ins: whether the vehicle was outside on that side just now, and may come in.
    """
    family, side = split_side(kind)
    distance = _MISSING[family](placed, side)
    if family in IN_FRONT:
        in_position = (placed.missing_overtaken() == 0.0) & (ready or family != "cut-in")
        distance = np.where(in_position, distance, _approach_cut_in(placed, side))
    elif family in BEHIND:
        distance = np.where(placed.missing_fallen_back() == 0.0, distance, _let_ego_pass(placed))
    return np.asarray(np.minimum(distance, MOST_MISSING_M))
