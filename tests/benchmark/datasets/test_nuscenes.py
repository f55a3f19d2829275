import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.datasets.annotated_objects import find_nearest_valid
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.geometry import quaternion_from_yaw, to_global
from benchmark.planning import Command
from benchmark.scene import EgoTrack, Scene
from tests.benchmark.datasets.nuscenes_tables import VERSION, TinyRoot
from tests.hand_made import Car, scene_on_straight_road


def short_scene(name: str = "scene-9901", seconds: float = 4.0) -> Scene:
    return scene_on_straight_road(name=name, seconds=seconds)


def with_gap(scene: Scene, agent: int, keyframes: list[int]) -> Scene:
    valid = scene.annotations.valid.copy()
    valid[agent, keyframes] = False
    return replace(scene, annotations=replace(scene.annotations, valid=valid))


def turning_left(scene: Scene) -> Scene:
    """The ego drives a left turn of 20 m radius at 8 m/s."""
    angle = scene.seconds * 8.0 / 20.0
    position = np.column_stack([50.0 + 20.0 * np.sin(angle), 198.25 + 20.0 * (1 - np.cos(angle)), 0 * angle])
    return replace(scene, ego=EgoTrack(position, quaternion_from_yaw(angle)))


@pytest.mark.parametrize("sweeps", [True, False])
def test_a_scene_comes_back_as_it_was(tmp_path: Path, sweeps: bool) -> None:
    scene = turning_left(short_scene())
    data = NuScenesData.open(TinyRoot.of(tmp_path, [scene], sweeps=sweeps).write())
    read = data.scene("scene-9901")
    last = int(scene.keyframes[-1])
    assert np.array_equal(read.keyframes, scene.keyframes)
    assert np.abs(read.timestamps_us - scene.timestamps_us[: last + 1]).max() <= 1
    assert np.array_equal(read.ego.position[read.keyframes], scene.ego.position[scene.keyframes])
    assert np.array_equal(read.ego.rotation[read.keyframes], scene.ego.rotation[scene.keyframes])
    if sweeps:
        assert np.array_equal(read.ego.position, scene.ego.position[: last + 1])
    else:
        assert np.abs(read.ego.position - scene.ego.position[: last + 1]).max() < 0.2
    assert np.allclose(read.agents.position, scene.agents.position[:, : last + 1], atol=1e-9)
    assert np.allclose(read.agents.yaw, scene.agents.yaw[:, : last + 1])
    for name in ("position", "rotation", "size", "valid", "attribute", "num_lidar_pts", "num_radar_pts", "visibility"):
        assert np.array_equal(getattr(read.annotations, name), getattr(scene.annotations, name)), name
    assert all(getattr(read, name) == getattr(scene, name) for name in ("log", "vehicle", "date", "description"))
    assert [camera.name for camera in read.cameras] == ["CAM_FRONT"]
    assert np.array_equal(read.cameras[0].intrinsic, scene.cameras[0].intrinsic)
    assert np.array_equal(read.lidar.translation, scene.lidar.translation)


def test_a_gap_in_annotations_stays_a_gap(tmp_path: Path) -> None:
    scene = with_gap(short_scene(), 1, [3])
    read = NuScenesData.open(TinyRoot.of(tmp_path, [scene]).write()).scene("scene-9901")
    there = read.agents.valid[list(read.agents.ids).index(f"scene-9901-{scene.agents.ids[1]}")]
    assert there[:13].all() and not there[13:24].any() and there[24:].all()
    assert np.isfinite(read.agents.position).all() and (read.annotations.rotation[1] != 0).any()


def test_an_object_annotated_once_is_there_for_one_frame(tmp_path: Path) -> None:
    scene = with_gap(short_scene(), 0, [0, 1, 3, 4, 5, 6, 7])
    read = NuScenesData.open(TinyRoot.of(tmp_path, [scene]).write()).scene("scene-9901")
    alone = list(read.agents.ids).index(f"scene-9901-{scene.agents.ids[0]}")
    assert np.flatnonzero(read.agents.valid[alone]).tolist() == [12]


