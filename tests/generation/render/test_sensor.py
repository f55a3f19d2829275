"""The schematic renderer as a sensor: pictures from where the ego really is."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.closed_loop.episodes import run_episode
from benchmark.scene import Scene
from generation.render.schematic import SECOND, SchematicRenderer
from generation.render.sensor import SchematicSensor
from tests.benchmark.closed_loop.staged import Watching, staged
from tests.hand_made import Car, scene_on_straight_road


@pytest.fixture(scope="module")
def scene() -> Scene:
    made = scene_on_straight_road((Car(80.0, 198.25, 8.0), Car(70.0, 194.75, 9.0)), seconds=4.0)
    return replace(made, cameras=tuple(camera.resized(112, 64) for camera in made.cameras))


def test_where_the_world_is_the_recording_pictures_are_the_renderers(scene: Scene) -> None:
    look = SchematicSensor("second").look(scene)
    for keyframe in (2, 0, 4):
        frame = int(scene.keyframes[keyframe])
        own = next(iter(SchematicRenderer(112, 64, style=SECOND).render(scene, [frame])))
        views = look.views(scene.first_frames(frame + 1))
        assert list(views) == [camera.name for camera in scene.cameras]
        for name, view in views.items():
            assert (view.load() == own[name]).all()
            assert view.camera.width == 112 and view.timestamp_us == scene.timestamps_us[frame]


def test_pictures_are_taken_from_where_the_ego_went(scene: Scene) -> None:
    stage = replace(staged(scene), sensor=SchematicSensor())
    ahead, aside = Watching(speed=8.0), Watching(speed=8.0, left=0.4)
    run_episode(stage, ahead)
    run_episode(stage, aside)
    first, last = (abs_difference(ahead.seen[at], aside.seen[at]) for at in (0, -1))
    assert first == 0.0 and last > 1.0
    view = aside.seen[-1].views["CAM_FRONT"]
    assert view.global_T_ego[:2, 3] == pytest.approx(aside.seen[-1].ego.pose[:2])


def abs_difference(first: object, second: object) -> float:
    one, other = (each.views["CAM_FRONT"].load().astype(float) for each in (first, second))  # type: ignore[attr-defined]
    return float(np.abs(one - other).mean())


def test_a_reader_may_change_its_picture(scene: Scene) -> None:
    view = SchematicSensor().look(scene).views(scene.first_frames(1))["CAM_BACK"]
    picture = view.load()
    picture[:] = 0
    assert view.load().any()


def test_a_sensor_says_what_it_draws() -> None:
    sensor = SchematicSensor("first")
    assert sensor.name == "schematic" and sensor.facts["style"] == "first"
    assert sensor.facts != SchematicSensor("second").facts


def test_a_scene_without_cameras_is_seen_with_the_default_rig(scene: Scene) -> None:
    look = SchematicSensor().look(replace(scene, cameras=()))
    assert len(look.cameras) == 6 and look.cameras[0].width == 448
