"""Recorded vehicle tracks (`benchmark.datasets.tracks`), cut into windows that a trajectory model can learn from."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.datasets.tracks import read_recorded_tracks
from benchmark.geometry import Floats, to_local, wrap_angle
from generation.diffusion.kinematics import MAX_ACCELERATION, STEP_S, compute_motion
from generation.diffusion.standardiser import WAYPOINTS

VEHICLE_CLASSES: Final = ("bus", "car", "large_vehicle", "truck", "van", "vehicle")
"""Road vehicles with four wheels or more and no joint."""
REAR_AXLE_FROM_CENTER: Final = EGO_CENTER_FROM_REAR_AXLE_M / EGO_LENGTH_M
"""Share of the length between rear axle and box centre; the recording car's share stands for all."""
REFERENCE_POINT_FROM_REAR_AXLE_M: Final = {"kitti_odometry_ego": 1.03, "comma2k19_example_ego": 0.0}
"""Recorded point ahead of the rear axle where it is not the box centre: KITTI's camera; comma2k19's heading is the
direction of motion of the recorded point, so moving it would change nothing."""
SMOOTHING_SPAN_S: Final = 1.7
"""Span of the local quadratic fit: removes jitter of perception, keeps braking and turning."""
ROUGH_SPAN_S: Final = 2.3
ROUGH_SOURCES: Final = (
    "argoverse2",
    "lyft_l5_prediction",
    "ngsim_commonroad",
    "ngsim_i80_smarts",
    "nuscenes_mini_scenarionet",
)
"""Raw perception, or boxes annotated at 2 Hz and interpolated: at the shorter span their jitter outweighs driving."""
GRID_S: Final = 0.1
MIN_PATH_M: Final = 5.0
MAX_LATERAL: Final = 8.0
MAX_JERK: Final = 10.0
"""m/s^3; an emergency brake takes about half a second to build up, jitter does not."""
MAX_ROUGHNESS: Final = 0.5
"""m/s^2: where acceleration changes by more than this in most half seconds, it is jitter of perception. A driver brakes
or pulls away once or twice in eight seconds and is steady between; KITTI's cars, measured well, are rougher in one of
twenty windows, raw perception in one of four."""
MAX_SLIP_RAD: Final = 0.35
"""Largest angle between heading and motion of the rear axle, above 2 m/s."""


@dataclass(frozen=True, slots=True)
class TrackFile:
    """Tracks of one source: (T, 3) rear-axle poses x, y, unwrapped heading, metres; fits span `smoothing_s`."""

    source: str
    licence: str
    tracks: tuple[Floats, ...]
    hz: float
    smoothing_s: float = SMOOTHING_SPAN_S


@dataclass(frozen=True, slots=True)
class TrackWindows:
    """Windows of driving in the frame of the rear axle now.

    `previous` is the (N, 3) pose half a second ago, `waypoints` (N, 16, 3) x, y, heading at 2 Hz; windows of one
    `track` resemble each other. `rejected` counts windows left out, by reason.
    """

    previous: Floats
    waypoints: Floats
    track: NDArray[np.int64]
    rejected: dict[str, int]

    def select_every(self, stride: int, start: int) -> Self:
        """Every ``stride``-th window from ``start`` on."""
        part = slice(start, None, stride)
        return type(self)(self.previous[part], self.waypoints[part], self.track[part], self.rejected)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Windows of several portions in order."""
        if not parts:
            return cls(np.zeros((0, 3)), np.zeros((0, WAYPOINTS, 3)), np.zeros(0, np.int64), {})
        reasons = dict.fromkeys(reason for part in parts for reason in part.rejected)
        return cls(
            np.concatenate([part.previous for part in parts]),
            np.concatenate([part.waypoints for part in parts]),
            np.concatenate([part.track for part in parts]),
            {reason: sum(part.rejected.get(reason, 0) for part in parts) for reason in reasons},
        )


def compute_rear_axle(center: Floats, length_m: float) -> Floats:
    """Rear axle, (T, 3) x, y, heading, of the box centre; a length that is not positive is the recording car's."""
    known = np.isfinite(length_m) and length_m > 0
    return _move_back(center, REAR_AXLE_FROM_CENTER * (length_m if known else EGO_LENGTH_M))


def _move_back(pose: Floats, distance_m: float) -> Floats:
    heading = pose[:, 2]
    return np.column_stack(
        [pose[:, 0] - distance_m * np.cos(heading), pose[:, 1] - distance_m * np.sin(heading), heading]
    )


