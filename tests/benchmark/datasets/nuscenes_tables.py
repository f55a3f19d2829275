"""Small nuScenes-format roots written row by row from hand-made scenes, so that reading is tested without a writer."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmark.constants import NUSCENES_TABLES
from benchmark.scene import Scene

VERSION = "v1.0-tiny"
Row = dict[str, Any]


@dataclass
class TinyRoot:
    """Tables of some scenes, to be changed by a test and then written."""

    root: Path
    version: str = VERSION
    tables: dict[str, list[Row]] = field(default_factory=lambda: {table: [] for table in NUSCENES_TABLES})

    @classmethod
    def of(
        cls,
        root: Path,
        scenes: Sequence[Scene],
        *,
        sweeps: bool = True,
        cameras: Sequence[str] = ("CAM_FRONT",),
        lidar: bool = True,
    ) -> "TinyRoot":
        made = cls(root)
        made._shared()
        for scene in scenes:
            made._scene(scene, sweeps=sweeps, cameras=cameras, lidar=lidar)
        return made

    def write(self) -> Path:
        folder = self.root / self.version
        folder.mkdir(parents=True, exist_ok=True)
        for table, rows in self.tables.items():
            (folder / f"{table}.json").write_text(json.dumps(rows))
        (self.root / "maps").mkdir(exist_ok=True)
        Image.new("L", (8, 8)).save(self.root / "maps" / "mask.png")
        return self.root

    def write_images(self, size: tuple[int, int] = (16, 9)) -> None:
        for row in self.tables["sample_data"]:
            if row["filename"].endswith(".png") and row["is_key_frame"]:
                path = self.root / row["filename"]
                path.parent.mkdir(parents=True, exist_ok=True)
                Image.new("RGB", size, (10, 20, 30)).save(path)

    def row(self, table: str, token: str) -> Row:
        return next(row for row in self.tables[table] if row["token"] == token)

    def _shared(self) -> None:
        self.tables["category"] = [{"token": "cat-vehicle.car", "name": "vehicle.car", "description": ""}]
        self.tables["attribute"] = [{"token": "att-vehicle.moving", "name": "vehicle.moving", "description": ""}]
        self.tables["visibility"] = [{"token": "4", "level": "v80-100", "description": ""}]
        self.tables["map"] = [
            {"token": "map", "log_tokens": ["log"], "category": "semantic_prior", "filename": "maps/mask.png"}
        ]

    def _scene(self, scene: Scene, *, sweeps: bool, cameras: Sequence[str], lidar: bool) -> None:
        name = scene.name
        samples = [f"{name}-sample-{index}" for index in range(len(scene.keyframes))]
        if not self.tables["log"]:
            self.tables["log"].append({
                "token": "log", "logfile": scene.log, "vehicle": scene.vehicle, "date_captured": scene.date,
                "location": scene.road_map.location,
            })  # fmt: skip
        self.tables["scene"].append({
            "token": f"{name}-token", "name": name, "description": scene.description, "log_token": "log",
            "nbr_samples": len(samples), "first_sample_token": samples[0], "last_sample_token": samples[-1],
        })  # fmt: skip
        for index, token in enumerate(samples):
            time_us = int(scene.timestamps_us[scene.keyframes[index]])
            row = {"token": token, "timestamp": time_us, "scene_token": f"{name}-token"}
            self.tables["sample"].append(row | _links(samples, index))
        for channel in (*(("LIDAR_TOP",) if lidar else ()), *cameras):
            self._channel(scene, channel, samples, sweeps=sweeps)
        self._objects(scene, samples)

    def _channel(self, scene: Scene, channel: str, samples: Sequence[str], *, sweeps: bool) -> None:
        camera = next((camera for camera in scene.cameras if camera.name == channel), None)
        mount = camera or scene.lidar
        if channel not in {row["channel"] for row in self.tables["sensor"]}:
            modality = "lidar" if camera is None else "camera"
            self.tables["sensor"].append({"token": channel, "channel": channel, "modality": modality})
        calibration = f"{scene.name}-{channel}"
        self.tables["calibrated_sensor"].append({
            "token": calibration, "sensor_token": channel, "translation": mount.translation.tolist(),
            "rotation": mount.rotation.tolist(), "camera_intrinsic": camera.intrinsic.tolist() if camera else [],
        })  # fmt: skip
        keyframes = scene.keyframes.tolist()
        frames = range(len(scene.timestamps_us)) if sweeps else keyframes
        tokens = [f"{calibration}-{frame}" for frame in frames]
        extension = "png" if camera else "pcd.bin"
        for number, (frame, token) in enumerate(zip(frames, tokens)):
            at_keyframe, time_us = frame in keyframes, int(scene.timestamps_us[frame])
            self.tables["ego_pose"].append({
                "token": token, "timestamp": time_us, "translation": scene.ego.position[frame].tolist(),
                "rotation": scene.ego.rotation[frame].tolist(),
            })  # fmt: skip
            row = {
                "token": token, "sample_token": samples[int(np.searchsorted(keyframes, frame, side="right")) - 1],
                "ego_pose_token": token, "calibrated_sensor_token": calibration, "timestamp": time_us,
                "fileformat": extension.split(".")[0], "is_key_frame": at_keyframe,
                "width": camera.width if camera else 0, "height": camera.height if camera else 0,
                "filename": f"{'samples' if at_keyframe else 'sweeps'}/{channel}/{token}.{extension}",
            }  # fmt: skip
            self.tables["sample_data"].append(row | _links(tokens, number))

    def _objects(self, scene: Scene, samples: Sequence[str]) -> None:
        known = scene.annotations
        for agent, identifier in enumerate(scene.agents.ids):
            at = np.flatnonzero(known.valid[agent]).tolist()
            instance = f"{scene.name}-{identifier}"
            tokens = [f"{instance}-{index}" for index in at]
            self.tables["instance"].append({
                "token": instance, "category_token": "cat-vehicle.car", "nbr_annotations": len(at),
                "first_annotation_token": tokens[0], "last_annotation_token": tokens[-1],
            })  # fmt: skip
            for number, index in enumerate(at):
                length, width, height = known.size[agent, index].tolist()
                row = {
                    "token": tokens[number], "sample_token": samples[index], "instance_token": instance,
                    "visibility_token": "4", "attribute_tokens": ["att-vehicle.moving"],
                    "translation": known.position[agent, index].tolist(), "size": [width, length, height],
                    "rotation": known.rotation[agent, index].tolist(),
                    "num_lidar_pts": int(known.num_lidar_pts[agent, index]),
                    "num_radar_pts": int(known.num_radar_pts[agent, index]),
                }  # fmt: skip
                self.tables["sample_annotation"].append(row | _links(tokens, number))


def _links(tokens: Sequence[str], number: int) -> Row:
    after = tokens[number + 1] if number + 1 < len(tokens) else ""
    return {"prev": tokens[number - 1] if number else "", "next": after}
