from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats, wrap_angle
from generation.physics import DriverLimits, MotionModel, SimulatedMotion, VehicleState, rear_axle, simulate
from generation.reference_path import reference_path

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "physics"
SI = MotionModel.si()
LENGTH_M = 4.6


def along_x(speeds: Floats) -> Floats:
    x = np.cumsum(0.5 * speeds, axis=-1)
    return np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=-1)


def drive(waypoints: Floats, speed: float, steps: int = 48, **more: float) -> SimulatedMotion:
    return simulate(waypoints, VehicleState(np.zeros(3), speed, **more), LENGTH_M, steps=steps, model=SI)


def test_reference_model_repeats_the_golden_numbers() -> None:
    golden = np.load(GOLDEN / "physics.npz")
    for group, row in enumerate(golden["groups"]):
        values = dict(zip(golden["group_columns"], row, strict=True))
        members = golden["group"] == group
        pose = np.array([values["rear_x"], values["rear_y"], values["rear_heading"]])
        motion = simulate(
            golden["waypoints_local"][members],
            VehicleState(pose, values["speed_per_step"]),
            values["length"],
            steps=80,
            model=MotionModel.reference(),
        )
        error = motion.center - golden["center_pose"][members]
        error[..., 2] = wrap_angle(error[..., 2])
        good = golden["well_conditioned"][members]
        assert np.abs(error[good]).max(initial=0.0) < 1e-6
        assert np.abs(motion.commands - golden["commands"][members])[good].max(initial=0.0) < 1e-8
        soon = golden["sensitivity_13_steps_m"][members] < 1e-6
        assert np.abs(error[soon, :14]).max(initial=0.0) < 1e-6


def test_reference_profiles_repeat_the_golden_numbers() -> None:
    golden = np.load(GOLDEN / "physics.npz")
    path = reference_path(golden["waypoints_local"][..., :2], dt=1.0, frames_per_waypoint=5, smooth=False)
    good = golden["well_conditioned"]
    np.testing.assert_allclose(path.speed[good], golden["velocity_profile"][good], atol=1e-10)
    np.testing.assert_allclose(path.curvature[good], golden["curvature_profile"][good], atol=1e-8)


def test_constant_speed_stays_constant() -> None:
    motion = drive(along_x(np.full((1, 16), 10.0)), 10.0)
    np.testing.assert_allclose(motion.states[0, :, 3], 10.0, atol=1e-6)
    np.testing.assert_allclose(motion.states[0, -1, 0], 40.0, atol=1e-4)
    np.testing.assert_allclose(motion.center[0, :, 0] - motion.states[0, :, 0], 0.3 * LENGTH_M)


def test_a_bend_is_followed() -> None:
    turn = 0.5 * 8.0 / 20.0 * np.arange(1, 17)
    waypoints = np.stack([20.0 * np.sin(turn), 20.0 * (1.0 - np.cos(turn)), turn], axis=-1)[None]
    state = VehicleState(np.zeros(3), 8.0, 0.0, float(np.arctan(0.6 * LENGTH_M / 20.0)))
    motion = simulate(waypoints, state, LENGTH_M, steps=36, model=SI)
    radius = np.hypot(motion.states[0, :, 0], motion.states[0, :, 1] - 20.0)
    assert np.abs(radius - 20.0).max() < 0.6


def test_a_standing_car_starts_and_a_moving_one_stops() -> None:
    speeds = np.stack([np.linspace(0.5, 8.0, 16), np.zeros(16)])
    motion = drive(along_x(speeds), 0.0)
    assert motion.states[0, -1, 3] > 1.5
    np.testing.assert_array_equal(motion.states[1, :, :3], 0.0)
    stopping = drive(along_x(np.maximum(8.0 - 1.5 * np.arange(1, 17), 0.0)[None]), 8.0, 84)
    assert stopping.states[0, -1, 3] < 0.5


