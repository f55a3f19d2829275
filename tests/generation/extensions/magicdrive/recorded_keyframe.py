"""The one recorded keyframe with six cameras and boxes that lies beside the repository, as a scene of one frame."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import shapely.geometry
from scipy.spatial.transform import Rotation

from benchmark.constants import CAMERA_NAMES
from benchmark.geometry import Floats, transform_matrix
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.scene import Agents, Annotations, Camera, EgoTrack, LidarMount, Scene, SweepPoses
from benchmark.untrusted.children import read_pickle

RECORDED = Path(__file__).resolve().parents[5] / "shared" / "data" / "nuscenes"
TABLES = RECORDED / "scene0061_tables_v1.0-test"
FRAME = RECORDED / "scene0061_frame_first"
_CATEGORIES = (
    "vehicle.car",
    "vehicle.truck",
    "vehicle.trailer",
    "vehicle.bus.rigid",
    "vehicle.construction",
    "vehicle.bicycle",
    "vehicle.motorcycle",
    "human.pedestrian.adult",
    "movable_object.trafficcone",
    "movable_object.barrier",
)


def table(name: str) -> dict[str, dict[str, Any]]:
    """Rows of a table by token."""
    return {row["token"]: row for row in json.loads((TABLES / f"{name}.json").read_text())}


def official_info() -> dict[str, Any]:
    """What the official converter of mmdet3d made of the keyframe."""
    info: dict[str, Any] = read_pickle(FRAME / "mmdet3d_demo_info.pkl")["data_list"][0]
    return info


def recorded_scene() -> Scene:
    """The keyframe with its real calibration, ego poses of each sensor, boxes and drivable area."""
    sensors = {row["token"]: row["channel"] for row in table("sensor").values()}
    mounts, poses = {}, {}
    for row in table("sample_data").values():
        mount = table("calibrated_sensor")[row["calibrated_sensor_token"]]
        channel = sensors[mount["sensor_token"]]
        mounts[channel], poses[channel] = mount, table("ego_pose")[row["ego_pose_token"]]
    placed = {
        channel: transform_matrix(poses[channel]["rotation"], poses[channel]["translation"])
        @ transform_matrix(mounts[channel]["rotation"], mounts[channel]["translation"])
        for channel in mounts
    }
    cameras = tuple(
        Camera(
            name,
            np.array(mounts[name]["translation"]),
            np.array(mounts[name]["rotation"]),
            np.array(mounts[name]["camera_intrinsic"]),
            1600,
            900,
        )
        for name in CAMERA_NAMES
    )
    lidar = LidarMount(np.array(mounts["LIDAR_TOP"]["translation"]), np.array(mounts["LIDAR_TOP"]["rotation"]))
    ego = EgoTrack(
        np.array([poses["LIDAR_TOP"]["translation"]], np.float64), np.array([poses["LIDAR_TOP"]["rotation"]])
    )
    agents, annotations = _objects(placed["LIDAR_TOP"])
    area = json.loads((RECORDED / "maps" / "devkit_tests" / "onenorth_drivable_area.json").read_text())
    return Scene(
        name="scene-0061",
        token="recorded",
        description="Parked truck, construction, intersection, turn left, following a van",
        log="n015",
        vehicle="n015",
        date="2018-07-24",
        timestamps_us=np.array([1532402927647951], dtype=np.int64),
        keyframes=np.array([0], dtype=np.int64),
        ego=ego,
        agents=agents,
        annotations=annotations,
        cameras=cameras,
        lidar=lidar,
        road_map=RoadMap("singapore-onenorth", _drivable(area)),
        sweep_poses=SweepPoses(placed["LIDAR_TOP"][None], np.stack([placed[name] for name in CAMERA_NAMES])[:, None]),
    )


def _drivable(area: Any) -> shapely.MultiPolygon:
    """The polygons of a GeoJSON geometry."""
    whole = shapely.union_all([part.buffer(0) for part in shapely.geometry.shape(area).geoms])
    return as_multipolygon(whole)


def _objects(global_T_lidar: Floats) -> tuple[Agents, Annotations]:
    """Official boxes (centre, length, width, height, yaw in the lidar frame), moved to the global frame."""
    rows = official_info()["instances"]
    boxes = np.array([row["bbox_3d"] for row in rows], np.float64)
    position = boxes[:, :3] @ global_T_lidar[:3, :3].T + global_T_lidar[:3, 3]
    turned = Rotation.from_matrix(global_T_lidar[:3, :3]) * Rotation.from_euler("z", boxes[:, 6:])
    rotation = turned.as_quat()[:, [3, 0, 1, 2]]
    heading = turned.as_matrix()[:, :2, 0]
    count = len(rows)
    valid = np.ones((count, 1), dtype=np.bool_)
    agents = Agents(
        ids=tuple(f"object-{number:03d}" for number in range(count)),
        categories=tuple(_CATEGORIES[row["bbox_label_3d"]] for row in rows),
        position=position[:, None],
        yaw=np.arctan2(heading[:, 1], heading[:, 0])[:, None],
        size=boxes[:, 3:6],
        valid=valid,
    )
    annotations = Annotations(
        position=position[:, None],
        rotation=rotation[:, None],
        size=boxes[:, None, 3:6],
        valid=valid,
        attribute=np.full((count, 1), ""),
        visibility=np.full((count, 1), 4),
        num_lidar_pts=np.array([[row["num_lidar_pts"]] for row in rows]),
        num_radar_pts=np.array([[row["num_radar_pts"]] for row in rows]),
    )
    return agents, annotations
