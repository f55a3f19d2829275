"""``log-replay``: where the recorded car was at each time, in closed loop too; the floor of the collision columns."""

import numpy as np

from benchmark.closed_loop.route import Route
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Floats, to_local
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.scene import Scene


class LogReplay:
    """Drives as recorded; past the end of the scene it keeps the last motion. Privileged: sees the future."""

    name = "log-replay"

    def __init__(self) -> None:
        self._lidar_path = np.empty((0, 2))
        self._route: Route | None = None

    def reset(self, scene: SceneInfo) -> None:
        """Forget the recording."""
        self._lidar_path = np.empty((0, 2))
        self._route = None

    def follow(self, route: Route) -> None:
        """Take the recorded path with its times: closed loop."""
        self._route = route

    def reveal(self, scene: Scene) -> None:
        """Take the recorded motion of the lidar, extended by one plan's length."""
        seconds = scene.seconds
        pose = scene.ego.pose
        heading = np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
        lidar = pose[:, :2] + float(scene.lidar.translation[0]) * heading
        keyframes = lidar[scene.keyframes]
        # The last half second of motion, or none in a scene that is shorter than that.
        last = np.searchsorted(seconds, seconds[-1] - PLAN_STEP_S)
        elapsed = max(float(seconds[-1] - seconds[last]), 1e-9)
        velocity = (lidar[-1] - lidar[last]) / elapsed
        beyond = seconds[scene.keyframes[-1]] + PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
        self._lidar_path = np.concatenate([keyframes, _extrapolate(beyond, seconds, lidar, velocity)])

    def plan(self, observation: Observation) -> Plan:
        """The recorded future: waypoints of the lidar, lidar frame; in closed loop of the rear axle, ego frame."""
        if self._route is not None:
            seconds = self._route.seconds_of(observation.timestamp_us) + PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
            return Plan(to_local(self._route.recorded_at(seconds), observation.ego.pose), PlanFrame.EGO)
        start, first = self._lidar_path[observation.index], observation.index + 1
        pose = np.array([start[0], start[1], observation.ego.pose[2]])
        forward_left = to_local(self._lidar_path[first : first + PLAN_STEPS], pose)
        return Plan(np.column_stack([-forward_left[:, 1], forward_left[:, 0]]), PlanFrame.LIDAR)


def _extrapolate(when: Floats, seconds: Floats, path: Floats, velocity: Floats) -> Floats:
    """Positions after the last keyframe: recorded frames where there are any, then the last velocity."""
    inside = np.column_stack([np.interp(when, seconds, path[:, axis]) for axis in range(2)])
    return np.asarray(inside + np.maximum(when - seconds[-1], 0.0)[:, None] * velocity)