def test_waypoints_behind_never_make_a_car_reverse_or_turn_round() -> None:
    motion = drive(along_x(np.full((1, 16), -4.0)), 3.0, 84)
    assert motion.states[0, :, 3].min() >= 0.0
    assert np.abs(motion.states[0, :, 2]).max() < 0.2
    assert (np.diff(motion.states[0, :, 0]) >= 0.0).all()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.0, 25.0), st.floats(-5.0, 2.5), st.floats(-0.3, 0.3))
def test_limits_hold_for_any_waypoints(seed: int, speed: float, acceleration: float, steering: float) -> None:
    limits = DriverLimits()
    steering = float(np.clip(steering, -0.4 * LENGTH_M / max(speed, 1.0) ** 2, 0.4 * LENGTH_M / max(speed, 1.0) ** 2))
    rng = np.random.default_rng(seed)
    waypoints = np.cumsum(rng.normal([3.0, 0.0, 0.0], [4.0, 3.0, 1.0], (12, 16, 3)), axis=1)
    motion = drive(waypoints, speed, acceleration=acceleration, steering=steering)
    states = motion.states
    wheelbase = 0.6 * LENGTH_M
    assert states[..., 3].min() >= 0.0
    assert states[:, 1:, 4].max() <= limits.acceleration_m_s2 + 1e-9
    assert states[:, 1:, 4].min() >= -limits.braking_m_s2 - 1e-9
    jerk = np.diff(states[..., 4], axis=1) * 12
    moving = states[:, 1:, 3] > 0.0
    assert np.abs(jerk[moving]).max(initial=0.0) <= limits.jerk_m_s3 + 1e-6
    lateral = states[:, 1:, 3] ** 2 * np.tan(states[:, 1:, 5]) / wheelbase
    assert np.abs(lateral).max() <= limits.lateral_acceleration_m_s2 + 1e-6
    sideways = np.diff(states[..., 1], axis=1) * np.cos(states[:, :-1, 2])
    sideways -= np.diff(states[..., 0], axis=1) * np.sin(states[:, :-1, 2])
    np.testing.assert_allclose(sideways, 0.0, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32), st.floats(-3.0, 3.0), st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))
def test_rigid_motion_of_the_start_moves_the_result(seed: int, yaw: float, x: float, y: float) -> None:
    waypoints = np.cumsum(np.random.default_rng(seed).normal([4.0, 0.0, 0.0], 1.0, (4, 16, 3)), axis=1)
    here = simulate(waypoints, VehicleState(np.zeros(3), 7.0), LENGTH_M, steps=24, model=SI)
    there = simulate(waypoints, VehicleState(np.array([x, y, yaw]), 7.0), LENGTH_M, steps=24, model=SI)
    cos, sin = np.cos(yaw), np.sin(yaw)
    expected_x = x + here.center[..., 0] * cos - here.center[..., 1] * sin
    np.testing.assert_allclose(there.center[..., 0], expected_x, atol=1e-8)
    np.testing.assert_allclose(wrap_angle(there.center[..., 2] - here.center[..., 2] - yaw), 0.0, atol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_one_broken_candidate_is_marked_and_the_rest_is_undisturbed(bad: float) -> None:
    waypoints = along_x(np.full((3, 16), 6.0))
    clean = drive(waypoints, 6.0)
    waypoints[1, 7, 0] = bad
    motion = drive(waypoints, 6.0)
    np.testing.assert_array_equal(motion.finite, [True, False, True])
    np.testing.assert_array_equal(motion.center[[0, 2]], clean.center[[0, 2]])
    assert np.isnan(motion.center[1]).all()


def test_going_on_from_a_state_is_the_same_as_not_stopping() -> None:
    waypoints = along_x(np.full((1, 16), 9.0))
    whole = drive(waypoints, 9.0, 24)
    half = simulate(waypoints, whole.state(0, 12), LENGTH_M, steps=12, model=SI)
    np.testing.assert_allclose(half.center[0], whole.center[0, 12:], atol=1e-6)


def test_rear_axle_is_behind_the_center() -> None:
    np.testing.assert_allclose(rear_axle(np.array([10.0, 5.0, np.pi / 2]), 5.0), [10.0, 3.5, np.pi / 2])
