"""Recorded vehicle tracks as training samples of ``ego-status``: each moving vehicle is the ego once."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from adapters.planners.ego_status import PAST_STEPS, EgoMotion
from benchmark.constants import COMMAND_LATERAL_M, LIDAR_FROM_REAR_AXLE_M, PLAN_STEPS
from benchmark.datasets.tracks import RecordedTracks, read_recorded_tracks
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_local, wrap_angle
from benchmark.planning import Command

HZ = 10
_STEP = HZ // 2
_PAST, _FUTURE = PAST_STEPS * _STEP, PLAN_STEPS * _STEP
_FIT_FRAMES = HZ + 1
_VEHICLES = frozenset({"car", "vehicle", "truck", "bus", "van", "large_vehicle"})
_REAR_AXLE_BEHIND_CENTER = 0.34
"""Share of the vehicle's length; that of the recording car of nuScenes."""
_LARGEST_ACCELERATION = 8.0
_LARGEST_SPEED = 45.0
_SMOOTHED_FRAMES = 9


@dataclass(frozen=True, slots=True)
class Samples:
    """B training samples. `future` are (B, 6, 2) rear-axle positions, ego frame, metres."""

    motion: EgoMotion
    future: Floats

    def __len__(self) -> int:
        return len(self.future)

    def rows(self, chosen: NDArray[np.int64]) -> "Samples":
        """Some of the samples."""
        motion = {field.name: getattr(self.motion, field.name)[chosen] for field in fields(EgoMotion)}
        return Samples(EgoMotion(**motion), self.future[chosen])


def read_samples(folder: Path, sources: Sequence[str]) -> dict[str, Samples]:
    """Samples by source, from a folder of ``SOURCE.npz`` files in the neutral track format."""
    return {source: _read(folder / f"{source}.npz") for source in sources}


def _read(path: Path) -> Samples:
    if not path.is_file():
        raise InputError(
            f"there is no track file {path}; name the folder that holds the SOURCE.npz files with --tracks"
        )
    windows = [samples for poses in _vehicle_paths(read_recorded_tracks(path), path) for samples in _windows(poses)]
    if not windows:
        raise InputError(f"{path} holds no vehicle that moves for at least five seconds")
    return _joined(windows)


def _vehicle_paths(tracks: RecordedTracks, path: Path) -> Iterator[Floats]:
    """(F, 3) rear-axle paths at 10 Hz of every vehicle that moves more than 5 m, smoothed."""
    stride = round(tracks.hz / HZ)
    if stride < 1 or abs(tracks.hz - stride * HZ) > 1e-6:
        raise InputError(f"{path} has {tracks.hz:g} samples per second; ego-status learns from multiples of {HZ}")
    for track, (start, stop) in enumerate(itertools.pairwise(tracks.pointers)):
        if tracks.kinds[track] not in _VEHICLES:
            continue
        recorded = (tracks.x, tracks.y, tracks.heading)
        columns = [np.asarray(values[start:stop:stride], np.float64) for values in recorded]
        if len(columns[0]) < _PAST + _FUTURE + 1:
            continue
        x, y, yaw = (_smooth(column) for column in (columns[0], columns[1], np.unwrap(columns[2])))
        if np.hypot(x[-1] - x[0], y[-1] - y[0]) < 5.0:
            continue
        behind = 0.0
        if not tracks.is_ego[track] and np.isfinite(tracks.length[track]):
            behind = _REAR_AXLE_BEHIND_CENTER * float(tracks.length[track])
        yield np.column_stack([x - behind * np.cos(yaw), y - behind * np.sin(yaw), yaw])


def _smooth(values: Floats) -> Floats:
    """Local parabolas over 0.9 s, as recorded positions of other vehicles jitter."""
    half = _SMOOTHED_FRAMES // 2
    powers = np.vander(np.arange(-half, half + 1), 3)
    kernel = np.linalg.pinv(powers)[2]
    padded = np.pad(values, half, mode="reflect", reflect_type="odd")
    return np.convolve(padded, kernel[::-1], mode="valid")


