"""Open-loop rates that NeuroNCAP gives beside its score: each plan laid out rigidly against what actors will do."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.extensions.neuroncap.actors import Actor
from benchmark.extensions.neuroncap.car import Car
from benchmark.extensions.neuroncap.contact import EgoMoment, touched
from benchmark.extensions.neuroncap.plan_path import WAYPOINT_US
from benchmark.geometry import Floats, quaternion_from_yaw, transform_matrix
from benchmark.records.neuroncap_switches import Switches

_STILL_M: Final = 0.2
"""Next waypoints nearer than this to the origin give no heading."""


def future_hits(future: Sequence[EgoMoment], actors: Sequence[Actor], car: Car, switches: Switches) -> tuple[bool, ...]:
    """Whether a plan touches an actor at 0.5, 1.0 .. 3.0 s: six verdicts on `future_moments`."""
    found = (touched(moment, actors, car, switches) for moment in future)
    return tuple(contact is not None for contact in found)


def future_moments(time_us: int, pose: Floats, plan: ArrayLike, switches: Switches) -> list[EgoMoment]:
    """A plan, (6, 2) x forward and y left, laid out rigidly from the (4, 4) pose of the rear axle.

    Args:
        switches: As ``plan_3s`` code, the pose at 3 s is that of 2.5 s.

    Returns:
        The ego at 0.5, 1.0 .. 3.0 s; its speeds are the published code's, and decide nothing.
    """
    waypoints = np.asarray(plan, np.float64)[:, :2]
    around = np.concatenate([np.zeros((1, 2)), waypoints, waypoints[-1:]])
    spans = np.linalg.norm(around[2:] - around[:-2], axis=1)
    found, last = [], PLAN_STEPS - 2
    for step in range(PLAN_STEPS):
        chord, end = waypoints[min(step, last) + 1] - waypoints[min(step, last)], waypoints[min(step, last) + 1]
        yaw = float(np.arctan2(chord[1], chord[0])) if np.linalg.norm(end) >= _STILL_M else 0.0
        position = waypoints[min(step, last) if switches.plan_3s == "code" else step]
        planned = transform_matrix(quaternion_from_yaw(np.array(yaw)), [*position, 0.0])
        seconds = PLAN_STEP_S * (step + 1)
        found.append(EgoMoment(time_us + WAYPOINT_US * (step + 1), pose @ planned, float(spans[step] / seconds)))
    return found
