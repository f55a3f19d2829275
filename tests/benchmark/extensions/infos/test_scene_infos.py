"""Infos of small scenes, whose values are known without a computer."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.constants import CAMERA_NAMES, LIDAR_FROM_REAR_AXLE_M
from benchmark.errors import InputError
from benchmark.extensions.infos.ego_trajectory import ConverterCanMessages
from benchmark.extensions.infos.exporting import CONVERTED_PREFIX
from benchmark.extensions.infos.repositories import REPOSITORIES
from benchmark.extensions.infos.scene_infos import classify_goals
from tests.benchmark.extensions.infos.info_roots import SECONDS, exported, plain_root, tilted
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

STEP_M = 4.0
"""The ego of the hand-made scene drives at 8 m/s."""


@pytest.fixture(scope="module")
def infos(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, Any]]]:
    folder = tmp_path_factory.mktemp("infos")
    root = plain_root(folder / "root")
    return {name: exported(root, folder / name, name, as_converted=True) for name in REPOSITORIES}


def test_keys_stand_in_the_order_of_the_converters(infos: dict[str, list[dict[str, Any]]]) -> None:
    poses = [
        "lidar2ego_translation",
        "lidar2ego_rotation",
        "ego2global_translation",
        "ego2global_rotation",
        "timestamp",
    ]
    in_scene = ["lidar_path", "token", "prev", "next", "can_bus", "frame_idx", "sweeps", "cams", "scene_token", *poses]
    boxes = ["gt_boxes", "gt_names", "gt_velocity", "num_lidar_pts", "num_radar_pts", "valid_flag"]
    agents = ["gt_agent_fut_trajs", "gt_agent_fut_masks"]
    ego = ["gt_ego_fut_trajs", "gt_ego_fut_masks", "gt_ego_fut_cmd"]
    assert list(infos["uniad"][0]) == [
        *in_scene, *boxes, "gt_inds", "gt_ins_tokens", "fut_traj", "fut_traj_valid_mask", "visibility_tokens"
    ]  # fmt: skip
    assert list(infos["vad"][0]) == [
        *in_scene, "fut_valid_flag", "map_location", *boxes, *agents, "gt_agent_lcf_feat", "gt_agent_fut_yaw",
        "gt_agent_fut_goal", "gt_ego_his_trajs", *ego, "gt_ego_lcf_feat",
    ]  # fmt: skip
    assert list(infos["sparsedrive"][0]) == [
        "lidar_path", "token", "sweeps", "cams", "scene_token", *poses, "map_location", "map_annos", *boxes,
        "instance_inds", *agents, *ego, "ego_status",
    ]  # fmt: skip
    assert list(infos["uniad"][0]["cams"]) == list(CAMERA_NAMES)
    assert [info["frame_idx"] for info in infos["vad"]] == list(range(9))


def test_a_sample_of_the_straight_road(infos: dict[str, list[dict[str, Any]]]) -> None:
    vad, uniad, sparse = (infos[name][1] for name in ("vad", "uniad", "sparsedrive"))
    ahead = 80.0 - 50.0 - LIDAR_FROM_REAR_AXLE_M
    # The car ahead drives as the ego does; x right, y ahead. Its heading is a quarter turn from the lidar's x axis.
    np.testing.assert_allclose(uniad["gt_boxes"][0], [0, ahead, 0.85 - 1.84, 1.9, 4.6, 1.7, np.pi / 2], atol=1e-9)
    np.testing.assert_allclose(vad["gt_boxes"][0, 3:], [1.9, 4.6, 1.7, -np.pi], atol=1e-9)
    np.testing.assert_allclose(sparse["gt_boxes"][0, 3:], [4.6, 1.9, 1.7, np.pi / 2], atol=1e-9)
    np.testing.assert_allclose(uniad["gt_velocity"], [[0, 8], [0, 10], [0, -9]], atol=1e-6)
    assert uniad["gt_names"].tolist() == ["car"] * 3 and uniad["gt_inds"].tolist() == [0, 1, 2]
    assert uniad["visibility_tokens"].tolist() == [4, 4, 4] and uniad["valid_flag"].all()
    steps = np.arange(1, 8)
    np.testing.assert_allclose(uniad["fut_traj"][0, :7], np.column_stack([0 * steps, STEP_M * steps]), atol=1e-6)
    assert uniad["fut_traj_valid_mask"][0, :, 0].tolist() == [1.0] * 7 + [0.0] * 9
    # Own frame: what comes towards the ego drives ahead, too, seen from itself; offsets are in the lidar frame.
    np.testing.assert_allclose(uniad["fut_traj"][2, 0], [0, 4.5], atol=1e-6)
    np.testing.assert_allclose(sparse["gt_agent_fut_trajs"][2, :7], [[0, -4.5]] * 7, atol=1e-6)
    np.testing.assert_allclose(vad["gt_agent_fut_trajs"][1].reshape(6, 2), [[0, 5.0]] * 6, atol=1e-6)
    # "Static" is what does not grow by a metre in either coordinate, with its sign.
    assert vad["gt_agent_fut_goal"].tolist() == [6, 6, 9]
    assert vad["gt_agent_fut_trajs"].dtype == np.float32 and uniad["fut_traj"].dtype == np.float64


def test_the_ego_of_the_straight_road(infos: dict[str, list[dict[str, Any]]]) -> None:
    first, last = infos["vad"][0], infos["vad"][-1]
    np.testing.assert_allclose(first["gt_ego_fut_trajs"], [[0, STEP_M]] * 6, atol=1e-5)
    # What was before the recording is made up of what came after it.
    np.testing.assert_allclose(first["gt_ego_his_trajs"], [[0, STEP_M]] * 2, atol=1e-5)
    assert first["fut_valid_flag"] is True and last["fut_valid_flag"] is False
    assert last["gt_ego_fut_masks"].tolist() == [0.0] * 6 and not last["gt_ego_fut_trajs"].any()
    assert first["gt_ego_fut_cmd"].tolist() == last["gt_ego_fut_cmd"].tolist() == [0, 0, 1]
    # Whatever its heading, the car is said to drive along y: the angle is a roll.
    np.testing.assert_allclose(first["gt_ego_lcf_feat"][[0, 1, 4, 5, 6]], [0, 8, 0, 4.084, 1.85], atol=1e-5)
    np.testing.assert_allclose(first["gt_ego_lcf_feat"][7:], [8, 0], atol=1e-3)
    np.testing.assert_allclose(infos["sparsedrive"][0]["ego_status"][[6, 9]], [8, 0], atol=1e-3)


def test_paths_and_sensors_are_the_root_s(infos: dict[str, list[dict[str, Any]]]) -> None:
    info = infos["uniad"][3]
    camera = info["cams"]["CAM_BACK"]
    assert info["lidar_path"].startswith(f"{CONVERTED_PREFIX}samples/LIDAR_TOP/")
    assert camera["data_path"].startswith(f"{CONVERTED_PREFIX}samples/CAM_BACK/") and camera["type"] == "CAM_BACK"
    assert camera["cam_intrinsic"].shape == (3, 3) and isinstance(camera["sensor2ego_rotation"], list)
    # Sweeps reach back over earlier key frames, newest first; the first sample has none before it.
    times = [sweep["timestamp"] for sweep in info["sweeps"]]
    assert len(times) == 10 and times == sorted(times, reverse=True) and times[0] < info["timestamp"]
    assert infos["uniad"][0]["sweeps"] == []
    # The sweep's own pose counts: its points lie behind by what the ego has driven since.
    away = (info["timestamp"] - times[0]) * 1e-6 * 8.0
    np.testing.assert_allclose(info["sweeps"][0]["sensor2lidar_translation"], [0, -away, 0], atol=1e-5)


def test_map_elements_of_the_straight_road(infos: dict[str, list[dict[str, Any]]]) -> None:
    elements = infos["sparsedrive"][0]["map_annos"]
    assert list(elements) == [1, 0, 2]
    # Ego and lidar at y = 198.25 on a road from 193 to 207, which becomes x = 5.25 to -8.75; dividers 3.5 m apart.
    assert sorted(round(float(line[0, 0]), 6) for line in elements[1]) == [-5.25, -1.75, 1.75]
    assert elements[0] == []
    assert sorted(round(float(line[0, 0]), 6) for line in elements[2]) == [-8.75, 5.25]
    assert all(np.abs(line[:, 1]).max() == pytest.approx(29.8) for line in elements[2])
    assert all(np.abs(line[:, 1]).max() == pytest.approx(30.0) for line in elements[1])


def test_goals() -> None:
    def of(x: float, y: float) -> float:
        return float(classify_goals(np.array([[[9.0, 9.0], [x, y], [0, 0], [0, 0], [0, 0], [0, 0]]]))[0])

    # The first step does not count.
    assert [of(5, 0), of(0, 5), of(-5, 3), of(-20, -20), of(0.9, 0.9), of(-5, 1.0)] == [4, 6, 7, 9, 9, 7]


def test_a_tilted_box_has_another_angle_than_its_heading(tmp_path: Path) -> None:
    scene = short_scene(seconds=SECONDS)
    turned = replace(scene, agents=replace(scene.agents, yaw=scene.agents.yaw + 0.4))
    write_root(tmp_path / "root", [tilted(turned, 0.1)])
    angle = exported(tmp_path / "root", tmp_path / "to", "uniad", as_converted=True)[0]["gt_boxes"][0, 6]
    heading = np.pi / 2 + 0.4
    # w z - x y in place of w z + x y of the heading.
    w, x, y, z = (
        np.cos(heading / 2) * np.cos(0.05), np.cos(heading / 2) * np.sin(0.05),
        np.sin(heading / 2) * np.sin(0.05), np.sin(heading / 2) * np.cos(0.05),
    )  # fmt: skip
    assert angle == pytest.approx(np.arctan2(2 * (w * z - x * y), 1 - 2 * (y * y + z * z)))
    assert abs(angle - heading) > 1e-3


def test_holes_in_tracks_are_packed(tmp_path: Path) -> None:
    scene = short_scene(seconds=SECONDS)
    valid = scene.annotations.valid.copy()
    valid[0, 3:5] = False
    valid[1] = False
    valid[1, 2] = True
    valid[:, 8] = False
    write_root(tmp_path / "root", [replace(scene, annotations=replace(scene.annotations, valid=valid))])
    uniad = exported(tmp_path / "root", tmp_path / "uniad", "uniad", as_converted=True)
    np.testing.assert_allclose(uniad[1]["fut_traj"][0, :4, 1], [4, 16, 20, 24], atol=1e-6)
    vad = exported(tmp_path / "root", tmp_path / "vad", "vad", as_converted=True)
    np.testing.assert_allclose(vad[1]["gt_agent_fut_trajs"][0, 1:8:2], [4, 12, 4, 4], atol=1e-6)
    assert vad[1]["gt_agent_fut_masks"][0].tolist() == [1, 1, 1, 1, 0, 0]
    # One box tells no velocity; beside a gap it is told only while both sides are near enough.
    assert np.isnan(vad[2]["gt_velocity"][1]).all() and np.isfinite(vad[2]["gt_velocity"][0]).all()
    empty = vad[8]
    assert empty["gt_boxes"].shape == (0, 7) and empty["gt_agent_fut_trajs"].shape == (0, 12)
    assert (
        empty["gt_names"].dtype == empty["num_lidar_pts"].dtype == np.float64 and empty["valid_flag"].dtype == np.bool_
    )


def _pose(utime: int, number: float) -> dict[str, Any]:
    return {
        "accel": [number] * 3,
        "orientation": [1.0, 0.0, 0.0, 0.0],
        "pos": [number] * 3,
        "rotation_rate": [number + 0.1] * 3,
        "utime": utime,
        "vel": [number + 0.2] * 3,
    }


def test_motion_is_one_message_younger_than_position() -> None:
    can = ConverterCanMessages([_pose(time, float(time)) for time in (10, 20, 30)], [{"utime": 10, "value": 1.0}])
    assert can.vector(25)[[0, 7, 10, 13]].tolist() == [20, 30, 30.1, 30.2]
    assert can.vector(99)[[0, 7]].tolist() == [30, 30]
    assert can.vector(5)[[0, 7]].tolist() == [10, 10]
    assert can.vector(25)[3:7].tolist() == [1, 0, 0, 0] and can.vector(25).shape == (18,)
    found = can.nearest(25)
    assert found is not None and found.velocity[0] == 30.2 and found.steering == 1.0
    assert ConverterCanMessages([], []).vector(3).tolist() == [0.0] * 18
    assert ConverterCanMessages(can.pose, []).nearest(25) is None
    for more in ([1.0, 2.0, 3.0], 7, ["text"]):
        with pytest.raises(InputError, match="do not hold the 16 numbers"):
            ConverterCanMessages([{**_pose(1, 0.0), "more": more}], []).vector(3)
    with pytest.raises(InputError, match="do not hold the 16 numbers"):
        ConverterCanMessages([{**_pose(1, 0.0), "more": []}, _pose(9, 0.0)], []).vector(3)
