"""The driving command of NeuroNCAP: where the recorded path lies three seconds ahead."""

from typing import Final

import numpy as np

from benchmark.constants import COMMAND_LATERAL_M
from benchmark.geometry import Floats
from benchmark.planning import Command
from benchmark.records.neuroncap_switches import Switches

_AHEAD_S: Final = 3.0
_SLOWEST_M_S: Final = 2.0
_EXTENSION_M: Final = 100.0


def extended_path(path: Floats, switches: Switches) -> Floats:
    """The recorded (F, 3) path of x, y, yaw, continued for 100 m as (F + 1, 2) positions.

    The switches decide whether the continuation divides by the norm of the last step with its turn in it, or follows
    the last step that moves. As ``code``, the last position is not finite where the last two frames are the same, and a
    recording that stands makes every command straight.
    """
    steps = np.diff(path, axis=0)
    if switches.command_extension == "paper":
        moving = np.flatnonzero(np.linalg.norm(steps[:, :2], axis=1) > 0)
        yaw = path[-1, 2]
        last = steps[moving[-1], :2] if len(moving) else np.array([np.cos(yaw), np.sin(yaw)])
    else:
        last = steps[-1]
    with np.errstate(invalid="ignore"):
        end = path[-1, :2] + _EXTENSION_M * last[:2] / np.linalg.norm(last)
    return np.concatenate([path[:, :2], end[None]])


def command_at(pose: Floats, speed: float, path: Floats, switches: Switches) -> Command:
    """Command of a state: a (4, 4) pose of the rear axle, m/s, and the recording's (F, 3) path.

    Left or right where the point of the path that is nearest to the point three seconds straight ahead lies more than 2
    m to that side.
    """
    extended = extended_path(path, switches)
    ahead = (pose @ np.array([_AHEAD_S * max(speed, _SLOWEST_M_S), 0.0, 0.0, 1.0]))[:2]
    start, step = extended[:-1], np.diff(extended, axis=0)
    squared = np.sum(step**2, axis=1)
    if switches.command_extension == "code" and not (squared > 0).all():
        # Two equal samples in a row are 0 / 0 in the published code: nothing is left or right of that.
        return Command.STRAIGHT
    share = np.sum((ahead - start) * step, axis=1) / np.where(squared > 0, squared, 1.0)
    nearest = start + np.clip(share, 0.0, 1.0)[:, None] * step
    point = nearest[int(np.argmin(np.linalg.norm(nearest - ahead, axis=1)))]
    left = float(np.linalg.inv(pose[:2, :2])[1] @ (point - pose[:2, 3]))
    if left > COMMAND_LATERAL_M:
        return Command.LEFT
    return Command.RIGHT if left < -COMMAND_LATERAL_M else Command.STRAIGHT
