from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyquaternion import Quaternion

from benchmark.constants import CAMERA_NAMES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.geometry import transform_matrix, yaw_of_quaternion
from benchmark.scene import Scene
from generation.extensions.magicdrive.clip import build_box_tracks, interpolate_annotations, slerp
from generation.extensions.magicdrive.sensor_frames import SensorFrames, compute_ego_motion
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.generation.extensions.magicdrive.busy_scenes import as_recording, busy_scene
from tests.generation.nuscenes_writer.written_roots import with_adversary

quaternions = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)


@given(first=quaternions, second=quaternions, fraction=st.floats(0, 1))
@settings(max_examples=25, deadline=None)
def test_rotations_go_along_great_arcs(first: list[float], second: list[float], fraction: float) -> None:
    start, end = Quaternion(first).normalised, Quaternion(second).normalised
    if abs(np.dot(start.elements, end.elements)) < 1e-3:
        return  # Opposite directions: both ways round are as short.
    slow = Quaternion.slerp(start, end, fraction).elements
    found = slerp(np.array(first), np.array(second), np.array(fraction))
    # The oracle itself takes the chord of arcs of less than two degrees.
    assert abs(found @ slow) == pytest.approx(1.0, abs=1e-6)


def uneven_scene() -> Scene:
    """Annotations with gaps, tilts, changing sizes and headings across the seam at 180 degrees."""
    scene = busy_scene(25 / 12)
    known = scene.annotations
    rng = np.random.default_rng(4)
    valid = rng.random(known.valid.shape) < 0.75
    valid[:, 0] = True
    rotation = rng.normal(size=known.rotation.shape) * [1.0, 0.05, 0.05, 1.0]
    rotation /= np.linalg.norm(rotation, axis=-1, keepdims=True)
    size = known.size * rng.uniform(0.9, 1.1, known.size.shape)
    position = known.position + rng.normal(size=known.position.shape)
    known = replace(known, valid=valid, rotation=rotation, size=size, position=position)
    return replace(scene, annotations=known)


def test_boxes_between_keyframes_agree_with_a_slow_interpolation() -> None:
    scene = uneven_scene()
    frames = np.arange(len(scene.timestamps_us))
    found, known = interpolate_annotations(scene, frames), scene.annotations
    for agent in range(len(scene.agents)):
        for frame in frames.tolist():
            key, step = divmod(frame, 6)
            if step == 0:
                assert found.valid[agent, frame] == known.valid[agent, key]
                expected = (known.position[agent, key], Quaternion(known.rotation[agent, key]))
            else:
                assert found.valid[agent, frame] == (known.valid[agent, key] and known.valid[agent, key + 1])
                share = step / 6
                start, end = known.position[agent, key], known.position[agent, key + 1]
                turns = (Quaternion(known.rotation[agent, at]) for at in (key, key + 1))
                expected = ((1 - share) * start + share * end, Quaternion.slerp(*turns, share))
            np.testing.assert_allclose(found.position[agent, frame], expected[0], atol=1e-9)
            assert abs(found.rotation[agent, frame] @ expected[1].elements) == pytest.approx(1.0, abs=1e-6)
            np.testing.assert_array_equal(found.size[agent, frame], known.size[agent, key])


def test_what_was_simulated_is_taken_as_it_is() -> None:
    scene = with_adversary(busy_scene(25 / 12), 1)
    swerving = scene.agents.position.copy()
    swerving[1, :, 1] += np.sin(np.arange(25))
    scene = replace(scene, agents=replace(scene.agents, position=swerving))
    frames = np.arange(25)
    assert np.array_equal(build_box_tracks(scene, frames).position, scene.agents.position)
    recording = build_box_tracks(as_recording(scene), frames)
    assert np.array_equal(recording.position[1], swerving[1])
    assert not np.array_equal(interpolate_annotations(scene, frames).position[1], swerving[1])


def test_the_data_set_reader_interpolates_the_same_way(tmp_path: Path) -> None:
    written = busy_scene(25 / 12)
    rows = TinyRoot.of(tmp_path, [written], cameras=CAMERA_NAMES)
    scene = NuScenesData.open(rows.write()).scene(written.name)
    assert scene.sweep_poses is not None
    frames = np.arange(len(scene.timestamps_us))
    tracks = interpolate_annotations(scene, frames)
    np.testing.assert_array_equal(tracks.valid, scene.agents.valid)
    np.testing.assert_allclose(tracks.position, scene.agents.position, atol=1e-9)
    turned = yaw_of_quaternion(tracks.rotation) - scene.agents.yaw
    np.testing.assert_allclose(np.cos(turned), 1.0, atol=1e-9)
    # All sensors of this data set share the ego pose of the frame.
    swept, shared = (SensorFrames.of(world, frames) for world in (scene, replace(scene, sweep_poses=None)))
    np.testing.assert_allclose(swept.lidar, shared.lidar, atol=1e-9)
    np.testing.assert_allclose(swept.cameras, shared.cameras, atol=1e-9)
    np.testing.assert_array_equal(swept.intrinsics, shared.intrinsics)


SPEED = 8.0


