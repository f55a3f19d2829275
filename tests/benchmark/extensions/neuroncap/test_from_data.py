"""Recordings from a data set: frames, annotations and CAN bus as the engine reads them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.loop import Engine
from benchmark.extensions.neuroncap.recording import read_recording
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.score import score_run
from benchmark.extensions.neuroncap.staging import RenderableActors, stage_run
from benchmark.records.neuroncap_aggregate import CODE, PAPER, NeuroncapSwitches
from benchmark.scene import Scene
from tests.benchmark.extensions.neuroncap.made import constant, driven_by
from tests.hand_made import Car, scene_on_straight_road


@pytest.fixture
def scene() -> Scene:
    digger = Car(200.0, 205.25, 0.0, 0.3, "vehicle.construction", (6.0, 2.5, 3.0))
    walker = Car(90.0, 190.0, 0.0, 0.0, "human.pedestrian.adult", (0.7, 0.6, 1.8))
    made = scene_on_straight_road((Car(110.0, 198.25), digger, walker), seconds=12.0)
    valid = made.annotations.valid.copy()
    valid[0, :2] = False
    return replace(made, annotations=replace(made.annotations, valid=valid))


@pytest.fixture
def root(tmp_path: Path, scene: Scene) -> Path:
    start = int(scene.timestamps_us[0])
    rows = [
        {
            "utime": start - 7_000 + 20_000 * number,
            "pos": [50.0 + 0.16 * number, 198.25, 0.0],
            "orientation": [1.0, 0.0, 0.0, 0.0],
            "accel": [0.1, 0.2, 9.8],
            "rotation_rate": [0.0, 0.0, 0.01],
            "vel": [8.0 + 0.001 * number, 0.0, 0.0],
        }
        for number in range(600)
    ]
    wheel = [{"utime": start + 40_000 * number, "steer_corrected": 3.0 + number} for number in range(250)]
    folder = tmp_path / "can_bus"
    folder.mkdir()
    (folder / f"{scene.name}_pose.json").write_text(json.dumps(rows))
    (folder / f"{scene.name}_zoe_veh_info.json").write_text(json.dumps(wheel))
    return tmp_path


def test_frames_have_the_first_message_at_or_after_them(scene: Scene, root: Path) -> None:
    recording = read_recording(scene, root, CODE)
    assert np.array_equal(recording.times, scene.timestamps_us[scene.keyframes])
    # The second message is 13 ms after the first frame; the 26th is 7 ms before the second one.
    assert recording.canbus[:2, 13] == pytest.approx([8.001, 8.026])
    assert recording.canbus[0, 7:10] == pytest.approx([0.1, 0.2, 9.8]) and recording.canbus.dtype == np.float32
    assert recording.steering_wheel[:2] == pytest.approx(np.radians([3.0, 16.0]))
    assert recording.path[:, 0] == pytest.approx(50.0 + 4.0 * np.arange(24)) and len(recording.times) == 24


def test_actors_are_those_of_the_engine_s_classes(scene: Scene, root: Path) -> None:
    for switches, kinds in ((CODE, ["pedestrian", "car"]), (PAPER, ["construction", "pedestrian", "car"])):
        actors = read_recording(scene, root, switches).actors
        # Who appears later stands later in the list.
        assert [actor.kind for actor in actors] == kinds
        car = actors[-1]
        assert car.size == pytest.approx([1.9, 4.6, 1.7]) and len(car.times) == 22
        assert car.poses[0, :3, 3] == pytest.approx([110.0, 198.25, 0.85])


def test_a_scene_can_be_driven_and_scored(scene: Scene, root: Path) -> None:
    for switches in (CODE, PAPER):
        recording = read_recording(scene, root, switches)
        scenario = Scenario(start_frame=2, priming_steps=2, duration_s=8.0)
        run = stage_run(scenario, 0, recording.times, RenderableActors.of(recording.actors), switches)
        made = Engine.of(recording, run, priming_steps=2, renderer_knows=frozenset(), switches=switches)
        world = driven_by(made, constant(8.0))
        assert world.contact is not None and world.contact.uuid == scene.agents.ids[0]
        assert score_run(made, world).score < 0.2


def test_a_scene_without_can_bus_is_refused(scene: Scene, root: Path) -> None:
    for message in ("zoe_veh_info", "pose"):
        path = root / "can_bus" / f"{scene.name}_{message}.json"
        path.write_text("[]")
        with pytest.raises(InputError, match=f"{message}.json holds nothing; get the CAN bus"):
            read_recording(scene, root, NeuroncapSwitches())
        path.unlink()
        with pytest.raises(InputError, match=f"{message}.json holds nothing; get the CAN bus"):
            read_recording(scene, root, NeuroncapSwitches())
