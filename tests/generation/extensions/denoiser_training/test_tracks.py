"""Track files: what becomes a window, what is left out or refused, and how training draws windows."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion.kinematics import compute_motion
from generation.diffusion.standardiser import convert_actions_to_waypoints, convert_waypoints_to_actions
from generation.extensions.denoiser_training.track_sources import find_track_sources
from generation.extensions.denoiser_training.tracks import (
    TrackFile,
    TrackWindows,
    cut_windows,
    read_tracks,
    smooth_track,
)
from generation.extensions.denoiser_training.window_pool import MOST_OF_ONE_SOURCE, WindowPool, compute_source_shares

HZ = 10.0


def drive(speed: Floats, yaw_rate: Floats | float = 0.0, start_yaw: float = 0.3) -> Floats:
    """(T, 3) rear-axle poses at 10 Hz, exactly on the motion."""
    yaw = start_yaw + np.concatenate([[0.0], np.cumsum(np.broadcast_to(yaw_rate, len(speed)) / HZ)])[:-1]
    step = speed[:, None] / HZ * np.column_stack([np.cos(yaw), np.sin(yaw)])
    return np.column_stack([np.cumsum(step, axis=0), yaw])


def write_tracks(path: Path, tracks: list[Floats], **changes: Any) -> Path:
    """A track file whose box centres lie 0.34 lengths ahead of the given rear axles."""
    poses = np.concatenate(tracks) if tracks else np.zeros((0, 3))
    ahead = 1.39 / 4.084 * 4.5
    arrays: dict[str, Any] = {
        "ptr": np.cumsum([0, *(len(track) for track in tracks)]),
        "x": (poses[:, 0] + ahead * np.cos(poses[:, 2])).astype(np.float32),
        "y": (poses[:, 1] + ahead * np.sin(poses[:, 2])).astype(np.float32),
        "heading": poses[:, 2].astype(np.float32),
        "length": np.full(len(tracks), 4.5, np.float32),
        "cls": np.array(["car"] * len(tracks)),
        "hz": np.float64(HZ),
        "source": np.array("made_up"),
        "licence": np.array("none"),
    }
    arrays |= changes
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def test_straight_drive_becomes_windows_in_the_rear_axle_frame(tmp_path: Path) -> None:
    path = write_tracks(tmp_path / "made_up.npz", [drive(np.full(100, 10.0))])
    windows = cut_windows(read_tracks(path))
    assert len(windows.previous) == 3
    assert np.allclose(windows.previous, [-5.0, 0.0, 0.0], atol=1e-3)
    assert np.allclose(windows.waypoints[:, :, 0], 5.0 * np.arange(1, 17), atol=1e-3)
    assert np.allclose(windows.waypoints[:, :, 1:], 0.0, atol=1e-3)


def test_start_from_rest_and_braking_are_kept() -> None:
    pulling_away = np.clip(np.arange(100) / HZ - 3.0, 0.0, 8.0)
    braking = np.clip(14.0 - 4.0 * (np.arange(100) / HZ - 2.0), 0.0, 14.0)
    windows = cut_windows(TrackFile("made_up", "none", (drive(pulling_away), drive(braking)), HZ))
    assert len(windows.previous) == 6
    assert sum(windows.rejected.values()) == 0


@pytest.mark.parametrize(
    ("speed", "yaw_rate", "reason"),
    [
        (np.full(100, 0.3), 0.0, "less than 5 m"),
        (np.where(np.arange(100) < 50, 20.0, 5.0), 0.0, "8 m/s"),
        (np.full(100, 20.0), 0.6, "lateral"),
        (8.0 + np.sin(2 * np.pi * np.arange(100) / HZ / 1.9), 0.0, "rough throughout"),
        (np.full(100, 4.0), 1.5, "tighter than a car"),
        (np.full(100, -5.0), 0.0, "heading against motion"),
    ],
)
def test_undrivable_windows_are_left_out(speed: Floats, yaw_rate: float, reason: str) -> None:
    windows = cut_windows(TrackFile("made_up", "none", (drive(speed, yaw_rate),), HZ))
    assert len(windows.previous) == 0
    assert any(reason in named and count for named, count in windows.rejected.items())


def test_short_tracks_and_other_road_users_give_nothing(tmp_path: Path) -> None:
    tracks = [drive(np.full(80, 10.0)), drive(np.full(100, 10.0))]
    path = write_tracks(tmp_path / "made_up.npz", tracks, cls=np.array(["car", "pedestrian"]))
    assert len(cut_windows(read_tracks(path)).previous) == 0


@settings(max_examples=20, deadline=None)
@given(curve=st.tuples(*[st.floats(-3, 3)] * 3), span=st.sampled_from([1.1, 1.7, 2.3]))
def test_smoothing_leaves_quadratics_alone(curve: tuple[float, float, float], span: float) -> None:
    time = np.arange(60) / HZ
    track = np.polyval(curve, time)[:, None]
    assert np.abs(smooth_track(track, HZ, span) - track).max() < 1e-8


def test_smoothing_removes_jitter() -> None:
    jitter = 0.1 * np.random.default_rng(0).standard_normal((200, 1))
    assert smooth_track(jitter, HZ, 2.3).std() < 0.5 * jitter.std()


@settings(max_examples=20, deadline=None)
@given(turn=st.floats(-3.1, 3.1), shift=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)))
def test_windows_do_not_depend_on_place_and_direction(turn: float, shift: tuple[float, float]) -> None:
    track = drive(np.linspace(5, 12, 100), 0.1)
    cos, sin = np.cos(turn), np.sin(turn)
    moved = np.column_stack([track[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + shift, track[:, 2] + turn])
    windows = [cut_windows(TrackFile("made_up", "none", (poses,), HZ)) for poses in (track, moved)]
    actions = [convert_waypoints_to_actions(part.waypoints, part.previous) for part in windows]
    assert np.abs(actions[0] - actions[1]).max() < 1e-9


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"heading": None}, "lacks the arrays heading"),
        ({"ptr": np.array([0, 50])}, "ptr"),
        ({"ptr": np.array([0, 120])}, "ptr"),
        ({"x": np.full(100, np.nan)}, "NaN"),
        ({"y": np.zeros(99)}, "one value per sample"),
        ({"hz": np.float64(0)}, "samples per second"),
        ({"cls": np.array(["car"], dtype=object)}, "cannot read"),
    ],
)
def test_broken_files_are_refused_with_a_sentence(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    path = write_tracks(tmp_path / "made_up.npz", [drive(np.full(100, 10.0))], **changes)
    with pytest.raises(InputError, match=words):
        read_tracks(path)


def test_truncated_and_foreign_files_are_refused(tmp_path: Path) -> None:
    path = write_tracks(tmp_path / "made_up.npz", [drive(np.full(100, 10.0))])
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(InputError, match="fetch or make"):
        read_tracks(path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match="fetch or make"):
        read_tracks(path)
    path.unlink()
    for folder in (tmp_path, tmp_path / "absent"):
        with pytest.raises(InputError, match=r"pass (the|a) folder"):
            find_track_sources(folder)


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


def test_reversing_is_never_drivable_and_standing_still_has_no_direction() -> None:
    forward = np.column_stack([2.0 * np.arange(1, 17), np.zeros((16, 2))])
    back = forward.copy()
    back[8:, 0] = back[7, 0] - 1.0 * np.arange(1, 9)
    moved = compute_motion(np.stack([forward, back]), np.array([-2.0, 0.0, 0.0]))
    assert moved.excess[0] == 0 and moved.excess[1] > 1
    standing = compute_motion(0.01 * np.random.default_rng(0).standard_normal((16, 3)), np.zeros(3))
    assert standing.excess == 0 and np.allclose(standing.turn, 0)
