"""The official tables of crashes: cut-ins and braking leaders, cell by cell.

Many cells of these grids lie exactly on a tie (a gap that is just the safe one, a side speed that is a whole number of
steps), where the last bit decides; so half a percent of the cells may differ, and a braking leader is also driven with
a gap that is a nanometre longer and shorter, of which the nearest answer counts.
"""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.drivers.following import braking_leader, cut_in, following_distances
from benchmark.extensions.golden_sets.drivers.straight_road import DriverArrays
from benchmark.geometry import Bools, Floats
from benchmark.interactions.reaction import Driver
from benchmark.interactions.straight import StraightRuns, drive_straight
from benchmark.verification.checks import Comparison

DIFFERENT_CELLS: Final = 0.005
_NUDGES_M: Final = (0.0, -1e-9, 1e-9)
TOLERANCE, NUDGED_TOLERANCE = 1e-9, 1e-6
_G: Final = 9.81
_KM_H: Final = 3.6
_STEPS: Final = 350
"""The official runs of following end after 35 s, also where the leader brakes so gently that it still rolls."""


def compare_tables(comparison: Comparison, path: Path) -> None:
    """Compare one file, of either kind.

    Args:
        comparison: Takes the errors.
        path: ``tables_*.npz``.

    Raises:
        InputError: If the file cannot be used.
    """
    stored = DriverArrays.read(path)
    if "pairs_km_h" in stored.names:
        _compare_cut_ins(comparison, stored)
    else:
        _compare_following(comparison, stored)


def _compare_cut_ins(comparison: Comparison, stored: DriverArrays) -> None:
    drivers = stored.drivers()
    pairs = stored.floats("pairs_km_h", None, 2) / _KM_H
    gaps, side_speeds = stored.floats("gap", None), stored.floats("lateral_speed", None)
    golden = stored.verdicts("crash", len(pairs), len(drivers), len(gaps), len(side_speeds))
    if not golden.size or (side_speeds < 0).any():
        raise InputError(f"{stored.path} has no cells, or negative side speeds; fetch or make the file again")
    ego, other = (np.repeat(pairs[:, column], len(gaps)) for column in (0, 1))
    gap = np.tile(gaps, len(pairs))
    crash = np.zeros((len(side_speeds), len(gap), len(drivers)), np.bool_)
    for number, side_speed in enumerate(side_speeds.tolist()):
        track, start = cut_in(ego, other, gap, side_speed)
        runs = drive_straight(np.repeat(start[:, None], len(drivers), axis=1), ego, ego, track, drivers)
        crash[number] = runs.crash_step >= 0
        if Driver.CC in drivers:
            given_up = runs.abandoned >= 0
            column = drivers.index(Driver.CC)
            before = (runs.crash_step[:, column] < 0) | (runs.abandoned < runs.crash_step[:, column])
            crash[number, :, column] &= ~(given_up & before)
    ours = crash.reshape(len(side_speeds), len(pairs), len(gaps), len(drivers)).transpose(1, 3, 2, 0)
    _share(comparison, "tables of cut-ins: share of cells that differ", ours != golden, stored.path.name)


def _compare_following(comparison: Comparison, stored: DriverArrays) -> None:
    drivers = stored.drivers()
    speed = stored.floats("speed_km_h", None) / _KM_H
    rows = len(speed)
    deceleration = stored.floats("deceleration_g", rows) * _G
    if not rows:
        raise InputError(f"{stored.path} has no rows; fetch or make the file again")
    golden_gap, crash = stored.floats("initial_gap", len(drivers), rows), stored.verdicts("crash", len(drivers), rows)
    impact = stored.floats("impact", len(drivers), rows)
    distances = following_distances(speed)
    wrong = np.zeros(crash.shape, np.bool_)
    for row, driver in enumerate(drivers):
        if driver not in distances:
            raise InputError(f"{stored.path}: nobody said at what distance {driver} follows; leave that model out")
        comparison.numbers("tables of following: gap (m)", distances[driver], golden_gap[row], TOLERANCE)
        targets = [crash[row].astype(np.float64), impact[row]]
        if driver is Driver.FSM:
            targets += [stored.floats(name, rows) for name in ("cfs_max", "pfs_max")]
        errors = _nearest(driver, speed, deceleration, distances[driver], np.array(targets))
        wrong[row] = errors[0] > 0
        agreed = ~wrong[row]
        comparison.errors("tables of following: impact (m/s)", errors[1][agreed], NUDGED_TOLERANCE)
        for name, error in zip(("cfs_max", "pfs_max"), errors[2:]):
            comparison.errors(f"tables of following: {name}", error[agreed], NUDGED_TOLERANCE)
    _share(comparison, "tables of following: share of cells that differ", wrong, stored.path.name)


def _nearest(driver: Driver, speed: Floats, deceleration: Floats, gap: Floats, targets: Floats) -> Floats:
    """(Q, C) errors of crash, impact and the two largest scores, those of the nudge that comes nearest."""
    errors = np.full(targets.shape, np.inf)
    for nudge in _NUDGES_M:
        track, start = braking_leader(speed, deceleration, gap + nudge, _STEPS)
        runs = drive_straight(start[:, None], speed, speed, track, (driver,), always_careful=True)
        found = np.abs(_summary(runs, track.speed)[: len(targets)] - targets)
        errors = np.where(found.sum(axis=0) < errors.sum(axis=0), found, errors)
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


def _share(comparison: Comparison, quantity: str, wrong: Bools, where: str) -> None:
    comparison.errors(quantity, np.full(1, wrong.mean()), DIFFERENT_CELLS, where=where)
    comparison.note(quantity, f"{where}: {np.count_nonzero(wrong)} of {wrong.size} cells")
