"""Pictures for people: which moments, who is seen from above, through which camera."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon

from benchmark.errors import InputError
from benchmark.geometry import box_gap
from benchmark.report.palette import ADVERSARY, EGO, Rgb
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from generation.render.pictures import PANELS, choose_frames, draw_scene_strip, find_best_camera, write_pictures
from generation.render.schematic import SchematicRenderer
from tests.benchmark.fake_data import FakeData
from tests.generation.nuscenes_writer.written_roots import with_adversary
from tests.hand_made import Car, scene_on_straight_road

RENDERER = SchematicRenderer(112, 64)


def attacked() -> Scene:
    scene = scene_on_straight_road((Car(60.0, 194.75, 8.0), Car(40.0, 201.75, 8.0)))
    return dataclasses.replace(scene, adversaries=(scene.agents.ids[0],))


def middle_of(image: NDArray[np.uint8], colour: Rgb) -> tuple[float, float]:
    """Column and row of the middle of what is painted in a colour in the second panel."""
    rows, columns = np.nonzero((image[:360, 364:] == colour).all(axis=-1))
    return float(columns.mean()), float(rows.mean())


def test_the_closest_approach_is_among_the_moments() -> None:
    scene = with_adversary(scene_on_straight_road((Car(20.0, 194.75, 12.0),), ego_x=50.0, ego_speed=5.0))
    gaps = box_gap(scene.agents.boxes[0], scene.ego.boxes)
    frames = choose_frames(scene)
    assert len(frames) == PANELS
    assert frames == sorted(frames)
    assert min(gaps[frames]) == gaps.min()


def test_a_scene_without_an_adversary_is_shown_from_start_to_end() -> None:
    scene = scene_on_straight_road()
    frames = choose_frames(scene)
    assert frames[0] == 0
    assert frames[-1] == len(scene.timestamps_us) - 1


def test_one_picture_a_scene(tmp_path: Path) -> None:
    data = FakeData({"scene-9901": with_adversary(scene_on_straight_road())})
    (path,) = write_pictures(data, ["scene-9901"], tmp_path, RENDERER)
    image = cv2.imread(str(path))
    assert image is not None
    assert image.std() > 10


def test_adversary_and_ego_are_seen_from_above_where_they_are() -> None:
    image = draw_scene_strip(attacked(), [0, 0], RENDERER)
    assert image.shape[1] == 2 * 360 + 4
    adversary, ego = middle_of(image, ADVERSARY), middle_of(image, EGO)
    # Six pixels a metre: ten metres ahead of the ego (its body, not its axle) and 3.5 to the right.
    assert abs(ego[0] - 180) < 6
    assert abs(adversary[0] - (180 + 6 * 3.5)) < 6
    assert adversary[1] < ego[1] - 30
    nobody = dataclasses.replace(attacked(), adversaries=())
    assert not (draw_scene_strip(nobody, [0, 0], RENDERER)[:360, 364:] == ADVERSARY).all(axis=-1).any()


def test_a_strip_is_a_row_of_panels_with_pictures_below() -> None:
    strip = draw_scene_strip(attacked(), [0, 20, 40], RENDERER, panel_px=112)
    assert strip.shape == (112 + 4 + 64, 3 * 112 + 2 * 4, 3)
    assert np.array_equal(strip, draw_scene_strip(attacked(), [0, 20, 40], RENDERER, panel_px=112))


def test_empty_map_and_no_agents() -> None:
    scene = dataclasses.replace(scene_on_straight_road(()), road_map=RoadMap("boston-seaport", MultiPolygon()))
    assert draw_scene_strip(scene, [95], RENDERER, panel_px=33).shape[1] == 33


def test_the_strip_looks_through_the_camera_that_sees_the_adversary() -> None:
    scene = scene_on_straight_road((Car(38.0, 198.25, 8.0),))
    behind = dataclasses.replace(scene, adversaries=scene.agents.ids)
    assert find_best_camera(behind, [0], RENDERER) == "CAM_BACK"
    assert find_best_camera(attacked(), [0], RENDERER) == "CAM_FRONT"
    assert find_best_camera(scene, [0], RENDERER) == "CAM_FRONT"


@pytest.mark.parametrize(("frames", "says"), [([], "at least one frame"), ([96], "frames 0 to 95, not 96")])
def test_a_strip_of_nothing_is_refused(frames: list[int], says: str) -> None:
    with pytest.raises(InputError, match=says):
        draw_scene_strip(attacked(), frames, RENDERER)
