"""The 12 Hz timeline of a scene, and steps of half a second from each sample, also where key frames are irregular.

Where all key frames on the way are 0.4 to 0.6 s apart, step k is the k-th following key frame, as in nuScenes.
Elsewhere it is the time t + 0.5 k, between the key frames around it. Nothing is known across a gap over 0.75 s.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from statistics import median
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME, KEYFRAME_HZ, LIDAR_NAME
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, wrap_angle
from benchmark.scene import EgoTrack, Scene

STEP_US: Final = 1_000_000 // KEYFRAME_HZ
SHORTEST_US: Final = 395_000
LONGEST_US: Final = 605_000
"""Intervals of nuScenes run from 0.4 to 0.6 s, to the hundredth."""
LONGEST_KNOWN_US: Final = 750_000
"""Positions across a longer gap are unknown."""
ON_KEY_FRAME_US: Final = 1_000
"""A time so near to a key frame is the key frame: time stamps are rounded."""
_RATE_TOLERANCE_US: Final = STEP_US // 10
"""Of a scene's median interval."""


def is_step(interval_us: int) -> bool:
    """Whether an interval between key frames counts as a step of half a second."""
    return SHORTEST_US <= interval_us <= LONGEST_US


def find_irregular_interval_us(timestamps_us: "list[int] | NDArray[np.int64]") -> float | None:
    """Median interval of K increasing times that do not come at 2 Hz; ``None`` if it is nuScenes' or there is none."""
    intervals_us = [int(next_time_us) - int(time_us) for time_us, next_time_us in pairwise(timestamps_us)]
    usual_us = float(median(intervals_us)) if intervals_us else float(STEP_US)
    return usual_us if abs(usual_us - STEP_US) > _RATE_TOLERANCE_US else None


@dataclass(frozen=True, slots=True)
class TimedSteps:
    """(N,) times among the key frames of a scene, outside the recording by its first or last key frame.

    ``fraction`` is 0 at the key frame ``before``, towards 1 at the one ``after``. ``recorded`` times are covered by the
    recording; ``known`` ones also have no gap that is too long between the sample and the time or around it.
    """

    times_us: NDArray[np.int64]
    before: NDArray[np.int64]
    after: NDArray[np.int64]
    fraction: Floats
    recorded: Bools
    known: Bools

    @property
    def nearest(self) -> NDArray[np.int64]:
        """(N,) the nearer one of the two key frames, the earlier one of two equally near."""
        return np.where(self.fraction <= 0.5, self.before, self.after)


class KeyFrameSteps:
    """The key frames of a scene as a clock, from (K,) increasing times."""

    def __init__(self, timestamps_us: NDArray[np.int64]) -> None:
        self.times_us = np.asarray(timestamps_us, np.int64)

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """The clock of a scene."""
        return cls(scene.timestamps_us[scene.keyframes])

    @cached_property
    def _irregular(self) -> NDArray[np.int64]:
        """(K,) intervals that are no step, before each key frame."""
        intervals = np.diff(self.times_us)
        return np.concatenate([[0], np.cumsum((intervals < SHORTEST_US) | (intervals > LONGEST_US))])

    @cached_property
    def _too_long(self) -> NDArray[np.int64]:
        """(K,) gaps that are too long, before each key frame."""
        return np.concatenate([[0], np.cumsum(np.diff(self.times_us) > LONGEST_KNOWN_US)])

    def are_key_frames(self, index: int, steps: int) -> bool:
        """Whether steps ahead, or back if negative, are key frames: all up to there that exist, half a second apart."""
        last = len(self.times_us) - 1
        first, end = sorted((index, min(max(index + steps, 0), last)))
        return bool(self._irregular[first] == self._irregular[end])

    def at(self, index: int, steps: NDArray[np.int64]) -> TimedSteps:
        """(N,) steps of half a second of a sample among the key frames, by the clock; negative ones lie before it."""
        times, last = self.times_us, len(self.times_us) - 1
        wanted = times[index] + STEP_US * np.asarray(steps, np.int64)
        before = np.clip(np.searchsorted(times, wanted + ON_KEY_FRAME_US, side="right") - 1, 0, last)
        after = np.clip(np.searchsorted(times, wanted - ON_KEY_FRAME_US, side="left"), 0, last)
        # Of two key frames within the rounding of a time stamp, the earlier one is used.
        before = np.minimum(before, after)
        span = np.where(after > before, times[after] - times[before], 1)
        fraction = np.where(after > before, (wanted - times[before]) / span, 0.0)
        recorded = (wanted >= times[0] - ON_KEY_FRAME_US) & (wanted <= times[-1] + ON_KEY_FRAME_US)
        unbroken = self._too_long[np.maximum(after, index)] == self._too_long[np.minimum(before, index)]
        return TimedSteps(wanted, before, after, fraction, recorded, recorded & unbroken)


def interpolate_values(
    values: Floats, times_us: NDArray[np.int64], wanted_us: NDArray[np.int64], heading: int = 2
) -> Floats:
    """(T, C) values at (T,) increasing times at other times (...): linear, the ``heading`` column by the shortest turn.

    (..., C) values, headings from -pi to pi; outside the recording those of its first or last frame.
    """
    columns = np.asarray(values, np.float64).copy()
    columns[:, heading] = np.unwrap(columns[:, heading])
    seconds, wanted = (times_us - times_us[0]) * 1e-6, (np.asarray(wanted_us) - times_us[0]) * 1e-6
    interpolated = np.stack([np.interp(wanted, seconds, column) for column in columns.T], axis=-1)
    interpolated[..., heading] = wrap_angle(interpolated[..., heading])
    return interpolated


def require_two_hz(scene: Scene, what: str) -> None:
    """Refuse a scene for ``what``, which counts frames and key frames instead of looking at the clock."""
    interval_us = find_irregular_interval_us(scene.timestamps_us[scene.keyframes])
    if interval_us is not None:
        raise InputError(
            f"the key frames of {scene.name} are {interval_us * 1e-6:.3g} s apart (median), and {what} needs one every "
            f"{STEP_US * 1e-6:g} s; only eval and rescore accept other rates; leave the scene out"
        )


@dataclass(frozen=True, slots=True)
class Timeline:
    """Frames of a scene at (T,) times; ``keyframes`` is (K,), the frame of each sample: 0, 6, 12, ... at 2 Hz."""

    timestamps_us: NDArray[np.int64]
    keyframes: NDArray[np.int64]
    ego: EgoTrack


def list_samples(nusc: Any, scene: Row) -> list[Row]:
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
    """The frames between the first and the last keyframe of samples in time order, every keyframe being each sixth one.

    In a scene whose keyframes do not come at 2 Hz there are as many in between as bring frames nearest to 12 Hz. Where
    the data set has exactly five sweeps between all keyframes (12 Hz), those rows are the frames. Otherwise the time
    between two keyframes is divided evenly and the ego interpolated between the poses of the sweeps that there are
    (linear position, normalised linear quaternion).
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
    ego = _interpolate_ego(times_us - sample_times_us[0], position, rotation, frame_times_us)
    ego.position[keyframes], ego.rotation[keyframes] = position[at], rotation[at]
    return Timeline(frame_times_us + sample_times_us[0], keyframes, ego)


def _keyframes(sample_times_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """(K,) frame of each sample."""
    if find_irregular_interval_us(sample_times_us) is None:
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


def _interpolate_ego(
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
