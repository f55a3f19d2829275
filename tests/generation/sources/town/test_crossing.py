"""More pedestrians who cross the ego's way: it meets them, and it and all others give way to them."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.geometry import Bools, boxes_overlap, to_local
from benchmark.scene import Scene
from generation.sources.mini import TownSettings, build_town_data_set
from generation.sources.town import build_town_scene, build_town_scene_driven, build_town_scene_off_path
from generation.sources.town.paths import EGO_BODY, compute_body_boxes
from tests.generation.sources.town.test_driven_ego import driven_as

INDICES = (1, 8)
MOST = 6


@cache
def _scene(index: int, crossing: int) -> Scene:
    return build_town_scene("train", index, seed=21, crossing=crossing)


def _ahead(scene: Scene) -> Bools:
    """(K,) in which key frames somebody on foot is on the 2 m to both sides of the next 25 m straight ahead."""
    on_foot = np.array([name.startswith("human.pedestrian") for name in scene.agents.categories])
    found = []
    for frame in scene.keyframes:
        there = on_foot & scene.agents.valid[:, frame]
        local = to_local(scene.agents.position[there, frame, :2], scene.ego.pose[frame])
        found.append(bool(((local[:, 0] > 3.5) & (local[:, 0] < 25.0) & (np.abs(local[:, 1]) < 2.0)).any()))
    return np.array(found)


def test_the_ego_meets_them_more_often() -> None:
    few, many = (sum(int(_ahead(_scene(index, most)).sum()) for index in INDICES) for most in (0, MOST))
    assert many > few + 10


@pytest.mark.parametrize("index", INDICES)
def test_everybody_gives_way_to_them(index: int) -> None:
    scene = _scene(index, MOST)
    agents, count = scene.agents, len(scene.timestamps_us)
    sizes = np.broadcast_to(agents.size[:, None, :2], (*agents.yaw.shape, 2))
    boxes = np.concatenate([agents.position[..., :2], sizes, agents.yaw[..., None]], -1)
    others = [(compute_body_boxes(scene.ego.pose, EGO_BODY), np.ones(count, dtype=np.bool_))]
    others += list(zip(boxes, agents.valid, strict=True))
    walkers = [row for row, category in enumerate(agents.categories) if category.startswith("human.pedestrian")]
    assert walkers
    for row in walkers:
        for number, (body, there) in enumerate(others, -1):
            both = there & agents.valid[row]
            assert number == row or not boxes_overlap(boxes[row][both], body[both]).any(), (row, number)


def _nobody_else_changed(scene: Scene, town: Scene) -> None:
    """Whoever is seen in both scenes does the same in both, as long as both last."""
    frames = len(scene.timestamps_us)
    assert scene.agents.categories == town.agents.categories
    both = scene.agents.valid & town.agents.valid[:, :frames]
    assert both.any()
    assert np.array_equal(scene.agents.position[both], town.agents.position[:, :frames][both])


def test_the_ego_leaves_its_path_there_too() -> None:
    scene, excursions = build_town_scene_off_path(INDICES[0], seed=21, crossing=MOST)
    assert excursions
    _nobody_else_changed(scene, _scene(INDICES[0], MOST))


def test_a_drive_past_them_is_none_through_the_town_without_them() -> None:
    driven = driven_as(_scene(INDICES[0], MOST))
    scene, _ = build_town_scene_driven(INDICES[0], driven, seed=21, crossing=MOST)
    _nobody_else_changed(scene, _scene(INDICES[0], MOST))
    with pytest.raises(InputError, match="crossing"):
        build_town_scene_driven(INDICES[0], driven, seed=21)


@pytest.mark.parametrize("settings", [TownSettings(1, 2, crossing=-1), TownSettings(1, crossing=3)])
def test_numbers_that_ask_for_nothing_are_refused(settings: TownSettings, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--crossing"):
        build_town_data_set(tmp_path / "town", settings, workers=1)
    assert not (tmp_path / "town").exists()
