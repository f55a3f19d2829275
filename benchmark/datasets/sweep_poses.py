"""Where lidar and cameras were at their sweeps, each by its own clock."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import LIDAR_NAME
from benchmark.datasets.tables import Row
from benchmark.geometry import Floats, rotation_matrix
from benchmark.scene import SweepPoses


def read_sweep_poses(
    nusc: Any, samples: Sequence[Row], keyframes: NDArray[np.int64], cameras: Sequence[str]
) -> SweepPoses | None:
    """Poses of the sensors at the frames of a scene.

    The k-th frame after a keyframe takes the sensor's k-th following row. Where there are fewer rows before the next
    keyframe the last one is repeated.

    Args:
        samples: Rows of the scene's K samples in time order.
        keyframes: (K,) frame of each.

    Returns:
        Poses at the frames from the first to the last of these, or ``None`` where a sensor has no sweeps at all or
        there is no camera.
    """
    if not cameras:
        return None
    poses = []
    for channel in (LIDAR_NAME, *cameras):
        rows = _rows_at_frames(nusc, samples, np.diff(keyframes).tolist(), channel)
        if rows is None:
            return None
        poses.append(_global_T_sensor(nusc, rows))
    return SweepPoses(poses[0], np.stack(poses[1:]))


def _rows_at_frames(nusc: Any, samples: Sequence[Row], frames: Sequence[int], channel: str) -> list[Row] | None:
    """Rows of one channel at every frame; nothing where a keyframe or all sweeps are missing."""
    if any(channel not in sample["data"] for sample in samples):
        return None
    rows: list[Row] = []
    swept = len(samples) == 1
    for sample, count in zip(samples, frames):
        row: Row = nusc.get("sample_data", sample["data"][channel])
        rows.append(row)
        for _ in range(count - 1):
            following: Row | None = nusc.get("sample_data", row["next"]) if row["next"] else None
            if following is not None and not following["is_key_frame"]:
                row, swept = following, True
            rows.append(row)
    rows.append(nusc.get("sample_data", samples[-1]["data"][channel]))
    return rows if swept else None


def _global_T_sensor(nusc: Any, rows: Sequence[Row]) -> Floats:
    """(T, 4, 4) sensor frame to global frame."""
    chain = []
    for table, link in (("ego_pose", "ego_pose_token"), ("calibrated_sensor", "calibrated_sensor_token")):
        records = [nusc.get(table, row[link]) for row in rows]
        matrix = np.tile(np.eye(4), (len(rows), 1, 1))
        matrix[:, :3, :3] = rotation_matrix(np.array([record["rotation"] for record in records], np.float64))
        matrix[:, :3, 3] = [record["translation"] for record in records]
        chain.append(matrix)
    return np.asarray(chain[0] @ chain[1])
