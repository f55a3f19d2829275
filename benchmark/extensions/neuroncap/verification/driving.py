"""Golden plans of all kinds driven sub-step by sub-step, published and in double precision; aggregates; set files."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.actors import Integers
from benchmark.extensions.neuroncap.contact import NeuroncapCar
from benchmark.extensions.neuroncap.recording import CAN_COLUMNS
from benchmark.extensions.neuroncap.vehicle import STEP_US, SUBSTEPS, Vehicle, VehicleStep, drive_plan
from benchmark.geometry import Floats, wrap_angle
from benchmark.records.neuroncap_aggregate import CODE, NeuroncapSwitches, aggregate_runs, find_invalid_reason
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder

_NAN: Final = "nan"


def read_plans(stored: GoldenArrays, name: str, counts: list[int]) -> list[Floats]:
    """Plans of so many waypoints each, which are padded to the longest."""
    padded = stored.floats(name, len(counts), None, 2, gaps=True)
    plans = [plan[:count] for plan, count in zip(padded, counts)]
    if [len(plan) for plan in plans] != counts or not all(np.isfinite(plan).all() for plan in plans):
        raise ValueError(f"array {name} has fewer waypoints than counted, or contains NaN or infinity")
    return plans


def parse_nan(value: Any) -> Any:
    """Values of a JSON file, with NaN for the word ``nan``."""
    if isinstance(value, dict):
        return {name: parse_nan(inner) for name, inner in value.items()}
    return float("nan") if value == _NAN else value


def compute_single_error(ours: Floats, golden: Floats) -> Floats:
    """Size of a difference of numbers that both were rounded to single precision, as far as rounding cannot make it."""
    step = np.spacing(np.abs(golden).astype(np.float32)).astype(np.float64)
    return np.asarray(np.maximum(np.abs(ours - golden) - step, 0.0))


_VALID = "passes"


def compare_aggregates(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare all sets of runs."""
    for case in folder.facts("aggregate.json", gaps=True)["cases"]:
        runs, at = parse_nan(case["runs"]), comparison.at(case["name"], "aggregate: ")
        why, golden = find_invalid_reason(runs), case["check_validity"]
        at.verdicts("is it complete", (why is None) != (golden == _VALID))
        if why is not None and golden != _VALID:
            at.verdicts("what is incomplete", why.split(" ")[0] not in golden)
        try:
            table = aggregate_runs(runs, CODE)
        except InputError:
            at.verdicts("is it refused", "error" not in case)
            continue
        at.verdicts("is it refused", "error" in case)
        if "error" in case:
            continue
        for level in ("per_sequence", "per_type", "overall"):
            ours, theirs = _flatten(getattr(table, level)), _flatten(parse_nan(case[level]))
            wrong = [not _is_equal(ours.get(key), theirs.get(key)) for key in {*ours, *theirs}]
            at.verdicts(level.replace("_", " "), wrong)


