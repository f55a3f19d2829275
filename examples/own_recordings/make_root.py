"""A root in nuScenes format from images, poses and boxes, here made up, without the devkit: ``make_root.py ROOT``."""

import json
import sys
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np

ROOT, SAMPLES, SIZE, FOCAL, HIGH = Path(sys.argv[1]), 41, (320, 180), 250.0, 1.4
CAMERAS = {"front": 0, "front_left": 55, "front_right": -55, "rear": 180, "rear_left": 110, "rear_right": -110}
LANES = {"ours": (-1.75, 0.0), "beside": (-5.25, 0.0), "oncoming": (1.75, np.pi)}  # y in metres, heading
OTHERS = {"ahead": ("ours", 25, 8, "car"), "near": ("beside", -6, 9, "car"), "far": ("oncoming", 150, 9, "truck")}
NAMES = {"cameras": "directions", "lidar": [1.0, 0.0, 1.7], "categories": "short", "layers": {"lanes": "lane"}}
NAMES |= {"attributes": {"driving": "vehicle.moving"}, "visibility": {"seen": "v80-100"}}
LAYERS = "node polygon line lanes lane_connector road_segment ped_crossing walkway stop_line carpark_area road_divider"
tables, layers, paths = defaultdict(list), {layer: [] for layer in (*LAYERS.split(), "lane_divider")}, {}


def add(table, token, k=None, **fields):
    """Row of a table, or the k-th of a chain; its token."""
    if k is not None:
        fields |= {"prev": f"{token}-{k - 1}" if k else "", "next": f"{token}-{k + 1}" if k < SAMPLES - 1 else ""}
    tables[table].append({"token": token if k is None else f"{token}-{k}", **fields})
    return tables[table][-1]["token"]


add("log", "log", logfile="log", vehicle="mine", date_captured="2026-01-01", location="my-town")
add("map", "map", category="semantic_prior", filename="maps/mask.png", log_tokens=["log"])
tables |= {"attribute": [{"token": "a", "name": "driving"}], "visibility": [{"token": "v", "level": "seen"}]}
tables["category"] = [{"token": name, "name": name} for name in ("car", "truck")]
box = {"attribute_tokens": ["a"], "visibility_token": "v", "num_lidar_pts": 1, "num_radar_pts": 0, "size": [2, 5, 1.6]}
for camera, degrees in CAMERAS.items():  # yours: calibrations; a quaternion w, x, y, z turns camera axes into car axes
    c, s = np.cos(np.radians(degrees) / 2) / 2, np.sin(np.radians(degrees) / 2) / 2
    mounted = {"translation": [0.0, 0.0, HIGH], "rotation": [c + s, -c - s, c - s, s - c]}
    mounted |= {"camera_intrinsic": [[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]]}
    add("calibrated_sensor", camera, sensor_token=add("sensor", camera, channel=camera, modality="camera"), **mounted)
for number, scene in enumerate(("scene-0001", "scene-0002")):
    ends = {"first_sample_token": f"{scene}-0", "last_sample_token": f"{scene}-{SAMPLES - 1}", "nbr_samples": SAMPLES}
    add("scene", scene, name=scene, description="", log_token="log", **ends)
    for name, (*_, kind) in OTHERS.items():
        ends = {"first_annotation_token": f"{scene}-{name}-0", "last_annotation_token": f"{scene}-{name}-{SAMPLES - 1}"}
        add("instance", f"{scene}-{name}", category_token=kind, nbr_annotations=SAMPLES, **ends)
    for k in range(SAMPLES):  # yours: poses of the rear axle and boxes, in one frame fixed to the world, every 0.5 s
        time = {"timestamp": 1_767_225_600_000_000 + number * 60_000_000 + k * 500_000}
        x, y, sample = (8 - number) * k / 2, LANES["ours"][0], add("sample", scene, k, scene_token=scene, **time)
        add("ego_pose", sample, translation=[x, y, 0.0], rotation=[1.0, 0.0, 0.0, 0.0], **time)
        boxes = {name: (at + v * k / 2 * np.cos(LANES[on][1]), *LANES[on]) for name, (on, at, v, _) in OTHERS.items()}
        for name, (u, v, yaw) in boxes.items():  # centre of the box; width, length, height
            box |= {"translation": [u, v, 0.8], "rotation": [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]}
            add("sample_annotation", f"{scene}-{name}", k, sample_token=sample, instance_token=f"{scene}-{name}", **box)
        for camera, degrees in CAMERAS.items():  # yours: copy or link the image
            picture, c, s = np.full((*SIZE[::-1], 3), 120, np.uint8), *np.exp([1j * np.radians(degrees)]).view(float)
            for u, v, _ in boxes.values():
                ahead, right = (u - x) * c + (v - y) * s, (u - x) * s - (v - y) * c
                if ahead > 3:
                    at = (int(160 + FOCAL * right / ahead), int(90 + 150 / ahead))
                    cv2.circle(picture, at, int(FOCAL / ahead), (40, 40, 160), -1)
            file = {"filename": f"samples/{camera}/{sample}.jpg", "fileformat": "jpg", "is_key_frame": True}
            (ROOT / file["filename"]).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(ROOT / file["filename"]), picture)
            file |= {"width": SIZE[0], "height": SIZE[1], "sample_token": sample, "ego_pose_token": sample, **time}
            add("sample_data", f"{scene}-{camera}", k, calibrated_sensor_token=camera, **file)
for low, high in ((-7.1, 3.5), *((y - 1.75, y + 1.75) for y, _ in LANES.values())):  # yours: roads, if you have a map
    ring = {f"{low}{x}{y}": (x, y) for x, y in ((-100, low), (600, low), (600, high), (-100, high))}
    layers["node"] += [{"token": token, "x": x, "y": y} for token, (x, y) in ring.items()]
    layers["polygon"].append({"token": str(low), "exterior_node_tokens": list(ring), "holes": []})
layers["drivable_area"] = [{"token": "road", "polygon_tokens": ["-7.1"]}]
for name, (y, yaw) in LANES.items():
    layers["lanes"].append({"token": name, "polygon_token": str(y - 1.75)})
    ends = {"start_pose": [250 - 350 * np.cos(yaw), y, yaw], "end_pose": [250 + 350 * np.cos(yaw), y, yaw]}
    paths[name] = [{"shape": "LSR", "radius": 1e3, "segment_length": [0, 700, 0], **ends}]
layers |= {"version": "1.3", "canvas_edge": [1000, 100], "connectivity": {}, "arcline_path_3": paths}
files = {f"v1.0-own/{table}": rows for table, rows in tables.items()} | {"v1.0-own/own_recordings": NAMES}
files |= {"v1.0-own/splits": {"val": ["scene-0001", "scene-0002"]}, "maps/expansion/my-town": layers}
for name, content in files.items():
    (ROOT / name).parent.mkdir(parents=True, exist_ok=True)
    (ROOT / f"{name}.json").write_text(json.dumps(content))
cv2.imwrite(str(ROOT / "maps/mask.png"), np.zeros((8, 8), np.uint8))  # the devkit wants one
