"""Small 123D logs, written as py123d 0.7 writes them: a car that drives east on a two-way road, seen by two cameras."""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from PIL import Image

from benchmark.geometry import quaternion_from_yaw
from generation.extensions.logs123d.poses import compose

SPEED = 8.0
STEP_US = 100_000
WEST_FIRST_X = -300.0
CAMERA_DELAY_US = 30_000
AHEAD = (0.5, -0.5, 0.5, -0.5)
"""A camera that looks along x."""
BACKLESS = {"pcam_f0": ("front", 0.0), "pcam_l0": ("left", 60.0)}


@dataclass(frozen=True)
class MadeLog:
    """What a made log is like; parts of it are replaced to be told apart."""

    dataset: str = "carla"
    split: str = "carla_train"
    name: str = "drive-1"
    location: str | None = "Town01"
    version: str = "0.7.0"
    frames: int = 21
    first_us: int = 0
    cameras: Mapping[str, tuple[str, float]] = field(default_factory=lambda: dict(BACKLESS))
    camera_metadata: Mapping[str, Any] = field(default_factory=dict)
    lacking: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    null_poses: bool = False
    storage: str = "binary"
    label_class: str = "py123d.parser.registry.DefaultBoxDetectionLabel"
    own_map: bool = True
    boxes: bool = True

    def write(self, data: Path) -> Path:
        """Write it below a DATA folder; the folder of the log."""
        folder = data / "logs" / self.split / self.name
        folder.mkdir(parents=True)
        metadata = {name: getattr(self, name) for name in ("dataset", "split", "location", "version")}
        metadata |= {"log_name": self.name, "map_metadata": None}
        columns: dict[str, Any] = {"sync.timestamp_us": self.times}
        for key in ("ego_state_se3", *(["box_detections_se3"] if self.boxes else [])):
            columns[key] = list(range(self.frames))
        for key in self.cameras:
            rows = iter(range(self.frames))
            lacking = self.lacking.get(key, ())
            columns[f"camera.{key}"] = [None if frame in lacking else next(rows) for frame in range(self.frames)]
            self._write_camera(folder, key)
        write_arrow(folder / "sync.arrow", columns, metadata)
        self._write_ego(folder)
        if self.boxes:
            self._write_boxes(folder)
        if self.own_map:
            write_arrow(folder / "map.arrow", road(), {"dataset": self.dataset, "map_is_per_log": True})
        return folder

    @property
    def times(self) -> list[int]:
        return [self.first_us + STEP_US * frame for frame in range(self.frames)]

    def ego_pose(self, time_us: int) -> list[float]:
        """Pose of the IMU frame."""
        return [WEST_FIRST_X + SPEED * (time_us - self.first_us) * 1e-6, -1.75, 10.0, 1.0, 0.0, 0.0, 0.0]

    def _write_ego(self, folder: Path) -> None:
        metadata = {
            "vehicle_name": "made", "length": 4.9, "width": 1.8, "height": 1.5, "wheel_base": 2.8,
            "center_to_imu_se3": [1.4, 0.0, 0.45, 1.0, 0.0, 0.0, 0.0],
            "rear_axle_to_imu_se3": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        }  # fmt: skip
        key = "ego_state_se3"
        columns = {
            f"{key}.timestamp_us": self.times,
            f"{key}.imu_se3": ("fixed", 7, [self.ego_pose(time) for time in self.times]),
            f"{key}.dynamic_state_se3": ("fixed", 9, [[SPEED] + [0.0] * 8] * self.frames),
        }
        write_arrow(folder / f"{key}.arrow", columns, metadata)

    def _write_boxes(self, folder: Path) -> None:
        """A car ahead, one that comes, and a sign."""
        key = "box_detections_se3"
        oncoming = quaternion_from_yaw(np.array(np.pi)).tolist()
        boxes = [
            [
                [-270.0 + SPEED * 0.1 * frame, -1.75, 10.5, 1.0, 0.0, 0.0, 0.0, 4.5, 1.8, 1.5],
                [-200.0 - SPEED * 0.1 * frame, 1.75, 10.5, *oncoming, 8.0, 2.5, 3.0],
                [-250.0, -6.0, 11.0, 1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 2.0],
            ]
            for frame in range(self.frames)
        ]
        columns = {
            f"{key}.timestamp_us": self.times,
            f"{key}.bounding_box_se3": ("lists", 10, boxes),
            f"{key}.track_token": [["ahead", "coming", "sign"]] * self.frames,
            f"{key}.label": ("labels", 0, [[1, 1, 6]] * self.frames),
            f"{key}.num_lidar_points": ("points", 0, [None] * self.frames),
        }
        write_arrow(folder / f"{key}.arrow", columns, {"box_detection_label_class": self.label_class})

    def mount(self, yaw_deg: float) -> list[float]:
        """Pose of a camera in the IMU frame."""
        turn = np.array([1.5, 0.0, 1.2, *quaternion_from_yaw(np.radians(yaw_deg)).tolist()])
        return [float(one) for one in compose(turn, np.array([0.0, 0.0, 0.0, *AHEAD]))]

    def _write_camera(self, folder: Path, key: str) -> None:
        name, yaw = self.cameras[key]
        mount, lacking = self.mount(yaw), self.lacking.get(key, ())
        times = [time + CAMERA_DELAY_US for frame, time in enumerate(self.times) if frame not in lacking]
        poses = [
            None if self.null_poses else list(compose(np.array(self.ego_pose(at)), np.array(mount))) for at in times
        ]
        metadata = {
            "camera_model": "pinhole", "camera_name": name, "camera_id": 0, "intrinsics": [50.0, 50.0, 32.0, 24.0, 0.0],
            "distortion": None, "width": 64, "height": 48, "camera_to_imu_se3": mount, "is_undistorted": True,
            **self.camera_metadata,
        }  # fmt: skip
        data: Any = [picture(row) for row in range(len(times))]
        if self.storage == "string":
            data = [f"{name}/{row:03d}.jpg" for row in range(len(times))]
        if self.storage == "int32":
            data = ("frames", 0, list(range(len(times))))
        columns = {
            f"camera.{key}.timestamp_us": times,
            f"camera.{key}.data": data,
            f"camera.{key}.camera_to_global_se3": ("fixed", 7, poses),
        }
        write_arrow(folder / f"camera.{key}.arrow", columns, metadata, rows_per_batch=10)


