"""Logs as they are read here, against py123d's own reading of them."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats, yaw_of_quaternion
from benchmark.untrusted.files import PICTURE
from benchmark.untrusted.http_images import decode_picture
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder
from generation.extensions.logs123d.cameras import read_lens
from generation.extensions.logs123d.images import LogImages
from generation.extensions.logs123d.key_frames import choose_key_frames
from generation.extensions.logs123d.labels import find_label_class, name_label
from generation.extensions.logs123d.log_files import BOXES, EGO, LogTables, find_map, read_boxes, read_log
from generation.extensions.logs123d.log_scene import EgoBody, LogCamera, build_log_scene
from generation.extensions.logs123d.poses import compose

EXPECTED = "expected.json"


def compare_logs(comparison: Comparison, golden: GoldenFolder) -> None:
    """Ego, boxes, cameras, images, times and key frames of every log."""
    for title, expected in sorted(golden.facts(EXPECTED)["logs"].items()):
        comparison.where = title
        log = read_log(find_folder(golden, title))
        metadata = dict(log.sync.metadata)
        comparison.verdicts("log: metadata", [metadata[name] != value for name, value in expected["log"].items()])
        found = find_map(log, golden.path / "maps")
        place = None if found is None else found.relative_to(golden.path).as_posix()
        comparison.verdicts("log: map", place != expected["map"])
        frames = expected["frames"]
        times = log.times_us()
        comparison.same("log: times of frames", times, [frame["timestamp_us"] for frame in frames])
        comparison.same("log: key frames", choose_key_frames(times), expected["keyframes_2hz"])
        _compare_times(comparison, log, expected["times"], expected["rows"])
        _compare_ego(comparison, log, expected)
        _compare_boxes(comparison, log, expected)
        _compare_cameras(comparison, log, golden, expected)


def find_folder(golden: GoldenFolder, title: str) -> Path:
    """Folder of a log of a set."""
    folder = golden.path / "logs" / title
    if ".." in Path(title).parts or not folder.is_dir():
        raise InputError(f"{golden.path} has no log {title}, which {EXPECTED} names; get the set again")
    return folder


def close(comparison: Comparison, quantity: str, ours: Any, golden: Any) -> None:
    """Compare numbers to 2e-6, or to 1e-7 of their size where that is more."""
    ours, golden = np.asarray(ours, np.float64), np.asarray(golden, np.float64)
    if ours.shape != golden.shape:
        raise ValueError(f"{quantity}: shapes {ours.shape} and {golden.shape}")
    comparison.errors(quantity, (ours - golden) / np.maximum(1.0, 0.05 * np.abs(golden)))


def close_poses(comparison: Comparison, what: str, ours: Floats, golden: Any) -> None:
    """Compare (..., 7) poses; a quaternion and its negative are one rotation."""
    ours, golden = np.asarray(ours, np.float64).reshape(-1, 7), np.asarray(golden, np.float64).reshape(-1, 7)
    if ours.shape != golden.shape:
        raise ValueError(f"{what}: {len(ours)} and {len(golden)} poses")
    comparison.errors(f"{what}: position", ours[:, :3] - golden[:, :3])
    turns = [each[:, 3:] / np.linalg.norm(each[:, 3:], axis=1, keepdims=True) for each in (ours, golden)]
    apart = [np.abs(turns[0] - sign * turns[1]).max(axis=1, initial=0.0) for sign in (1.0, -1.0)]
    comparison.errors(f"{what}: rotation", np.minimum(*apart))


def _compare_times(
    comparison: Comparison, log: LogTables, times: Mapping[str, list[int]], rows: Mapping[str, int]
) -> None:
    for key, expected in times.items():
        named = log.rows_of(key)
        named = named[named >= 0]
        ours = log.others[key].times_us()[named.min() : named.max() + 1]
        comparison.verdicts("log: times of rows", not np.array_equal(ours, expected))
        comparison.verdicts("log: number of rows", log.others[key].rows != rows[key])


def _compare_ego(comparison: Comparison, log: LogTables, expected: Mapping[str, Any]) -> None:
    table, golden = log.others[EGO], expected["ego"]
    body, frames = EgoBody.of(table), [frame["ego"] for frame in expected["frames"]]
    rows = log.rows_of(EGO)
    comparison.verdicts("ego: rows", [(row < 0) != (frame is None) for row, frame in zip(rows, frames, strict=True)])
    rows, frames = rows[rows >= 0], [frame for frame in frames if frame is not None]
    comparison.verdicts("ego: vehicle", table.metadata["vehicle_name"] != golden["vehicle_name"])
    for name in ("length", "width", "height", "wheel_base"):
        close(comparison, "ego: size", table.number(name), golden[name])
    close_poses(comparison, "ego: parts", body.centre, golden["center_to_imu_se3"])
    close_poses(comparison, "ego: parts", body.rear_axle, golden["rear_axle_to_imu_se3"])
    comparison.same("ego: times", body.times_us[rows], [frame["timestamp_us"] for frame in frames])
    imu = body.imu[rows]
    close_poses(comparison, "ego: IMU", imu, [frame["imu_se3"] for frame in frames])
    close_poses(comparison, "ego: rear axle", compose(imu, body.rear_axle), [one["rear_axle_se3"] for one in frames])
    close_poses(comparison, "ego: centre", compose(imu, body.centre), [frame["center_se3"] for frame in frames])
    # At its own times a row is what is interpolated there.
    close_poses(comparison, "ego: interpolated", body.base_at(body.times_us[rows]), compose(imu, body.base))
    known = [(row, one["dynamic_state"]) for row, one in zip(rows.tolist(), frames) if one["dynamic_state"] is not None]
    dynamics = table.poses("dynamic_state_se3", 9)[[row for row, _ in known]]
    close(comparison, "ego: motion", dynamics, np.array([state for _, state in known]).reshape(-1, 9))


def _compare_boxes(comparison: Comparison, log: LogTables, expected: Mapping[str, Any]) -> None:
    table = log.others[BOXES]
    boxes, label_class = read_boxes(table), find_label_class(table)
    comparison.verdicts("boxes: label class", label_class != expected["label_class"])
    for row, frame in zip(log.rows_of(BOXES).tolist(), expected["frames"], strict=True):
        golden = frame["boxes"]["items"] if frame["boxes"] is not None else []
        here = np.flatnonzero(boxes.row == row) if row >= 0 else np.zeros(0, np.int64)
        comparison.same("boxes: tracks in order", [boxes.track[one] for one in here], [one["track"] for one in golden])
        codes = boxes.label[here].tolist()
        comparison.same("boxes: codes", codes, [one["code"] for one in golden])
        names = [name_label(label_class, code, table) for code in codes]
        comparison.same("boxes: labels", names, [(one["label"], one["default"]) for one in golden])
        points = [-1 if one["points"] is None else one["points"] for one in golden]
        comparison.same("boxes: points", boxes.points[here], points)
        box = boxes.box[here]
        close_poses(comparison, "boxes", box[:, :7], [[*one["center"], *one["rotation"]] for one in golden])
        close(comparison, "boxes: size", box[:, 7:], np.array([one["size_lwh"] for one in golden]).reshape(-1, 3))
        comparison.numbers("boxes: yaw", yaw_of_quaternion(box[:, 3:7]), [one["yaw"] for one in golden], angle=True)
        moving = [(place, one["velocity"]) for place, one in enumerate(golden) if one["velocity"] is not None]
        velocity = boxes.velocity[here][[place for place, _ in moving]]
        close(comparison, "boxes: velocity", velocity, np.array([one for _, one in moving]).reshape(-1, 3))


def _compare_cameras(comparison: Comparison, log: LogTables, golden: GoldenFolder, expected: Mapping[str, Any]) -> None:
    source = build_log_scene(log, golden.path / "maps", images=True)
    images = LogImages.of(source, golden.path / "sensors" / "nuscenes")
    comparison.same("cameras: files", log.cameras, sorted(expected["cameras"]))
    for camera in source.cameras:
        facts, lens = expected["cameras"][camera.key], camera.lens
        given = camera.table.metadata
        said = [lens.name, given["camera_id"], given.get("camera_model", "pinhole"), given["is_undistorted"]]
        said += [*lens.size, camera.table.types["data"]]
        names = ("name", "id", "model", "is_undistorted", "width", "height", "storage")
        comparison.verdicts("cameras: metadata", [one != facts[name] for one, name in zip(said, names, strict=True)])
        again = read_lens(camera.table)
        assert again is not None
        close(comparison, "cameras: matrix", again.matrix, facts["matrix"])
        close(comparison, "cameras: distortion", given["distortion"] or [], facts["distortion"] or [])
        close_poses(comparison, "cameras: place", lens.camera_to_imu, facts["camera_to_imu_se3"])
        views = np.array(lens.view_deg()), np.array([facts["view_yaw_deg"], facts["view_pitch_deg"]])
        comparison.numbers("cameras: view", (views[0] - views[1] + 180) % 360 - 180, np.zeros(2))
        _compare_images(comparison, log, images, camera, [frame["cameras"][camera.key] for frame in expected["frames"]])


def _compare_images(
    comparison: Comparison, log: LogTables, images: LogImages, camera: LogCamera, frames: list[Any]
) -> None:
    rows = log.rows_of(camera.key)
    comparison.verdicts("images: there", [(row < 0) != (one is None) for row, one in zip(rows, frames, strict=True)])
    rows, frames = rows[rows >= 0], [frame for frame in frames if frame is not None]
    times = camera.table.times_us()[rows]
    comparison.same("images: times", times, [frame["timestamp_us"] for frame in frames])
    close_poses(comparison, "images", camera.in_world[rows], [frame["camera_to_global_se3"] for frame in frames])
    for data, frame in zip(images.read(camera, rows.tolist()), frames, strict=True):
        image = decode_picture(io.BytesIO(data), PICTURE)
        comparison.same("images: size", image.shape[:2], frame["image_hw"])
        comparison.numbers("images: mean colour", image.reshape(-1, 3).mean(axis=0), frame["mean_rgb"])