def _windows(path: Floats) -> Iterator[Samples]:
    """One sample each half second of a path, as far as its motion is physically possible."""
    starts = np.arange(_PAST, len(path) - _FUTURE, _STEP)
    if len(starts) == 0:
        return
    now = path[starts]
    seen = path[starts[:, None] - _STEP * np.arange(PAST_STEPS, 0, -1)]
    ahead = path[starts[:, None] + _STEP * np.arange(1, PLAN_STEPS + 1)]
    recent = path[starts[:, None] + np.arange(1 - _FIT_FRAMES, 1)]
    velocity, acceleration, yaw_rate = _motion(to_local(recent[..., :2], now[:, None]), recent[..., 2])
    future = to_local(ahead[..., :2], now[:, None])
    turned = ahead[:, -1, 2] - now[:, 2]
    past = np.concatenate(
        [to_local(seen[..., :2], now[:, None]), wrap_angle(seen[..., 2:] - now[:, None, 2:])], axis=-1
    )
    samples = Samples(
        EgoMotion(
            past=past,
            past_valid=np.ones(past.shape[:2], dtype=np.bool_),
            velocity=velocity,
            acceleration=acceleration,
            yaw_rate=yaw_rate,
            command=_command(future[:, -1, 1] + LIDAR_FROM_REAR_AXLE_M * np.sin(turned)),
        ),
        future,
    )
    yield samples.rows(np.flatnonzero(_possible(samples)))


def _motion(local: Floats, yaw: Floats) -> tuple[Floats, Floats, Floats]:
    """Velocity, acceleration and yaw rate now, from parabolas through the last second; nothing of the future."""
    seconds = np.arange(1 - _FIT_FRAMES, 1) / HZ
    parabola = np.linalg.pinv(np.vander(seconds, 3, increasing=True))
    line = np.linalg.pinv(np.vander(seconds, 2, increasing=True))
    return (
        np.einsum("f,bfd->bd", parabola[1], local),
        2 * np.einsum("f,bfd->bd", parabola[2], local),
        np.einsum("f,bf->b", line[1], yaw),
    )


def _command(left_m: Floats) -> NDArray[np.int64]:
    """The official rule: at least 2 m to a side at the last waypoint."""
    straight = np.full(left_m.shape, int(Command.STRAIGHT))
    turned = np.where(left_m >= COMMAND_LATERAL_M, int(Command.LEFT), straight)
    return np.where(left_m <= -COMMAND_LATERAL_M, int(Command.RIGHT), turned)


def _possible(samples: Samples) -> NDArray[np.bool_]:
    """Whether a car could have driven it, and drove forwards."""
    start = np.zeros_like(samples.future[:, :1])
    velocity = np.diff(np.concatenate([start, samples.future], axis=1), axis=1) * 2
    acceleration = np.linalg.norm(np.diff(velocity, axis=1) * 2, axis=-1).max(axis=1)
    speed = np.linalg.norm(velocity, axis=-1).max(axis=1)
    sideways = np.abs(samples.motion.velocity[:, 1])
    return np.asarray(
        (acceleration < _LARGEST_ACCELERATION)
        & (np.linalg.norm(samples.motion.acceleration, axis=1) < _LARGEST_ACCELERATION)
        & (speed < _LARGEST_SPEED)
        & (sideways < 0.3 + 0.1 * np.abs(samples.motion.velocity[:, 0]))
        & (samples.motion.velocity[:, 0] > -1.0)
    )


def _joined(parts: Sequence[Samples]) -> Samples:
    motion = {
        field.name: np.concatenate([getattr(part.motion, field.name) for part in parts]) for field in fields(EgoMotion)
    }
    return Samples(EgoMotion(**motion), np.concatenate([part.future for part in parts]))


def joined(samples: dict[str, Samples]) -> Samples:
    """Samples of several sources in one batch, by the name of the source."""
    return _joined([samples[source] for source in sorted(samples)])
