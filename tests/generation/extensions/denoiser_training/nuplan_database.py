"""Small databases in nuPlan's schema."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from benchmark.geometry import Floats

START_US = 1_620_000_000_000_000
UTM_M = (331_000.0, 4_690_000.0)
"""Where nuPlan's maps lie."""

SCHEMA = """
    CREATE TABLE log (token BLOB PRIMARY KEY, vehicle_name VARCHAR(64), date VARCHAR(64), timestamp INTEGER,
        logfile VARCHAR(64), location VARCHAR(64), map_version VARCHAR(64));
    CREATE TABLE scene (token BLOB PRIMARY KEY, log_token BLOB, name TEXT, goal_ego_pose_token BLOB,
        roadblock_ids TEXT);
    CREATE TABLE ego_pose (token BLOB PRIMARY KEY, timestamp INTEGER, x FLOAT, y FLOAT, z FLOAT, qw FLOAT, qx FLOAT,
        qy FLOAT, qz FLOAT, vx FLOAT, vy FLOAT, vz FLOAT, epsg INTEGER, log_token BLOB);
    CREATE TABLE lidar_pc (token BLOB PRIMARY KEY, next_token BLOB, prev_token BLOB, ego_pose_token BLOB,
        lidar_token BLOB, scene_token BLOB, filename VARCHAR(128), timestamp INTEGER);
    CREATE TABLE category (token BLOB PRIMARY KEY, name VARCHAR(64), description TEXT);
    CREATE TABLE track (token BLOB PRIMARY KEY, category_token BLOB, width FLOAT, length FLOAT, height FLOAT);
    CREATE TABLE lidar_box (token BLOB PRIMARY KEY, lidar_pc_token BLOB, track_token BLOB, next_token BLOB,
        prev_token BLOB, x FLOAT, y FLOAT, z FLOAT, width FLOAT, length FLOAT, height FLOAT, vx FLOAT, vy FLOAT,
        vz FLOAT, yaw FLOAT, confidence FLOAT);
"""
CATEGORIES = ("vehicle", "bicycle", "pedestrian", "traffic_cone", "barrier", "czone_sign", "generic_object")
EGO_HZ, CLOUD_HZ = 100.0, 20.0


def token(kind: str, number: int) -> bytes:
    """Eight bytes, as in nuPlan."""
    return f"{kind[:3]}{number:05d}".encode()


def write_nuplan(
    path: Path, ego: Floats, others: Sequence[tuple[str, float, Floats]] = (), *, missing: Sequence[int] = ()
) -> Path:
    """Write (E, 3) rear-axle poses at 100 Hz, and category, length and (F, 3) box centres at 20 Hz of each vehicle.

    Nothing is detected at the missing frames.
    """
    with closing(sqlite3.connect(path)) as database:
        database.executescript(SCHEMA)
        execute = database.executemany
        execute("INSERT INTO category VALUES (?, ?, '')", [(token("cat", i), n) for i, n in enumerate(CATEGORIES)])
        execute(
            "INSERT INTO ego_pose VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?)", [_ego_row(i, p) for i, p in enumerate(ego)]
        )
        frames = max((len(poses) for _, _, poses in others), default=0)
        clouds = [
            (token("pc", frame), None, None, None, None, None, "", START_US + round(frame * 1e6 / CLOUD_HZ))
            for frame in range(frames)
        ]
        # Nothing promises that rows lie in the order of time.
        execute("INSERT INTO lidar_pc VALUES (?,?,?,?,?,?,?,?)", clouds[::-1])
        for number, (category, length, poses) in enumerate(others):
            kind = token("cat", CATEGORIES.index(category))
            execute("INSERT INTO track VALUES (?,?,?,?,?)", [(token("trk", number), kind, 1.9, length, 1.6)])
            boxes = [_box_row(number, frame, pose, length) for frame, pose in enumerate(poses) if frame not in missing]
            execute(f"INSERT INTO lidar_box VALUES ({','.join('?' * 16)})", boxes)
        database.commit()
    return path


def _ego_row(index: int, pose: Floats) -> tuple[object, ...]:
    x, y, yaw = (float(value) for value in pose)
    stamp = START_US + round(index * 1e6 / EGO_HZ)
    turn = (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2)))
    return (token("ego", index), stamp, UTM_M[0] + x, UTM_M[1] + y, 0.0, *turn, 0.0, 0.0, 0.0, 32618, None)


def _box_row(number: int, frame: int, pose: Floats, length: float) -> tuple[object, ...]:
    x, y, yaw = (float(value) for value in pose)
    name = f"{number:03d}{frame:05d}".encode()
    place = (UTM_M[0] + x, UTM_M[1] + y, 0.0, 1.9, length, 1.6)
    return (name, token("pc", frame), token("trk", number), None, None, *place, 0.0, 0.0, 0.0, yaw, 0.9)