def test_irregular_sweeps_are_replaced_by_even_frames_through_jittering_keyframes(tmp_path: Path) -> None:
    made = TinyRoot.of(tmp_path, [short_scene()], sweeps=True)
    dropped = made.row("sample_data", "scene-9901-LIDAR_TOP-8")
    made.row("sample_data", dropped["prev"])["next"] = dropped["next"]
    made.row("sample_data", dropped["next"])["prev"] = dropped["prev"]
    made.tables["sample_data"].remove(dropped)
    for index, sample in enumerate(made.tables["sample"]):
        sample["timestamp"] += (-1) ** index * 7000
        made.row("sample_data", f"scene-9901-LIDAR_TOP-{6 * index}")["timestamp"] = sample["timestamp"]
    read = NuScenesData.open(made.write()).scene("scene-9901")
    assert read.timestamps_us[read.keyframes].tolist() == [row["timestamp"] for row in made.tables["sample"]]
    steps = np.diff(read.timestamps_us)
    assert abs(int(steps[:6].max()) - int(steps[:6].min())) <= 1 and (steps > 0).all()
    x = read.ego.position[:, 0]
    assert (np.diff(x) > 0).all() and np.allclose(x[read.keyframes], 50.0 + 4.0 * np.arange(8))


def test_without_lidar_a_camera_gives_the_ego_pose(tmp_path: Path) -> None:
    data = NuScenesData.open(TinyRoot.of(tmp_path, [short_scene()], lidar=False).write())
    assert np.allclose(data.scene("scene-9901").ego.position[0], [50.0, 198.25, 0.0])
    assert data.truth("scene-9901")[0].lidar_ahead_m == pytest.approx(0.943713)


def test_truth_is_the_recorded_future_seen_from_the_lidar(tmp_path: Path) -> None:
    scene = turning_left(with_gap(short_scene(seconds=5.0), 0, [2]))
    data = NuScenesData.open(TinyRoot.of(tmp_path, [scene]).write())
    truths = data.truth("scene-9901")
    assert [truth.index for truth in truths] == list(range(10))
    truth = truths[1]
    yaw = scene.ego.yaw[6]
    ahead = scene.lidar.translation[0]
    assert np.allclose(
        truth.lidar_pose, [*(scene.ego.position[6, :2] + ahead * np.array([np.cos(yaw), np.sin(yaw)])), yaw]
    )
    for step in range(6):
        frame = 6 * (step + 2)
        later = scene.ego.yaw[frame]
        origin = scene.ego.position[frame, :2] + ahead * np.array([np.cos(later), np.sin(later)])
        right, forward, turn = truth.ego_future[step]
        assert np.allclose(to_global(np.array([forward, -right]), truth.lidar_pose), origin)
        assert turn == pytest.approx(later - yaw + np.pi / 2)
    assert truth.ego_future[5, 0] < -2 and truth.command is Command.LEFT
    row = truth.instances.index(f"scene-9901-{scene.agents.ids[0]}")
    assert truth.annotated[row].tolist() == [True, False, True, True, True, True, True]
    assert np.array_equal(truth.boxes[row, 1], truth.boxes[row, 0]) and not truth.has_points[row, 1]
    right, forward = truth.boxes[row, 3, :2]
    assert np.allclose(to_global(np.array([forward, -right]), truth.lidar_pose), scene.agents.position[0, 24, :2])
    assert truth.boxes[row, 3, 2:4].tolist() == [4.6, 1.9]
    assert truth.boxes[row, 3, 4] == pytest.approx(np.pi / 2 - yaw)


def test_the_future_ends_with_the_scene(tmp_path: Path) -> None:
    truths = NuScenesData.open(TinyRoot.of(tmp_path, [short_scene()]).write()).truth("scene-9901")
    assert [truth.complete for truth in truths] == [True, True, *[False] * 6]
    last = truths[-1]
    assert not last.ego_future_valid.any() and last.command is Command.STRAIGHT
    assert np.allclose(last.ego_future, [0.0, 0.0, np.pi / 2])
    assert last.annotated[:, 0].all() and not last.annotated[:, 1:].any()
    assert truths[-3].ego_future[2:].tolist() == [truths[-3].ego_future[1].tolist()] * 4


def test_observations_show_the_past_and_nothing_else(tmp_path: Path) -> None:
    scene = turning_left(short_scene())
    whole = NuScenesData.open(TinyRoot.of(tmp_path / "a", [scene]).write())
    stopped = scene.ego.position.copy()
    stopped[25:] = stopped[24]
    changed = replace(scene, ego=EgoTrack(stopped, scene.ego.rotation))
    other = NuScenesData.open(TinyRoot.of(tmp_path / "b", [changed]).write())
    seen, also = list(whole.observations("scene-9901")), list(other.observations("scene-9901"))
    for first, second in zip(seen[:5], also[:5]):
        assert np.array_equal(first.past_poses, second.past_poses)
        assert np.array_equal(first.ego.velocity, second.ego.velocity)
        assert first.ego.yaw_rate == second.ego.yaw_rate
    assert seen[2].past_valid.tolist() == [False, False, True, True, True]
    assert np.allclose(seen[2].past_poses[-1], scene.ego.pose[12])
    assert np.allclose(seen[2].past_poses[2], scene.ego.pose[0])


