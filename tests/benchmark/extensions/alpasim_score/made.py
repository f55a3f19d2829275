"""Logged drives of one line: the recording goes along x at a speed, the ego as it is told."""

from typing import Any

import numpy as np

from benchmark.extensions.alpasim_score.scene_score import LoggedDrive
from benchmark.geometry import Floats

STEP_US = 100_000
CAR = (4.6, 1.9)
BODY = (4.084, 1.73)


def boxes(x: Any, y: Any = 0.0, size: tuple[float, float] = CAR, yaw: Any = 0.0, count: int = 41) -> Floats:
    """(count, 5) boxes."""
    columns = (np.broadcast_to(np.asarray(each, np.float64), count) for each in (x, y, *size, yaw))
    return np.column_stack(list(columns))


def along(speed: float, start: float = 0.0, count: int = 41) -> Floats:
    """(count,) positions."""
    return start + 0.1 * speed * np.arange(count)


def logged(ego: Floats, *others: Floats, speed: float = 10.0, recorded_s: float = 5.0, **changes: Any) -> LoggedDrive:
    """A drive beside a recording of ``speed`` for so many seconds, scored from 0.5 s on."""
    times = STEP_US * np.arange(len(ego))
    frames = round(10 * recorded_s) + 1
    there = np.array(others).reshape(len(others), len(ego), 5)
    made = {
        **{"times_us": times, "ego": ego, "others": there, "present": np.ones(there.shape[:2], np.bool_)},
        "recorded_us": STEP_US * np.arange(frames),
        "recorded": np.column_stack([along(speed, count=frames), np.zeros(frames)]),
        **{"scored_from_us": 500_000, "ends_us": int(times[-1]) if len(times) else 0},
    }
    return LoggedDrive(**{**made, **changes})
