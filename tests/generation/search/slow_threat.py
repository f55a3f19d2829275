"""The terms of a threat written candidate by candidate, as ``docs/generation.md`` says them.

Nothing is shared with the fast side but the settings and the ego's path, which has tests of its own.
"""

import math

import numpy as np
from shapely.geometry import Polygon

from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_ego_path import RecordedEgoPath
from tests.generation.search.slow_scoring import outline

FULL_BRAKING = 0.774 * 9.81


def slow_further(
    scene: Scene, agent: int, frames: list[int], center: Floats, states: Floats, hyper: HyperParameters
) -> float:
    """Weighted sum of the terms of one candidate: (S, 3) poses and (S, 6) states at S frames."""
    way, total = RecordedEgoPath.of(scene), 0.0
    length, width = (float(value) for value in scene.agents.size[agent, :2])
    for step, frame in enumerate(frames):
        x, y, yaw = (float(value) for value in center[step])
        speed, acceleration, steering = (float(value) for value in states[step, 3:])
        station, offset, heading = nearest(way, x, y, float(way.station[frames[0]]), float(way.station[frames[-1]]))
        cos, sin = math.cos(yaw - heading), math.sin(yaw - heading)
        along = 0.5 * (abs(cos) * length + abs(sin) * width)
        across = 0.5 * (abs(sin) * length + abs(cos) * width)
        ego, driven = float(way.station[frame]), float(way.speed[frame])
        room = (station - along) - (ego + 0.5 * way.length_m)
        lag = (ego - 0.5 * way.length_m) - (station + along)
        side = abs(offset) - across - 0.5 * way.width_m
        closing = driven - speed * cos
        needed = 1.1 * max(closing, 0.0) + max(closing, 0.0) ** 2 / (2 * FULL_BRAKING)
        ahead = side <= 0.0 < room
        aim = hyper.threat_gap_s * driven
        if way.overrun[frame] >= hyper.threat_least_m:
            aim = min(aim, 0.6 * float(way.overrun[frame]))
        aim = max(aim, hyper.threat_least_m)
        total += hyper.threat_weight * math.sqrt(math.hypot(room - aim, max(side + 0.6, 0.0)) / 20.0)
        if ahead and needed <= room <= 3 * needed:
            total -= hyper.closing_weight * min(max(closing / 4.0, 0.0), 1.0)
        if ahead and room < needed:
            total += hyper.careful_weight * (needed - room) / max(needed, 1.0)
        if room <= 0.0 and lag <= 0.0 and driven >= 1.0:
            wanted = hyper.side_least_m + hyper.side_s * driven
            total += hyper.side_weight * min(max(1.0 - side / wanted, 0.0), 1.0)
        if lag > 0.0 and driven >= 1.0:
            total += hyper.behind_weight
        if hovers(scene, agent, frame, outline(x, y, length + 1.0, width + 1.0, yaw)):
            total += hyper.hover_weight
        sideways = speed**2 * math.tan(steering) / (0.6 * length)
        total += hyper.likelihood_weight * (abs(acceleration) / 1.0 + abs(sideways) / 0.7)
        total += hyper.area_weight * outward(scene, frame, x, y, hyper.half_extent_m) ** 2
        total += hyper.against_weight * against(scene, x, y, yaw)
    return total / len(frames) + hyper.ahead_weight * min(max((8.0 - room) / 20.0, 0.0), 3.0)


def nearest(way: RecordedEgoPath, x: float, y: float, first: float, last: float) -> tuple[float, float, float]:
    """Station, offset and heading at the nearest point of the way between 60 m back and 90 m on."""
    best, found = math.inf, (0.0, 0.0, 0.0)
    for (px, py), heading, station in zip(way.points.tolist(), way.headings.tolist(), way.stations.tolist()):
        away = math.hypot(x - px, y - py)
        if first - 60.0 <= station < last + 90.0 and away < best:
            along = math.cos(heading) * (x - px) + math.sin(heading) * (y - py)
            best, found = away, (station + along, math.cos(heading) * (y - py) - math.sin(heading) * (x - px), heading)
    return found


def hovers(scene: Scene, agent: int, frame: int, corners: list[tuple[float, float]]) -> bool:
    """Whether a body that is half a metre larger all round touches anybody, the ego included."""
    others = [box for row, box in enumerate(scene.agents.boxes[:, frame]) if row != agent]
    shape = Polygon(corners)
    return any(shape.intersects(Polygon(outline(*box.tolist()))) for box in [*others, scene.ego.boxes[frame]])


def outward(scene: Scene, frame: int, x: float, y: float, half_m: float) -> float:
    """0 up to 60 % of the way to the edge of the area around the ego, 1 at the edge."""
    px, py, yaw = (float(value) for value in scene.ego.pose[frame])
    along = (x - px) * math.cos(yaw) + (y - py) * math.sin(yaw)
    across = (y - py) * math.cos(yaw) - (x - px) * math.sin(yaw)
    return max(max(abs(along), abs(across)) - 0.6 * half_m, 0.0) / (0.4 * half_m)


def against(scene: Scene, x: float, y: float, yaw: float) -> bool:
    """Whether a heading is against every lane that has a centre line within 2 m, if there is one."""
    near, along = False, False
    for lane in scene.road_map.lanes.values():
        for first, second in zip(lane.centerline[:-1], lane.centerline[1:]):
            edge = second - first
            share = float(np.clip((np.array([x, y]) - first) @ edge / (edge @ edge), 0.0, 1.0))
            if math.hypot(*(np.array([x, y]) - first - share * edge)) <= 2.0:
                near = True
                along |= math.cos(yaw - math.atan2(edge[1], edge[0])) >= 0.0
    return near and not along