def read_tracks(path: Path) -> TrackFile:
    """Read the road vehicles of one npz track file in the neutral format; nothing in it is unpickled."""
    recorded = read_recorded_tracks(path)
    tracks = []
    for index, kind in enumerate(recorded.kinds):
        if kind not in VEHICLE_CLASSES:
            continue
        part = slice(recorded.pointers[index], recorded.pointers[index + 1])
        heading = np.unwrap(recorded.heading[part].astype(np.float64))
        pose = np.column_stack([recorded.x[part], recorded.y[part], heading])
        ahead = REFERENCE_POINT_FROM_REAR_AXLE_M.get(recorded.source)
        length = float(recorded.length[index])
        tracks.append(compute_rear_axle(pose, length) if ahead is None else _move_back(pose, ahead))
    span = ROUGH_SPAN_S if recorded.source in ROUGH_SOURCES else SMOOTHING_SPAN_S
    return TrackFile(recorded.source, recorded.licence, tuple(tracks), recorded.hz, span)


def smooth_track(track: Floats, hz: float, span_s: float) -> Floats:
    """Local quadratic least-squares fit of (T, C) over ``span_s`` (Savitzky and Golay); ends use the end window's fit.

    Too few samples for a quadratic leave the track as it is.
    """
    reach = round(span_s * hz / 2)
    span = 2 * reach + 1
    if reach < 2 or len(track) < span:
        return track
    offsets = np.arange(-reach, reach + 1) / reach
    powers = np.stack([np.ones(span), offsets, offsets**2], axis=1)
    fit = powers @ np.linalg.solve(powers.T @ powers, powers.T)
    windows = np.lib.stride_tricks.sliding_window_view(track, span, axis=0)
    middle = windows @ fit[reach]
    return np.concatenate([fit[:reach] @ track[:span], middle, fit[reach + 1 :] @ track[-span:]])


def cut_windows(file: TrackFile, stride_s: float = 0.5) -> TrackWindows:
    """Windows of half a second of past and eight seconds of future.

    Left out are those that move less than 5 m, that no tyre holds (8 m/s^2 along or across), that jitter, at one place
    or throughout, whose heading does not fit the motion, and those with a step that no car can take
    (`TrajectoryMotion.excess`).
    """
    step, stride = round(STEP_S / GRID_S), max(round(stride_s / GRID_S), 1)
    reach = step * (WAYPOINTS + 1)
    cut, origin = [], []
    for index, track in enumerate(file.tracks):
        times = np.arange(len(track)) / file.hz
        grid = np.arange(int(times[-1] / GRID_S + 1e-6) + 1 if len(track) else 0) * GRID_S
        if len(grid) <= reach:
            continue
        smoothed = smooth_track(track, file.hz, file.smoothing_s)
        poses = np.column_stack([np.interp(grid, times, column) for column in smoothed.T])
        starts = np.arange(0, len(poses) - reach, stride)
        cut.append(poses[starts[:, None] + np.arange(0, reach + 1, step)])
        origin.append(np.full(len(starts), index))
    poses = np.concatenate(cut) if cut else np.zeros((0, WAYPOINTS + 2, 3))
    now = poses[:, 1]
    local = np.concatenate([to_local(poses[..., :2], now[:, None]), (poses[..., 2] - now[:, None, 2])[..., None]], -1)
    return _select_drivable(local, np.concatenate([np.zeros(0, np.int64), *origin]))


def _select_drivable(local: Floats, track: NDArray[np.int64]) -> TrackWindows:
    """Sort out (N, 18, 3) local windows of (N,) tracks."""
    moved = compute_motion(local[:, 2:], local[:, 0])
    steps = np.diff(local, axis=1)
    jerk = np.linalg.norm(np.diff(local[..., :2], n=3, axis=1), axis=-1) / STEP_S**3
    middle = 0.5 * (local[:, 1:, 2] + local[:, :-1, 2])
    slip = np.abs(wrap_angle(np.arctan2(steps[..., 1], steps[..., 0]) - middle))
    reasons = {
        "moves less than 5 m": np.hypot(steps[..., 0], steps[..., 1]).sum(axis=1) < MIN_PATH_M,
        "accelerates beyond 8 m/s^2": np.abs(moved.acceleration).max(axis=1, initial=0.0) > MAX_ACCELERATION,
        "lateral beyond 8 m/s^2": np.abs(moved.lateral).max(axis=1, initial=0.0) > MAX_LATERAL,
        "jerk beyond 10 m/s^3": (jerk > MAX_JERK).any(axis=1),
        "rough throughout": _compute_roughness(moved.acceleration) > MAX_ROUGHNESS,
        "heading against motion": ((slip > MAX_SLIP_RAD) & (moved.speed > 2.0)).any(axis=1),
        "turns tighter than a car": moved.excess > 0,
    }
    keep = np.ones(len(local), dtype=bool)
    rejected = {}
    for reason, hit in reasons.items():
        rejected[reason] = int((hit & keep).sum())
        keep &= ~hit
    return TrackWindows(local[keep, 0], local[keep, 2:], track[keep], rejected)


def _compute_roughness(acceleration: Floats) -> Floats:
    """(N,) median change of (N, 16) accelerations in half a second, which one hard brake cannot move."""
    return np.asarray(np.median(np.abs(np.diff(acceleration, axis=1)), axis=1))
