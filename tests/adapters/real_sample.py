"""The first keyframe of the real scene-0061 as a complete root: real images, calibration, poses and boxes.

The shared tables lack four of the thirteen; they are completed here, the boxes from another project's info file.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.geometry import Floats, quaternion_from_yaw, transform_matrix
from benchmark.untrusted.children import read_pickle

NUSCENES = Path(__file__).resolve().parents[3] / "shared" / "data" / "nuscenes"
FRAME = NUSCENES / "scene0061_frame_first"
TABLES = NUSCENES / "scene0061_tables_v1.0-test"
SCENE = "scene-0061"


def info() -> dict[str, Any]:
    """The keyframe as mmdetection3d describes it."""
    entry: dict[str, Any] = read_pickle(FRAME / "mmdet3d_demo_info.pkl")["data_list"][0]
    return entry


def boxes_in_lidar() -> Floats:
    """(N, 7) x, y, z of the centre, length, width, height, yaw from +x, in the lidar frame."""
    return np.array([instance["bbox_3d"] for instance in info()["instances"]], dtype=np.float64)


def real_root(root: Path) -> NuScenesData:
    """Write the root; images are links to the shared ones."""
    tables = {name: _read(name) for name in NUSCENES_TABLES}
    sample, scene = tables["sample"][0], tables["scene"][0]
    sample |= {"prev": "", "next": ""}
    scene |= {"nbr_samples": 1, "first_sample_token": sample["token"], "last_sample_token": sample["token"]}
    for row in tables["sample_data"]:
        row |= {"prev": "", "next": ""}
        source = FRAME / Path(row["filename"]).parent.name / Path(row["filename"]).name
        target = root / row["filename"]
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(source)
    tables["log"] = [
        {
            "token": scene["log_token"],
            "logfile": "n015-2018-07-24-11-22-45+0800",
            "vehicle": "n015",
            "date_captured": "2018-07-24",
            "location": "singapore-onenorth",
        }
    ]
    tables["map"] = [{"token": "map", "log_tokens": [scene["log_token"]], "category": "", "filename": "maps/mask.png"}]
    (root / "maps").mkdir()
    Image.new("L", (8, 8)).save(root / "maps" / "mask.png")
    _annotate(tables, sample["token"])
    folder = root / "v1.0-real"
    folder.mkdir(parents=True)
    for name, rows in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(rows))
    return NuScenesData.open(root)


def _annotate(tables: dict[str, list[dict[str, Any]]], sample: str) -> None:
    lidar = next(row for row in tables["sample_data"] if "LIDAR_TOP" in row["filename"])
    pose = _row(tables["ego_pose"], lidar["ego_pose_token"])
    mount = _row(tables["calibrated_sensor"], lidar["calibrated_sensor_token"])
    to_global = transform_matrix(pose["rotation"], pose["translation"]) @ transform_matrix(
        mount["rotation"], mount["translation"]
    )
    heading_of_lidar = float(np.arctan2(to_global[1, 0], to_global[0, 0]))
    category = next(row["token"] for row in tables["category"] if row["name"] == "vehicle.car")
    for number, box in enumerate(boxes_in_lidar()):
        annotation, instance = f"annotation-{number}", f"instance-{number}"
        tables["instance"].append(
            {
                "token": instance,
                "category_token": category,
                "nbr_annotations": 1,
                "first_annotation_token": annotation,
                "last_annotation_token": annotation,
            }
        )
        tables["sample_annotation"].append(
            {
                "token": annotation,
                "sample_token": sample,
                "instance_token": instance,
                "visibility_token": "4",
                "attribute_tokens": [],
                "translation": (to_global @ [*box[:3], 1.0])[:3].tolist(),
                "size": [box[4], box[3], box[5]],
                "rotation": quaternion_from_yaw(np.array(box[6] + heading_of_lidar)).tolist(),
                "num_lidar_pts": 1,
                "num_radar_pts": 0,
                "prev": "",
                "next": "",
            }
        )


def _read(name: str) -> list[dict[str, Any]]:
    path = TABLES / f"{name}.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text()) if path.exists() else []
    return rows


def _row(rows: list[dict[str, Any]], token: str) -> dict[str, Any]:
    return next(row for row in rows if row["token"] == token)
