from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits

from benchmark.dynamics.bicycle import (
    DriverLimits,
    MotionModel,
    SimulatedMotion,
    VehicleState,
    compute_rear_axle,
    simulate,
)
from benchmark.dynamics.reference_path import (
    HELD_BELOW_M_S,
    _hold_chords,
    _hold_step_by_step,
    _interpolation,
    _speed_fit,
    build_reference_path,
)
from benchmark.geometry import Floats, wrap_angle
from tests.benchmark.dynamics.slow_physics import slow_path, slow_simulate

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "physics"
SHARED_GOLDEN = Path(__file__).resolve().parents[4] / "shared" / "golden" / "physics"
SI, REFERENCE = MotionModel.si(), MotionModel.reference()
LENGTH_M = 4.6


def along_x(speeds: Floats) -> Floats:
    x = np.cumsum(0.5 * speeds, axis=-1)
    return np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=-1)


def drive(waypoints: Floats, speed: float, steps: int = 48, **more: float) -> SimulatedMotion:
    return simulate(waypoints, VehicleState(np.zeros(3), speed, **more), LENGTH_M, steps=steps, model=SI)


@pytest.mark.parametrize(
    "folder",
    [
        GOLDEN,
        pytest.param(SHARED_GOLDEN, marks=pytest.mark.skipif(not SHARED_GOLDEN.is_dir(), reason="needs all numbers")),
    ],
    ids=["some", "all"],
)
def test_reference_model_repeats_the_golden_numbers(folder: Path) -> None:
    golden = np.load(folder / "physics.npz")
    for group, row in enumerate(golden["groups"]):
        values = dict(zip(golden["group_columns"], row, strict=True))
        members = golden["group"] == group
        pose = np.array([values["rear_x"], values["rear_y"], values["rear_heading"]])
        motion = simulate(
            golden["waypoints_local"][members],
            VehicleState(pose, values["speed_per_step"]),
            values["length"],
            steps=80,
            model=REFERENCE,
        )
        error = motion.center - golden["center_pose"][members]
        error[..., 2] = wrap_angle(error[..., 2])
        good = golden["well_conditioned"][members]
        assert np.abs(error[good]).max(initial=0.0) < 1e-9
        assert np.abs(motion.commands - golden["commands"][members])[good].max(initial=0.0) < 1e-11
        soon = golden["sensitivity_13_steps_m"][members] < 1e-6
        assert np.abs(error[soon, :14]).max(initial=0.0) < 1e-6


def test_what_is_kept_for_the_whole_process_does_not_depend_on_threads() -> None:
    kept = []
    for threads in (1, 2, 4):
        _speed_fit.cache_clear()
        _interpolation.cache_clear()
        with threadpool_limits(threads, user_api="blas"):
            kept.append((_speed_fit(97, 1 / 12, True), _speed_fit(97, 1 / 12, False), _interpolation(6, True)))
    for others in kept[1:]:
        assert all(np.array_equal(one, other) for one, other in zip(kept[0], others))


def test_reference_profiles_repeat_the_golden_numbers() -> None:
    golden = np.load(GOLDEN / "physics.npz")
    path = build_reference_path(golden["waypoints_local"][..., :2], dt=1.0, frames_per_waypoint=5, smooth=False)
    good = golden["well_conditioned"]
    np.testing.assert_allclose(path.speed.T[good], golden["velocity_profile"][good], atol=1e-10)
    np.testing.assert_allclose(path.curvature.T[good], golden["curvature_profile"][good], atol=1e-8)


DEGENERATE = {
    **dict.fromkeys(("zeros_moving", "zeros_stopped", "one_point", "tiny_1e-9", "sideways"), 1e-9),
    **dict.fromkeys(("huge_speed", "zigzag", "random_1e3"), 1e-6),
    "huge_jump": 0.1,  # 10 km in one waypoint, then the steering saturates
}


@pytest.mark.skipif(not SHARED_GOLDEN.is_dir(), reason="needs the golden numbers")
@pytest.mark.parametrize("name", DEGENERATE)
def test_reference_model_repeats_degenerate_cases(name: str) -> None:
    golden = np.load(SHARED_GOLDEN / "physics_degenerate.npz")
    x, y, yaw, _, length, _ = golden["common_center_x_y_heading_width_length_height"]
    state = VehicleState(compute_rear_axle(np.array([x, y, yaw]), length), float(golden[f"{name}/speed_per_step"]))
    motion = simulate(golden[f"{name}/waypoints_local"][None], state, length, steps=80, model=REFERENCE)
    error = motion.center[0] - golden[f"{name}/center_pose"]
    error[:, 2] = wrap_angle(error[:, 2])
    assert np.abs(error[:14]).max() < 1e-8
    assert np.abs(error).max() < DEGENERATE[name]


