"""``constant-velocity-on-path``: along the recorded path at the present speed.

Privileged: sees where the recorded car drove, but neither the times nor other road users, so it never brakes. In closed
loop it continues from the nearest point of the path.
"""

import numpy as np

from benchmark.closed_loop.route import Route
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Floats, to_local
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.scene import Scene


class ConstantVelocityOnPath:
    """Keeps the present speed along the recorded path; past its end it goes straight on."""

    name = "constant-velocity-on-path"

    def __init__(self) -> None:
        self._route: Route | None = None
        self._station: float | None = None
        self._forget()

    def reset(self, scene: SceneInfo) -> None:
        """Forget the path."""
        self._forget()

    def reveal(self, scene: Scene) -> None:
        """Take the path of the rear axle; only where the scene's ego drives is looked at."""
        pose = scene.ego.pose
        self._path = pose[:, :2]
        self._driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self._path, axis=0).T))])
        self._at_sample = self._driven[scene.keyframes]
        self._beyond = np.array([np.cos(pose[-1, 2]), np.sin(pose[-1, 2])])

    def follow(self, route: Route) -> None:
        """Take the recorded path: closed loop."""
        self._route = route

    def plan(self, observation: Observation) -> Plan:
        """Waypoints of the rear axle along the path from the place of the observation's index, ego frame."""
        if self._route is None and not len(self._path):
            raise RuntimeError(f"{self.name} plans only after reveal(scene)")
        # As for constant-velocity: velocity across the heading is noise, and paths are not driven backwards.
        speed = max(float(observation.ego.velocity[0]), 0.0)
        ahead = speed * PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
        if self._route is not None:
            self._station = self._route.place(observation.ego.pose, self._station).station
            points = self._route.at(self._station + ahead)
        else:
            points = self._at(self._at_sample[observation.index] + ahead)
        return Plan(to_local(points, observation.ego.pose), PlanFrame.EGO)

    def _forget(self) -> None:
        self._path, self._driven, self._at_sample = np.empty((0, 2)), np.empty(0), np.empty(0)
        self._beyond = np.zeros(2)
        self._route, self._station = None, None

    def _at(self, driven: Floats) -> Floats:
        """(N, 2) points of the path at arc lengths in metres."""
        on_path = np.column_stack([np.interp(driven, self._driven, self._path[:, axis]) for axis in range(2)])
        past = np.maximum(driven - self._driven[-1], 0.0)
        return np.asarray(on_path + past[:, None] * self._beyond)
