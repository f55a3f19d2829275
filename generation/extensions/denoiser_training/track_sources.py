"""Tracks from recordings: the kinds of folders, nuScenes roots, nuPlan databases, and resampling to an even rate."""

import contextlib
import itertools
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.datasets.roots import open_data
from benchmark.datasets.tables import find_version_folders
from benchmark.errors import InputError
from benchmark.geometry import Floats, yaw_of_quaternion
from benchmark.machine.storage import content_key, file_sha256
from benchmark.scene import Scene
from generation.extensions.denoiser_training.tracks import (
    ROUGH_SPAN_S,
    SMOOTHING_SPAN_S,
    TrackFile,
    TrackWindows,
    compute_rear_axle,
    cut_windows,
    read_tracks,
)

RATE_HZ: Final = 10.0
"""Samples per second of what comes out; windows are cut on this grid."""


def resample_tracks(seconds: Floats, poses: Floats, longest_gap_s: float) -> tuple[Floats, ...]:
    """Even 10 Hz tracks, (F, 3), heading unwrapped, of each stretch of poses without a gap above ``longest_gap_s``.

    Poses, (T, 3) x, y, heading, with NaN or infinity, and those not later than the one before them, are left out.
    """
    sound = np.isfinite(seconds) & np.isfinite(poses).all(axis=1)
    seconds, poses = seconds[sound], poses[sound]
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], seconds[:-1]])) if len(seconds) else seconds
    seconds, poses = seconds[seconds > latest], poses[seconds > latest]
    tracks = []
    for stretch in np.split(np.arange(len(seconds)), np.flatnonzero(np.diff(seconds) > longest_gap_s) + 1):
        if len(stretch) < 2:
            continue
        times = seconds[stretch] - seconds[stretch[0]]
        grid = np.arange(int(times[-1] * RATE_HZ + 1e-6) + 1) / RATE_HZ
        columns = (poses[stretch, 0], poses[stretch, 1], np.unwrap(poses[stretch, 2]))
        tracks.append(np.column_stack([np.interp(grid, times, column) for column in columns]))
    return tuple(tracks)


NUPLAN_LICENCE: Final = "CC BY-NC-SA 4.0 (nuPlan; nuScenes terms of use)"
LONGEST_GAP_S: Final = 0.3
"""Boxes come at 20 Hz; a detection that fails a few times is bridged."""
PORTION_ROWS: Final = 100_000
"""Poses that are read at a time, some 30 MB; up to twice as many are held."""
FARTHEST_M: Final = 1e8
"""No map reaches so far; nuPlan's coordinates are UTM."""
WAIT_FOR_LOCK_S: Final = 2.0

EGO_QUERY: Final = "SELECT 0, 0.0, timestamp, x, y, qw, qx, qy, qz FROM ego_pose ORDER BY timestamp"
"""The recording car at up to 100 Hz; the point is the rear axle."""
BOX_QUERY: Final = """
    SELECT box.track_token, track.length, cloud.timestamp, box.x, box.y, box.yaw
    FROM lidar_box AS box
    JOIN lidar_pc AS cloud ON cloud.token = box.lidar_pc_token
    JOIN track ON track.token = box.track_token
    JOIN category ON category.token = track.category_token
    WHERE category.name = 'vehicle'
    ORDER BY box.track_token, cloud.timestamp
"""
"""Box centres of cars, trucks and buses at 20 Hz. SQLite sorts in temporary files where memory is short."""


def read_nuplan(path: Path, source: str) -> Iterator[TrackFile]:
    """Tracks of one nuPlan database (``.db``, opened read-only), portion by portion.

    Rear-axle tracks at 10 Hz: the recording car's first, then those of vehicles. Rows without a number, and rows not
    later than the one before them, are left out; a longer gap splits a track. A locked database is refused, too.
    """
    rows = 0
    try:
        address = f"{path.resolve().as_uri()}?mode=ro"
        with contextlib.closing(sqlite3.connect(address, uri=True, timeout=WAIT_FOR_LOCK_S)) as database:
            for query, span in ((EGO_QUERY, SMOOTHING_SPAN_S), (BOX_QUERY, ROUGH_SPAN_S)):
                for portion in _read_portions(database.execute(query)):
                    rows += len(portion)
                    tracks = tuple(_build_tracks(portion, path))
                    yield TrackFile(source, NUPLAN_LICENCE, tracks, RATE_HZ, span)
    except sqlite3.Error as error:
        raise InputError(
            f"cannot read {path} as a nuPlan database ({error}); close other programs that use it or fetch it again"
        ) from error
    if not rows:
        raise InputError(f"the nuPlan database {path} holds no pose of any vehicle; remove it or fetch it again")