def driven(rng: np.random.Generator, count: int) -> Floats:
    speed = np.maximum(rng.uniform(0.0, 15.0) + np.cumsum(rng.normal(0.0, 0.7, (count, 16)), axis=1), 0.0)
    heading = np.cumsum(rng.normal(0.0, 0.08, (count, 16)), axis=1)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return np.cumsum(0.5 * speed[..., None] * direction, axis=1)


def erratic(rng: np.random.Generator, count: int) -> Floats:
    return np.cumsum(rng.normal([3.0, 0.0], [3.0, 2.0], (count, 16, 2)), axis=1)


def hardly_moving(rng: np.random.Generator, count: int) -> Floats:
    return np.asarray(np.cumsum(rng.normal(0.0, 0.05, (count, 16, 2)), axis=1) * (rng.random((count, 16, 1)) < 0.5))


@pytest.mark.parametrize(
    "model, waypoints",
    [(SI, driven), (SI, erratic), (SI, hardly_moving), (REFERENCE, driven), (REFERENCE, erratic)],
    ids=["si driven", "si erratic", "si hardly moving", "reference driven", "reference erratic"],
)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32), steps=st.integers(1, 80))
def test_the_fast_side_agrees_with_the_slow_one(
    model: MotionModel, waypoints: Callable[[np.random.Generator, int], Floats], seed: int, steps: int
) -> None:
    rng = np.random.default_rng(seed)
    candidates, length = waypoints(rng, 2), float(rng.uniform(2.0, 11.0))
    per_frame = 1.0 if model.limits else 1.0 / 12.0
    state = VehicleState(
        np.array([*rng.uniform(-500.0, 500.0, 2), rng.uniform(-np.pi, np.pi)]),
        float(rng.uniform(0.0, 15.0) * per_frame),
        float(rng.uniform(-2.0, 2.0) * per_frame**2),
        float(rng.uniform(-0.05, 0.05)),
    )
    fast = simulate(candidates, state, length, steps=steps, model=model)
    path = build_reference_path(
        candidates, dt=model.dt, frames_per_waypoint=model.frames_per_waypoint, smooth=model.smooth
    )
    around = np.hypot(*(path.position[2:] - path.position[:-2]).transpose(1, 0, 2))
    # Where a path turns on the spot, its direction is a matter of the last bit.
    assume(model.smooth or around.min() > 1e-6)
    for index, candidate in enumerate(candidates):
        expected = slow_path(candidate, model)
        np.testing.assert_allclose(path.position[..., index], expected.pose[:, :2], atol=1e-9)
        np.testing.assert_allclose(wrap_angle(path.heading[:, index] - expected.pose[:, 2]), 0.0, atol=1e-9)
        np.testing.assert_allclose(path.speed[:, index], expected.speed, atol=1e-9)
        center, states, commands = slow_simulate(candidate, state, length, steps=steps, model=model)
        for mine, theirs in ((fast.center, center), (fast.states, states)):
            error = mine[index] - theirs
            error[:, 2] = wrap_angle(error[:, 2])
            assert np.abs(error).max() < 1e-6
        np.testing.assert_allclose(fast.commands[index], commands, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), size=st.sampled_from([0.01, 0.1, 1.0]), drift=st.sampled_from([0.0, 0.1, 1.0]))
def test_chords_are_held_as_step_by_step(seed: int, size: float, drift: float) -> None:
    rng, dt = np.random.default_rng(seed), 1.0 / 12.0
    chord = size * rng.normal(size=(12, 2, 5)) + np.array([drift, 0.0])[:, None]
    expected, ahead = chord.copy(), np.array([[1.0], [0.0]]).repeat(5, axis=1)
    _hold_step_by_step(expected, (chord**2).sum(axis=1) < (2.0 * HELD_BELOW_M_S * dt) ** 2, ahead)
    _hold_chords(chord, dt)
    assert chord.tolist() == expected.tolist()


def test_a_standing_car_starts_and_a_moving_one_stops_and_none_reverses() -> None:
    motion = drive(along_x(np.stack([np.linspace(0.5, 8.0, 16), np.zeros(16)])), 0.0)
    assert motion.states[0, -1, 3] > 1.5
    np.testing.assert_array_equal(motion.states[1, :, :3], 0.0)
    stopping = drive(along_x(np.maximum(8.0 - 1.5 * np.arange(1, 17), 0.0)[None]), 8.0, 84)
    assert stopping.states[0, -1, 3] < 0.5
    # Waypoints behind it.
    motion = drive(along_x(np.full((1, 16), -4.0)), 3.0, 84)
    assert motion.states[0, :, 3].min() >= 0.0 and np.abs(motion.states[0, :, 2]).max() < 0.2
    assert (np.diff(motion.states[0, :, 0]) >= 0.0).all()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.0, 25.0), st.floats(-5.0, 2.5), st.floats(-0.3, 0.3))
