"""From a file's frame to plans, and back: positions of the lidar in its own frame, and of the rear axle."""

import numpy as np

from adapters.result_files.contract import FileFrame, FilePlans
from adapters.result_files.samples import RecordedSamples, rotate
from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.planning import Plan, PlanFrame
from benchmark.waypoints import chord_headings

_ASIDE_M = 1e-6
"""A lidar so near to the middle of the car is in the middle."""


def lidar_waypoints(found: FilePlans, samples: RecordedSamples) -> Floats:
    """Future positions of the lidar in its own frame, as most files hold them: (N, K, 2) x right, y forward, metres."""
    mount = samples.lidar_in_ego[found.rows]
    if found.frame is FileFrame.LIDAR:
        return found.waypoints
    if found.frame is FileFrame.DISPLACEMENT:
        return rotate(found.waypoints, -mount[:, None, 2])
    heading = chord_headings(found.waypoints, start_heading_rad=0.0)
    at = mount[:, None, :2]
    return rotate(
        found.waypoints + rotate(np.broadcast_to(at, found.waypoints.shape), heading) - at, -mount[:, None, 2]
    )


def ego_waypoints(found: FilePlans, samples: RecordedSamples) -> Floats:
    """Rear-axle positions over the first 3 s, (N, 6, 2) x forward, y left, metres, from those of the lidar."""
    if found.frame is FileFrame.EGO:
        return found.waypoints[:, :PLAN_STEPS]
    mount = samples.lidar_in_ego[found.rows]
    at = np.broadcast_to(mount[:, None, :2], (len(mount), PLAN_STEPS, 2))
    away = rotate(lidar_waypoints(found, samples)[:, :PLAN_STEPS], mount[:, None, 2])
    heading = chord_headings(away, start_heading_rad=0.0)
    return away + at - rotate(at, heading)


def plans_of(found: FilePlans, samples: RecordedSamples) -> list[Plan]:
    """Plans as protocols take them: waypoints of the lidar stay such, turned from its own axes to the car's."""
    mount = samples.lidar_in_ego[found.rows]
    if found.frame is FileFrame.EGO or np.abs(mount[:, 1]).max(initial=0.0) > _ASIDE_M:
        return [Plan(waypoints, PlanFrame.EGO) for waypoints in ego_waypoints(found, samples)]
    ahead = rotate(lidar_waypoints(found, samples), mount[:, None, 2] + np.pi / 2)
    return [Plan(waypoints, PlanFrame.LIDAR) for waypoints in ahead]


def file_waypoints(plan: Plan, frame: FileFrame, mount: Floats) -> Floats:
    """A plan in the frame of a file, (K, 2) metres; `mount` is (3,) x, y and yaw of the lidar in the ego frame."""
    at, yaw = mount[:2], float(mount[2])
    if frame is FileFrame.EGO and plan.frame is PlanFrame.EGO:
        return plan.waypoints
    away: Floats
    if plan.frame is PlanFrame.EGO:
        heading = chord_headings(plan.waypoints, start_heading_rad=0.0)
        away = plan.waypoints + rotate(np.broadcast_to(at, plan.waypoints.shape), heading) - at
    else:
        away = rotate(plan.waypoints, -np.pi / 2)
    if frame is FileFrame.DISPLACEMENT:
        return away
    if frame is FileFrame.LIDAR:
        return rotate(away, -yaw)
    heading = chord_headings(away, start_heading_rad=0.0)
    return away + at - rotate(np.broadcast_to(at, away.shape), heading)
