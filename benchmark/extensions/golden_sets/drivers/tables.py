"""Rules and straight-road runs against official code, and its tables of crashes (cut-ins, braking leaders) by cell.

Many cells lie exactly on a tie (a gap that is just the safe one, a side speed of a whole number of steps), where the
last bit decides; so half a percent may differ, and a braking leader is also driven with a gap that is a nanometre
longer and shorter, of which the nearest answer counts.
"""

from typing import Final

import numpy as np

from benchmark.extensions.golden_sets.drivers.following import (
    build_braking_leaders,
    build_cut_ins,
    compute_following_distances,
)
from benchmark.geometry import Bools, Floats
from benchmark.interactions.idm_driver import compute_nuplan_acceleration
from benchmark.interactions.reaction import (
    Driver,
    critical_score,
    proactive_score,
    rss_distance_across,
    rss_distance_along,
)
from benchmark.interactions.straight_road import OtherCar, StraightRuns, drive_straight
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder

MODELS: Final = {
    "CC_human_driver": Driver.CC,
    "Reg157": Driver.R157,
    "RSS": Driver.RSS,
    "FSM": Driver.FSM,
}
"""Names of the official models."""


def read_drivers(stored: GoldenArrays) -> tuple[Driver, ...]:
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
        **{f"following_distance_{driver}": metres for driver, metres in compute_following_distances(speed).items()},
    }
    for name, values in ours.items():
        at.numbers(name, values, stored.floats(name, len(gap)))
    at.same("rss_unsafe", (gap < along_m) & (side < across_m), stored.verdicts("rss_unsafe", len(gap)))
    parameters = stored.floats("idm_parameters", 5)
    raw = compute_nuplan_acceleration(speed, stored.floats("idm_gap", len(gap)), leader, *parameters.tolist())
    at.numbers("idm_acceleration_raw (m/s2)", raw, stored.floats("idm_acceleration_raw", len(gap)))