def picture(row: int, width: int = 64, height: int = 48) -> bytes:
    """A JPEG file of one shade, brighter by the row."""
    stream = io.BytesIO()
    Image.new("RGB", (width, height), (10 * row % 256, 80, 40)).save(stream, "JPEG", quality=95)
    return stream.getvalue()


def write_arrow(path: Path, columns: Mapping[str, Any], metadata: Any, *, rows_per_batch: int = 1000) -> None:
    """Write an Arrow file whose schema has metadata in MessagePack."""
    import msgpack
    import pyarrow as pa

    kinds: dict[str, Callable[[int], Any]] = {
        "fixed": lambda width: pa.list_(pa.float64(), width),
        "lists": lambda width: pa.list_(pa.list_(pa.float64(), width)),
        "labels": lambda _: pa.list_(pa.uint16()),
        "points": lambda _: pa.list_(pa.int32()),
        "frames": lambda _: pa.int32(),
        "layers": lambda _: pa.int8(),
    }
    arrays = {
        name: pa.array(given[2], kinds[given[0]](given[1])) if isinstance(given, tuple) else pa.array(given)
        for name, given in columns.items()
    }
    table = pa.table(arrays).replace_schema_metadata({b"metadata": msgpack.packb(metadata)})
    with pa.ipc.new_file(str(path), table.schema) as writer:
        writer.write_table(table, max_chunksize=rows_per_batch)


def array(values: Any) -> dict[Any, Any]:
    """An array as features of maps hold it."""
    numbers = np.asarray(values, "<f8")
    return {
        b"__ndarray__": True, b"dtype": "<f8", b"shape": list(numbers.shape), b"data": numbers.tobytes()
    }  # fmt: skip


def road() -> dict[str, Any]:
    """Two lanes along x that drive opposite ways, a bicycle lane, and a drivable area with a hole.

    Either lane's left neighbour is the other. A white line lies between them, another right of the first.
    """
    import msgpack

    low, high = WEST_FIRST_X - 100.0, WEST_FIRST_X + 250.0
    east, west = [[low, -1.75], [high, -1.75]], [[high, 1.75], [low, 1.75]]
    middle, right = [[low, 0.0], [high, 0.0]], [[low, -3.5], [high, -3.5]]
    bicycles = [[low, -4.2], [high, -4.2]]
    hole = shapely.box(low + 20, 4.0, low + 30, 8.0)
    rows: list[tuple[int, int, dict[str, Any], shapely.Geometry]] = []

    def lane(identifier: int, line: Any, left: Any, sides: tuple[Any, Any], kind: int, shape: Any) -> None:
        features = {
            "lane_type": kind, "lane_group_id": 0, "left_boundary": array(sides[0]), "right_boundary": array(sides[1]),
            "centerline": array(line), "left_lane_id": left, "right_lane_id": None, "predecessor_ids": [],
            "successor_ids": [99], "speed_limit_mps": float("nan"), "outline": array(outline(shape)),
        }  # fmt: skip
        rows.append((0, identifier, features, shape))

    lane(0, east, 1, (middle, right), 2, shapely.box(low, -3.5, high, 0.0))
    lane(1, west, 0, (middle[::-1], [[high, 3.5], [low, 3.5]]), 2, shapely.box(low, 0.0, high, 3.5))
    lane(2, bicycles, None, (right, right), 3, shapely.box(low, -5.0, high, -3.5))
    area = shapely.box(low, -5.0, high, 10.0).difference(hole)
    rows.append((6, 0, {"outline": array(outline(area))}, area))
    for identifier, line in enumerate((middle, right)):
        rows.append((9, identifier, {"road_line_type": 11}, shapely.LineString(line)))
    return {
        "object_id": [row[1] for row in rows],
        "map_layer": ("layers", 0, [row[0] for row in rows]),
        "features": [msgpack.packb(row[2]) for row in rows],
        "wkb": [shapely.to_wkb(row[3]) for row in rows],
    }


def outline(shape: Any) -> Any:
    """The ring around a shape with heights, which leaves holes out."""
    return np.column_stack([shapely.get_coordinates(shape.exterior), np.zeros(len(shape.exterior.coords))])


def renamed(log: MadeLog, number: int) -> MadeLog:
    """The same under another name."""
    return replace(log, name=f"drive-{number}")
