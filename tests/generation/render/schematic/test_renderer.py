"""What the pictures promise: same bytes, any size, any scene, and nothing that gives the adversary away."""

import dataclasses
import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from shapely.geometry import MultiPolygon

from benchmark.constants import CAMERA_NAMES, CATEGORIES
from benchmark.errors import InputError
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from generation.render.contract import Images, Renderer
from generation.render.schematic import FIRST, SECOND, SchematicRenderer
from generation.render.schematic.roadside import build_roadside
from generation.render.schematic.shapes import choose_shape_name, get_shape
from generation.render.schematic.styles import DrawingStyle
from tests.hand_made import Car, scene_on_straight_road

SMALL = (112, 64)


STYLES = pytest.mark.parametrize("style", [FIRST, SECOND], ids=["first", "second"])


def render(scene: Scene, frames: list[int], size: tuple[int, int] = SMALL, style: DrawingStyle = FIRST) -> list[Images]:
    return list(SchematicRenderer(*size, style=style).render(scene, frames))


def same(first: Images, second: Images) -> bool:
    return first.keys() == second.keys() and all(np.array_equal(first[name], second[name]) for name in first)


def digest() -> str:
    everything = hashlib.sha256()
    for look, style in (("day", FIRST), ("rain", SECOND)):
        for images in render(scene_on_straight_road(description=look, seconds=2.0), [3, 20], style=style):
            for name, image in images.items():
                everything.update(name.encode() + image.tobytes())
    return everything.hexdigest()


def test_pictures_are_rgb_of_all_cameras_in_order() -> None:
    renderer: Renderer = SchematicRenderer()
    scene = scene_on_straight_road()
    images = next(iter(renderer.render(scene, [0])))
    assert tuple(images) == CAMERA_NAMES
    for image in images.values():
        assert image.shape == (256, 448, 3) and image.dtype == np.uint8 and image.std() > 10
    assert [camera.width for camera in renderer.cameras(scene)] == [448] * 6


def test_bytes_are_the_same_in_another_instance_and_another_process() -> None:
    here = digest()
    assert digest() == here
    root = Path(__file__).resolve().parents[4]
    program = "from tests.generation.render.schematic.test_renderer import digest; print(digest())"
    environment = {**os.environ, "PYTHONHASHSEED": "77", "PYTHONPATH": str(root)}
    done = subprocess.run([sys.executable, "-c", program], cwd=root, env=environment, capture_output=True, check=True)
    assert done.stdout.decode().strip() == here


@STYLES
def test_a_frame_does_not_depend_on_the_frames_rendered_with_it(style: DrawingStyle) -> None:
    scene = scene_on_straight_road(ego_speed=15.0)
    together = render(scene, [0, 30, 60, 95], style=style)
    assert same(render(scene, [60], style=style)[0], together[2])
    assert same(render(scene, [95, 60], style=style)[1], together[2])


@STYLES
def test_being_an_adversary_changes_no_pixel(style: DrawingStyle) -> None:
    scene = scene_on_straight_road()
    marked = dataclasses.replace(scene, name="other-name", adversaries=(scene.agents.ids[0],))
    drawn = render(scene, [0, 50], style=style), render(marked, [0, 50], style=style)
    assert all(same(*pair) for pair in zip(*drawn))


def grey_levels(scene: Scene, style: DrawingStyle) -> float:
    """Mean difference of a picture from the one in the first style."""
    first, other = (render(scene, [10], (224, 128), drawn)[0]["CAM_FRONT"].astype(float) for drawn in (FIRST, style))
    return float(np.abs(first - other).mean())


@pytest.mark.parametrize("look", ["day", "dusk", "night", "rain"])
def test_the_second_style_changes_pictures_far_more_than_storing_them(look: str) -> None:
    scene = scene_on_straight_road(description=f"Road, {look}", seconds=2.0)
    assert grey_levels(scene, FIRST) == 0.0
    assert grey_levels(scene, SECOND) > 4.0
    names = [SchematicRenderer(style=style).name for style in (FIRST, SECOND)]
    assert names == ["schematic", "schematic-restyled"]


