"""How training draws: sources capped, speeds and turns evened out, windows mirrored and scaled with their past."""

import numpy as np
import pytest

from benchmark.geometry import Floats
from generation.diffusion.kinematics import compute_motion
from generation.diffusion.standardiser import convert_actions_to_waypoints
from generation.extensions.denoiser_training.tracks import TrackWindows
from generation.extensions.denoiser_training.window_pool import MOST_OF_ONE_SOURCE, WindowPool, compute_source_shares


def windows(speed: float, count: int, yaw_rate: float = 0.0) -> TrackWindows:
    """The same steady drive many times, all of one track."""
    yaw = yaw_rate * 0.5 * np.arange(-1, 17)
    step = 0.5 * speed * np.column_stack([np.cos(yaw), np.sin(yaw)])
    path = np.column_stack([np.cumsum(step, axis=0), yaw])
    path[:, :2] -= path[1, :2]
    every = np.broadcast_to(path, (count, 18, 3))
    return TrackWindows(every[:, 0], every[:, 2:], np.zeros(count, np.int64), {})


def speeds(previous: Floats) -> Floats:
    return np.asarray(np.hypot(previous[:, 0], previous[:, 1]) / 0.5)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_shares_are_roots_with_a_cap() -> None:
    share = compute_source_shares(np.array([22_000, 3500, 2800, 2400, 700, 500, 50]))
    assert share.sum() == pytest.approx(1.0)
    assert share[0] == pytest.approx(MOST_OF_ONE_SOURCE)
    assert share[1] / share[3] == pytest.approx(np.sqrt(3500 / 2400))
    assert np.sqrt(22_000) / np.sqrt([22_000, 3500, 2800, 2400, 700, 500, 50]).sum() > 0.35


def test_the_cap_holds_for_all_sources_and_gives_way_where_there_are_too_few_others() -> None:
    share = compute_source_shares(np.array([10_000, 9000, 100, 100, 100, 0]))
    assert share.max() == pytest.approx(MOST_OF_ONE_SOURCE) and (share == share.max()).sum() == 2 and share[-1] == 0
    for count in ([7], [900, 1], [5, 5, 5]):
        share = compute_source_shares(np.array(count))
        assert share.sum() == pytest.approx(1.0) and share.max() == pytest.approx(1 / len(count))


def test_long_sources_do_not_drown_short_ones() -> None:
    """All in the same cell of speed and turn, so that only the sources count."""
    counts = (10_000, 400, 400, 400, 100)
    sources = {str(index): windows(9.0 + 0.2 * index, count) for index, count in enumerate(counts)}
    pool = WindowPool.of(sources)
    drawn = speeds(pool.draw(20_000, 0.0, rng()).previous)
    assert list(pool.shares.values()) == pytest.approx(list(compute_source_shares(np.array(counts))))
    for index, share in enumerate(compute_source_shares(np.array(counts))):
        assert np.isclose(drawn, 9.0 + 0.2 * index, atol=0.05).mean() == pytest.approx(share, abs=0.01)


def test_rare_speeds_and_turns_are_drawn_more_often_than_they_are_there() -> None:
    common, fast, turning = windows(9.0, 9000), windows(20.0, 700), windows(9.0, 300, 0.2)
    drawn = WindowPool.of({"one": TrackWindows.joined([common, fast, turning])}).draw(20_000, 0.0, rng())
    turned = np.abs(convert_actions_to_waypoints(drawn.actions, drawn.previous)[:, -1, 2]) > 0.5
    quick = speeds(drawn.previous) > 15
    expected = np.array([0.9, 0.07, 0.03]) ** 0.7
    expected /= expected.sum()
    assert quick.mean() == pytest.approx(expected[1], abs=0.01)
    assert turned.mean() == pytest.approx(expected[2], abs=0.01)
    assert expected[2] > 0.05


def test_windows_are_mirrored_and_scaled_together_with_their_past() -> None:
    pool = WindowPool.of({"one": windows(8.0, 50, 0.1)})
    kept = pool.actions.copy(), pool.previous.copy()
    drawn = pool.draw(4000, 0.3, rng())
    np.testing.assert_array_equal(pool.actions, kept[0])
    np.testing.assert_array_equal(pool.previous, kept[1])
    left = convert_actions_to_waypoints(drawn.actions, drawn.previous)[:, -1, 2]
    assert (left > 0).mean() == pytest.approx(0.5, abs=0.03)
    moved = compute_motion(convert_actions_to_waypoints(drawn.actions, drawn.previous), drawn.previous)
    assert np.abs(moved.acceleration).max() < 1e-6
    assert np.allclose(np.abs(moved.yaw_rate), 0.1)
    assert moved.speed.min() == pytest.approx(8.0 * 0.7, rel=0.01)
    assert moved.speed.max() == pytest.approx(8.0 * 1.3, rel=0.01)