def test_derived_motion_is_that_of_the_track(tmp_path: Path) -> None:
    data = NuScenesData.open(TinyRoot.of(tmp_path, [turning_left(short_scene())]).write())
    states = [seen.ego for seen in data.observations("scene-9901")]
    assert states[0].source == "derived" and np.array_equal(states[0].velocity, [0.0, 0.0])
    for state in states[2:]:
        assert np.allclose(state.velocity, [8.0, 0.0], atol=0.01)
        assert np.allclose(state.acceleration, [0.0, 8.0 * 0.4], atol=0.01)
        assert state.yaw_rate == pytest.approx(0.4, abs=1e-3) and state.steering_angle is None


@pytest.mark.parametrize("name", ["scene-9901", "scene-9901-a1"])
def test_can_bus_is_the_latest_message_that_is_not_from_the_future(tmp_path: Path, name: str) -> None:
    scene = short_scene(name)
    root = TinyRoot.of(tmp_path, [scene]).write()
    (root / "can_bus").mkdir()
    start = int(scene.timestamps_us[0])
    poses = [
        {"utime": start + 20_000 * step, "vel": [step, 0, 0], "accel": [1, 2, 9.8], "rotation_rate": [0, 0, 0.5]}
        for step in range(-1, 60)
    ]
    (root / "can_bus" / f"{name}_pose.json").write_text(json.dumps(poses[::-1]))
    steering = [{"utime": start + 510_000, "value": 0.25}]
    (root / "can_bus" / f"{name}_steeranglefeedback.json").write_text(json.dumps(steering))
    states = [seen.ego for seen in NuScenesData.open(root).observations(name)]
    assert [state.velocity[0] for state in states[:3]] == [0.0, 25.0, 50.0]
    assert states[0].acceleration.tolist() == [1.0, 2.0] and states[0].yaw_rate == 0.5
    assert [state.steering_angle for state in states[:4]] == [None, None, 0.25, None]
    assert [state.source for state in states] == ["can_bus"] * 4 + ["derived"] * 4
    assert states[5].velocity == pytest.approx([8.0, 0.0])


def test_images_are_opened_only_on_demand(tmp_path: Path) -> None:
    made = TinyRoot.of(tmp_path, [short_scene()])
    data = NuScenesData.open(made.write())
    view = next(data.observations("scene-9901")).views["CAM_FRONT"]
    with pytest.raises(InputError, match=r"samples/CAM_FRONT/.* is missing"):
        view.load()
    made.write_images()
    assert view.load().shape == (9, 16, 3) and view.load()[0, 0].tolist() == [10, 20, 30]
    view.path.write_bytes(view.path.read_bytes()[:40])
    with pytest.raises(InputError, match="cannot be read"):
        view.load()


def test_adversaries_and_provenance_come_from_challenger_json(tmp_path: Path) -> None:
    scene = short_scene()
    root = TinyRoot.of(tmp_path, [scene]).write()
    adversary = f"scene-9901-{scene.agents.ids[1]}"
    entry = {"source_scene": "scene-9901", "adversaries": [adversary], "report": {}}
    path = root / VERSION / "challenger.json"
    path.write_text(json.dumps({"schema": 1, "split": "adv", "scenes": {"scene-9901": entry}}))
    data = NuScenesData.open(root)
    assert data.scene("scene-9901").adversaries == (adversary,)
    provenance = data.provenance()
    assert provenance is not None and provenance["split"] == "adv" and data.scene_names("adv") == ("scene-9901",)
    entry["adversaries"] = ["nobody"]
    path.write_text(json.dumps({"schema": 1, "split": "adv", "scenes": {"scene-9901": entry}}))
    with pytest.raises(InputError, match="nobody"):
        NuScenesData.open(root).scene("scene-9901")