@pytest.mark.parametrize(
    "change",
    [
        {"salt": SECOND.salt},
        {"sun_turn_rad": SECOND.sun_turn_rad, "sun_height": SECOND.sun_height},
        {"sky": SECOND.sky, "haze": SECOND.haze},
        {"surfaces": SECOND.surfaces},
        {"pipeline": SECOND.pipeline},
    ],
    ids=["colours", "light", "air", "ground", "camera"],
)
def test_each_part_of_the_second_style_shows(change: dict[str, Any]) -> None:
    assert grey_levels(scene_on_straight_road(seconds=2.0), dataclasses.replace(FIRST, **change)) > 0.2


def test_styles_move_nothing() -> None:
    # Where a car stands is where its picture differs from the one without it: the same place in both styles.
    here, away = (scene_on_straight_road(cars, seconds=0.5) for cars in ((Car(64.0, 198.25),), ()))
    quiet = dataclasses.replace(SECOND, pipeline=None)
    places = []
    for style in (FIRST, quiet):
        pair = [render(scene, [0], (448, 256), style)[0]["CAM_FRONT"].astype(int) for scene in (here, away)]
        places.append(np.abs(pair[0] - pair[1]).max(axis=-1) > 24)
    both, either = (places[0] & places[1]).sum(), (places[0] | places[1]).sum()
    assert both > 0.6 * either > 100


def test_an_agent_that_is_not_there_is_not_drawn() -> None:
    scene = scene_on_straight_road((Car(64.0, 198.25, 8.0), Car(70.0, 201.75, 8.0)))
    without = scene_on_straight_road((Car(64.0, 198.25, 8.0),))
    valid = scene.agents.valid.copy()
    valid[1, :5] = False
    hidden = dataclasses.replace(scene, agents=dataclasses.replace(scene.agents, valid=valid))
    assert same(render(hidden, [2])[0], render(without, [2])[0])
    assert not same(render(hidden, [6])[0], render(without, [6])[0])


@pytest.mark.parametrize("size", [(1, 1), (7, 3), (333, 77), (90, 160), (1600, 900)])
def test_any_size(size: tuple[int, int]) -> None:
    for image in render(scene_on_straight_road(seconds=0.5), [0], size)[0].values():
        assert image.shape == (size[1], size[0], 3)


def test_looks_differ_and_night_is_dark() -> None:
    bright = {}
    for look in ("day", "dusk", "night", "rain"):
        image = render(scene_on_straight_road(description=f"Road, {look}", seconds=0.5), [0])[0]["CAM_FRONT"]
        bright[look] = float(image.mean())
    assert bright["night"] < 0.5 * bright["dusk"] < 0.5 * bright["day"]
    assert len({round(value, 2) for value in bright.values()}) == 4


def test_front_and_rear_of_a_car_differ() -> None:
    pictures = render(in_turn((Car(62.0, 198.25), Car(62.0, 198.25, 0.0, np.pi))), [0, 1], (448, 256))
    red = []
    for images in pictures:
        image = images["CAM_FRONT"].astype(int)
        red.append(int(((image[..., 0] > 70) & (image[..., 1] < 45) & (image[..., 2] < 45)).sum()))
    assert red[0] > 20 and red[1] == 0


def test_brake_lamps_light_up() -> None:
    scene = scene_on_straight_road((Car(62.0, 198.25, 8.0),))
    position = scene.agents.position.copy()
    time = scene.seconds
    position[0, :, 0] = 62.0 + 8.0 * time - 1.2 * time**2 * (time < 3.0)
    braking = dataclasses.replace(scene, agents=dataclasses.replace(scene.agents, position=position))
    images = [render(s, [18], (448, 256))[0]["CAM_FRONT"].astype(int) for s in (scene, braking)]
    red = [int(((image[..., 0] > 190) & (image[..., 1] < 90)).sum()) for image in images]
    assert red[1] > red[0] + 10


