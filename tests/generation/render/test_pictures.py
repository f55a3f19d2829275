from pathlib import Path

import cv2

from benchmark.geometry import box_gap
from generation.render.pictures import PANELS, moments, write_pictures
from generation.render.schematic import SchematicRenderer
from tests.benchmark.fake_data import FakeData
from tests.generation.nuscenes_writer.written_roots import with_adversary
from tests.hand_made import Car, scene_on_straight_road


def test_the_closest_approach_is_among_the_moments() -> None:
    scene = with_adversary(scene_on_straight_road((Car(20.0, 194.75, 12.0),), ego_x=50.0, ego_speed=5.0))
    gaps = box_gap(scene.agents.boxes[0], scene.ego.boxes)
    frames = moments(scene)
    assert len(frames) == PANELS
    assert frames == sorted(frames)
    assert min(gaps[frames]) == gaps.min()


def test_a_scene_without_an_adversary_is_shown_from_start_to_end() -> None:
    scene = scene_on_straight_road()
    frames = moments(scene)
    assert frames[0] == 0
    assert frames[-1] == len(scene.timestamps_us) - 1


def test_one_picture_a_scene(tmp_path: Path) -> None:
    data = FakeData({"scene-9901": with_adversary(scene_on_straight_road())})
    (path,) = write_pictures(data, ["scene-9901"], tmp_path, SchematicRenderer(112, 64))
    image = cv2.imread(str(path))
    assert image is not None
    assert image.std() > 10