def _read_portions(cursor: sqlite3.Cursor) -> Iterator[list[tuple[Any, ...]]]:
    """Rows in lists that end where a vehicle ends, or are cut where one vehicle alone fills a list."""
    held: list[tuple[Any, ...]] = []
    while rows := cursor.fetchmany(PORTION_ROWS):
        held += rows
        if len(rows) < PORTION_ROWS:
            break
        end = len(held) - 1
        while end > 0 and held[end - 1][0] == held[-1][0]:
            end -= 1
        if end or len(held) >= 2 * PORTION_ROWS:
            yield held[: end or len(held)]
            held = held[end or len(held) :]
    if held:
        yield held


def _build_tracks(rows: list[tuple[Any, ...]], path: Path) -> Iterator[Floats]:
    """Even tracks of rows (vehicle, length, microseconds, x, y, yaw or quaternion) sorted by vehicle and time."""
    for _, group in itertools.groupby(rows, key=lambda row: row[0]):
        try:
            numbers = np.array([row[1:] for row in group], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"{path} holds a vehicle pose that is not numeric ({error}); fetch it again") from error
        if np.nanmax(np.abs(numbers[:, 2:4]), initial=0.0) > FARTHEST_M:
            raise InputError(f"{path} has a vehicle {FARTHEST_M:.0e} m from the origin of its map; fetch it again")
        seconds = (numbers[:, 1] - numbers[0, 1]) * 1e-6
        is_box = numbers.shape[1] == 5
        heading = numbers[:, 4] if is_box else yaw_of_quaternion(numbers[:, 4:])
        even = resample_tracks(seconds, np.column_stack([numbers[:, 2:4], heading]), LONGEST_GAP_S)
        yield from (compute_rear_axle(track, float(numbers[0, 0])) for track in even) if is_box else even


NUSCENES_LICENCE: Final = "CC BY-NC-SA 4.0 (nuScenes terms of use)"
GENERATED_LICENCE: Final = "the terms of the recordings that the data set was made from"
RIGID_VEHICLES: Final = (
    "vehicle.bus.rigid",
    "vehicle.car",
    "vehicle.construction",
    "vehicle.emergency.ambulance",
    "vehicle.emergency.police",
    "vehicle.truck",
)
"""Categories with four wheels or more and no joint."""


def read_nuscenes(root: Path, version: str, source: str) -> Iterator[TrackFile]:
    """Tracks of a root, scene by scene; generated adversaries are left out.

    Rear-axle tracks at 10 Hz: the recording car (12 Hz where the root has all sweeps), then vehicles, linear between 2
    Hz.
    """
    data = open_data(root, version=version)
    licence = GENERATED_LICENCE if data.provenance() else NUSCENES_LICENCE
    for name in data.scene_names():
        scene = data.scene(name)
        seconds = (scene.timestamps_us - scene.timestamps_us[0]) * 1e-6
        ego = resample_tracks(seconds, scene.ego.pose, LONGEST_GAP_S)
        yield TrackFile(source, licence, ego, RATE_HZ, SMOOTHING_SPAN_S)
        yield TrackFile(source, licence, tuple(_read_vehicle_tracks(scene, seconds)), RATE_HZ, ROUGH_SPAN_S)


def _read_vehicle_tracks(scene: Scene, seconds: Floats) -> Iterator[Floats]:
    agents = scene.agents
    for index, category in enumerate(agents.categories):
        if category not in RIGID_VEHICLES or agents.ids[index] in scene.adversaries:
            continue
        valid = agents.valid[index]
        center = np.column_stack([agents.position[index, valid, :2], agents.yaw[index, valid]])
        for track in resample_tracks(seconds[valid], center, LONGEST_GAP_S):
            yield compute_rear_axle(track, float(agents.size[index, 0]))


