"""Twenty-five things that a driver could still do: brake so hard, and swerve so far, from a moment on.

``docs/severity.md``, "Time to last chance". A kinematic bicycle follows the path, shifted sideways, by pure pursuit;
what braking leaves of the friction circle limits steering.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_WHEELBASE_M
from benchmark.geometry import Floats, wrap_angle
from benchmark.interactions.ego_path import EgoPath
from benchmark.interactions.rules import HARDEST_BRAKING

BRAKING: Final = (0.0, 2.0, 4.0, 6.0, HARDEST_BRAKING)
OFFSETS_M: Final = (0.0, 1.75, -1.75, 3.5, -3.5)
MANOEUVRES: Final = tuple((braking, offset) for braking in BRAKING for offset in OFFSETS_M)
"""Index ``5 i + j`` is the i-th braking with the j-th offset."""
STEP_S: Final = 0.05
LONGEST_STEPS: Final = 120
_BUILD_UP: Final = 12.65 * STEP_S
_LARGEST_STEERING_RAD: Final = 0.6
_STEERING_STEP_RAD: Final = 0.03
_LOOK_TIME_S: Final = 0.8
_SHORTEST_LOOK_M: Final = 4.0
_BACK_M, _AHEAD_M = 2.0, 20.0
"""How far the rear axle's station may move in a step."""
STATE_COLUMNS: Final = 5
X, Y, HEADING, SPEED, STEERING = range(STATE_COLUMNS)
"""Columns of a state: rear axle, heading, speed, steering angle."""


@dataclass(frozen=True, slots=True)
class Starts:
    """O moments at which manoeuvres start.

    Poses are (O, 3) box centre x, y and heading of the ego; the station is metres along the path.
    """

    pose: Floats
    speed: Floats
    station: Floats


def manoeuvres(path: EgoPath, starts: Starts, steps: int) -> Floats:
    """Drive all manoeuvres from all moments, as if the ego were alone.

    (O, 25, steps + 1, 5) states, the start included; steps are of 0.05 s.
    """
    shape = (len(starts.speed), len(MANOEUVRES))
    braking = np.broadcast_to([each for each, _ in MANOEUVRES], shape).ravel()
    offset = np.broadcast_to([each for _, each in MANOEUVRES], shape).ravel()
    x, y, heading, speed, steering, station = (
        np.broadcast_to(column[:, None], shape).ravel() for column in _start(path, starts)
    )
    states = np.empty((len(braking), steps + 1, STATE_COLUMNS))
    states[:, 0] = np.column_stack([x, y, heading, speed, steering])
    built_up = np.zeros(len(braking))
    for step in range(1, steps + 1):
        built_up = np.minimum(braking, built_up + _BUILD_UP)
        position = np.column_stack([x, y])
        station, _ = path.project(position, station - _BACK_M, station + _AHEAD_M)
        wanted = _steering_to(path, position, heading, speed, station, offset)
        left = np.sqrt(np.maximum(HARDEST_BRAKING**2 - built_up**2, 0.0))
        largest = np.minimum(_LARGEST_STEERING_RAD, np.arctan(left * EGO_WHEELBASE_M / np.maximum(speed, 0.1) ** 2))
        change = np.clip(np.clip(wanted, -largest, largest) - steering, -_STEERING_STEP_RAD, _STEERING_STEP_RAD)
        steering = np.clip(steering + change, -largest, largest)
        speed = np.maximum(speed - STEP_S * built_up, 0.0)
        turned = heading + STEP_S * speed * np.tan(steering) / EGO_WHEELBASE_M
        x = x + STEP_S * speed * np.cos(0.5 * (heading + turned))
        y = y + STEP_S * speed * np.sin(0.5 * (heading + turned))
        heading = turned
        states[:, step] = np.column_stack([x, y, heading, speed, steering])
    return states.reshape(*shape, steps + 1, STATE_COLUMNS)


def boxes_of(states: Floats, size: Floats) -> Floats:
    """(..., 5) rectangles of (..., 5) states, for a car of (2,) length and width."""
    heading = states[..., HEADING]
    ahead = EGO_CENTER_FROM_REAR_AXLE_M * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    sizes = np.broadcast_to(size, (*heading.shape, 2))
    return np.concatenate([states[..., :2] + ahead, sizes, heading[..., None]], axis=-1)


def _start(path: EgoPath, starts: Starts) -> tuple[Floats, ...]:
    heading = starts.pose[:, 2]
    x = starts.pose[:, 0] - EGO_CENTER_FROM_REAR_AXLE_M * np.cos(heading)
    y = starts.pose[:, 1] - EGO_CENTER_FROM_REAR_AXLE_M * np.sin(heading)
    turn = wrap_angle(path.heading(starts.station + 1.0) - path.heading(starts.station - 1.0))
    steering = np.clip(np.arctan(EGO_WHEELBASE_M * turn / 2), -_LARGEST_STEERING_RAD, _LARGEST_STEERING_RAD)
    return x, y, heading, starts.speed, steering, starts.station - EGO_CENTER_FROM_REAR_AXLE_M


def _steering_to(
    path: EgoPath, position: Floats, heading: Floats, speed: Floats, station: Floats, offset: Floats
) -> Floats:
    """Pure pursuit of a point ahead on the shifted path."""
    aim = station + np.maximum(_SHORTEST_LOOK_M, _LOOK_TIME_S * speed)
    tangent = path.tangent(aim)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    target = path.position(aim) + offset[:, None] * normal - position
    cos, sin = np.cos(heading), np.sin(heading)
    ahead, left = target[:, 0] * cos + target[:, 1] * sin, target[:, 1] * cos - target[:, 0] * sin
    return np.asarray(np.arctan(2 * EGO_WHEELBASE_M * left / (ahead**2 + left**2)))
