"""Recorded vehicle tracks (`benchmark.datasets.tracks`), cut into windows that a trajectory model can learn from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.datasets.tracks import read_recorded_tracks
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_local, wrap_angle
from generation.diffusion.kinematics import MAX_ACCELERATION, STEP_S, motion
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
MAX_SLIP_RAD: Final = 0.35
"""Largest angle between heading and motion of the rear axle, above 2 m/s."""


@dataclass(frozen=True, slots=True)
class TrackFile:
    """One source.

    Attributes:
        source: Name.
        licence: Licence in words.
        tracks: Per vehicle (T, 3) rear-axle poses x, y, unwrapped heading at ``hz``, metres.
        hz: Samples per second.
    """

    source: str
    licence: str
    tracks: tuple[Floats, ...]
    hz: float


@dataclass(frozen=True, slots=True)
class Windows:
    """Windows of driving in the frame of the rear axle now.

    Attributes:
        previous: (N, 3) pose half a second ago.
        waypoints: (N, 16, 3) x, y, heading at 2 Hz.
        rejected: Windows left out, by reason.
    """

    previous: Floats
    waypoints: Floats
    rejected: dict[str, int]


def find_track_files(folder: Path) -> dict[str, Path]:
    """Track files of a folder.

    Args:
        folder: Holds ``<source>.npz`` files.

    Returns:
        Path by source name, sorted.

    Raises:
        InputError: If there is no such folder or no file in it.
    """
    if not folder.is_dir():
        raise InputError(f"no folder of tracks at {folder}; pass the folder that holds the <source>.npz files")
    found = {path.stem: path for path in sorted(folder.glob("*.npz"))}
    if not found:
        raise InputError(f"{folder} holds no .npz track files; pass the folder that holds the <source>.npz files")
    return found


def read_tracks(path: Path) -> TrackFile:
    """Read one track file.

    Args:
        path: An npz file in the neutral format; nothing in it is unpickled.

    Returns:
        Its road vehicles.

    Raises:
        InputError: If the file is broken, lacks an array, or holds numbers that cannot be tracks.
    """
    recorded = read_recorded_tracks(path)
    tracks = []
    for index, kind in enumerate(recorded.kinds):
        if kind not in VEHICLE_CLASSES:
            continue
        part = slice(recorded.pointers[index], recorded.pointers[index + 1])
        heading = np.unwrap(recorded.heading[part].astype(np.float64))
        length = float(recorded.length[index])
        default = REAR_AXLE_FROM_CENTER * (length if np.isfinite(length) and length > 0 else EGO_LENGTH_M)
        ahead = REFERENCE_POINT_FROM_REAR_AXLE_M.get(recorded.source, default)
        x = recorded.x[part] - ahead * np.cos(heading)
        y = recorded.y[part] - ahead * np.sin(heading)
        tracks.append(np.column_stack([x, y, heading]))
    return TrackFile(recorded.source, recorded.licence, tuple(tracks), recorded.hz)


def smooth(track: Floats, hz: float, span_s: float) -> Floats:
    """Local quadratic least-squares fit at each sample (Savitzky and Golay); the ends use the fit of the end window.

    Args:
        track: (T, C) values at ``hz``.
        hz: Samples per second.
        span_s: Width of the fit; too few samples for a quadratic leave the track as it is.

    Returns:
        (T, C) smoothed values.
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


def cut_windows(file: TrackFile, stride_s: float = 0.5) -> Windows:
    """Windows of half a second of past and eight seconds of future.

    Left out are windows that move less than 5 m, that no tyre could hold (8 m/s^2 along or across), that jitter, whose
    heading does not fit the motion, and those with a step that no car can take (`Motion.excess`).

    Args:
        file: One source.
        stride_s: Time between the starts of windows.

    Returns:
        See `Windows`.
    """
    step, stride = round(STEP_S / GRID_S), max(round(stride_s / GRID_S), 1)
    reach = step * (WAYPOINTS + 1)
    cut = []
    for track in file.tracks:
        times = np.arange(len(track)) / file.hz
        grid = np.arange(int(times[-1] / GRID_S + 1e-6) + 1 if len(track) else 0) * GRID_S
        if len(grid) <= reach:
            continue
        smoothed = smooth(track, file.hz, ROUGH_SPAN_S if file.source in ROUGH_SOURCES else SMOOTHING_SPAN_S)
        poses = np.column_stack([np.interp(grid, times, column) for column in smoothed.T])
        starts = np.arange(0, len(poses) - reach, stride)
        cut.append(poses[starts[:, None] + np.arange(0, reach + 1, step)])
    poses = np.concatenate(cut) if cut else np.zeros((0, WAYPOINTS + 2, 3))
    now = poses[:, 1]
    local = np.concatenate([to_local(poses[..., :2], now[:, None]), (poses[..., 2] - now[:, None, 2])[..., None]], -1)
    return _drivable(local)


def _drivable(local: Floats) -> Windows:
    """Sort out (N, 18, 3) local windows."""
    moved = motion(local[:, 2:], local[:, 0])
    steps = np.diff(local, axis=1)
    jerk = np.linalg.norm(np.diff(local[..., :2], n=3, axis=1), axis=-1) / STEP_S**3
    middle = 0.5 * (local[:, 1:, 2] + local[:, :-1, 2])
    slip = np.abs(wrap_angle(np.arctan2(steps[..., 1], steps[..., 0]) - middle))
    reasons = {
        "moves less than 5 m": np.hypot(steps[..., 0], steps[..., 1]).sum(axis=1) < MIN_PATH_M,
        "accelerates beyond 8 m/s^2": np.abs(moved.acceleration).max(axis=1, initial=0.0) > MAX_ACCELERATION,
        "lateral beyond 8 m/s^2": np.abs(moved.lateral).max(axis=1, initial=0.0) > MAX_LATERAL,
        "jerk beyond 10 m/s^3": (jerk > MAX_JERK).any(axis=1),
        "heading against motion": ((slip > MAX_SLIP_RAD) & (moved.speed > 2.0)).any(axis=1),
        "turns tighter than a car": moved.excess > 0,
    }
    keep = np.ones(len(local), dtype=bool)
    rejected = {}
    for reason, hit in reasons.items():
        rejected[reason] = int((hit & keep).sum())
        keep &= ~hit
    return Windows(local[keep, 0], local[keep, 2:], rejected)
