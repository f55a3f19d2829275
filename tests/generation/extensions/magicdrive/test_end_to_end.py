"""From scenes of the town to JPEG files in a data set, with tiny random networks loaded as the real ones are."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from adapters.registry import planner_factory
from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.schema.check import check_tables
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.geometry import transform_matrix
from benchmark.machine.workers import LocalProcesses
from benchmark.scene import Scene, SweepPoses
from generation.extensions.magicdrive.clip import build_clip_boxes
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS
from generation.extensions.magicdrive.renderer import MagicDriveRenderer
from generation.extensions.magicdrive.sensor_frames import SensorFrames
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import build_split
from tests.benchmark.cli.in_process import run_here
from tests.generation.extensions.magicdrive.busy_scenes import busy_scene
from tests.generation.extensions.magicdrive.small_weights import SIZE, small_renderer, write_weights
from tests.generation.nuscenes_writer.written_roots import SolidRenderer, contents, write_root

FRAMES, KEYFRAMES = 7, 2


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_weights(tmp_path_factory.mktemp("published") / "weights")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    root = tmp_path_factory.mktemp("recorded") / "recorded"
    write_root(root, [busy_scene(FRAMES / 12, f"scene-990{number}") for number in (1, 2)])
    return open_data(root)


def settings_of(weights: Path, folder: Path, **changes: Any) -> BuildSettings:
    drawing = small_renderer(weights, folder / "rendering")
    return BuildSettings(**{"out": folder / "val-r", "renderer": drawing, "lossless": True, **changes})


@pytest.fixture(scope="module")
def built(weights: Path, source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = settings_of(weights, tmp_path_factory.mktemp("built"))
    build_split(source, "val-r", settings)
    return settings.out


def test_the_devkit_finds_a_picture_for_every_row(built: Path) -> None:
    from nuscenes import NuScenes

    nusc = NuScenes("v1.0-trainval", str(built), verbose=False)
    rows = [row for row in nusc.sample_data if row["sensor_modality"] == "camera"]
    assert len(rows) == 2 * FRAMES * 6 and {row["fileformat"] for row in rows} == {"jpg"}
    pictures = set()
    for row in rows:
        picture = cv2.imread(str(built / row["filename"]))
        assert picture.shape == (*SIZE, 3) == (row["height"], row["width"], 3)
        pictures.add(picture.tobytes())
        exact = cv2.imread(str(built / row["filename"]).replace(".jpg", ".png"))
        assert np.abs(exact.astype(float) - picture).mean() < 30
    # Frames of one latent frame may be equal with random weights.
    assert len(pictures) > len(rows) / 2
    path, boxes, intrinsic = nusc.get_sample_data(nusc.sample[0]["data"]["CAM_FRONT"])
    assert Path(path).is_file() and boxes
    assert intrinsic[0, 0] == pytest.approx(1266.0 * SIZE[1] / 1600)


@pytest.mark.path
def test_the_data_set_is_sound_and_planners_run_on_it(built: Path, tmp_path: Path) -> None:
    assert check_tables(built) == []
    record = evaluate(
        open_data(built), "val-r", planner_factory("constant-velocity"), tmp_path / "runs", EvalSettings()
    )
    assert record.complete and record.summary.samples == 2 * KEYFRAMES
    provenance = open_data(built).provenance()
    assert provenance is not None and provenance["renderer"]["name"] == "magicdrive"
    assert "24x48, recorded, seed 0" in provenance["renderer"]["version"]


def test_written_calibration_shows_boxes_where_the_conditions_had_them(built: Path, source: DataSet) -> None:
    data = open_data(built)
    name = data.scene_names("val-r")[0]
    recorded, written = source.scene(name), data.scene(name)
    frames = np.arange(FRAMES)
    told = SensorFrames.of(recorded, frames)
    boxes = build_clip_boxes(recorded, frames, told)
    places = boxes.true_corners[6, boxes.classes[6] >= 0].reshape(-1, 3)
    for view, camera_name in enumerate(MODEL_CAMERAS):
        camera = next(camera for camera in written.cameras if camera.name == camera_name)
        seen = told.camera_from_lidar[view, 6] @ np.column_stack([places, np.ones(len(places))]).T
        ego = transform_matrix(written.ego.rotation[6], written.ego.position[6])
        at = ego @ transform_matrix(camera.rotation, camera.translation)
        found = np.linalg.inv(at) @ told.lidar[6] @ np.column_stack([places, np.ones(len(places))]).T
        np.testing.assert_allclose(found[:3], seen[:3], atol=1e-3)
        drawn = told.intrinsics[view] * np.array([[SIZE[1] / 1600], [SIZE[1] / 1600], [1.0]])
        drawn[1, 2] -= 900 * SIZE[1] / 1600 - SIZE[0]
        np.testing.assert_allclose(camera.intrinsic, drawn, atol=1e-9)


def test_neither_workers_nor_a_killed_command_change_a_byte(
    weights: Path, source: DataSet, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = settings_of(weights, tmp_path, rendering=LocalProcesses(2))
    killed = replace(settings, rendering=None)
    render = MagicDriveRenderer.render

    def dies(renderer: MagicDriveRenderer, scene: Scene, frames: Any) -> Any:
        for number, images in enumerate(render(renderer, scene, frames)):
            if number == 5:
                raise KeyboardInterrupt
            yield images

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(MagicDriveRenderer, "render", dies)
        build_split(source, "val-r", killed)
    assert len(list(settings.out.glob("s*/CAM_FRONT/*.jpg"))) == 5
    build_split(source, "val-r", settings)
    assert contents(settings.out) == contents(built)


def test_scenes_that_are_there_are_not_drawn_again(
    weights: Path, source: DataSet, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(built, tmp_path / "val-r")
    victim = next((tmp_path / "val-r").glob("samples/CAM_BACK/*.jpg"))
    victim.unlink()
    drawn: list[str] = []
    render = MagicDriveRenderer.render

    def noted(renderer: MagicDriveRenderer, scene: Scene, frames: Any) -> Any:
        drawn.append(scene.name)
        return render(renderer, scene, frames)

    monkeypatch.setattr(MagicDriveRenderer, "render", noted)
    build_split(source, "val-r", settings_of(weights, tmp_path))
    assert len(drawn) == 1 and victim.is_file()
    build_split(source, "val-r", settings_of(weights, tmp_path))
    assert len(drawn) == 1


def test_pictures_of_sweeps_are_written_with_the_poses_of_the_sweeps(source: DataSet, tmp_path: Path) -> None:
    """A recording whose cameras have clocks of their own: the tables say where each camera was."""

    class Drawn(SolidRenderer):
        camera_tracks = MagicDriveRenderer.camera_tracks

    scene = source.scene(source.scene_names("val")[0])
    sensors = SensorFrames.of(replace(scene, sweep_poses=None), np.arange(FRAMES))
    ahead = np.eye(4)
    ahead[:3, 3] = [0.4, -0.1, 0.0]
    by_name = dict(zip(MODEL_CAMERAS, sensors.cameras, strict=True))
    cameras = ahead @ np.stack([by_name[camera.name] for camera in scene.cameras])
    swept = replace(scene, sweep_poses=SweepPoses(sensors.lidar, cameras))
    plan = DataSetPlan(root=tmp_path, split="val", renderer=Drawn())
    finish_data_set(plan, [write_scene(plan, swept, name=scene.name, source_scene=scene.name, report={})])
    found = open_data(tmp_path).scene(scene.name)
    assert found.sweep_poses is not None
    np.testing.assert_allclose(found.sweep_poses.cameras, cameras, atol=1e-6)
    np.testing.assert_allclose(found.ego.position, scene.ego.position, atol=1e-9)


@pytest.mark.path
def test_the_command_says_what_to_get_and_what_it_would_cost(
    source: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("generate", "--split", "val-r", "--data", source.root, "--renderer", "magicdrive")
    out = ("--out", tmp_path / "out", "--workers", "1")
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    run = run_here(*arguments, *out)
    assert (run.code, run.out) == (2, "") and run.err.count("\n") == 1
    assert all(word in run.err for word in ("ema.pt", "about 8150 MB", "weights fetch magicdrive-dit"))
    extra = ("--dry-run", "--json", "--render-device", "cuda", "--executor", "ray", "--tflops", "400")
    run = run_here(*arguments, *out[:2], *extra, "--render-size", "424x800")
    assert run.code == 0
    assert "a scene of 7 frames and six views at 424x800: about" in run.err and "GiB" in run.err
    assert "a GPU at 400 TFLOP/s" in run.err and "transformer" in run.err
    estimate = json.loads(run.out)["estimate"]
    assert estimate["scenes"] == 2 and estimate["scene_s"] > 1
    assert not (tmp_path / "out").exists() and not (tmp_path / "cache").exists()
