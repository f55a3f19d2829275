"""A scene turned about the origin with all that is in it: nothing that is said of it may change."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from benchmark.geometry import Floats
from benchmark.road_map import RoadMap
from benchmark.scene import EgoTrack, Scene


def turned_scene(scene: Scene, angle_rad: float, *, shift_m: tuple[float, float] = (0.0, 0.0)) -> Scene:
    """The same scene in a frame that is turned, and then shifted."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, sin], [-sin, cos]])

    def points(old: Floats) -> Floats:
        return np.concatenate([old[..., :2] @ turn + shift_m, old[..., 2:]], axis=-1)

    agents, known = scene.agents, scene.annotations
    return replace(
        scene,
        ego=EgoTrack(points(scene.ego.position), _rotations(scene.ego.rotation, angle_rad)),
        agents=replace(agents, position=points(agents.position), yaw=agents.yaw + angle_rad),
        annotations=replace(known, position=points(known.position), rotation=_rotations(known.rotation, angle_rad)),
        road_map=_map(scene.road_map, points, [cos, -sin, sin, cos, *shift_m]),
    )


def _rotations(quaternions: Floats, angle_rad: float) -> Floats:
    cos, sin = np.cos(angle_rad / 2), np.sin(angle_rad / 2)
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)


def _map(road_map: RoadMap, points: Callable[[Floats], Floats], matrix: list[float]) -> RoadMap:
    def turned(value: Any) -> Any:
        if isinstance(value, BaseGeometry):
            return affinity.affine_transform(value, matrix)
        return {name: turned(one) for name, one in value.items()} if isinstance(value, dict) else value

    lanes = {
        name: replace(lane, centerline=points(lane.centerline), polygon=turned(lane.polygon))
        for name, lane in road_map.lanes.items()
    }
    dividers = tuple(replace(one, line=points(one.line)) for one in road_map.dividers)
    layers = {one.name: turned(getattr(road_map, one.name)) for one in fields(road_map) if one.init}
    return RoadMap(**{**layers, "lanes": lanes, "dividers": dividers})