def in_turn(cars: tuple[Car, ...]) -> Scene:
    """Car i is there at frame i alone; the ego stands."""
    scene = scene_on_straight_road(cars, ego_speed=0.0, seconds=4.0)
    valid = np.eye(len(cars), len(scene.timestamps_us), dtype=np.bool_)
    return dataclasses.replace(scene, agents=dataclasses.replace(scene.agents, valid=valid))


def test_things_around_and_across_the_cameras_do_not_break_anything() -> None:
    places = (49.0, 50.0, 51.7, 52.5, 53.0)
    cars = tuple(Car(x, 198.25) for x in places)
    cars += tuple(Car(x, 199.6, 0.0, 0.3, "vehicle.truck", (12.0, 2.6, 3.4)) for x in places)
    cars += tuple(Car(x, 198.0, 0.0, 1.0, "animal", (0.2, 0.2, 0.2)) for x in places)
    for images in render(in_turn(cars), list(range(len(cars)))):
        assert all(image.shape == (64, 112, 3) for image in images.values())


def test_every_category_can_be_drawn() -> None:
    categories = (*CATEGORIES, "something.new")
    scene = in_turn(tuple(Car(58.0, 198.25, 0.0, 0.5, category, (1.5, 0.8, 1.4)) for category in categories))
    *drawn, blank = (images["CAM_FRONT"] for images in render(scene, list(range(len(categories) + 1))))
    for category, image in zip(categories, drawn):
        assert not np.array_equal(image, blank), category


def test_facets_of_shapes_face_outwards() -> None:
    for category in CATEGORIES:
        shape = get_shape(choose_shape_name(category, np.array([4.0, 2.0, 1.6])))
        assert np.abs(shape.quads[..., :2]).max() <= 0.52 and shape.quads[..., 2].min() >= 0.0
        diagonals = shape.quads[:, 2] - shape.quads[:, 0], shape.quads[:, 3] - shape.quads[:, 1]
        normal = np.cross(*diagonals)
        assert (np.linalg.norm(normal, axis=1) > 0.0).all()
        assert (normal[:, 2] > -1e-9).mean() > 0.6


def test_no_agents_no_map_no_motion_no_cameras() -> None:
    for scene in (scene_on_straight_road(()), scene_on_straight_road(ego_speed=0.0, seconds=0.1)):
        bare = dataclasses.replace(scene, road_map=RoadMap("boston-seaport", MultiPolygon()), cameras=())
        for case in (scene, bare):
            assert tuple(render(case, [0])[0]) == CAMERA_NAMES
    assert list(SchematicRenderer().render(scene_on_straight_road(), [])) == []


@pytest.mark.parametrize("frame", [-1, 96])
def test_a_frame_outside_the_scene_is_refused(frame: int) -> None:
    with pytest.raises(InputError, match="frames 0 to 95"):
        render(scene_on_straight_road(), [0, frame])


@pytest.mark.parametrize("size", [(0, 10), (10, -1)])
def test_a_size_that_is_no_size_is_refused(size: tuple[int, int]) -> None:
    with pytest.raises(InputError, match="positive size"):
        SchematicRenderer(*size)


def test_nothing_stands_on_the_road_or_on_anybody() -> None:
    parked = Car(70.0, 230.0)
    scene = scene_on_straight_road((parked,))
    beside = build_roadside(scene, lamps=False)
    assert len(beside.footprint) > 50
    footprints = shapely.polygons(beside.footprint)
    paved = shapely.union_all([scene.road_map.drivable_area, *scene.road_map.walkways.values()])
    assert not shapely.intersects(footprints, paved).any()
    assert not shapely.intersects(footprints, shapely.Point(parked.x, parked.y)).any()


def test_a_place_looks_the_same_in_every_scene() -> None:
    def seen(ego_x: float) -> set[tuple[float, ...]]:
        beside = build_roadside(scene_on_straight_road((), ego_x=ego_x), lamps=False)
        inside = np.abs(beside.centre[:, 0] - 130.0) < 25.0
        inside &= np.abs(beside.centre[:, 1] - 200.0) < 40.0
        return {tuple(place) for place in beside.centre[inside].round(6).tolist()}

    assert seen(80.0) == seen(110.0) != set()
