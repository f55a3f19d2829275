"""Waypoints to actions and back: a Verlet recursion, so that the network only sees accelerations.

``p_i = 2 p_{i-1} - p_{i-2} + 4 a_i`` for x, y and heading, starting from the pose half a second ago and the pose now,
which is the origin of the local frame.
"""

from typing import Final

import numpy as np

from benchmark.geometry import Floats

WAYPOINTS: Final = 16
"""Waypoints of a trajectory, 2 Hz, 8 s."""
CHANNELS: Final = 3
"""x, y, heading."""
ACTION_SCALE: Final = 4.0
"""Second difference, metres per squared half second, of an action of one: 16 m/s^2."""


def convert_waypoints_to_actions(waypoints: Floats, previous: Floats, now: Floats | None = None) -> Floats:
    """Standardise (..., 16, 3) waypoints, metres and radians in the local frame: scaled second differences.

    ``previous`` is the (..., 3) pose half a second ago, ``now`` the origin by default; headings must not jump by 2 pi.
    """
    waypoints = np.asarray(waypoints, np.float64)
    shape = (*waypoints.shape[:-2], 1, CHANNELS)
    start = np.zeros(shape) if now is None else np.broadcast_to(np.asarray(now, np.float64)[..., None, :], shape)
    before = np.broadcast_to(np.asarray(previous, np.float64)[..., None, :], shape)
    path = np.concatenate([before, start, waypoints], axis=-2)
    return np.diff(path, n=2, axis=-2) / ACTION_SCALE


def convert_actions_to_waypoints(actions: Floats, previous: Floats, now: Floats | None = None) -> Floats:
    """Unstandardise: integrate (..., 16, 3) actions twice; the inverse of `convert_waypoints_to_actions`."""
    actions = np.asarray(actions, np.float64)
    start = np.zeros(CHANNELS) if now is None else np.asarray(now, np.float64)
    first_step = start - np.asarray(previous, np.float64)
    steps = first_step[..., None, :] + np.cumsum(ACTION_SCALE * actions, axis=-2)
    return np.asarray(start[..., None, :] + np.cumsum(steps, axis=-2))
