"""Speed laws of edits: how they change, how strong they are, and where they lead along a path."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import ACCELERATION_LAG_S
from benchmark.geometry import Floats
from generation.extensions.effect.paths import SPACING_M, PathKind, VehiclePath

MOST_SLOWER_M_S2, MOST_FASTER_M_S2 = 4.0, 2.0
BRAKING_M_S2: Final = tuple(np.arange(0.5, MOST_SLOWER_M_S2 + 0.01, 0.5).tolist())
BRAKED_TO: Final = (0.0, 0.3, 0.5, 0.7, 0.85)
HELD_S: Final = (0.5, 1.5, 3.0, 5.0, 9.0)
RECOVERY_M_S2: Final = 1.0
"""An edit that brakes: how hard, to which share of its speed, how long it stays there, and how it comes back."""
ACCELERATION_M_S2: Final = (0.4, 0.8, 1.2, 1.6, MOST_FASTER_M_S2)
FASTER: Final = (1.0, 1.1, 1.2)
"""An edit that goes early: how hard, and up to which multiple of its own highest speed."""
LANE_SPEEDS_M_S: Final = (3.0, 4.5, 6.0, 7.5, 9.0, 11.0)
"""Speeds at which a vehicle drives a path that it did not drive."""
NOSE_M_S, NOSE_HELD_S = 2.5, tuple(np.arange(0.0, 3.01, 0.5).tolist())
"""An edit that edges out and waits: how fast, and how long before it stops."""
BRAKING_FROM_M_S: Final = 2.0
"""Slower ones do not brake, and may edge out."""
ACROSS_M_S2: Final = 2.5
"""Bends are taken at this."""
SLOWING_M_S2: Final = 2.0
"""For bends ahead."""
SETTLING_S, REACHED_M_S = 0.4, 0.3
"""How softly a speed is reached, and when it is."""
LAG_SHARE: Final = 1.0 / (1.0 + FRAME_HZ * ACCELERATION_LAG_S)
"""Accelerations build up as those of the simulator do, so that it keeps to the law."""


@dataclass(frozen=True, slots=True)
class SpeedLaw:
    """Speed of an edit: ``change`` m/s^2 to ``target`` m/s, ``held_s`` there, then +1 m/s^2 to ``then`` m/s."""

    change: float
    target: float
    held_s: float
    then: float


def list_laws(kind: PathKind, speed: float, fastest: float) -> list[SpeedLaw]:
    """Laws of a vehicle at a speed, whose highest is known, on a path of a kind; m/s."""
    recorded, laws = kind == "recorded", []
    if recorded:
        own = max(fastest, speed)
        laws += [SpeedLaw(a, times * own, np.inf, 0.0) for a in ACCELERATION_M_S2 for times in FASTER]
    else:
        laws += [SpeedLaw(a, max(of, speed), np.inf, 0.0) for a in ACCELERATION_M_S2[::2] for of in LANE_SPEEDS_M_S]
    if not recorded and speed < BRAKING_FROM_M_S:
        laws += [SpeedLaw(a, NOSE_M_S, held, 0.0) for a in ACCELERATION_M_S2[::2] for held in NOSE_HELD_S]
    if speed >= BRAKING_FROM_M_S:
        laws += [
            SpeedLaw(-b, share * speed, held, speed) for b in BRAKING_M_S2 for share in BRAKED_TO for held in HELD_S
        ]
    return laws


def scale_law(law: SpeedLaw, before: float, strength: float) -> SpeedLaw:
    """A law with a change of speed, or a way that is edged out, that many times as large, within +2 and -4 m/s^2.

    ``before`` is the speed at its start, m/s.
    """
    if law.change < 0.0:
        target = max(before - strength * (before - law.target), 0.0)
        return replace(law, change=max(law.change * strength, -MOST_SLOWER_M_S2), target=target)
    if np.isfinite(law.held_s):
        return replace(law, target=law.target * strength, held_s=law.held_s * strength)
    return replace(law, change=min(law.change * strength, MOST_FASTER_M_S2))


def compute_stations(
    paths: Sequence[VehiclePath], rows: NDArray[np.int64], laws: Sequence[SpeedLaw], start_speed: float, frames: int
) -> Floats:
    """(B, F) metres along paths by B laws at F frames, slower where they bend; ``rows`` (B,) are the paths of the laws.

    All of them at once: most of the time would go into the calls, one a frame.
    """
    change, target, held, then = (
        np.array([getattr(law, name) for law in laws]) for name in ("change", "target", "held_s", "then")
    )
    bends, speed = compute_bend_speeds(paths), np.full(len(laws), start_speed)
    last = bends.shape[1] - 2
    acceleration, reached = np.zeros(len(laws)), np.full(len(laws), np.inf)
    station, step = np.zeros((len(laws), frames)), 1.0 / FRAME_HZ
    for frame in range(1, frames):
        now = frame * step
        back = now > reached + held
        wanted = np.where(back, then, target)
        most = np.where(back, RECOVERY_M_S2, np.abs(change))
        reached = np.where(np.isinf(reached) & (np.abs(speed - target) <= REACHED_M_S), now, reached)
        along = station[:, frame - 1] / SPACING_M
        index = np.minimum(along.astype(np.int64), last)
        share = np.minimum(along - index, 1.0)
        bend = (1.0 - share) * bends[rows, index] + share * bends[rows, index + 1]
        most = np.where(bend < np.minimum(wanted, speed), SLOWING_M_S2, most)
        asked = np.clip((np.minimum(wanted, bend) - speed) / SETTLING_S, -most, most)
        acceleration = acceleration + LAG_SHARE * (asked - acceleration)
        speed = np.maximum(speed + acceleration * step, 0.0)
        station[:, frame] = station[:, frame - 1] + speed * step
    return station


def compute_bend_speeds(paths: Sequence[VehiclePath]) -> Floats:
    """(P, V) m/s at which paths can be driven, slowed down for bends ahead; the last holds behind a path's end."""
    most = max(len(path.points) for path in paths)
    curvature = np.stack([np.pad(path.curvature, (0, most - len(path.points)), mode="edge") for path in paths])
    speed = np.sqrt(ACROSS_M_S2 / np.maximum(np.abs(curvature), 1e-3))
    for index in range(most - 2, -1, -1):
        speed[:, index] = np.minimum(speed[:, index], np.sqrt(speed[:, index + 1] ** 2 + 2 * SLOWING_M_S2 * SPACING_M))
    return np.asarray(speed)
