"""Steps are half a second by the clock: truth, history and command where key frames are not half a second apart."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.datasets.observations import compute_past
from benchmark.datasets.sample_truth import compute_planar_lidar_poses, compute_recorded_command, compute_truth
from benchmark.datasets.steps import (
    KeyFrameSteps,
    find_irregular_interval_us,
    interpolate_values,
    is_step,
    require_two_hz,
)
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_global, wrap_angle
from benchmark.planning import Command
from benchmark.scene import EgoTrack, Scene
from benchmark.truth import SampleTruth
from tests.benchmark.irregular_time import at_other_times, slow_steps, with_key_frames, without_key_frames
from tests.hand_made import Car, scene_on_straight_road

CARS = (Car(80.0, 198.25, 8.0), Car(60.0, 194.75, 10.0), Car(120.0, 201.75, 9.0, np.pi))


def curved() -> Scene:
    """The ego turns by more than half a circle, past +-180 degrees, and speeds up; objects come and go."""
    scene = scene_on_straight_road(CARS)
    time = scene.seconds
    half = 0.5 * (2.5 + 0.3 * time)
    rotation = np.column_stack([np.cos(half), np.zeros((len(time), 2)), np.sin(half)])
    position = scene.ego.position + np.column_stack([0.5 * time**2, np.sin(time), np.zeros(len(time))])
    valid = scene.annotations.valid.copy()
    valid[0, :3], valid[1, 6], valid[2, 10:] = False, False, False
    scene = replace(scene, ego=EgoTrack(position, rotation))
    return replace(scene, annotations=replace(scene.annotations, valid=valid))


def truths(scene: Scene, steps: int = 6) -> tuple[SampleTruth, ...]:
    return compute_truth(scene, [str(index) for index in range(len(scene.keyframes))], steps)


def in_global(truth: SampleTruth, boxes: Floats) -> Floats:
    """Boxes (..., 5) or poses (..., 3) of the lidar frame in the global one; headings from -pi to pi."""
    points = to_global(np.stack([boxes[..., 1], -boxes[..., 0]], axis=-1), truth.lidar_pose)
    yaw = wrap_angle(boxes[..., -1:] - np.pi / 2 + truth.lidar_pose[2])
    return np.concatenate([points, boxes[..., 2:-1], yaw], axis=-1)


def lidar_of(axle: Floats, ahead_m: float) -> Floats:
    return np.array([*(axle[:2] + ahead_m * np.array([np.cos(axle[2]), np.sin(axle[2])])), wrap_angle(axle[2])])


def require_slow_truth(scene: Scene, truth: SampleTruth) -> None:
    """The truth by the clock is what the slow one says, step by step."""
    by_clock, slow = truth.by_clock, slow_steps(scene, truth.index)
    assert by_clock.ego_future_valid.tolist() == [step.known for step in slow[1:]]
    assert by_clock.cut_short == (all(step.recorded for step in slow) and not all(step.known for step in slow))
    assert set(by_clock.instances) == {name for step in slow for name in step.boxes}
    boxes, future = in_global(truth, by_clock.boxes), in_global(truth, by_clock.ego_future)
    for number, step in enumerate(slow):
        if number and step.known:
            np.testing.assert_allclose(future[number - 1], lidar_of(step.axle, truth.lidar_ahead_m), atol=1e-6)
        for row, name in enumerate(by_clock.instances):
            assert bool(by_clock.annotated[row, number]) == (name in step.boxes)
            if name in step.boxes:
                expected = step.boxes[name] - [0, 0, 0, 0, boxes[row, number, 4]]
                np.testing.assert_allclose(boxes[row, number, :4], expected[:4], atol=1e-6)
                assert abs(float(wrap_angle(expected[4]))) < 1e-6


@pytest.mark.parametrize("gap_s", [0.39926, 0.4, 0.5, 0.6])
def test_where_intervals_are_those_of_nuscenes_steps_are_key_frames(gap_s: float) -> None:
    rng = np.random.default_rng(0)
    for gaps in (np.full(15, gap_s), rng.uniform(0.4, 0.6, 15)):
        found = truths(at_other_times(curved(), gaps))
        assert all(truth.timed is None and truth.by_clock is truth and not truth.cut_short for truth in found)
    assert is_step(400_000) and is_step(600_000) and not is_step(390_000) and not is_step(610_000)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.08, 0.2, 0.35]), mean_s=st.sampled_from([0.1, 0.2, 0.5]))
def test_interpolation_is_that_of_the_slow_truth(seed: int, spread: float, mean_s: float) -> None:
    rng = np.random.default_rng(seed)
    gaps = mean_s * rng.uniform(1 - 2 * spread, 1 + 2 * spread, 15)
    scene = at_other_times(curved(), gaps)
    for truth in truths(scene):
        if truth.timed is not None:
            require_slow_truth(scene, truth)


@pytest.mark.parametrize("every", [1, 3])
def test_more_key_frames_of_the_same_motion_say_the_same(every: int) -> None:
    scene = scene_on_straight_road(CARS)
    frames = np.arange(0, scene.keyframes[-1] + 1, every)
    at_two_hz, dense = truths(scene), truths(with_key_frames(scene, frames))
    assert not any(truth.at_two_hz for truth in dense)
    for truth in at_two_hz[:-1]:
        same = dense[truth.index * 6 // every]
        assert same.timed is not None
        np.testing.assert_array_equal(same.timed.ego_future_valid, truth.ego_future_valid)
        np.testing.assert_array_equal(same.timed.annotated, truth.annotated)
        known = truth.ego_future_valid
        np.testing.assert_allclose(same.timed.ego_future[known], truth.ego_future[known], atol=1e-4)
        np.testing.assert_allclose(same.timed.boxes[truth.annotated], truth.boxes[truth.annotated], atol=1e-4)


def test_a_missing_key_frame_leaves_unknown_what_lies_in_the_gap_and_beyond() -> None:
    scene = without_key_frames(curved(), 7)
    found = truths(scene)
    known = [truth.by_clock.ego_future_valid.sum() for truth in found]
    assert known[:8] == [6, 5, 4, 3, 2, 1, 0, 6]
    assert [truth.timed is None for truth in found[:8]] == [True, *[False] * 6, True]
    assert [truth.by_clock.cut_short for truth in found[:8]] == [False, *[True] * 6, False]
    for truth in found[1:7]:
        require_slow_truth(scene, truth)
        # The official rule: the k-th key frame, whenever that is.
        expected = in_global(truth, truth.ego_future)[-1]
        np.testing.assert_allclose(expected, compute_planar_lidar_poses(scene)[truth.index + 6], atol=1e-9)


def test_longer_plans_go_by_the_clock_too() -> None:
    scene = without_key_frames(scene_on_straight_road(CARS), 9)
    assert [int(truth.by_clock.ego_future_valid.sum()) for truth in truths(scene, 12)[:4]] == [8, 7, 6, 5]


def test_the_command_is_where_the_car_is_after_three_seconds_whatever_lies_between() -> None:
    scene = scene_on_straight_road(CARS)
    position = scene.ego.position.copy()
    position[:, 1] += np.where(scene.seconds > 3.3, 2.5, 0.0)
    scene = replace(scene, ego=EgoTrack(position, scene.ego.rotation))
    expected = [Command.STRAIGHT, *[Command.LEFT] * 6, Command.STRAIGHT]
    assert [truth.command for truth in truths(scene)[:8]] == expected
    for other in (without_key_frames(scene, 2), with_key_frames(scene, np.arange(91))):
        clock = KeyFrameSteps.of(other)
        commands = {
            round((truth.timestamp_us - scene.timestamps_us[0]) * 2e-6, 3): truth.command for truth in truths(other)
        }
        assert all(commands[at] is expected[int(at)] for at in commands if at in range(8))
        lidar = compute_planar_lidar_poses(other)
        asked = [compute_recorded_command(other, clock, lidar, truth.index) for truth in truths(other)]
        assert asked == [truth.command for truth in truths(other)]


def test_history_is_half_a_second_back_step_by_step() -> None:
    scene = curved()
    dense = with_key_frames(scene_on_straight_road(CARS), np.arange(91))
    dense = replace(dense, ego=scene.ego)
    for at in range(16):
        poses, valid = compute_past(scene, scene.ego.pose, KeyFrameSteps.of(scene), at)
        if 6 * at in dense.keyframes:
            same, same_valid = compute_past(dense, dense.ego.pose, KeyFrameSteps.of(dense), 6 * at)
            assert same_valid.tolist() == valid.tolist()
            np.testing.assert_allclose(same[valid][:, :2], poses[valid][:, :2], atol=1e-4)
            np.testing.assert_allclose(wrap_angle(same[valid] - poses[valid]), 0.0, atol=1e-4)


def test_history_ends_at_a_gap_and_the_oldest_known_pose_stands_there() -> None:
    scene = without_key_frames(scene_on_straight_road(CARS), 7)
    clock = KeyFrameSteps.of(scene)
    poses, valid = compute_past(scene, scene.ego.pose, clock, 8)
    assert valid.tolist() == [False, False, False, True, True]
    assert poses[:4, 0].tolist() == [poses[3, 0]] * 4 and poses[4, 0] - poses[3, 0] == pytest.approx(4.0)
    assert compute_past(scene, scene.ego.pose, clock, 6)[1].all()


def test_a_rate_is_the_median_interval() -> None:
    assert find_irregular_interval_us([0, 500_000, 1_500_000, 2_000_000]) is None
    assert find_irregular_interval_us([0, 100_000, 200_000, 700_000]) == 100_000
    assert find_irregular_interval_us([0]) is None and find_irregular_interval_us([]) is None
    with pytest.raises(InputError, match=r"0\.0833 s apart .* the search needs one every 0\.5 s"):
        require_two_hz(with_key_frames(scene_on_straight_road(CARS), np.arange(91)), "the search")


def test_headings_are_interpolated_by_the_shortest_turn() -> None:
    values = np.array([[0.0, 0.0, 3.1], [1.0, 2.0, -3.1]])
    found = interpolate_values(values, np.array([0, 1_000_000]), np.array([-5, 500_000, 2_000_000]))
    np.testing.assert_allclose(found[[0, 2]], values)
    np.testing.assert_allclose(found[1, :2], [0.5, 1.0])
    assert abs(found[1, 2]) == pytest.approx(np.pi)