WINDOW_LIMIT: Final = 200_000
"""Windows of one source that are kept; 160 MB. Beyond it every second one is dropped, again and again."""


class RecordingKind(StrEnum):
    """Kinds of recordings."""

    TRACK_FILE = "track file"
    NUPLAN = "nuPlan databases"
    NUSCENES = "nuScenes root"


@dataclass(frozen=True, slots=True)
class TrackSource:
    """Source of tracks: files or one root folder; ``version`` is the version folder of a nuScenes root."""

    name: str
    kind: RecordingKind
    paths: tuple[Path, ...]
    version: str = ""

    def read(self) -> Iterator[TrackFile]:
        """Tracks in portions that fit into memory."""
        if self.kind is RecordingKind.TRACK_FILE:
            yield read_tracks(self.paths[0])
        elif self.kind is RecordingKind.NUPLAN:
            for path in self.paths:
                yield from read_nuplan(path, self.name)
        else:
            yield from read_nuscenes(self.paths[0], self.version, self.name)

    def content(self) -> str:
        """Hash of everything that is read."""
        if self.kind is RecordingKind.NUSCENES:
            return open_data(self.paths[0], version=self.version).fingerprint()
        hashes = [file_sha256(path) for path in self.paths]
        return hashes[0] if self.kind is RecordingKind.TRACK_FILE else content_key(hashes)


def find_track_sources(folder: Path) -> tuple[TrackSource, ...]:
    """Sources in a folder, or one level below, sorted by name.

    ``NAME.npz`` is a track file; ``*.db`` beside each other are nuPlan databases and one source; a folder with nuScenes
    tables is a root.
    """
    if not folder.is_dir():
        raise InputError(f"no folder of tracks at {folder}; pass the folder that holds the <source>.npz files")
    try:
        sources = sorted(_list_sources(folder), key=lambda source: source.name)
    except OSError as error:
        raise InputError(f"cannot list {folder} ({error}); make it readable or pass another folder") from error
    if not sources:
        raise InputError(
            f"{folder} holds no track files (.npz), nuPlan databases (.db) or nuScenes roots; pass a folder that does"
        )
    for one, other in itertools.pairwise(sources):
        if one.name == other.name:
            raise InputError(f"{folder} has two sources called {one.name}; rename {other.paths[0]}")
    return tuple(sources)


def _list_sources(folder: Path) -> Iterator[TrackSource]:
    for path in folder.glob("*.npz"):
        yield TrackSource(path.stem, RecordingKind.TRACK_FILE, (path,))
    for place in (folder, *(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))):
        name = place.resolve().name
        if databases := tuple(sorted(place.glob("*.db"))):
            yield TrackSource("nuplan" if place is folder else name, RecordingKind.NUPLAN, databases)
        versions = find_version_folders(place)
        for version in versions:
            title = name if len(versions) == 1 else f"{name}_{version}"
            yield TrackSource(title, RecordingKind.NUSCENES, (place,), version)


def cut_source_windows(source: TrackSource, stride_s: float, limit: int = WINDOW_LIMIT) -> tuple[TrackWindows, str]:
    """Windows of a source, read in portions, thinned out evenly to ``limit``, and its licence in words."""
    parts: list[TrackWindows] = []
    licence = NUPLAN_LICENCE if source.kind is RecordingKind.NUPLAN else NUSCENES_LICENCE
    window_count, every, tracks = 0, 1, 0
    for portion in source.read():
        licence = portion.licence
        windows = cut_windows(portion, stride_s)
        numbered = replace(windows, track=windows.track + tracks)
        parts.append(numbered.select_every(every, -window_count % every))
        window_count, tracks = window_count + len(windows.previous), tracks + len(portion.tracks)
        while sum(len(part.previous) for part in parts) > limit:
            parts, every = [TrackWindows.joined(parts).select_every(2, 0)], every * 2
    return TrackWindows.joined(parts), licence