def test_the_fingerprint_follows_content_and_not_place(tmp_path: Path) -> None:
    scene = short_scene()
    made = TinyRoot.of(tmp_path / "a", [scene])
    first = NuScenesData.open(made.write())
    second = NuScenesData.open(TinyRoot.of(tmp_path / "b", [scene]).write())
    assert first.fingerprint() == second.fingerprint()
    made.write_images()
    with_images = NuScenesData.open(tmp_path / "a").fingerprint()
    made.tables["sample_annotation"][0]["translation"][0] += 1e-3
    made.write()
    assert len({first.fingerprint(), with_images, NuScenesData.open(tmp_path / "a").fingerprint()}) == 3


def test_a_data_set_travels_to_another_process_as_a_path(tmp_path: Path) -> None:
    data = NuScenesData.open(TinyRoot.of(tmp_path, [short_scene()]).write(), name="mine")
    packed = pickle.dumps(data)
    assert len(packed) < 1000
    assert pickle.loads(packed).name == "mine"  # noqa: S301


def test_the_same_scene_is_read_once(tmp_path: Path) -> None:
    data = NuScenesData.open(TinyRoot.of(tmp_path, [short_scene()]).write())
    assert data.scene("scene-9901") is data.scene("scene-9901")
    with pytest.raises(InputError, match="no scene 'scene-1'"):
        data.scene("scene-1")


def test_variant_roots_are_one_data_set(tmp_path: Path) -> None:
    for number in (10, 2, 0):
        scene = scene_on_straight_road((Car(80.0 + number, 198.25, 8.0),), name="scene-0061", seconds=4.0)
        root = TinyRoot.of(tmp_path / f"v{number}", [scene]).write()
        (root / "splits.json").write_text(json.dumps({"adv": ["scene-0061"]}))
    data = open_data(tmp_path)
    names = ("v0/scene-0061", "v2/scene-0061", "v10/scene-0061")
    assert data.scene_names() == data.scene_names("adv") == data.splits()["adv"] == names
    assert data.scene("v10/scene-0061").agents.position[0, 0, 0] == 90.0
    assert {data.scene(name).name for name in names} == set(names)
    assert next(data.observations(names[1])).scene == data.truth(names[1])[0].scene == names[1]
    assert data.provenance() is None and len(data.fingerprint()) == 64 and not data.has_map(names[0])
    with pytest.raises(InputError, match="no scene"):
        data.scene("scene-0061")
    with pytest.raises(InputError, match="no split 'val-r'"):
        data.scene_names("val-r")
    (tmp_path / "v3").mkdir()
    with pytest.raises(InputError, match="v3 has no version folder"):
        open_data(tmp_path)


def test_a_root_like_the_published_one_opens_as_it_is(tmp_path: Path) -> None:
    """Adv-nuSc: suffixed names, no splits.json, lidar files of 0 bytes, CAN bus files under the suffixed names."""
    made = TinyRoot.of(tmp_path, [short_scene("scene-0003-a0"), short_scene("scene-0003-a1")])
    made.version = "v1.0-trainval"
    data = open_data(made.write(), name="Adv-nuSc")
    assert data.scene_names("adv") == ("scene-0003-a0", "scene-0003-a1") and data.splits() == {}
    assert data.name == "Adv-nuSc" and data.provenance() is None
    assert data.truth("scene-0003-a1")[0].complete and data.scene("scene-0003-a0").adversaries == ()


@pytest.mark.parametrize(
    "content",
    ["{}", "[", '[{"utime": 1}]', '[{"utime": 1, "vel": [NaN, 0, 0], "accel": [0, 0, 0], "rotation_rate": [0, 0, 0]}]'],
)
def test_a_broken_can_bus_file_is_refused(tmp_path: Path, content: str) -> None:
    root = TinyRoot.of(tmp_path, [short_scene()]).write()
    (root / "can_bus").mkdir()
    (root / "can_bus" / "scene-9901_pose.json").write_text(content)
    with pytest.raises(InputError, match=r"scene-9901_pose\.json"):
        list(NuScenesData.open(root).observations("scene-9901"))


@settings(max_examples=20, deadline=None)
@given(st.lists(st.booleans(), min_size=1, max_size=12).filter(any))
def test_nearest_valid_is_nearest_and_valid(flags: list[bool]) -> None:
    valid = np.array([flags])
    found = find_nearest_valid(valid)[0]
    for index, held in enumerate(found.tolist()):
        assert flags[held]
        assert abs(held - index) == min(abs(other - index) for other, flag in enumerate(flags) if flag)
