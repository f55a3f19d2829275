"""Tracks from nuPlan databases (SQLite): the recording car and the vehicles around it."""

import contextlib
import itertools
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats, yaw_of_quaternion
from generation.extensions.denoiser_training.resampling import RATE_HZ, even_tracks
from generation.extensions.denoiser_training.tracks import ROUGH_SPAN_S, SMOOTHING_SPAN_S, TrackFile, rear_axle_of_box

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

    Args:
        source: Name that the tracks get.

    Yields:
        Rear-axle tracks at 10 Hz: the recording car's first, then those of vehicles. Rows without a number, and
        rows not later than the one before them, are left out; a longer gap splits a track.

    Raises:
        InputError: If the file is not a nuPlan database, is damaged or locked, or holds no pose at all.
    """
    rows = 0
    try:
        address = f"{path.resolve().as_uri()}?mode=ro"
        with contextlib.closing(sqlite3.connect(address, uri=True, timeout=WAIT_FOR_LOCK_S)) as database:
            for query, span in ((EGO_QUERY, SMOOTHING_SPAN_S), (BOX_QUERY, ROUGH_SPAN_S)):
                for portion in _portions(database.execute(query)):
                    rows += len(portion)
                    tracks = tuple(_tracks(portion, path))
                    yield TrackFile(source, NUPLAN_LICENCE, tracks, RATE_HZ, span)
    except sqlite3.Error as error:
        raise InputError(
            f"cannot read {path} as a nuPlan database ({error}); close other programs that use it or fetch it again"
        ) from error
    if not rows:
        raise InputError(f"the nuPlan database {path} holds no pose of any vehicle; remove it or fetch it again")


def _portions(cursor: sqlite3.Cursor) -> Iterator[list[tuple[Any, ...]]]:
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


def _tracks(rows: list[tuple[Any, ...]], path: Path) -> Iterator[Floats]:
    """Even tracks of rows (vehicle, length, microseconds, x, y, yaw or quaternion) sorted by vehicle and time."""
    for _, group in itertools.groupby(rows, key=lambda row: row[0]):
        try:
            numbers = np.array([row[1:] for row in group], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{path} holds something other than numbers as the pose of a vehicle ({error}); fetch it again"
            ) from error
        if np.nanmax(np.abs(numbers[:, 2:4]), initial=0.0) > FARTHEST_M:
            raise InputError(f"{path} has a vehicle {FARTHEST_M:.0e} m from the origin of its map; fetch it again")
        seconds = (numbers[:, 1] - numbers[0, 1]) * 1e-6
        is_box = numbers.shape[1] == 5
        heading = numbers[:, 4] if is_box else yaw_of_quaternion(numbers[:, 4:])
        even = even_tracks(seconds, np.column_stack([numbers[:, 2:4], heading]), LONGEST_GAP_S)
        yield from (rear_axle_of_box(track, float(numbers[0, 0])) for track in even) if is_box else even
