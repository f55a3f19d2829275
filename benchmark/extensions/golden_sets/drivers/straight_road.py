"""The rules and the runs on a straight road against those of the official code."""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.drivers.following import following_distances
from benchmark.interactions.golden import TrackArrays
from benchmark.interactions.keeping_distance import raw_acceleration
from benchmark.interactions.reaction import Driver
from benchmark.interactions.rules import (
    critical_score,
    proactive_score,
    rss_distance_across,
    rss_distance_along,
)
from benchmark.interactions.straight import OtherCar, drive_straight
from benchmark.verification.checks import Comparison

MODELS: Final = {
    "CC_human_driver": Driver.CC,
    "Reg157": Driver.R157,
    "RSS": Driver.RSS,
    "FSM": Driver.FSM,
}
"""Names of the official models."""
TOLERANCE: Final = 1e-9


class DriverArrays(TrackArrays):
    """Arrays of one file."""

    def drivers(self, *needed: Driver) -> tuple[Driver, ...]:
        """The drivers that the array ``models`` names, each once.

        Raises:
            InputError: If it names others, or not those that are needed.
        """
        names = [str(name) for name in self._taken("models", "U", "names", (None,))]
        found = tuple(MODELS[name] for name in names if name in MODELS)
        if len(set(found)) != len(names) or not set(needed) <= set(found):
            raise InputError(f"{self.path} is about the models {', '.join(names)}; known are {', '.join(MODELS)}")
        return found

    def words(self, name: str, length: int | None = None) -> tuple[str, ...]:
        """Names; arguments and errors as in `floats`."""
        return tuple(str(word) for word in self._taken(name, "U", "names", (length,)))


def compare_functions(comparison: Comparison, path: Path) -> None:
    """Scores, distances and accelerations of single situations.

    Args:
        comparison: Takes the errors.
        path: ``functions.npz``.

    Raises:
        InputError: If the file cannot be used.
    """
    stored = DriverArrays.read(path)
    gap = stored.floats("gap", None)
    speed, leader, acceleration, side, across = (
        stored.floats(name, len(gap)) for name in ("speed", "leader_speed", "acceleration", "side", "lateral_speed")
    )
    along_m, across_m = rss_distance_along(speed, leader), rss_distance_across(np.abs(across))
    ours = {
        "pfs": proactive_score(gap, speed, leader),
        "cfs": critical_score(gap, speed, leader, acceleration),
        "rss_distance_along": along_m,
        "rss_distance_across": across_m,
        **{f"following_distance_{driver}": metres for driver, metres in following_distances(speed).items()},
    }
    for name, values in ours.items():
        comparison.numbers(f"function {name}", values, stored.floats(name, len(gap)), TOLERANCE)
    unsafe = (gap < along_m) & (side < across_m)
    comparison.verdicts("function rss_unsafe", unsafe != stored.verdicts("rss_unsafe", len(gap)))
    parameters = stored.floats("idm_parameters", 5)
    raw = raw_acceleration(speed, stored.floats("idm_gap", len(gap)), leader, *parameters.tolist())
    golden = stored.floats("idm_acceleration_raw", len(gap))
    comparison.numbers("function idm_acceleration_raw (m/s2)", raw, golden, TOLERANCE)


def compare_straight(comparison: Comparison, path: Path) -> None:
    """Runs of the official models.

    Args:
        comparison: Takes the errors.
        path: ``straight.npz``.

    Raises:
        InputError: If the file cannot be used.
    """
    stored = DriverArrays.read(path)
    drivers = stored.drivers(Driver.FSM)
    x = stored.floats("other_x", None, None)
    cases, steps = x.shape
    if steps < 2 or not cases:
        raise InputError(f"{path} holds no runs; fetch or make the file again")
    other = OtherCar(x, *(stored.floats(name, cases, steps) for name in ("other_y", "other_vx", "other_vy")))
    speed = stored.floats("ego_speed", cases)
    position = stored.floats("position", cases, len(drivers), steps)
    runs = drive_straight(position[:, :, 0], speed, speed, other, drivers)
    per_model = {
        "speed (m/s)": (runs.speed, stored.floats("speed", cases, len(drivers), steps)),
        "position (m)": (runs.position, position),
        "braking (m/s2)": (runs.braking, stored.floats("braking", cases, len(drivers), steps - 1)),
    }
    for row, driver in enumerate(drivers):
        for quantity, (ours, golden) in per_model.items():
            comparison.numbers(f"straight, {driver}: {quantity}", ours[:, row], golden[:, row], TOLERANCE)
        unsafe = stored.verdicts("unsafe", cases, len(drivers), steps - 1)[:, row]
        comparison.verdicts(f"straight, {driver}: unsafe", runs.unsafe[:, row] != unsafe)
        for quantity, numbers in (("crash_step", runs.crash_step), ("crash_type", runs.crash_kind)):
            golden_numbers = stored.integers(quantity, cases, len(drivers))[:, row]
            comparison.verdicts(f"straight, {driver}: {quantity}", numbers[:, row] != golden_numbers)
    for quantity, scores in (("cfs", runs.critical), ("pfs", runs.proactive)):
        comparison.numbers(f"straight, fsm: {quantity}", scores, stored.floats(quantity, cases, steps - 1), TOLERANCE)
    if Driver.CC in drivers:
        abandoned = stored.integers("cc_abandoned_step", cases)
        comparison.verdicts("straight, cc: abandoned step", runs.abandoned != abandoned)
