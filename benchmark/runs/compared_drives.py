"""Plans of drives beside what was recorded, at the instants where both speak of the same motion."""

from typing import Final

import numpy as np

from benchmark.closed_loop.courses import recorded_poses
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import to_global, to_local, wrap_angle
from benchmark.records.drive_schema import DriveRow
from benchmark.scene import Scene
from benchmark.untrusted.plans_beside_recording import ComparedPlans
from benchmark.waypoints import waypoints_in_lidar

NEAR_M: Final = 1.0
NEAR_RAD: Final = 0.1
NEAR_M_S: Final = 1.0
_JUST_NOW_US: Final = 100_000
_STEPS_US: Final = np.arange(PLAN_STEPS + 1, dtype=np.int64) * round(PLAN_STEP_S * 1e6)


def compared_drive(scene: Scene, row: DriveRow) -> ComparedPlans:
    """Plans of a drive that were made where the recorded car was, as fast as it was, with 3 s of recording ahead.

    The planner sees nothing of this: it is done with rows that are finished.
    """
    count = len(row.plans)
    if not count:
        return ComparedPlans.joined([])
    times, ego = np.array(row.ticks.time_us[:count], np.int64), np.array(row.ticks.ego[:count])
    now, before = recorded_poses(scene, times), recorded_poses(scene, times - _JUST_NOW_US)
    speed = np.hypot(*(now - before)[:, :2].T) / (_JUST_NOW_US * 1e-6)
    near = np.hypot(*(ego[:, :2] - now[:, :2]).T) < NEAR_M
    near &= (np.abs(wrap_angle(ego[:, 2] - now[:, 2])) < NEAR_RAD) & (np.abs(ego[:, 3] - speed) < NEAR_M_S)
    near &= times + _STEPS_US[-1] <= int(scene.timestamps_us[-1])
    ahead = np.array([float(scene.lidar.translation[0]), 0.0])
    lidar = recorded_poses(scene, times[near, None] + _STEPS_US)
    lidar[..., :2] = to_global(ahead, lidar)
    forward = to_local(lidar[:, 1:, :2], lidar[:, :1])
    recorded = np.stack([-forward[..., 1], forward[..., 0]], axis=-1)
    plans = [
        waypoints_in_lidar(np.array(plan.waypoints[:PLAN_STEPS]), plan.frame, ahead[0])
        for plan, is_near in zip(row.plans, near.tolist(), strict=True)
        if is_near
    ]
    return ComparedPlans(np.array(plans).reshape(-1, PLAN_STEPS, 2), recorded)
