"""A scene turned about the origin with all that is in it: nothing that is said of it may change."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from benchmark.geometry import Floats
from benchmark.road_map import RoadMap
from benchmark.scene import EgoTrack, Scene


def turned_scene(scene: Scene, angle_rad: float) -> Scene:
    """The same scene in a frame that is turned."""
    agents, known = scene.agents, scene.annotations
    return replace(
        scene,
        ego=EgoTrack(_points(scene.ego.position, angle_rad), _rotations(scene.ego.rotation, angle_rad)),
        agents=replace(agents, position=_points(agents.position, angle_rad), yaw=agents.yaw + angle_rad),
        annotations=replace(
            known, position=_points(known.position, angle_rad), rotation=_rotations(known.rotation, angle_rad)
        ),
        road_map=_map(scene.road_map, angle_rad),
    )


def _points(points: Floats, angle_rad: float) -> Floats:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y = points[..., 0], points[..., 1]
    return np.concatenate([np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1), points[..., 2:]], axis=-1)


def _rotations(quaternions: Floats, angle_rad: float) -> Floats:
    cos, sin = np.cos(angle_rad / 2), np.sin(angle_rad / 2)
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)


def _map(road_map: RoadMap, angle_rad: float) -> RoadMap:
    def turned(value: Any) -> Any:
        if isinstance(value, BaseGeometry):
            return affinity.rotate(value, angle_rad, origin=(0.0, 0.0), use_radians=True)
        if isinstance(value, dict):
            return {name: turned(one) for name, one in value.items()}
        return value

    lanes = {
        name: replace(lane, centerline=_points(lane.centerline, angle_rad), polygon=turned(lane.polygon))
        for name, lane in road_map.lanes.items()
    }
    dividers = tuple(replace(one, line=_points(one.line, angle_rad)) for one in road_map.dividers)
    layers = {one.name: turned(getattr(road_map, one.name)) for one in fields(road_map) if one.init}
    return RoadMap(**{**layers, "lanes": lanes, "dividers": dividers})
