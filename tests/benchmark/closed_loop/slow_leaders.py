"""The slow, obvious version of `benchmark.closed_loop.idm_policy`: one vehicle after the other, every point."""

import numpy as np

from benchmark.closed_loop.agent_policy import TrafficSnapshot
from benchmark.closed_loop.idm_policy import SIDE_MARGIN_M, SIGHT_M
from benchmark.dynamics.lane_path import SPACING_M, LanePath
from benchmark.geometry import Floats
from benchmark.interactions.tracks import Integers


def slow_leaders(
    paths: tuple[LanePath, ...], driving: Integers, station: Floats, here: Integers, moment: TrafficSnapshot
) -> tuple[Floats, Floats]:
    gaps, speeds = np.full(len(driving), np.inf), np.zeros(len(driving))
    yaw = moment.ego[4]
    own_motion = moment.ego_speed * np.array([[np.cos(yaw), np.sin(yaw)]])
    boxes = np.concatenate([moment.boxes, moment.ego[None]])
    velocity = np.concatenate([moment.velocity, own_motion])
    there = np.append(moment.present, True)
    for index in here:
        agent, path = driving[index], paths[index]
        own = moment.boxes[agent]
        others = there & (np.hypot(*(boxes[:, :2] - own[:2]).T) < SIGHT_M)
        others[agent] = False
        rows = np.flatnonzero(others)
        if not len(rows):
            continue
        ahead, speed = _in_the_way(path, station[index], own, boxes[rows], velocity[rows])
        if len(ahead):
            nearest = int(np.argmin(ahead))
            gaps[index], speeds[index] = ahead[nearest], speed[nearest]
    return gaps, speeds


def _in_the_way(path: LanePath, station: float, own: Floats, boxes: Floats, velocity: Floats) -> tuple[Floats, Floats]:
    first = max(int((station - 20.0) / SPACING_M), 0)
    rows = slice(first, int((station + 2 * SIGHT_M) / SPACING_M) + 1)
    path = LanePath(path.points[rows], path.heading[rows], path.arc_length[rows], path.curvature[rows])
    along, left = path.project(boxes[:, :2])
    heading = np.interp(along, path.arc_length, path.heading)
    cos, sin = np.cos(boxes[:, 4] - heading), np.sin(boxes[:, 4] - heading)
    half_along = 0.5 * (np.abs(boxes[:, 2] * cos) + np.abs(boxes[:, 3] * sin))
    half_across = 0.5 * (np.abs(boxes[:, 2] * sin) + np.abs(boxes[:, 3] * cos))
    inside = np.abs(left) <= half_across + 0.5 * own[3] + SIDE_MARGIN_M
    ahead = inside & (along > station) & (along <= station + SIGHT_M)
    gap = along - half_along - station - 0.5 * own[2]
    speed = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
    return np.asarray(np.maximum(gap, 0.0)[ahead]), np.asarray(speed[ahead])
