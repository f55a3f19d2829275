"""Pictures from above: who is drawn where, in which colour."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon

from benchmark.errors import InputError
from benchmark.geometry import quaternion_from_yaw
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from generation.render.birdseye import best_camera, birdseye_strip, draw_birdseye
from generation.render.schematic import SchematicRenderer
from tests.hand_made import Car, scene_on_straight_road

Image = NDArray[np.uint8]


def attacked() -> Scene:
    scene = scene_on_straight_road((Car(60.0, 194.75, 8.0), Car(40.0, 201.75, 8.0)))
    return dataclasses.replace(scene, adversaries=(scene.agents.ids[0],))


def centre_of(mask: NDArray[np.bool_]) -> tuple[float, float]:
    rows, columns = np.nonzero(mask)
    return float(columns.mean()), float(rows.mean())


def red(image: Image) -> NDArray[np.bool_]:
    return np.asarray((image[..., 0] > 190) & (image[..., 1] < 80) & (image[..., 2] < 80))


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_the_adversary_is_red_where_it_is_seen_from_the_ego(yaw: float) -> None:
    scene = attacked()
    count = len(scene.timestamps_us)
    scene = dataclasses.replace(
        scene, ego=dataclasses.replace(scene.ego, rotation=np.tile(quaternion_from_yaw(np.array(yaw)), (count, 1)))
    )
    image = draw_birdseye(scene, 0, size_px=400, extent_m=20.0, trails=False)
    offset = np.array([10.0, -3.5])
    ahead = offset @ [np.cos(yaw), np.sin(yaw)]
    left = offset @ [-np.sin(yaw), np.cos(yaw)]
    column, row = centre_of(red(image))
    assert abs(column - (200 - 10 * left)) < 8 and abs(row - (200 - 10 * ahead)) < 8


def test_without_highlight_nothing_is_red() -> None:
    assert red(draw_birdseye(attacked(), 0)).sum() > 50
    assert red(draw_birdseye(attacked(), 0, highlight=False)).sum() == 0


def test_ego_is_green_in_the_middle_and_pointing_up() -> None:
    image = draw_birdseye(scene_on_straight_road(()), 0, size_px=400, extent_m=10.0, trails=False).astype(int)
    green = (image[..., 1] > image[..., 0] + 60) & (image[..., 1] > image[..., 2] + 40)
    column, row = centre_of(green)
    assert abs(column - 200) < 4 and 150 < row < 200
    rows, columns = np.nonzero(green)
    assert np.ptp(rows) > 1.8 * np.ptp(columns)


def test_trails_and_plans_are_drawn() -> None:
    bare = draw_birdseye(attacked(), 40, trails=False)
    assert not np.array_equal(draw_birdseye(attacked(), 40), bare)
    plan = np.column_stack([np.arange(1, 7) * 4.0, np.arange(1, 7) * 1.0])
    image = draw_birdseye(attacked(), 40, trails=False, plan=plan).astype(int)
    blue = (image[..., 2] > 200) & (image[..., 0] < 90)
    rows, columns = np.nonzero(blue)
    assert blue.sum() > 30 and rows.min() < 240 - 6 * 20 and columns.mean() < 240


def test_an_absent_agent_is_absent() -> None:
    scene = attacked()
    nobody = dataclasses.replace(scene, agents=dataclasses.replace(scene.agents, valid=scene.agents.valid & False))
    assert red(draw_birdseye(nobody, 0)).sum() == 0


def test_empty_map_and_no_agents() -> None:
    scene = dataclasses.replace(scene_on_straight_road(()), road_map=RoadMap("boston-seaport", MultiPolygon()))
    assert draw_birdseye(scene, 95, size_px=33).shape == (33, 33, 3)


def test_same_scene_same_bytes() -> None:
    assert np.array_equal(draw_birdseye(attacked(), 10), draw_birdseye(attacked(), 10))


def test_strip_is_a_row_of_panels_with_pictures_below() -> None:
    plain = birdseye_strip(attacked(), [0, 20, 40], size_px=100)
    assert plain.shape == (100, 3 * 100 + 2 * 4, 3)
    with_pictures = birdseye_strip(attacked(), [0, 20], SchematicRenderer(112, 64), size_px=112)
    assert with_pictures.shape == (112 + 4 + 64, 2 * 112 + 4, 3)


def test_the_strip_looks_through_the_camera_that_sees_the_adversary() -> None:
    scene = scene_on_straight_road((Car(38.0, 198.25, 8.0),))
    behind = dataclasses.replace(scene, adversaries=scene.agents.ids)
    renderer = SchematicRenderer(112, 64)
    assert best_camera(behind, [0], renderer) == "CAM_BACK"
    assert best_camera(attacked(), [0], renderer) == "CAM_FRONT"
    assert best_camera(scene, [0], renderer) == "CAM_FRONT"


@pytest.mark.parametrize(("frame", "size", "extent"), [(96, 10, 10.0), (-1, 10, 10.0), (0, 0, 10.0), (0, 10, 0.0)])
def test_bad_requests_are_refused(frame: int, size: int, extent: float) -> None:
    with pytest.raises(InputError):
        draw_birdseye(attacked(), frame, size_px=size, extent_m=extent)


def test_a_strip_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="at least one frame"):
        birdseye_strip(attacked(), [])
