"""What planners see of a driven world: simulated motion, and nothing of the recording's future."""

import gc
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.closed_loop.default_engine import PRIMING_STEPS, DefaultBackend
from benchmark.closed_loop.episodes import run_episode
from benchmark.closed_loop.observation_builder import STEERING_RATIO
from benchmark.closed_loop.simulation_state import SimulatorBackend
from benchmark.closed_loop.world_state import STEP_US
from benchmark.geometry import Floats
from benchmark.planning import CameraView, Observation
from benchmark.scene import Scene
from generation.render.sensor import SchematicSensor
from tests.benchmark.closed_loop.staged import Peeking, Watching, can_of, staged
from tests.benchmark.fake_data import FakeData
from tests.hand_made import Car, scene_on_straight_road

MAKERS = [DefaultBackend(), DefaultBackend("idm")]


def seen_by(planner: Watching, scene: Scene, maker: SimulatorBackend) -> list[Observation]:
    run_episode(staged(scene, maker), planner)
    return planner.seen


def arrays_reachable(value: Any) -> Iterator[Floats]:
    """Every array of numbers that can be got at from a value, through attributes, closures, containers."""
    waiting, known = [value], set()
    while waiting:
        here = waiting.pop()
        if id(here) in known or isinstance(here, type | str | bytes | int | float | None.__class__):
            continue
        known.add(id(here))
        if isinstance(here, np.ndarray):
            yield here
            if here.base is not None:
                waiting.append(here.base)
        elif isinstance(here, Observation) or is_dataclass(here):
            waiting += [getattr(here, field.name) for field in fields(here)]
        elif type(here).__module__ in ("builtins", "functools", "collections", "types"):
            # What a function is defined in is code and not data.
            module = getattr(here, "__globals__", None)
            waiting += [each for each in gc.get_referents(here) if each is not module]


@pytest.mark.parametrize(("maker", "with_images"), [*((maker, False) for maker in MAKERS), (MAKERS[0], True)])
def test_nothing_of_the_recordings_future_can_be_reached(maker: SimulatorBackend, with_images: bool) -> None:
    scene = marked_future(scene_on_straight_road((Car(80.0, 201.75, 8.0),), seconds=5.0))
    scene = replace(scene, cameras=tuple(camera.resized(56, 32) for camera in scene.cameras))
    stage = staged(scene, maker)
    planner = Watching()
    run_episode(replace(stage, sensor=SchematicSensor()) if with_images else stage, planner)
    assert len(planner.seen) > PRIMING_STEPS + 2
    future = future_numbers(scene, PRIMING_STEPS + 1)
    for observation in planner.seen[: PRIMING_STEPS + 2]:
        if with_images:
            assert set(observation.views) == {camera.name for camera in scene.cameras}
        for array in arrays_reachable(observation):
            if array.dtype.kind == "f":
                assert not future & set(np.round(array.ravel(), 9).tolist())


def test_a_leak_would_be_found() -> None:
    scene = marked_future(scene_on_straight_road((), seconds=5.0))
    planner = Watching()
    run_episode(staged(scene), planner)
    view = CameraView(scene.cameras[0], Path("x"), 0, np.eye(4), lambda: np.asarray(scene.ego.position, np.uint8))
    leaking = replace(planner.seen[0], views={"CAM_FRONT": view})
    found = [set(np.round(array.ravel(), 9).tolist()) for array in arrays_reachable(leaking) if array.dtype.kind == "f"]
    assert any(numbers & future_numbers(scene, PRIMING_STEPS + 1) for numbers in found)


def marked_future(scene: Scene) -> Scene:
    """The scene with a recorded ego whose later positions are numbers that nothing else comes to."""
    position = scene.ego.position.copy()
    later = int(scene.keyframes[PRIMING_STEPS]) + 1
    position[later:, :2] += 1e-3 * np.random.default_rng(1).random((len(position) - later, 2))
    return replace(scene, ego=replace(scene.ego, position=position))


def future_numbers(scene: Scene, keyframe: int) -> set[float]:
    later = scene.ego.position[int(scene.keyframes[keyframe - 1]) + 1 :, :2]
    everybody = scene.agents.position[:, int(scene.keyframes[keyframe + 1]) :, 0]
    tokens = np.round(np.concatenate([later.ravel(), everybody.ravel()]), 9)
    return set(tokens.tolist())


