"""The 12 Hz timeline of a nuScenes scene, and where the ego was on it."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME, LIDAR_NAME
from benchmark.datasets.steps import other_interval_us
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.scene import EgoTrack


@dataclass(frozen=True, slots=True)
class Timeline:
    """Frames of a scene.

    Attributes:
        timestamps_us: (T,).
        keyframes: (K,) frame of each sample: 0, 6, 12, ... where samples come at 2 Hz.
    """

    timestamps_us: NDArray[np.int64]
    keyframes: NDArray[np.int64]
    ego: EgoTrack


def samples_of_scene(nusc: Any, scene: Row) -> list[Row]:
    """Samples of a scene in time order."""
    samples: list[Row] = []
    token = scene["first_sample_token"]
    while token:
        samples.append(nusc.get("sample", token))
        token = samples[-1]["next"]
    return samples


def _keyframe_row(nusc: Any, sample: Row) -> Row:
    """The sample_data row that carries a sample's ego pose: LIDAR_TOP, or the first camera where there is none."""
    channels = sample["data"]
    if LIDAR_NAME in channels:
        return _row(nusc, channels[LIDAR_NAME])
    cameras = sorted(name for name in channels if _row(nusc, channels[name])["sensor_modality"] == "camera")
    if not cameras:
        raise InputError(
            f"sample {sample['token']} has neither {LIDAR_NAME} nor a camera among its keyframe rows in "
            "sample_data.json, so the ego pose is unknown; add one or leave the scene out"
        )
    front = "CAM_FRONT" if "CAM_FRONT" in cameras else cameras[0]
    return _row(nusc, channels[front])


def read_timeline(nusc: Any, samples: list[Row]) -> Timeline:
    """The frames between the first and the last keyframe, every keyframe being each sixth one.

    In a scene whose keyframes do not come at 2 Hz there are as many in between as bring frames nearest to 12 Hz. Where
    the data set has exactly five sweeps between all keyframes (12 Hz), those rows are the frames. Otherwise the time
    between two keyframes is divided evenly and the ego interpolated between the poses of the sweeps that there are
    (linear position, normalised linear quaternion).

    Args:
        samples: Rows of the scene's samples in time order.
    """
    rows = _rows_between(nusc, samples)
    times_us = np.array([row["timestamp"] for row in rows], dtype=np.int64)
    is_keyframe = np.array([row["is_key_frame"] for row in rows])
    sample_times_us = np.array([sample["timestamp"] for sample in samples], dtype=np.int64)
    times_us[is_keyframe] = sample_times_us
    poses = [nusc.get("ego_pose", row["ego_pose_token"]) for row in rows]
    position = np.array([pose["translation"] for pose in poses], dtype=np.float64)
    rotation = np.array([pose["rotation"] for pose in poses], dtype=np.float64)
    keyframes = _keyframes(sample_times_us)
    at = np.flatnonzero(is_keyframe)
    if np.array_equal(at, keyframes) and (np.diff(times_us) > 0).all():
        return Timeline(times_us, keyframes, EgoTrack(position, rotation))
    frames = np.arange(keyframes[-1] + 1)
    frame_times_us = np.rint(np.interp(frames, keyframes, sample_times_us - sample_times_us[0])).astype(np.int64)
    ego = _interpolated(times_us - sample_times_us[0], position, rotation, frame_times_us)
    ego.position[keyframes], ego.rotation[keyframes] = position[at], rotation[at]
    return Timeline(frame_times_us + sample_times_us[0], keyframes, ego)


def _keyframes(sample_times_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """(K,) frame of each sample."""
    if other_interval_us(sample_times_us) is None:
        return np.arange(len(sample_times_us), dtype=np.int64) * FRAMES_PER_KEYFRAME
    frames = np.maximum(np.rint(np.diff(sample_times_us) * 1e-6 * FRAME_HZ), 1)
    return np.concatenate([[0], np.cumsum(frames)], dtype=np.int64, casting="unsafe")


def _row(nusc: Any, token: str) -> Row:
    row: Row = nusc.get("sample_data", token)
    return row


def _rows_between(nusc: Any, samples: list[Row]) -> list[Row]:
    """Rows of the pose-carrying channel from keyframe to keyframe; sweeps that are out of line are left out."""
    rows: list[Row] = []
    for sample, following in pairwise(samples):
        row, last = _keyframe_row(nusc, sample), _keyframe_row(nusc, following)
        between: list[Row] = []
        sweep = row
        while sweep["next"] and sweep["next"] != last["token"]:
            sweep = _row(nusc, sweep["next"])
            if sweep["is_key_frame"] or not sample["timestamp"] < sweep["timestamp"] < following["timestamp"]:
                between = []
                break
            if between and sweep["timestamp"] <= between[-1]["timestamp"]:
                between = []
                break
            between.append(sweep)
        rows += [row, *(between if sweep["next"] else [])]
    rows.append(_keyframe_row(nusc, samples[-1]))
    return rows


def _interpolated(
    times_us: NDArray[np.int64], position: Floats, rotation: Floats, wanted_us: NDArray[np.int64]
) -> EgoTrack:
    rotation = rotation / np.linalg.norm(rotation, axis=-1, keepdims=True)
    # A quaternion and its negative are the same rotation; neighbours must not point away from each other.
    signs = np.where((rotation[1:] * rotation[:-1]).sum(axis=-1) < 0, -1.0, 1.0)
    rotation = rotation * np.concatenate([[1.0], np.cumprod(signs)])[:, None]
    between = np.column_stack([np.interp(wanted_us, times_us, column) for column in rotation.T])
    return EgoTrack(
        np.column_stack([np.interp(wanted_us, times_us, column) for column in position.T]),
        between / np.linalg.norm(between, axis=-1, keepdims=True),
    )