def compare_straight(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare runs of the official models."""
    stored = folder.arrays("straight.npz")
    drivers, x = read_drivers(stored), stored.floats("other_x", None, None)
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
        for quantity, (computed, wanted) in equal.items():
            at.same(quantity, computed[:, row], wanted[:, row])
    for quantity, scores in (("cfs", runs.critical), ("pfs", runs.proactive)):
        comparison.numbers(f"straight, fsm: {quantity}", scores, stored.floats(quantity, cases, steps - 1))
    if Driver.CC in drivers:
        comparison.same("straight, cc: abandoned step", runs.abandoned, stored.integers("cc_abandoned_step", cases))


_NUDGES_M: Final = (0.0, -1e-9, 1e-9)
_G: Final = 9.81
_KM_H: Final = 3.6
_STEPS: Final = 350
"""The official runs of following end after 35 s, also where the leader brakes so gently that it still rolls."""


def compare_tables(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare the files of both kinds."""
    for path in folder.named("tables_*.npz"):
        stored = folder.arrays(path.name)
        compare = _compare_cut_ins if "pairs_km_h" in stored.names else _compare_following
        compare(comparison.at(path.name, "tables of "), stored)


def _compare_cut_ins(comparison: Comparison, stored: GoldenArrays) -> None:
    drivers = read_drivers(stored)
    pairs = stored.floats("pairs_km_h", None, 2) / _KM_H
    gaps, side_speeds = stored.floats("gap", None), stored.floats("lateral_speed", None)
    golden = stored.verdicts("crash", len(pairs), len(drivers), len(gaps), len(side_speeds))
    ego, other = (np.repeat(pairs[:, column], len(gaps)) for column in (0, 1))
    gap = np.tile(gaps, len(pairs))
    crash = np.zeros((len(side_speeds), len(gap), len(drivers)), np.bool_)
    for number, side_speed in enumerate(side_speeds.tolist()):
        track, start = build_cut_ins(ego, other, gap, side_speed)
        runs = drive_straight(np.repeat(start[:, None], len(drivers), axis=1), ego, ego, track, drivers)
        crash[number] = runs.crash_step >= 0
        if Driver.CC in drivers:
            given_up = runs.abandoned >= 0
            column = drivers.index(Driver.CC)
            before = (runs.crash_step[:, column] < 0) | (runs.abandoned < runs.crash_step[:, column])
            crash[number, :, column] &= ~(given_up & before)
    ours = crash.reshape(len(side_speeds), len(pairs), len(gaps), len(drivers)).transpose(1, 3, 2, 0)
    _compare_share(comparison, "cut-ins", ours != golden, stored.path.name)


def _compare_following(comparison: Comparison, stored: GoldenArrays) -> None:
    drivers = read_drivers(stored)
    speed = stored.floats("speed_km_h", None) / _KM_H
    rows = len(speed)
    deceleration = stored.floats("deceleration_g", rows) * _G
    golden_gap, crash = stored.floats("initial_gap", len(drivers), rows), stored.verdicts("crash", len(drivers), rows)
    impact = stored.floats("impact", len(drivers), rows)
    distances = compute_following_distances(speed)
    wrong = np.zeros(crash.shape, np.bool_)
    for row, driver in enumerate(drivers):
        comparison.numbers("following: gap (m)", distances[driver], golden_gap[row])
        targets = [crash[row].astype(np.float64), impact[row]]
        if driver is Driver.FSM:
            targets += [stored.floats(name, rows) for name in ("cfs_max", "pfs_max")]
        errors = _compute_errors(driver, speed, deceleration, distances[driver], np.array(targets))
        wrong[row] = errors[0] > 0
        agreed = ~wrong[row]
        comparison.errors("following: impact (m/s)", errors[1][agreed])
        for name, error in zip(("cfs_max", "pfs_max"), errors[2:]):
            comparison.errors(f"following: {name}", error[agreed])
    _compare_share(comparison, "following", wrong, stored.path.name)


def _compute_errors(driver: Driver, speed: Floats, deceleration: Floats, gap: Floats, targets: Floats) -> Floats:
    """(Q, C) errors of crash, impact and the two largest scores, those of the nudge that comes nearest."""
    errors = np.full(targets.shape, np.inf)
    for nudge in _NUDGES_M:
        track, start = build_braking_leaders(speed, deceleration, gap + nudge, _STEPS)
        runs = drive_straight(start[:, None], speed, speed, track, (driver,), always_careful=True)
        nudged_errors = np.abs(_summary(runs, track.speed)[: len(targets)] - targets)
        errors = np.where(nudged_errors.sum(axis=0) < errors.sum(axis=0), nudged_errors, errors)
    return errors


def _summary(runs: StraightRuns, leader_speed: Floats) -> Floats:
    """(4, C) whether a run crashes before the ego stands, how fast, and the largest scores until then."""
    speed = runs.speed[:, 0]
    stands = speed <= 0
    end = np.where(stands.any(axis=1), stands.argmax(axis=1), speed.shape[1])
    step = runs.crash_step[:, 0]
    crash: Bools = (step >= 0) & (step <= end)
    at = np.maximum(step, 0)[:, None]
    closing = (np.take_along_axis(speed, at, 1) - np.take_along_axis(leader_speed, at, 1))[:, 0]
    before = np.arange(speed.shape[1] - 1) < end[:, None]
    scores = [(score * before).max(axis=1) for score in (runs.critical, runs.proactive)]
    return np.array([crash, np.where(crash, closing, 0.0), *scores])


def _compare_share(comparison: Comparison, table: str, wrong: Bools, where: str) -> None:
    comparison.errors(f"{table}: share of cells that differ", wrong.mean())
    comparison.note(f"{table}: share of cells that differ", f"{where}: {np.count_nonzero(wrong)} of {wrong.size} cells")
