"""The part of a drive in which the ego is still the recorded one."""

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.courses import recorded_ego
from benchmark.closed_loop.following import Ego
from benchmark.closed_loop.riding import Motion
from benchmark.geometry import Floats
from benchmark.scene import Scene


def recorded_motion(scene: Scene, first: int, last: int) -> Motion:
    """Recorded frames from the first to the last as motion; the last one, a keyframe, is a planning instant."""
    frames = slice(first, last + 1)
    times = scene.timestamps_us[frames]
    ego = np.array([ego_columns(recorded_ego(scene, time)) for time in times.tolist()])
    agents = scene.agents
    tick: NDArray[np.int64] = np.array([last - first])
    return Motion(times, ego, agents.position[:, frames], agents.yaw[:, frames], agents.valid[:, frames], tick)


def ego_columns(ego: Ego) -> Floats:
    """(7,) an ego of the default engine in the columns of a motion."""
    return np.array([ego.x, ego.y, ego.yaw, ego.speed, ego.acceleration, ego.yaw_rate, ego.steering])
