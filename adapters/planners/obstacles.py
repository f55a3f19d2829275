"""Which others a lane-following driver will meet on its path, judged by where they are and how they move now."""

from dataclasses import dataclass

import numpy as np

from benchmark.constants import EGO_WIDTH_M
from benchmark.dynamics.lane_path import Path
from benchmark.geometry import Bools, Floats, wrap_angle

_CROSSING_RAD = np.deg2rad(40.0)
_ONCOMING_RAD = np.deg2rad(135.0)


@dataclass(frozen=True, slots=True)
class Obstacles:
    """Others along a path at each of K instants.

    Attributes:
        rear: (A, K) arc length where each begins, metres; infinite where it is not in the corridor.
        front: (A, K) arc length where it ends.
        speed: (A, K) speed along the path, m/s, negative when oncoming.
    """

    rear: Floats
    front: Floats
    speed: Floats


@dataclass(frozen=True, slots=True)
class _Expectation:
    """Places beside a path where A others are expected at K instants.

    `crossing` and `ahead` (whether it can be met at all) are (A,), as is the heading of the path beside it now;
    `along`, arc length, and `left`, metres to the left of the path, are (A, K).
    """

    crossing: Bools
    ahead: Bools
    heading: Floats
    along: Floats
    left: Floats


def obstacles_along(
    path: Path, boxes: Floats, velocity: Floats, seconds: Floats, *, side_margin_m: float, foresight_s: float
) -> Obstacles:
    """Others that will be in the corridor.

    What goes along the path keeps its velocity relative to it, sideways only for a while (`foresight_s`), so that the
    cars of the next lane stay there in a bend. What comes towards the car keeps to its side. What crosses goes
    straight on.

    `boxes` are (A, 5) present ones and `velocity` (A, 2) m/s, global; `seconds` (K,) instants from now;
    `side_margin_m` is room beside the car that counts as its corridor.
    """
    expected = _expectation(path, boxes, velocity, seconds, foresight_s)
    # A box is turned to the path as now, unless it goes straight on where the path does not.
    heading_there = np.where(expected.crossing[:, None], path.heading_at(expected.along), expected.heading[:, None])
    half_along, half_across = _half_extents(boxes, heading_there)
    inside = np.abs(expected.left) - half_across < 0.5 * EGO_WIDTH_M + side_margin_m
    # What lies before the start or beyond the end of the path has no place beside it.
    inside &= expected.ahead[:, None] & (expected.along > 0.0) & (expected.along < path.arc_length[-1])
    return Obstacles(
        rear=np.where(inside, expected.along - half_along, np.inf),
        front=np.where(inside, expected.along + half_along, np.inf),
        speed=_turned_by(velocity[:, None], heading_there)[0],
    )


def expected_centres(path: Path, boxes: Floats, velocity: Floats, seconds: Floats, *, foresight_s: float) -> Floats:
    """Centres where others are expected, (A, K, 2) global metres, by the rules and arguments of `obstacles_along`.

    In the plane instead of along the path; beyond its ends the path goes straight on.
    """
    now_and_then = np.concatenate([[0.0], seconds])
    expected = _expectation(path, boxes, velocity, now_and_then, foresight_s)
    beside = _beside(path, expected.along, expected.left)
    # A point far from a bend is not quite where its place beside the path is; its motion is taken, from where it is.
    following = boxes[:, None, :2] + beside[:, 1:] - beside[:, :1]
    straight = boxes[:, None, :2] + velocity[:, None] * seconds[:, None]
    return np.where(expected.crossing[:, None, None], straight, following)


def _expectation(path: Path, boxes: Floats, velocity: Floats, seconds: Floats, foresight_s: float) -> _Expectation:
    along, left = path.project(boxes[:, :2])
    heading = path.heading_at(along)
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])
    turned = np.abs(wrap_angle(np.where(np.hypot(*velocity.T) > 0.3, direction, boxes[:, 4]) - heading))
    crossing, oncoming = (turned > _CROSSING_RAD) & (turned < _ONCOMING_RAD), turned >= _ONCOMING_RAD

    forward, sideways = _turned_by(velocity, heading)
    # What follows behind cannot lead, even where, going on as it does, it would drive through the ego.
    ahead = crossing | (along > 0.0)
    sideways_s = np.where(oncoming[:, None], 0.0, np.minimum(seconds, foresight_s))
    straight = boxes[:, None, :2] + velocity[:, None] * seconds[:, None]
    straight_along, straight_left = path.project(straight)
    return _Expectation(
        crossing=crossing,
        ahead=ahead,
        heading=heading,
        along=np.where(crossing[:, None], straight_along, along[:, None] + forward[:, None] * seconds),
        left=np.where(crossing[:, None], straight_left, left[:, None] + sideways[:, None] * sideways_s),
    )


def _beside(path: Path, along: Floats, left: Floats) -> Floats:
    """(..., 2) points beside a path; the inverse of `Path.project`."""
    on_path = np.clip(along, 0.0, path.arc_length[-1])
    heading = np.interp(on_path, path.arc_length, path.heading)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    to_the_left = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
    return np.asarray(path.at(on_path) + (along - on_path)[..., None] * direction + left[..., None] * to_the_left)


def _turned_by(velocity: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """Components along and to the left of a heading."""
    cos, sin = np.cos(heading), np.sin(heading)
    return velocity[..., 0] * cos + velocity[..., 1] * sin, velocity[..., 1] * cos - velocity[..., 0] * sin


def _half_extents(boxes: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """(A, K) half lengths of boxes along and across a direction."""
    turn = boxes[:, None, 4] - heading
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    half_length, half_width = 0.5 * boxes[:, None, 2], 0.5 * boxes[:, None, 3]
    return half_length * cos + half_width * sin, half_length * sin + half_width * cos
