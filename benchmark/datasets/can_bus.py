"""Ego motion at a sample: measured (CAN bus expansion) or derived from past poses, and never from the future.

The two exceptions are `EgoState.can_motion` at the start of a scene whose messages begin after its first sample, and
`EgoState.can_motion_after`, which few planners are given.

The files are those of the CAN bus expansion. The devkit's reader refuses scene names that are not ``scene-dddd``, which
the published Adv-nuSc has, so they are read here.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ
from benchmark.datasets.scene_names import find_can_bus_file
from benchmark.datasets.schema.sidecar_files import CAN_BUS, require_records
from benchmark.datasets.schema.tables import ValueKind
from benchmark.geometry import Floats
from benchmark.machine.storage import read_json
from benchmark.planning import EgoState
from benchmark.scene import EgoTrack

_STALE_AFTER_US: Final = 500_000
"""A message that is older than this says nothing about now."""
_FIT_FRAMES: Final = FRAME_HZ + 1
"""Derived motion is fitted to the poses of the last second."""
_FIT_QUADRATIC_FROM: Final = 7
"""Below this many poses a parabola follows the jitter of the localisation."""


def move_messages(messages: Any, later_us: int) -> int:
    """Move what of a CAN bus file's content has a time, by whole microseconds; how many messages that are."""
    listed = messages if isinstance(messages, list) else []
    timed = [message for message in listed if isinstance(message, dict) and type(message.get("utime")) is int]
    for message in timed:
        message["utime"] += later_us
    return len(timed)


@dataclass(frozen=True, slots=True)
class CanMessages:
    """(M,) times and (M, F) values of messages of one kind, in time order, with a column for each field asked for."""

    times_us: NDArray[np.int64]
    values: Floats

    @classmethod
    def read(cls, path: Path, fields: Mapping[str, ValueKind]) -> Self | None:
        """Messages of ``can_bus/<scene>_<message>.json``; ``None`` if missing or empty; ``fields`` need ``utime``."""
        if not path.is_file():
            return None
        messages = require_records(path, "message", read_json(path), fields)
        if not messages:
            return None
        times_us = np.array([message["utime"] for message in messages], dtype=np.int64)
        columns = [
            np.array([message[name] for message in messages], dtype=np.float64) for name in fields if name != "utime"
        ]
        values = np.concatenate([column.reshape(len(messages), -1) for column in columns], axis=-1)
        order = np.argsort(times_us, kind="stable")
        return cls(times_us[order], values[order])

    def before(self, timestamp_us: int) -> Floats | None:
        """(F,) latest values not later than a time, or ``None`` if there are none within half a second."""
        index = int(np.searchsorted(self.times_us, timestamp_us, side="right")) - 1
        if index < 0 or timestamp_us - int(self.times_us[index]) > _STALE_AFTER_US:
            return None
        return np.asarray(self.values[index])

    def before_or_first(self, timestamp_us: int) -> Floats | None:
        """As `before`; where a scene begins up to half a second ahead of its messages, the first of them."""
        first_us = int(self.times_us[0])
        if timestamp_us < first_us <= timestamp_us + _STALE_AFTER_US:
            return np.asarray(self.values[0])
        return self.before(timestamp_us)

    def after_or_last(self, timestamp_us: int) -> Floats:
        """(F,) first values later than a time, however much later; the last ones where none are."""
        index = int(np.searchsorted(self.times_us, timestamp_us, side="right"))
        return np.asarray(self.values[min(index, len(self.times_us) - 1)])


@dataclass(frozen=True, slots=True)
class CanBus:
    """CAN bus messages of one scene, if there: motion in the ego frame (``pose``) and ``steeranglefeedback``."""

    motion: CanMessages | None
    steering: CanMessages | None

    @classmethod
    def read(cls, root: Path, scene: str) -> Self:
        """Read the CAN bus files of a scene; any of them may be absent."""
        motion, steering = (
            CanMessages.read(find_can_bus_file(root, scene, message), fields) for message, fields in CAN_BUS.items()
        )
        return cls(motion, steering)


def compute_ego_state(ego: EgoTrack, timestamps_us: NDArray[np.int64], frame: int, can_bus: CanBus) -> EgoState:
    """Ego motion at a frame, from nothing later than the frame.

    Velocity, acceleration and yaw rate are measured where a CAN message of the last half second exists, else fitted to
    the poses of the last second (`_fit_motion`).
    """
    now_us, pose = int(timestamps_us[frame]), ego.pose[frame]
    measured = can_bus.motion.before(now_us) if can_bus.motion else None
    steering = can_bus.steering.before(now_us) if can_bus.steering else None
    if measured is not None:
        velocity, acceleration, yaw_rate = measured[0:2], measured[3:5], float(measured[8])
    else:
        first = max(frame + 1 - _FIT_FRAMES, 0)
        seconds = (timestamps_us[first : frame + 1] - now_us) * 1e-6
        velocity, acceleration, yaw_rate = _fit_motion(ego.pose[first : frame + 1], seconds)
    return EgoState(
        pose=pose,
        position=ego.position[frame],
        rotation=ego.rotation[frame],
        velocity=velocity,
        acceleration=acceleration,
        yaw_rate=yaw_rate,
        steering_angle=None if steering is None else float(steering[0]),
        source="derived" if measured is None else "can_bus",
        can_motion=can_bus.motion.before_or_first(now_us) if can_bus.motion else None,
        can_motion_after=can_bus.motion.after_or_last(now_us) if can_bus.motion else None,
    )


def _fit_motion(poses: Floats, seconds: Floats) -> tuple[Floats, Floats, float]:
    """Velocity, acceleration and yaw rate at the last of some poses, by least squares.

    A rear axle moves along the heading, so the distance driven is fitted by a parabola and the heading by a line. From
    (H, 3) planar poses, oldest first, and their times, the last one 0, to (2,) m/s and (2,) m/s^2 in the frame of the
    last pose, and rad/s. A single pose tells no motion: zeros. Fewer than seven tell no longitudinal acceleration.
    """
    if len(poses) < 2:
        return np.zeros(2), np.zeros(2), 0.0
    yaw = np.unwrap(poses[:, 2])
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    steps = np.diff(poses[:, :2], axis=0)
    driven = np.concatenate([[0.0], np.cumsum(steps[:, 0] * np.cos(middle) + steps[:, 1] * np.sin(middle))])
    degree = 2 if len(poses) >= _FIT_QUADRATIC_FROM else 1
    powers = np.vander(seconds, degree + 1, increasing=True)
    along, *_ = np.linalg.lstsq(powers, driven, rcond=None)
    turning, *_ = np.linalg.lstsq(powers[:, :2], yaw - yaw[-1], rcond=None)
    speed, yaw_rate = float(along[1]), float(turning[1])
    speeding_up = 2 * float(along[2]) if degree == 2 else 0.0
    return np.array([speed, 0.0]), np.array([speeding_up, speed * yaw_rate]), yaw_rate