def recording_with_clocks(root: Path) -> tuple[TinyRoot, Scene]:
    """Keyframes only, then a 20 Hz lidar and 12 Hz cameras that fire 40 ms early."""
    written = busy_scene(19 / 12)
    rows = TinyRoot.of(root, [written], cameras=CAMERA_NAMES, sweeps=False)
    add_sweeps(rows, "LIDAR_TOP", period_s=0.05, count=9, lead_s=0.0)
    for camera in CAMERA_NAMES:
        add_sweeps(rows, camera, period_s=1 / 12, count=5, lead_s=0.04)
    return rows, written


def add_sweeps(rows: TinyRoot, channel: str, *, period_s: float, count: int, lead_s: float) -> None:
    """Sweeps of an ego that goes along +x, linked between the keyframes."""
    keys = [row for row in rows.tables["sample_data"] if f"-{channel}-" in row["token"]]
    for key in keys:
        pose = rows.row("ego_pose", key["ego_pose_token"])
        pose["translation"][0] -= lead_s * SPEED
        start, chain = pose["translation"], [key]
        if not key["next"]:
            continue
        for number in range(1, count + 1):
            token = f"{key['token']}+{number}"
            at = [start[0] + SPEED * number * period_s, *start[1:]]
            time_us = key["timestamp"] + round(number * period_s * 1e6)
            rows.tables["ego_pose"].append({**pose, "token": token, "translation": at, "timestamp": time_us})
            sweep: dict[str, Any] = {
                **key, "token": token, "ego_pose_token": token, "is_key_frame": False,
                "timestamp": time_us, "filename": f"sweeps/{token}",
            }  # fmt: skip
            rows.tables["sample_data"].append(sweep)
            chain.append(sweep)
        following = rows.row("sample_data", key["next"])
        for earlier, later in zip(chain, [*chain[1:], following]):
            earlier["next"], later["prev"] = later["token"], earlier["token"]


def test_each_sensor_stands_where_its_sweep_was_taken(tmp_path: Path) -> None:
    rows, written = recording_with_clocks(tmp_path)
    scene = NuScenesData.open(rows.write()).scene(written.name)
    frames = np.arange(19)
    sensors = SensorFrames.of(scene, frames)
    lidar = transform_matrix(written.lidar.rotation, written.lidar.translation)
    key, step = np.divmod(frames, 6)
    x = written.ego.position[0, 0] + SPEED * (0.5 * key + 0.05 * step) + lidar[0, 3]
    np.testing.assert_allclose(sensors.lidar[:, 0, 3], x, atol=1e-6)
    # Five short steps and a long one, in the lidar's y.
    steps = -np.diff(np.linalg.inv(compute_ego_motion(sensors).astype(np.float64))[:, 1, 3])
    np.testing.assert_allclose(np.abs(steps), SPEED * np.array([0.05, 0.05, 0.05, 0.05, 0.05, 0.25] * 3), atol=1e-3)
    # The front camera fires early, so it seems to sit further back.
    ahead = np.linalg.norm((sensors.lidar_from_camera[1, 0] - late_camera(written))[:3, 3])
    assert ahead == pytest.approx(0.04 * SPEED, abs=1e-6)
    # Boxes are of the evenly spread frames all the same.
    np.testing.assert_allclose(build_box_tracks(scene, frames).position[0, :, 0], 80.0 + SPEED * frames / 12, atol=1e-5)


def late_camera(scene: Scene) -> Any:
    front = next(camera for camera in scene.cameras if camera.name == "CAM_FRONT")
    lidar = transform_matrix(scene.lidar.rotation, scene.lidar.translation)
    return np.linalg.inv(lidar) @ transform_matrix(front.rotation, front.translation)


def test_short_sweeps_stand_still_and_no_sweeps_are_none(tmp_path: Path) -> None:
    rows, written = recording_with_clocks(tmp_path / "short")
    chain = [row for row in rows.tables["sample_data"] if "-LIDAR_TOP-0+" in row["token"]]
    key = rows.row("sample_data", chain[0]["prev"])
    third, following = chain[2], rows.row("sample_data", chain[-1]["next"])
    third["next"], following["prev"] = following["token"], third["token"]
    gone = {row["token"] for row in chain[3:]}
    rows.tables["sample_data"] = [row for row in rows.tables["sample_data"] if row["token"] not in gone]
    scene = NuScenesData.open(rows.write()).scene(written.name)
    assert scene.sweep_poses is not None
    x = scene.sweep_poses.lidar[:7, 0, 3] - scene.sweep_poses.lidar[0, 0, 3]
    np.testing.assert_allclose(x, SPEED * np.array([0.0, 0.05, 0.1, 0.15, 0.15, 0.15, 0.5]), atol=1e-6)
    assert key["is_key_frame"]

    bare = TinyRoot.of(tmp_path / "bare", [written], cameras=CAMERA_NAMES, sweeps=False)
    scene = NuScenesData.open(bare.write()).scene(written.name)
    assert scene.sweep_poses is None
    assert np.ptp(np.diff(SensorFrames.of(scene, np.arange(19)).lidar[:, 0, 3])) < 1e-4
