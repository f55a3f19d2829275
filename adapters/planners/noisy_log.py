"""``noisy-log``: the recording with the error of a planner of published accuracy; measures how forgiving traffic is.

The waypoint at t seconds is the recorded pose plus s(v) (t / 3 s)^1.5 (along z1, across z2) in the recorded heading
there, with s(v) = min(1, 0.2 + v / 6 m/s) of the present speed v. One pair z a plan, standard normal, by seed and
sample token. Its rates are means over 40 seeds (`adapters.models`); one run is one draw.
"""

from typing import Final

import numpy as np

from adapters.planners.log_replay import LogReplay
from benchmark.constants import PLAN_ERROR_M, PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from benchmark.planning import Observation, Plan, PlanFrame
from benchmark.scene import Scene

ALONG_M, ACROSS_M = PLAN_ERROR_M
"""Standard deviations at 3 s and at speed: plans are 0.97 m off on average."""
_GROWTH: Final = (np.arange(1, PLAN_STEPS + 1) / PLAN_STEPS) ** 1.5


class NoisyLog(LogReplay):
    """Recorded future with an error that grows with time and speed. Privileged: sees the future.

    ``seed`` draws another error; ``settings`` are the standard deviations at 3 s, metres.
    """

    name = "noisy-log"
    scale = 1.0

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        self.seed = seed
        self.settings = {"along_m": self.scale * ALONG_M, "across_m": self.scale * ACROSS_M}
        self._yaw = np.empty(0)

    def reveal(self, scene: Scene) -> None:
        """Take the recorded motion; past the end of the scene it keeps the last heading."""
        super().reveal(scene)
        yaw = scene.ego.yaw[scene.keyframes]
        self._yaw = np.concatenate([yaw, np.full(PLAN_STEPS, scene.ego.yaw[-1])])

    def plan(self, observation: Observation) -> Plan:
        """Waypoints of `LogReplay.plan`, in its frame, each with its error."""
        recorded = super().plan(observation)
        heading = self._recorded_headings(observation) - observation.ego.pose[2]
        cos, sin = np.cos(heading), np.sin(heading)
        along, across = self._errors(observation)
        ahead, left = along * cos - across * sin, along * sin + across * cos
        error = np.column_stack([-left, ahead] if recorded.frame is PlanFrame.LIDAR else [ahead, left])
        return Plan(recorded.waypoints + error, recorded.frame)

    def _recorded_headings(self, observation: Observation) -> Floats:
        """(6,) global headings of the recording at the waypoints, radians."""
        if self._route is None:
            return self._yaw[observation.index + 1 : observation.index + 1 + PLAN_STEPS]
        seconds = self._route.seconds_of(observation.timestamp_us) + PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
        return np.interp(seconds, self._route.seconds, np.unwrap(self._route.poses[:, 2]))

    def _errors(self, observation: Observation) -> tuple[Floats, Floats]:
        """(6,) metres along the recorded heading and (6,) to its left."""
        z = np.random.default_rng(content_seed("noisy-log", self.seed, observation.sample_token)).standard_normal(2)
        share = min(1.0, 0.2 + abs(float(observation.ego.velocity[0])) / 6.0)
        along, across = share * z * [self.settings["along_m"], self.settings["across_m"]]
        return along * _GROWTH, across * _GROWTH


class PublishedNoisyLog(NoisyLog):
    """Twice the error: plans of the four published models are 1.65 to 2.0 m off at 3 s."""

    name = "noisy-log-published"
    scale = 2.0
