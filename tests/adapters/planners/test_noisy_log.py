"""The recording with an error: its formula, its seeds, and what is never drawn from it."""

from dataclasses import replace

import numpy as np
import pytest

from adapters.models import MODELS, baselines, build_baseline
from adapters.planners.noisy_log import ACROSS_M, ALONG_M, NoisyLog, PublishedNoisyLog
from adapters.registry import planner_factory
from benchmark.closed_loop.route import Route
from benchmark.geometry import Floats, quaternion_from_yaw, to_local
from benchmark.machine.storage import content_seed
from benchmark.planning import PlanFrame, SceneInfo
from benchmark.scene import EgoTrack, Scene
from tests.benchmark.fake_data import observation, sample_truth
from tests.hand_made import scene_on_straight_road

NOWHERE = SceneInfo("scene", "boston-seaport", ())


def bend() -> Scene:
    """A quarter of a circle to the left of 30 m, driven at 5.9 m/s."""
    scene = scene_on_straight_road(())
    angle = np.linspace(0.4, 0.4 + np.pi / 2, len(scene.timestamps_us))
    position = 30.0 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle), np.zeros(len(angle))])
    return replace(scene, ego=EgoTrack(position, quaternion_from_yaw(angle)))


def revealed(planner: NoisyLog, scene: Scene) -> NoisyLog:
    planner.reset(NOWHERE)
    planner.reveal(scene)
    return planner


def error_of(scene: Scene, index: int, planner: NoisyLog) -> Floats:
    """(6, 2) metres along the recorded heading and to its left, by the truth of the sample."""
    future = sample_truth(scene, index).ego_future
    off = revealed(planner, scene).plan(observation(scene, index, {})).waypoints_in_lidar() - future[:, :2]
    cos, sin = np.cos(future[:, 2]), np.sin(future[:, 2])
    return np.column_stack([off[:, 0] * cos + off[:, 1] * sin, off[:, 1] * cos - off[:, 0] * sin])


@pytest.mark.parametrize("index", [2, 6])
def test_the_error_is_that_of_the_formula_in_the_recorded_heading(index: int) -> None:
    scene = bend()
    seen = observation(scene, index, {})
    z1, z2 = np.random.default_rng(content_seed("noisy-log", 3, seen.sample_token)).standard_normal(2)
    share = min(1.0, 0.2 + seen.ego.velocity[0] / 6.0)
    by_hand = [
        (share * (0.5 * step / 3.0) ** 1.5 * 1.04 * z1, share * (0.5 * step / 3.0) ** 1.5 * 0.45 * z2)
        for step in range(1, 7)
    ]
    assert error_of(scene, index, NoisyLog(3)) == pytest.approx(np.array(by_hand), abs=1e-9)
    assert error_of(scene, index, PublishedNoisyLog(3)) == pytest.approx(2.0 * np.array(by_hand), abs=1e-9)


def test_plans_depend_on_seed_and_sample_alone() -> None:
    scene = bend()
    planner = revealed(NoisyLog(1), scene)
    forwards = [planner.plan(observation(scene, index, {})).waypoints for index in range(8)]
    backwards = [planner.plan(observation(scene, index, {})).waypoints for index in reversed(range(8))]
    assert np.array_equal(forwards, backwards[::-1])
    errors = np.array([error_of(scene, index, NoisyLog(seed))[-1] for index in range(8) for seed in range(40)])
    assert len(np.unique(errors[:, 0])) == len(errors)
    assert np.abs(np.corrcoef(errors.T)[0, 1]) < 0.15


def test_plans_are_as_far_off_as_they_say_and_less_where_the_car_stands() -> None:
    fast, stands = (scene_on_straight_road((), ego_speed=speed, seconds=6.0) for speed in (9.0, 0.0))
    errors = [np.array([error_of(scene, 4, NoisyLog(seed))[-1] for seed in range(600)]) for scene in (fast, stands)]
    assert np.hypot(*errors[0].T).mean() == pytest.approx(0.97, abs=0.05)
    assert errors[0].std(axis=0) == pytest.approx([ALONG_M, ACROSS_M], rel=0.1)
    assert errors[1] == pytest.approx(0.2 * errors[0], abs=1e-9), "the same draws of the same sample"


def test_past_the_end_of_the_recording_it_goes_on_as_log_replay_does() -> None:
    scene = bend()
    last = len(scene.keyframes) - 1
    recorded, noisy = (
        planner.plan(observation(scene, last, {})).waypoints
        for planner in (revealed(NoisyLog(0), scene), revealed(NoisyLog(1), scene))
    )
    assert np.isfinite(recorded).all() and 0.0 < np.abs(recorded - noisy)[-1].max() < 6.0


def test_in_closed_loop_it_errs_around_the_recording_in_time() -> None:
    scene, route = bend(), Route.of(bend())
    planner = NoisyLog(5)
    planner.reset(NOWHERE)
    planner.follow(route)
    seen = observation(scene, 4, {})
    plan = planner.plan(seen)
    seconds = route.seconds_of(seen.timestamp_us) + 0.5 * np.arange(1, 7)
    off = plan.waypoints - to_local(route.recorded_at(seconds), seen.ego.pose)
    in_open_loop = error_of(scene, 4, NoisyLog(5))
    assert plan.frame is PlanFrame.EGO and np.hypot(*off.T) == pytest.approx(np.hypot(*in_open_loop.T), rel=1e-6)


def test_it_is_a_baseline_whose_seed_is_part_of_its_runs() -> None:
    one, two = (planner_factory("noisy-log", seed=seed) for seed in (0, 7))
    assert (one.facts.seed, two.facts.seed, one.facts.privileged) == (0, 7, True)
    assert one.facts.settings == {"along_m": ALONG_M, "across_m": ACROSS_M}
    assert planner_factory("noisy-log-published").facts.settings == {"along_m": 2 * ALONG_M, "across_m": 2 * ACROSS_M}
    drawn = {name for name, model in baselines().items() if model.draws > 1}
    assert drawn == {"noisy-log", "noisy-log-published"} and MODELS["noisy-log"].draws == 40
    assert build_baseline("noisy-log", seed=7).seed == 7 and build_baseline("stop", seed=7).name == "stop"
