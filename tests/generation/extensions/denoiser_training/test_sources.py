"""nuPlan databases and nuScenes roots as sources of tracks."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion.kinematics import compute_motion
from generation.extensions.denoiser_training import track_sources as nuplan
from generation.extensions.denoiser_training.track_sources import (
    NUPLAN_LICENCE,
    RecordingKind,
    TrackSource,
    cut_source_windows,
    find_track_sources,
    read_nuplan,
    resample_tracks,
)
from generation.extensions.denoiser_training.window_pool import load_track_data
from tests.generation.extensions.denoiser_training.nuplan_database import CLOUD_HZ, EGO_HZ, UTM_M, write_nuplan
from tests.generation.extensions.denoiser_training.test_tracks import drive, write_tracks
from tests.generation.nuscenes_writer.written_roots import short_scene, with_adversary, write_root
from tests.hand_made import Car


def circle(hz: float, seconds: float, speed: float = 8.0, yaw_rate: float = 0.2) -> Floats:
    """(T, 3) poses of a point that moves along its heading on a circle."""
    time = np.arange(round(seconds * hz)) / hz
    yaw, radius = yaw_rate * time, speed / yaw_rate
    return np.column_stack([radius * np.sin(yaw), radius * (1 - np.cos(yaw)), yaw])


def centers(poses: Floats, length: float) -> Floats:
    """Box centres of rear-axle poses, as the reader assumes them."""
    ahead = 1.39 / 4.084 * length
    yaw = poses[:, 2]
    return np.column_stack([poses[:, 0] + ahead * np.cos(yaw), poses[:, 1] + ahead * np.sin(yaw), yaw])


def database(folder: Path, name: str = "log.db", **kwargs: tuple[int, ...]) -> Path:
    others = [
        ("vehicle", 4.6, centers(circle(CLOUD_HZ, 12), 4.6)),
        ("bicycle", 1.8, circle(CLOUD_HZ, 12)),
        ("vehicle", 12.0, centers(circle(CLOUD_HZ, 10, 5.0, -0.1), 12.0)),
    ]
    return write_nuplan(folder / name, circle(EGO_HZ, 11), others, **kwargs)


def three_cars(folder: Path) -> Path:
    cars = [("vehicle", 4.6, circle(CLOUD_HZ, 12, speed)) for speed in (6.0, 8.0, 10.0)]
    return write_nuplan(folder / "log.db", circle(EGO_HZ, 2), cars)


def test_nuplan_tracks_are_rear_axles_at_an_even_rate(tmp_path: Path) -> None:
    ego, vehicles = read_nuplan(database(tmp_path), "nuplan")
    assert (ego.hz, ego.licence, len(ego.tracks), len(vehicles.tracks)) == (10.0, NUPLAN_LICENCE, 1, 2)
    assert vehicles.smoothing_s > ego.smoothing_s
    for track, expected in ((ego.tracks[0], circle(10, 11)), (vehicles.tracks[0], circle(10, 12))):
        count = min(len(track), len(expected))
        assert count >= len(expected) - 1
        assert np.abs(track[:count] - [*UTM_M, 0.0] - expected[:count]).max() < 1e-3
    assert np.allclose(np.diff(vehicles.tracks[1][:, 2]), -0.01)


def test_nuplan_windows_turn_as_the_cars_did_and_reading_leaves_the_database_alone(tmp_path: Path) -> None:
    folder = tmp_path / "nuplan"
    folder.mkdir()
    before = (path := database(folder)).read_bytes()
    (source,) = find_track_sources(folder)
    windows, licence = cut_source_windows(source, 0.5)
    assert (source.name, source.kind, licence) == ("nuplan", RecordingKind.NUPLAN, NUPLAN_LICENCE)
    assert sorted(set(windows.track)) == [0, 1, 2]
    moved = compute_motion(windows.waypoints, windows.previous)
    assert np.allclose(moved.curvature[windows.track != 2], 0.025, atol=1e-3)
    assert np.allclose(moved.speed[windows.track == 2], 5.0, atol=0.02)
    assert path.read_bytes() == before and [entry.name for entry in folder.iterdir()] == ["log.db"]


def test_one_endless_track_is_cut_so_that_it_fits_into_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nuplan, "PORTION_ROWS", 300)
    files = list(read_nuplan(write_nuplan(tmp_path / "log.db", circle(EGO_HZ, 11)), "nuplan"))
    assert [len(file.tracks[0]) for file in files] == [60, 50]


def test_missing_detections_split_only_where_they_are_long(tmp_path: Path) -> None:
    short = list(read_nuplan(database(tmp_path, "a.db", missing=(50, 51, 52)), "nuplan"))
    long = list(read_nuplan(database(tmp_path, "b.db", missing=tuple(range(50, 60))), "nuplan"))
    assert [len(files[1].tracks) for files in (short, long)] == [2, 4]


def test_null_poses_are_left_out(tmp_path: Path) -> None:
    path = database(tmp_path)
    with closing(sqlite3.connect(path)) as opened:
        opened.execute("UPDATE lidar_box SET x = NULL WHERE token = ?", (b"00000100",))
        opened.execute("UPDATE track SET length = NULL")
        opened.commit()
    _, vehicles = read_nuplan(path, "nuplan")
    assert len(vehicles.tracks) == 2
    assert all(np.isfinite(track).all() for track in vehicles.tracks)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("DROP TABLE lidar_box", "no such table"),
        ("ALTER TABLE lidar_box RENAME COLUMN yaw TO heading", "no such column"),
        ("DELETE FROM ego_pose; DELETE FROM lidar_box", "no pose of any vehicle"),
        ("UPDATE lidar_box SET x = 'far'", "not numeric"),
        ("UPDATE ego_pose SET y = 1e300", "from the origin"),
        ("UPDATE ego_pose SET y = 9e999", "from the origin"),
    ],
)
def test_databases_that_are_not_nuplan_are_refused(tmp_path: Path, change: str, words: str) -> None:
    path = database(tmp_path)
    with closing(sqlite3.connect(path)) as opened:
        opened.executescript(change)
    with pytest.raises(InputError, match=words):
        list(read_nuplan(path, "nuplan"))


def test_broken_locked_and_absent_databases_are_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nuplan, "WAIT_FOR_LOCK_S", 0.05)
    path = database(tmp_path)
    with closing(sqlite3.connect(path)) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(InputError, match="locked"):
            list(read_nuplan(path, "nuplan"))
    data = path.read_bytes()
    for content in (b"", b"not a database at all, only text" * 40, data[: len(data) // 2], data[:50] + bytes(8000)):
        path.write_bytes(content)
        with pytest.raises(InputError, match="nuPlan database"):
            list(read_nuplan(path, "nuplan"))
    (tmp_path / "folder.db").mkdir()
    for absent in (tmp_path / "absent.db", tmp_path / "folder.db"):
        with pytest.raises(InputError, match="nuPlan database"):
            list(read_nuplan(absent, "nuplan"))
    assert not (tmp_path / "absent.db").exists()


def test_sources_are_found_by_their_kind(tmp_path: Path) -> None:
    write_tracks(tmp_path / "made_up.npz", [drive(np.full(120, 10.0))])
    for folder in ("city", "town"):
        (tmp_path / folder).mkdir()
        write_nuplan(tmp_path / folder / "a.db", circle(EGO_HZ, 10))
    write_nuplan(tmp_path / "town" / "b.db", circle(EGO_HZ, 10))
    write_root(tmp_path / "written", [short_scene()])
    found = find_track_sources(tmp_path)
    assert [(source.name, source.kind.name, len(source.paths)) for source in found] == [
        ("city", "NUPLAN", 1),
        ("made_up", "TRACK_FILE", 1),
        ("town", "NUPLAN", 2),
        ("written", "NUSCENES", 1),
    ]
    assert len({source.content() for source in found}) == 4
    data = load_track_data(tmp_path, ("town",), 0.5)
    assert (sorted(data.training), sorted(data.held_out)) == (["city", "made_up"], ["town"])
    write_tracks(tmp_path / "city.npz", [drive(np.full(120, 10.0))])
    with pytest.raises(InputError, match="two sources called city"):
        find_track_sources(tmp_path)


def test_nuscenes_root_gives_the_recording_car_and_rigid_vehicles(tmp_path: Path) -> None:
    cars = (
        Car(80.0, 198.25, 6.0),
        Car(60.0, 194.75, 10.0, category="vehicle.truck", size=(8.0, 2.5, 3.0)),
        Car(40.0, 194.75, 5.0, category="vehicle.motorcycle"),
        Car(20.0, 194.75, 5.0, category="vehicle.bus.bendy"),
    )
    write_root(tmp_path / "written", [short_scene(seconds=10.1, cars=cars)])
    (source,) = find_track_sources(tmp_path)
    windows, _ = cut_source_windows(source, 0.5)
    assert (source.name, source.kind) == ("written", RecordingKind.NUSCENES)
    speed = compute_motion(windows.waypoints, windows.previous).speed
    for track, expected in enumerate((8.0, 6.0, 10.0)):
        assert np.allclose(speed[windows.track == track], expected, atol=0.01)
    ego, vehicles = source.read()
    assert ego.smoothing_s < vehicles.smoothing_s
    behind = 1.39 / 4.084 * np.array([4.6, 8.0])
    assert np.allclose([track[0, 0] for track in vehicles.tracks], [80.0, 60.0] - behind, atol=1e-3)
    assert np.allclose(ego.tracks[0][0], [50.0, 198.25, 0.0], atol=1e-3)


def test_generated_adversaries_are_not_learnt_from(tmp_path: Path) -> None:
    scene = short_scene(seconds=4.0)
    write_root(tmp_path / "recorded", [scene])
    write_root(tmp_path / "adversarial", [with_adversary(scene)])
    made, recorded = find_track_sources(tmp_path)
    assert [len(file.tracks) for file in recorded.read()] == [1, 3]
    assert [len(file.tracks) for file in made.read()] == [1, 2]


def test_broken_root_is_refused(tmp_path: Path) -> None:
    write_root(tmp_path / "written", [short_scene()])
    (version,) = (tmp_path / "written").glob("v1.0*")
    (version / "scene.json").write_text("[")
    (source,) = find_track_sources(tmp_path)
    with pytest.raises(InputError):
        list(source.read())


def test_long_sources_are_thinned_out_evenly(tmp_path: Path) -> None:
    path = write_tracks(tmp_path / "made_up.npz", [drive(5.0 + np.arange(400) * 0.02)])
    (source,) = find_track_sources(path.parent)
    every, _ = cut_source_windows(source, 0.1)
    few, _ = cut_source_windows(source, 0.1, limit=100)
    assert len(every.previous) > 300
    assert 50 <= len(few.previous) <= 100
    assert np.array_equal(few.previous, every.previous[::4])


def test_thinning_does_not_depend_on_portions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = TrackSource("nuplan", RecordingKind.NUPLAN, (three_cars(tmp_path),))
    whole, _ = cut_source_windows(source, 0.1)
    monkeypatch.setattr(nuplan, "PORTION_ROWS", 260)
    for limit in (70, 40, 20):
        few, _ = cut_source_windows(source, 0.1, limit=limit)
        every = round(len(whole.previous) / len(few.previous))
        assert len(few.previous) <= limit
        assert np.allclose(few.waypoints, whole.waypoints[::every], atol=1e-9)
        assert np.array_equal(few.track, whole.track[::every])


@settings(max_examples=20, deadline=None)
@given(
    seconds=st.lists(st.floats(0, 30), min_size=0, max_size=60),
    gap=st.floats(0.1, 2.0),
    broken=st.sets(st.integers(0, 59), max_size=5),
)
def test_even_tracks_never_leave_the_recorded_line(seconds: list[float], gap: float, broken: set[int]) -> None:
    times = np.sort(np.array(seconds))
    poses = np.column_stack([3.0 * times, -times, (0.5 * times + np.pi) % (2 * np.pi) - np.pi])
    for index in broken & set(range(len(times))):
        poses[index, 1] = np.nan
    sound = times[np.isfinite(poses).all(axis=1)]
    tracks = resample_tracks(times, poses, gap)
    for track in tracks:
        assert np.isfinite(track).all()
        assert np.allclose(track[:, 0], -3.0 * track[:, 1])
        assert np.allclose(np.diff(track[:, 0]), 0.3)
    assert (
        sum((len(track) - 1) / 10 for track in tracks) <= max(np.ptp(sound), 0.0) + 1e-6 if len(sound) else not tracks
    )
