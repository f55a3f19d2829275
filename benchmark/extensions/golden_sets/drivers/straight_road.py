"""The rules and the runs on a straight road against those of the official code."""

from typing import Final

import numpy as np

from benchmark.extensions.golden_sets.drivers.following import following_distances
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
from benchmark.verification.golden import GoldenArrays, GoldenFolder

MODELS: Final = {
    "CC_human_driver": Driver.CC,
    "Reg157": Driver.R157,
    "RSS": Driver.RSS,
    "FSM": Driver.FSM,
}
"""Names of the official models."""


def drivers_of(stored: GoldenArrays) -> tuple[Driver, ...]:
    """The drivers that the array ``models`` names."""
    return tuple(MODELS[name] for name in stored.texts("models"))


def compare_functions(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare scores, distances and accelerations of single situations."""
    stored, at = folder.arrays("functions.npz"), comparison.at("", "function ")
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
        at.numbers(name, values, stored.floats(name, len(gap)))
    at.same("rss_unsafe", (gap < along_m) & (side < across_m), stored.verdicts("rss_unsafe", len(gap)))
    parameters = stored.floats("idm_parameters", 5)
    raw = raw_acceleration(speed, stored.floats("idm_gap", len(gap)), leader, *parameters.tolist())
    at.numbers("idm_acceleration_raw (m/s2)", raw, stored.floats("idm_acceleration_raw", len(gap)))


def compare_straight(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare runs of the official models."""
    stored = folder.arrays("straight.npz")
    drivers, x = drivers_of(stored), stored.floats("other_x", None, None)
    cases, steps = x.shape
    other = OtherCar(x, *(stored.floats(name, cases, steps) for name in ("other_y", "other_vx", "other_vy")))
    speed = stored.floats("ego_speed", cases)
    position = stored.floats("position", cases, len(drivers), steps)
    runs = drive_straight(position[:, :, 0], speed, speed, other, drivers)
    numbers = {
        "speed (m/s)": (runs.speed, stored.floats("speed", cases, len(drivers), steps)),
        "position (m)": (runs.position, position),
        "braking (m/s2)": (runs.braking, stored.floats("braking", cases, len(drivers), steps - 1)),
    }
    equal = {
        "unsafe": (runs.unsafe, stored.verdicts("unsafe", cases, len(drivers), steps - 1)),
        "crash_step": (runs.crash_step, stored.integers("crash_step", cases, len(drivers))),
        "crash_type": (runs.crash_kind, stored.integers("crash_type", cases, len(drivers))),
    }
    for row, driver in enumerate(drivers):
        at = comparison.at("", f"straight, {driver}: ")
        for quantity, (ours, golden) in numbers.items():
            at.numbers(quantity, ours[:, row], golden[:, row])
        for quantity, (found, wanted) in equal.items():
            at.same(quantity, found[:, row], wanted[:, row])
    for quantity, scores in (("cfs", runs.critical), ("pfs", runs.proactive)):
        comparison.numbers(f"straight, fsm: {quantity}", scores, stored.floats(quantity, cases, steps - 1))
    if Driver.CC in drivers:
        comparison.same("straight, cc: abandoned step", runs.abandoned, stored.integers("cc_abandoned_step", cases))