def test_no_sample_of_the_recording_is_named() -> None:
    scene = scene_on_straight_road((), seconds=4.0)
    names = {each.sample_token for each in FakeData({scene.name: scene}).observations(scene.name)}
    seen = seen_by(Watching(), scene, DefaultBackend())
    assert not names & {each.sample_token for each in seen}
    assert len({each.sample_token for each in seen}) == len(seen)


def test_motion_is_measured_while_primed_and_simulated_from_then_on() -> None:
    scene = scene_on_straight_road((), ego_speed=8.0, seconds=6.0)
    seen = seen_by(Watching(speed=4.0), scene, DefaultBackend())
    for primed, motion in zip(seen[: PRIMING_STEPS + 1], can_of(scene).motion):
        assert primed.ego.can_motion == pytest.approx(motion) and primed.ego.source == "derived"
    last = seen[-1].ego
    assert last.source == "can_bus" and last.velocity[0] == pytest.approx(4.0, abs=0.5)
    assert seen[PRIMING_STEPS + 1].ego.acceleration[0] < -0.5
    assert last.can_motion is not None and last.can_motion[5] == pytest.approx(9.81)
    assert all(each.ego.can_motion_after is None for each in seen)


def test_who_reads_the_message_after_is_given_none_of_later() -> None:
    class Reading(Watching):
        reads_message_after = True

    for observation in seen_by(Reading(speed=4.0), scene_on_straight_road((), seconds=5.0), DefaultBackend()):
        ego = observation.ego
        assert ego.can_motion is not None and ego.can_motion_after is not None
        assert ego.can_motion_after.tolist() == ego.can_motion.tolist()


def test_a_bend_is_in_yaw_rate_acceleration_and_wheel() -> None:
    scene = scene_on_straight_road((), ego_speed=6.0, seconds=6.0)
    ego = seen_by(Watching(speed=6.0, left=0.4), scene, DefaultBackend())[-1].ego
    assert ego.yaw_rate > 0.02 and ego.steering_angle is not None
    assert ego.acceleration[1] == pytest.approx(ego.velocity[0] * ego.yaw_rate)
    assert np.tan(ego.steering_angle / STEERING_RATIO) * ego.velocity[0] / 2.588 == pytest.approx(ego.yaw_rate)


def test_poses_are_those_that_were_driven() -> None:
    scene = scene_on_straight_road((), ego_speed=8.0, seconds=6.0)
    seen = seen_by(Watching(speed=2.0), scene, DefaultBackend())
    for before, after in pairwise(seen):
        assert after.past_poses[-2] == pytest.approx(before.ego.pose) and after.past_valid[-2]
        assert after.index == before.index + 1 and after.timestamp_us - before.timestamp_us == STEP_US
    assert seen[0].past_valid.tolist() == [False] * 4 + [True]
    behind = scene.ego.pose[scene.keyframes[len(seen) - 1], 0] - seen[-1].ego.pose[0]
    assert behind > 5.0


def test_the_privileged_see_the_world_as_driven_up_to_now() -> None:
    scene = scene_on_straight_road((Car(90.0, 198.25, 1.0), Car(70.0, 201.75, 9.0)), ego_speed=8.0, seconds=6.0)
    planner = Peeking(speed=3.0)
    seen = seen_by(planner, scene, DefaultBackend("idm"))
    assert len(planner.revealed) == len(seen)
    for revealed, observation in zip(planner.revealed, seen):
        assert int(revealed.timestamps_us[-1]) == observation.timestamp_us
        assert len(revealed.keyframes) == observation.index + 1 and revealed.keyframes[-1] == len(revealed.seconds) - 1
        assert revealed.ego.pose[-1] == pytest.approx(observation.ego.pose)
        assert revealed.agents.position.shape[1] == len(revealed.seconds) == len(revealed.ego.position)
        assert revealed.annotations.position.shape[1] == len(revealed.keyframes)
        assert revealed.road_map is scene.road_map


def test_agents_that_answer_are_seen_where_they_went() -> None:
    ego_stands = scene_on_straight_road((Car(20.0, 198.25, 8.0),), ego_speed=8.0, seconds=8.0)
    replayed, answering = Peeking(speed=0.0), Peeking(speed=0.0)
    seen_by(replayed, ego_stands, DefaultBackend("replay"))
    seen_by(answering, ego_stands, DefaultBackend("idm"))
    last = min(len(replayed.revealed), len(answering.revealed)) - 1
    assert answering.revealed[last].agents.position[0, -1, 0] < replayed.revealed[last].agents.position[0, -1, 0] - 2.0