def _flatten(table: Mapping[str, Any], before: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    flat: dict[tuple[str, ...], Any] = {}
    for name, value in table.items():
        flat |= _flatten(value, (*before, name)) if isinstance(value, Mapping) else {(*before, name): value}
    return flat


def _is_equal(ours: Any, golden: Any) -> bool:
    if ours is None or golden is None:
        return False
    return bool(ours == golden) or (math.isnan(ours) and isinstance(golden, float) and math.isnan(golden))


STATE_COLUMNS: Final = (
    "x",
    "y",
    "heading",
    "speed",
    "acceleration",
    "steering_angle",
    "yaw_rate",
    "yaw_acceleration",
    "steering_rate",
)
COMMAND_COLUMNS: Final = ("acceleration", "steering_rate")
_HEADING: Final = STATE_COLUMNS.index("heading")
_LAST_BIT_M: Final = 1e-3
"""Cases whose two golden versions are further apart are decided by the last bit after their first step."""


_READINGS: Final = {"as code": ("code", CODE), "in double precision": ("float64", replace(CODE, float32="paper"))}
"""Ways in which the set has every number: what its arrays' names begin with, and the switches that lead to it."""


def compare_driving(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare all cases."""
    stored = folder.arrays("vehicle.npz")
    names, case = stored.texts("name"), stored.integers("step_case", None)
    plans = read_plans(stored, "plan", stored.integers("plan_waypoints", len(case)).tolist())
    fragile = stored.floats("code_minus_float64_m", len(names)) > _LAST_BIT_M
    compared = np.r_[True, case[1:] != case[:-1]] | ~fragile[case]
    for called, (prefix, switches) in _READINGS.items():
        golden = _GoldenReading(stored, prefix, len(plans))
        for number, step in enumerate(_drive_steps(stored, case, plans, switches)):
            if compared[number]:
                _compare_step(comparison.at(f"step {number}", f"car {called}: "), step, golden, number, switches)
    starts = stored.texts("initial", len(names))
    if left_out := [f"{names[index]} {starts[index]}" for index in np.flatnonzero(fragile)]:
        note = f"after their first step, {', '.join(left_out)} are decided by the last bit and left out"
        for called in _READINGS:
            comparison.note(f"car {called}: states of sub-steps", note)


def _drive_steps(
    stored: GoldenArrays, case: Integers, plans: list[Floats], switches: NeuroncapSwitches
) -> Iterator[tuple[VehicleStep, int]]:
    """Every step in order, and the time at its end; a car goes on from step to step of its case."""
    car, cases = NeuroncapCar.of(switches), len(stored.texts("name"))
    poses, canbus = stored.floats("ego2world", cases, 4, 4), stored.floats("canbus", cases, CAN_COLUMNS)
    wheel, start = stored.floats("steering_wheel", cases), stored.integers("start_time", cases)
    vehicle: Vehicle | None = None
    time, last = 0, -1
    for which, plan in zip(case.tolist(), plans):
        if vehicle is None or which != last:
            row = canbus[which].astype(np.float32)
            vehicle, time = Vehicle.start(poses[which], row, float(wheel[which]), switches), int(start[which])
        step = drive_plan(vehicle, plan, time, car, switches)
        vehicle, time, last = step.vehicle, time + STEP_US, which
        yield step, time


def _compare_step(
    comparison: Comparison,
    ours: tuple[VehicleStep, int],
    golden: "_GoldenReading",
    number: int,
    switches: NeuroncapSwitches,
) -> None:
    (step, time), vehicle = ours, ours[0].vehicle
    comparison.errors("states of sub-steps", compute_state_errors(step.states, golden.states[number]))
    comparison.numbers("commands", step.commands, golden.commands[number])
    comparison.numbers("commands before the limit", step.unlimited, golden.unlimited[number])
    comparison.numbers("poses", vehicle.pose, golden.poses[number])
    row = vehicle.canbus(NeuroncapCar.of(switches), switches)
    speed = np.linalg.norm(row[13:15])
    for name, single, stored in (
        ("CAN rows", row, golden.canbus[number]),
        ("speeds", np.array([speed]), golden.speeds[number : number + 1]),
    ):
        beyond = compute_single_error(np.asarray(single, np.float64), stored)
        comparison.errors(f"{name}, beyond one step of single precision", beyond)
    comparison.verdicts("times", bool(time != golden.times[number]))


def compute_state_errors(ours: Floats, golden: Floats) -> Floats:
    """Differences of the states of sub-steps."""
    error = ours - golden
    error[:, _HEADING] = wrap_angle(error[:, _HEADING])
    return error


class _GoldenReading:
    """Golden arrays of one reading, S steps."""

    def __init__(self, stored: GoldenArrays, reading: str, steps: int) -> None:
        columns = stored.columns("state_columns", *STATE_COLUMNS)
        commands = stored.columns("command_columns", *COMMAND_COLUMNS)
        self.states = stored.floats(f"{reading}_substep_state", steps, SUBSTEPS, None)[..., columns]
        self.commands = stored.floats(f"{reading}_substep_command", steps, SUBSTEPS, None)[..., commands]
        self.unlimited = stored.floats(f"{reading}_substep_command_unclipped", steps, SUBSTEPS, None)[..., commands]
        self.poses = stored.floats(f"{reading}_step_pose", steps, 4, 4)
        self.canbus = stored.floats(f"{reading}_step_canbus", steps, CAN_COLUMNS)
        self.speeds = stored.floats(f"{reading}_step_speed", steps)
        self.times = stored.integers(f"{reading}_step_time", steps)
