"""Infos of small scenes, whose values are known without a computer; what official code trips on, cured or refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from benchmark.cli.app import app
from benchmark.constants import CAMERA_NAMES, LIDAR_FROM_REAR_AXLE_M, NUMBERED_CATEGORIES, OFFICIAL_LOCATIONS
from benchmark.datasets.fingerprint import compute_fingerprint
from benchmark.datasets.split_names import compute_shifts_us, sort_as_exported
from benchmark.errors import InputError
from benchmark.extensions.infos.ego_trajectory import ConverterCanMessages
from benchmark.extensions.infos.exporting import CONVERTED_PREFIX, InfoSettings, build_info_files, export_infos
from benchmark.extensions.infos.repairs import build_category_numbers
from benchmark.extensions.infos.repositories import REPOSITORIES, RepositoryName
from benchmark.extensions.infos.scene_infos import classify_goals
from benchmark.untrusted.children import read_pickle
from tests.benchmark.cli.cli_runs import bytes_below, refusal
from tests.benchmark.extensions.infos.info_roots import (
    SECONDS,
    LargeRenderer,
    as_roots_were,
    exported,
    plain_root,
    read,
    scene_names,
    tilted,
    variant_root,
)
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

STEP_M = 4.0
"""The ego of the hand-made scene drives at 8 m/s."""


@pytest.fixture(scope="module")
def infos(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, Any]]]:
    folder = tmp_path_factory.mktemp("infos")
    root = plain_root(folder / "root")
    return {name: exported(root, folder / name, name, as_converted=True) for name in REPOSITORIES}


def test_keys_stand_in_the_order_of_the_converters(infos: dict[str, list[dict[str, Any]]]) -> None:
    frames = [f"{pair}_{part}" for pair in ("lidar2ego", "ego2global") for part in ("translation", "rotation")]
    poses = [*frames, "timestamp"]
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


@pytest.mark.path
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
    dtypes = [empty[name].dtype for name in ("gt_names", "num_lidar_pts", "valid_flag")]
    assert dtypes == [np.float64, np.float64, np.bool_]


def _pose(utime: int, number: float) -> dict[str, Any]:
    motion = {"accel": number, "pos": number, "rotation_rate": number + 0.1, "vel": number + 0.2}
    vectors = {name: [value] * 3 for name, value in motion.items()}
    # In the order of the tables.
    return dict(sorted({**vectors, "orientation": [1.0, 0.0, 0.0, 0.0], "utime": utime}.items()))


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


@pytest.fixture(scope="module")
def variants(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return as_roots_were(variant_root(tmp_path_factory.mktemp("variants") / "root"))


@pytest.fixture(scope="module")
def cured(variants: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    to = tmp_path_factory.mktemp("cured")
    before = compute_fingerprint(variants, "v1.0-trainval", [])
    for name in ("uniad", "vad"):
        export_infos(variants, to, InfoSettings(name))
    # The root is what run records know it by, and stays as it is.
    assert compute_fingerprint(variants, "v1.0-trainval", []) == before
    return to


def departures(folder: Path, repository: RepositoryName) -> list[dict[str, Any]]:
    said = json.loads((folder / f"{repository}_departures.json").read_text())
    assert said["for"] == REPOSITORIES[repository].title
    found: list[dict[str, Any]] = said["departures"]
    return found


def test_readers_find_variants_one_after_the_other(variants: Path, cured: Path) -> None:
    infos = read(cured / "nuscenes_infos_temporal_val.pkl")
    as_read = sorted(infos, key=lambda info: int(info["timestamp"]))
    scenes = [scene_names(variants)[info["scene_token"]] for info in as_read]
    assert scenes == sorted(scenes) and len(set(scenes)) == 3
    times = np.array([info["timestamp"] for info in as_read])
    changes = np.flatnonzero(np.diff(np.array(scenes).view(np.int32).reshape(len(scenes), -1).sum(axis=1)))
    assert (np.diff(times)[changes] > 2_000_000).all()
    # Within a scene all differences stay, those to cameras and sweeps too.
    converted = _by_token(variants, cured, "uniad")
    for info in infos:
        shift = info["timestamp"] - converted[info["token"]]["timestamp"]
        for mine, theirs in zip(info["sweeps"], converted[info["token"]]["sweeps"], strict=True):
            assert mine["timestamp"] - theirs["timestamp"] == shift
        for channel in CAMERA_NAMES:
            stamps = (each["cams"][channel]["timestamp"] for each in (info, converted[info["token"]]))
            assert next(stamps) - next(stamps) == shift
    moved = next(found for found in departures(cured, "uniad") if "timestamp" in found["keys"])
    assert len(moved["scenes"]) == 2 and all(found["shift_us"] > 0 for found in moved["scenes"].values())


def _by_token(root: Path, beside: Path, repository: RepositoryName) -> dict[str, dict[str, Any]]:
    settings = InfoSettings(repository, as_converted=True)
    return {info["token"]: info for info in build_info_files(root, REPOSITORIES[repository], settings).parts["val"]}


def test_as_converted_cures_nothing(variants: Path, tmp_path: Path) -> None:
    found = build_info_files(variants, REPOSITORIES["vad"], InfoSettings("vad", as_converted=True))
    infos = found.parts["val"]
    times = [info["timestamp"] for info in infos]
    assert len(set(times)) == len(times) / 3
    assert not any(info["can_bus"].any() for info in infos)
    # Row 16 of 23 is the car; of 32 it is 17.
    assert {int(row[8]) for info in infos for row in info["gt_agent_lcf_feat"]} == {16}
    assert any("2-8 for people" in said for said in found.unrepaired)
    assert any("zeros as model input" in said for said in found.unrepaired)


def test_suffixed_names_keep_their_can_bus(cured: Path) -> None:
    for repository in ("uniad", "vad"):
        infos = read(cured / REPOSITORIES[repository].file_name("v1.0-trainval", "val"))
        assert all(np.abs(info["can_bus"][:16]).any() for info in infos)
        assert infos[3]["can_bus"][13] == pytest.approx(8.0, abs=0.1)
    said = next(found for found in departures(cured, "vad") if "can_bus" in found["keys"])
    assert len(said["scenes"]) == 3


def test_categories_have_the_numbers_that_vad_means(cured: Path) -> None:
    infos = read(cured / "vad_nuscenes_infos_temporal_val.pkl")
    assert {int(row[8]) for info in infos for row in info["gt_agent_lcf_feat"]} == {17}
    assert any("32 rows" in found["what"] for found in departures(cured, "vad"))
    numbers = build_category_numbers({"vehicle.bicycle": 13, "human.pedestrian.adult": 1, "vehicle.hovercraft": 23})
    assert numbers == {"vehicle.bicycle": 14, "human.pedestrian.adult": 2, "vehicle.hovercraft": 55}
    assert all(name.startswith("human.pedestrian.") for name in NUMBERED_CATEGORIES[2:9])
    assert all(name.startswith("vehicle.") for name in NUMBERED_CATEGORIES[14:24]) and len(NUMBERED_CATEGORIES) == 32


def test_files_are_named_so_that_all_repositories_find_them(variants: Path, cured: Path, tmp_path: Path) -> None:
    info = read(cured / "nuscenes_infos_temporal_val.pkl")[0]
    for name in (info["lidar_path"], info["cams"]["CAM_FRONT"]["data_path"]):
        assert Path(name).is_absolute() and Path(name).is_file()
    elsewhere = exported(variants, tmp_path, "uniad", root_as="/data/adv")[0]
    assert elsewhere["lidar_path"].startswith("/data/adv/samples/LIDAR_TOP/")
    assert (tmp_path / "nuscenes" / "samples").readlink() == Path("/data/adv/samples")


def test_the_folder_for_official_code_has_all_four_maps(variants: Path, cured: Path) -> None:
    from nuscenes.map_expansion.map_api import NuScenesMap
    from nuscenes.nuscenes import NuScenes

    folder = cured / "nuscenes"
    here = {city: NuScenesMap(dataroot=str(folder), map_name=city) for city in OFFICIAL_LOCATIONS}
    assert here["boston-seaport"].lane and not here["singapore-onenorth"].lane
    opened = NuScenes(version="v1.0-trainval", dataroot=str(folder), verbose=False)
    assert len(opened.scene) == 3
    # VAD looks for its infos there.
    beside = folder / "vad_nuscenes_infos_temporal_val.pkl"
    assert beside.is_symlink() and beside.resolve() == (cured / beside.name).resolve()
    # The same command again, also when the root has got a map that it lacked.
    export_infos(variants, cured, InfoSettings("vad"))


def test_pickles_are_of_the_kind_that_official_environments_load(cured: Path) -> None:
    data = (cured / "nuscenes_infos_temporal_val.pkl").read_bytes()
    assert data[:2] == b"\x80\x02" and b"numpy.core.multiarray" in data and b"numpy._core" not in data
    content = read_pickle(cured / "nuscenes_infos_temporal_val.pkl")
    assert content["metadata"] == {"version": "v1.0-trainval"}
    info = content["infos"][0]
    assert {type(info[key]) for key in ("timestamp", "frame_idx")} == {int}
    assert all(type(value) is float for value in info["ego2global_translation"])


def test_a_split_of_several_is_chosen_and_stands_in_the_val_file(tmp_path: Path) -> None:
    from generation.nuscenes_writer import finish_data_set, write_scene

    scenes = [short_scene(name) for name in ("scene-0061", "scene-9902")]
    plan = write_root(tmp_path / "root", scenes, split="mine")
    keys = [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={}) for scene in scenes]
    finish_data_set(plan, keys, extra_splits={"train": ["scene-0061"]})
    with pytest.raises(InputError, match="has the splits mine, train; name one with --split"):
        export_infos(tmp_path / "root", tmp_path / "to", InfoSettings("uniad"))
    infos = exported(tmp_path / "root", tmp_path / "to", "uniad", split="train")
    assert len(infos) == 5 and {info["scene_token"] for info in infos} == {infos[0]["scene_token"]}
    said = [found["what"] for found in departures(tmp_path / "to", "uniad")]
    assert any("among its training scenes" in what for what in said) and any("are left out" in what for what in said)
    converted = InfoSettings("uniad", as_converted=True)
    assert sorted(export_infos(tmp_path / "root", tmp_path / "converted", converted).files.values()) == [5, 5]
    with pytest.raises(InputError, match="takes the whole root"):
        export_infos(tmp_path / "root", tmp_path / "no", replace(converted, split="train"))


def test_folders_of_variant_roots_get_a_folder_each(tmp_path: Path) -> None:
    for name in ("v0", "v1"):
        plain_root(tmp_path / "root" / name)
    done = export_infos(tmp_path / "root", tmp_path / "to", InfoSettings("uniad"))
    names = sorted(str(path.relative_to(tmp_path / "to")) for path, count in done.files.items() if count)
    assert names == [f"{name}/nuscenes_infos_temporal_val.pkl" for name in ("v0", "v1")]
    export_infos(tmp_path / "root", tmp_path / "as", InfoSettings("uniad", root_as="/data"))
    elsewhere = read(tmp_path / "as" / "v1" / "nuscenes_infos_temporal_val.pkl")
    assert elsewhere[0]["lidar_path"].startswith("/data/v1/samples/")


def test_infos_of_the_test_set_have_no_annotations(tmp_path: Path) -> None:
    root = plain_root(tmp_path / "root", version="v1.0-test")
    for repository, last in (("uniad", "timestamp"), ("vad", "map_location"), ("sparsedrive", "map_annos")):
        done = export_infos(root, tmp_path / repository, InfoSettings(repository, as_converted=True))
        # No test scene of nuScenes is called like it.
        assert [(path.name.endswith("_test.pkl"), count) for path, count in done.files.items()] == [(True, 0)]
        if repository != "sparsedrive":
            done = export_infos(root, tmp_path / repository, InfoSettings(repository))
            infos = read(next(iter(done.files)))
            assert len(infos) == 9 and list(infos[0])[-1] == last


def test_scenes_that_are_apart_keep_their_times() -> None:
    assert compute_shifts_us([("b", 30_000_000, 40_000_000), ("a", 0, 20_000_000)]) == {}
    shifts = compute_shifts_us([("b", 0, 20), ("a", 0, 20), ("c", 5_000_000, 6_000_000)])
    assert shifts == {"b": 10_000_020, "c": 15_000_040}
    order = sort_as_exported(["b", "a", "b", "a"], np.array([0, 0, 500_000, 500_000]))
    assert order.tolist() == [1, 3, 0, 2]


@pytest.mark.path
def test_the_command_says_what_it_did(variants: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["data", "export", "infos", str(variants), "--for", "vad", "--to", str(tmp_path / "to")]
    command = typer.main.get_command(app)
    command.main(words, standalone_mode=False)
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == f"27 infos in {tmp_path}/to/vad_nuscenes_infos_temporal_val.pkl"
    assert sum(line.startswith("differs from the converter: ") for line in lines) == 5
    assert any("32x18, but published networks were trained on 1600x900" in line for line in lines)
    first = bytes_below(tmp_path / "to")
    command.main([*words, "--json"], standalone_mode=False)
    said = json.loads(capsys.readouterr().out)
    assert sum(said["files"].values()) == 27 and len(said["departures"]) == 5 and len(said["not_cured"]) == 2
    assert bytes_below(tmp_path / "to") == first


def test_sparsedrive_finds_map_elements(tmp_path: Path) -> None:
    root = plain_root(tmp_path / "root", renderer=LargeRenderer(), frames="keyframes")
    infos = exported(root, tmp_path / "large", "sparsedrive")
    assert [len(info["map_annos"][1]) for info in infos] == [3] * 9 and infos[0]["ego_status"].any()


def _without(path: str) -> Any:
    return lambda root: next(root.glob(path)).unlink()


def _changed(table: str, **values: Any) -> Any:
    def change(root: Path) -> None:
        path = next(root.glob(f"*/{table}.json"))
        path.write_text(json.dumps([{**row, **values} for row in json.loads(path.read_text())]))

    return change


def _no_cameras(root: Path) -> None:
    path = root / "v1.0-trainval" / "sample_data.json"
    rows = json.loads(path.read_text())
    path.write_text(json.dumps([row for row in rows if "/LIDAR_TOP/" in row["filename"]]))
    path = root / "v1.0-trainval" / "calibrated_sensor.json"
    path.write_text(json.dumps([row for row in json.loads(path.read_text()) if not row["camera_intrinsic"]]))


def _no_back_camera(root: Path) -> None:
    path = root / "v1.0-trainval" / "sample_data.json"
    rows = json.loads(path.read_text())
    path.write_text(json.dumps([row for row in rows if "/CAM_BACK/" not in row["filename"]]))


def _written(path: str, text: str) -> Any:
    return lambda root: next(root.glob(path)).write_text(text)


def _line_of_one_node(root: Path) -> None:
    path = next(root.glob("maps/expansion/boston*"))
    layers = json.loads(path.read_text())
    for line in layers["line"]:
        line["node_tokens"] = line["node_tokens"][:1]
    path.write_text(json.dumps(layers))


@pytest.mark.parametrize(
    ("spoil", "options", "says"),
    [
        (_without("samples/CAM_BACK/*"), "--for uniad", "write the images"),
        (_without("samples/LIDAR_TOP/*"), "--for vad", "VAD opens it"),
        (_without("maps/expansion/boston*"), "--for uniad", "boston-seaport.json, which official code opens"),
        (_without("maps/expansion/boston*"), "--for sparsedrive --as-converted", "the source of map elements"),
        (_without("v1.0-trainval/log.json"), "--for vad", "lacks log.json"),
        (_no_back_camera, "--for uniad", "no image of CAM_BACK at"),
        (_no_cameras, "--for uniad --as-converted", "or leave --as-converted out"),
        (_changed("log", location="atlantis"), "--for uniad", "lies in atlantis"),
        (_changed("sample_annotation", visibility_token=""), "--for uniad --as-converted", "is not a number"),
        (_changed("ego_pose", rotation=[1, 1, 0, 0]), "--for uniad --as-converted", "of norm one"),
        (
            lambda root: (root / "v1.0-trainval").rename(root / "v2.0"),
            "--for uniad",
            "official code opens only v1.0-mini",
        ),
        (
            _written("maps/expansion/boston*", '{"version": "1.3"}'),
            "--for sparsedrive --as-converted",
            "map expansion is incomplete",
        ),
        (_line_of_one_node, "--for sparsedrive --as-converted", "is not a well-formed map expansion"),
        (_written("can_bus/*_pose.json", '[{"utime": 1700594060000000}]'), "--for vad", "has no field"),
        (lambda _: None, "--for vad --split adv", "split 'adv' of root is missing"),
        (lambda _: None, "--for vad --split mine", "has no split 'mine'"),
        (lambda _: None, "--for vad --root-as data/nuscenes", "must be an absolute path"),
        (lambda _: None, "--for momad", "momad"),
        (lambda _: None, "--for vad --tables v9", "no version folder 'v9'"),
    ],
)
def test_what_cannot_be_cured_is_refused_and_nothing_written(
    healthy: Path, tmp_path: Path, spoil: Any, options: str, says: str
) -> None:
    root = Path(shutil.copytree(healthy, tmp_path / "root"))
    spoil(root)
    said = refusal("data", "export", "infos", root, "--to", tmp_path / "to", *options.split())
    assert says in said and "\n" not in said
    assert not (tmp_path / "to").exists()


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return plain_root(tmp_path_factory.mktemp("healthy") / "root", frames="keyframes")


def test_an_unknown_visibility_is_full_and_single_samples_are_refused(healthy: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(healthy, tmp_path / "root"))
    _changed("sample_annotation", visibility_token="")(root)
    infos = exported(root, tmp_path / "to", "uniad")
    assert {int(level) for info in infos for level in info["visibility_tokens"]} == {4}
    assert any("visibility_tokens" in found["keys"] for found in departures(tmp_path / "to", "uniad"))
    write_root(tmp_path / "single", [short_scene(seconds=0.5)])
    single = ("data", "export", "infos", tmp_path / "single", "--to", tmp_path / "no", "--for")
    assert "one sample" in refusal(*single, "uniad") and "one sample" in refusal(*single, "vad", "--as-converted")


def test_the_export_overwrites_nothing_of_others(healthy: Path, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "nuscenes").symlink_to(healthy)
    said = refusal("data", "export", "infos", healthy, "--for", "uniad", "--to", tmp_path / "data")
    assert "is a link, whose target must not be changed" in said
    (tmp_path / "other" / "nuscenes" / "samples").mkdir(parents=True)
    said = refusal("data", "export", "infos", healthy, "--for", "uniad", "--to", tmp_path / "other")
    assert "exists where a link" in said
    export_infos(healthy, tmp_path / "third", InfoSettings("uniad"))
    copy = shutil.copytree(healthy, tmp_path / "copy")
    said = refusal("data", "export", "infos", copy, "--for", "vad", "--to", tmp_path / "third")
    assert "was exported from another root" in said
