"""Version 1 of the embedded town: ten recordings as packed tracks and maps, since the code that made them has changed.

The file holds what commit 3657e693 made with seed 0: whole micrometres and microradians as second differences, and
road maps as `pack_road_map` writes them. All else is computed as it was then.
"""

import json
import lzma
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.road_map import RoadMap
from benchmark.scene import Agents, Annotations, EgoTrack, Scene
from generation.nuscenes_writer.road_maps import unpack_road_map
from generation.sources.rig import build_default_cameras, build_default_lidar

_FILE: Final = Path(__file__).parent / "assets" / "town-1.json.xz"
_STEPS_PER_UNIT: Final = 1_000_000
FIRST_SCENES: Final = 10


def read_first_scene(index: int) -> Scene:
    """Recording ``index`` of ten, 20 s at 12 Hz, to the bit as the town's code made it."""
    packed = _read_file()["scenes"][index]
    valid = _read_digits(packed["valid"]).astype(np.bool_)
    frames = valid.shape[1]
    keyframes = np.arange(0, frames, FRAMES_PER_KEYFRAME, dtype=np.int64)
    ego_x, ego_y, ego_yaw = _add_up(packed["ego"])
    ego = EgoTrack(np.column_stack([ego_x, ego_y, np.zeros(frames)]), quaternion_from_yaw(ego_yaw))
    size = np.array(packed["size"], np.float64)
    x, y, yaw = np.moveaxis(_add_up(packed["tracks"]), 1, 0)
    height = np.broadcast_to(np.round(size[:, 2:] / 2, 6), yaw.shape)
    agents = Agents(
        ids=tuple(packed["ids"]),
        categories=tuple(packed["categories"]),
        position=np.stack([x, y, height], axis=-1),
        yaw=np.ascontiguousarray(yaw),
        size=size,
        valid=valid,
    )
    return Scene(
        name=packed["name"],
        token=packed["token"],
        description=packed["description"],
        log=packed["log"],
        vehicle="n000",
        date=packed["date"],
        timestamps_us=packed["first_us"] + np.round(np.arange(frames) * 1e6 / FRAME_HZ).astype(np.int64),
        keyframes=keyframes,
        ego=ego,
        agents=agents,
        annotations=Annotations(
            position=agents.position[:, keyframes],
            rotation=quaternion_from_yaw(agents.yaw[:, keyframes]),
            size=np.repeat(size[:, None], len(keyframes), axis=1),
            valid=valid[:, keyframes],
            attribute=np.array(packed["attributes"], np.str_)[_read_digits(packed["attribute"])],
            visibility=_read_digits(packed["visibility"]),
            num_lidar_pts=np.array(packed["lidar"], np.int64),
            num_radar_pts=np.array(packed["radar"], np.int64),
        ),
        cameras=build_default_cameras(),
        lidar=build_default_lidar(),
        road_map=_read_map(packed["location"]),
    )


@lru_cache(maxsize=1)
def _read_file() -> dict[str, Any]:
    packed: dict[str, Any] = json.loads(lzma.decompress(_FILE.read_bytes()))
    return packed


@lru_cache(maxsize=2)
def _read_map(location: str) -> RoadMap:
    return unpack_road_map(_read_file()["maps"][location])


def _add_up(second_differences: list[Any]) -> Floats:
    """Metres or radians along the last axis."""
    steps = np.array(second_differences, np.int64)
    return np.asarray(steps.cumsum(axis=-1).cumsum(axis=-1) / _STEPS_PER_UNIT)


def _read_digits(rows: list[str]) -> NDArray[np.int64]:
    return np.array([[int(digit) for digit in row] for row in rows], np.int64)
