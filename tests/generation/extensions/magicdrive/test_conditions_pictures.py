from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.report.palette import ADVERSARY
from benchmark.scene import Scene
from generation.extensions.magicdrive.clip import build_clip
from generation.extensions.magicdrive.condition_pictures import (
    choose_shown_frames,
    draw_boxes,
    draw_condition_pictures,
    write_condition_pictures,
)
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS
from tests.benchmark.cli.in_process import run_here
from tests.generation.extensions.magicdrive.busy_scenes import busy_scene
from tests.generation.nuscenes_writer.written_roots import SolidRenderer, with_adversary, write_root

ONCE_A_SCENE = {"cameras", "ego-motion", "pooling", "words"}


def decoded(content: bytes) -> NDArray[Any]:
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image


@pytest.fixture(scope="module")
def attacked() -> Scene:
    return with_adversary(busy_scene(25 / 12), 1)


def test_every_condition_of_a_scene_is_drawn(attacked: Scene, tmp_path: Path) -> None:
    write_root(tmp_path / "root", [attacked])
    data = NuScenesData.open(tmp_path / "root")
    written = write_condition_pictures(data, [attacked.name], tmp_path / "pictures", SolidRenderer())
    names = {path.stem for path in written}
    frames = choose_shown_frames(data.scene(attacked.name))
    kinds = {f"{kind}-{frame:03d}" for kind in ("boxes", "visibility", "map") for frame in frames}
    assert names == ONCE_A_SCENE | kinds
    assert all(path.parent == tmp_path / "pictures" / attacked.name for path in written)
    assert all(decoded(path.read_bytes()).std() > 5 for path in written)


def test_a_clip_of_one_frame_without_objects_is_drawn_too() -> None:
    scene = busy_scene()
    scene.agents.valid[:] = False
    clip = build_clip(scene, [0])
    assert set(draw_condition_pictures(clip, scene, [0], [None])) > ONCE_A_SCENE


def test_boxes_lie_over_what_the_cameras_saw(attacked: Scene) -> None:
    clip = build_clip(attacked, range(25))
    images = {name: np.full((90, 160, 3), 200, np.uint8) for name in MODEL_CAMERAS}
    plain, over = draw_boxes(clip, 0, None, []), draw_boxes(clip, 0, images, [])
    assert plain.shape == over.shape == (720, 1920, 3)
    assert np.median(plain) == 45 and np.median(over) == 200
    # The truck in front of the ego is drawn in the colour of adversaries where it is one.
    marked = draw_boxes(clip, 0, None, [clip.boxes.ids.index(attacked.agents.ids[1])])
    assert (marked == ADVERSARY).all(axis=-1).any() and not (plain == ADVERSARY).all(axis=-1).any()


def test_the_command_refuses_a_data_set_without_cameras_in_one_sentence(tmp_path: Path) -> None:
    write_root(tmp_path / "root", [busy_scene()], renderer=None)
    run = run_here("data", "show", tmp_path / "root", "--conditions", "--to", tmp_path / "pictures")
    assert run.code == 2 and "has no camera CAM_FRONT_LEFT" in run.err