def test_limits_hold_for_any_waypoints(seed: int, speed: float, acceleration: float, steering: float) -> None:
    limits, wheelbase, most = DriverLimits(), 0.6 * LENGTH_M, 0.4 * LENGTH_M / max(speed, 1.0) ** 2
    steering = float(np.clip(steering, -most, most))
    waypoints = np.cumsum(np.random.default_rng(seed).normal([3.0, 0.0, 0.0], [4.0, 3.0, 1.0], (12, 16, 3)), axis=1)
    states = drive(waypoints, speed, acceleration=acceleration, steering=steering).states
    speeds, accelerations = states[..., 3], states[:, 1:, 4]
    assert speeds.min() >= 0.0 and accelerations.max() <= limits.acceleration_m_s2 + 1e-9
    assert accelerations.min() >= -limits.braking_m_s2 - 1e-9
    jerk = np.diff(states[..., 4], axis=1) * 12
    assert np.abs(jerk[speeds[:, 1:] > 0.0]).max(initial=0.0) <= limits.jerk_m_s3 + 1e-6
    lateral = speeds[:, 1:] ** 2 * np.tan(states[:, 1:, 5]) / wheelbase
    assert np.abs(lateral).max() <= limits.lateral_acceleration_m_s2 + 1e-6
    sideways = np.diff(states[..., 1], axis=1) * np.cos(states[:, :-1, 2])
    sideways -= np.diff(states[..., 0], axis=1) * np.sin(states[:, :-1, 2])
    np.testing.assert_allclose(sideways, 0.0, atol=1e-9)


@pytest.mark.parametrize("model", [SI, REFERENCE], ids=["si", "reference"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e160, 1e20])
def test_one_broken_candidate_leaves_the_rest_undisturbed(bad: float, model: MotionModel) -> None:
    waypoints = np.cumsum(np.random.default_rng(5).normal([3.0, 0.0], 1.0, (5, 16, 2)), axis=1)
    waypoints[4] = 0.0  # comes to a stand
    state = VehicleState(np.zeros(3), 6.0)
    clean = simulate(waypoints, state, LENGTH_M, steps=48, model=model)
    waypoints[1, 7, 0] = waypoints[3] = bad
    motion = simulate(waypoints, state, LENGTH_M, steps=48, model=model)
    others = [0, 2, 4]
    assert motion.finite[others].all()
    assert not motion.finite[1] or bad == 1e20
    np.testing.assert_array_equal(motion.center[others], clean.center[others])
    np.testing.assert_array_equal(motion.commands[others], clean.commands[others])
    np.testing.assert_array_equal(np.isfinite(motion.center).all(axis=(1, 2)), motion.finite)


def test_nothing_and_no_time_are_simulated_as_such() -> None:
    assert simulate(np.zeros((0, 16, 3)), VehicleState(np.zeros(3), 5.0), 4.0, steps=12, model=SI).finite.shape == (0,)
    still = drive(along_x(np.full((2, 16), 6.0)), 6.0, 0)
    np.testing.assert_array_equal(still.states[:, 0], [[0.0, 0.0, 0.0, 6.0, 0.0, 0.0]] * 2)
    np.testing.assert_allclose(compute_rear_axle(np.array([10.0, 5.0, np.pi / 2]), 5.0), [10.0, 3.5, np.pi / 2])


def test_si_penalises_jerk_and_the_reference_acceleration() -> None:
    accelerating = 5.0 + 0.1 * np.arange(96.0)
    np.testing.assert_allclose(_speed_fit(96, 1.0 / 12.0, True) @ (accelerating / 12.0), accelerating, atol=1e-9)
    per_frame = 0.5 + 0.01 * np.arange(80.0)
    assert np.abs(_speed_fit(80, 1.0, False) @ per_frame - per_frame).max() > 1e-7


@pytest.mark.parametrize("length", [3.6, 4.6, 11.0])
def test_si_tracks_with_the_vehicles_own_wheelbase(length: float) -> None:
    turn = 0.5 * 6.0 / 30.0 * np.arange(1, 17)
    waypoints = np.stack([30.0 * np.sin(turn), 30.0 * (1.0 - np.cos(turn))], axis=-1)[None]
    on_circle = VehicleState(np.zeros(3), 6.0, 0.0, float(np.arctan(0.6 * length / 30.0)))
    believing = replace(SI, tracker_wheelbase_m=REFERENCE.tracker_wheelbase_m)
    missed = []
    for model in (SI, believing):
        states = simulate(waypoints, on_circle, length, steps=48, model=model).states[0, 24:]
        missed.append(np.abs(np.hypot(states[:, 0], states[:, 1] - 30.0) - 30.0).max())
    assert missed[0] < 0.25 and (length != 11.0 or missed[1] > 2.0 * missed[0])


def test_going_on_from_a_state_is_the_same_as_not_stopping() -> None:
    waypoints = along_x(np.full((1, 16), 9.0))
    whole = drive(waypoints, 9.0, 24)
    half = simulate(waypoints, whole.state(0, 12), LENGTH_M, steps=12, model=SI)
    np.testing.assert_allclose(half.center[0], whole.center[0, 12:], atol=1e-6)
