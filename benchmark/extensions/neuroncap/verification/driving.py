"""The car: every sub-step of plans of all kinds, as the published code drives them and in double precision."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.actors import Integers
from benchmark.extensions.neuroncap.car import Car
from benchmark.extensions.neuroncap.recording import CAN_COLUMNS
from benchmark.extensions.neuroncap.vehicle import STEP_US, SUBSTEPS, DrivenStep, Vehicle, driven
from benchmark.extensions.neuroncap.verification.golden_set import (
    CODE_TOLERANCE,
    TOLERANCE,
    NcapArrays,
    beyond_single,
)
from benchmark.geometry import Floats, wrap_angle
from benchmark.records.neuroncap_switches import CODE, Switches
from benchmark.verification.checks import Comparison

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


@dataclass(frozen=True, slots=True)
class _Reading:
    """One way in which the set has every number.

    Attributes:
        stored: What its arrays' names begin with.
        switches: That lead to it.
        tolerance: Of its numbers.
    """

    stored: str
    switches: Switches
    tolerance: float


_READINGS: Final = {
    "as code": _Reading("code", CODE, CODE_TOLERANCE),
    "in double precision": _Reading("float64", replace(CODE, float32="paper"), TOLERANCE),
}


def compare_driving(comparison: Comparison, path: Path) -> None:
    """Compare all cases.

    Args:
        comparison: Takes the errors.
        path: ``vehicle.npz``.

    Raises:
        InputError: If the file cannot be used.
    """
    stored = NcapArrays.read(path)
    cases = len(stored.texts("name"))
    case = stored.integers("step_case", None)
    if not len(case) or (case < 0).any() or (case >= cases).any():
        raise InputError(f"{path}: step_case has no steps, or names cases that are not there; fetch the file again")
    plans = stored.plans("plan", stored.integers("plan_waypoints", len(case)).tolist())
    fragile = stored.floats("code_minus_float64_m", cases) > _LAST_BIT_M
    kept = np.r_[True, case[1:] != case[:-1]] | ~fragile[case]
    for called, reading in _READINGS.items():
        golden = _Golden(stored, reading.stored, len(plans))
        for number, step in enumerate(_driven(stored, case, plans, reading.switches)):
            if kept[number]:
                _compare_step(comparison, step, golden, number, called=called)
    names, starts = stored.texts("name"), stored.texts("initial", cases)
    left_out = [f"{names[index]} {starts[index]}" for index in np.flatnonzero(fragile)]
    if left_out:
        note = f"after their first step, {', '.join(left_out)} are decided by the last bit and left out"
        for called in _READINGS:
            comparison.note(f"car {called}: states of sub-steps", note)


def _driven(
    stored: NcapArrays, case: Integers, plans: list[Floats], switches: Switches
) -> Iterator[tuple[DrivenStep, int]]:
    """Every step in order, and the time at its end; a car goes on from step to step of its case."""
    car, cases = Car.of(switches), len(stored.texts("name"))
    poses, canbus = stored.floats("ego2world", cases, 4, 4), stored.floats("canbus", cases, CAN_COLUMNS)
    wheel, start = stored.floats("steering_wheel", cases), stored.integers("start_time", cases)
    vehicle: Vehicle | None = None
    time, last = 0, -1
    for which, plan in zip(case.tolist(), plans):
        if vehicle is None or which != last:
            row = canbus[which].astype(np.float32)
            vehicle, time = Vehicle.start(poses[which], row, float(wheel[which]), switches), int(start[which])
        step = driven(vehicle, plan, time, car, switches)
        vehicle, time, last = step.vehicle, time + STEP_US, which
        yield step, time


def _compare_step(
    comparison: Comparison, ours: tuple[DrivenStep, int], golden: "_Golden", number: int, *, called: str
) -> None:
    (step, time), reading, where = ours, _READINGS[called], f"step {number}"
    tolerance, vehicle = reading.tolerance, step.vehicle
    states = np.abs(step.states - golden.states[number])
    states[:, _HEADING] = np.abs(wrap_angle(step.states[:, _HEADING] - golden.states[number][:, _HEADING]))
    comparison.errors(f"car {called}: states of sub-steps", states, tolerance, where=where)
    for name, mine, theirs in (
        ("commands", step.commands, golden.commands[number]),
        ("commands before the limit", step.unlimited, golden.unlimited[number]),
        ("poses", vehicle.pose, golden.poses[number]),
    ):
        comparison.numbers(f"car {called}: {name}", mine, theirs, tolerance, where=where)
    row = vehicle.canbus(Car.of(reading.switches), reading.switches)
    speed = np.linalg.norm(row[13:15])
    for name, single, stored in (
        ("CAN rows", row, golden.canbus[number]),
        ("speeds", np.array([speed]), golden.speeds[number : number + 1]),
    ):
        beyond = beyond_single(np.asarray(single, np.float64), stored)
        comparison.errors(f"car {called}: {name}, beyond one step of single precision", beyond, tolerance, where=where)
    comparison.verdicts(f"car {called}: times", np.array([time != golden.times[number]]), where=where)


class _Golden:
    """Golden arrays of one reading, S steps."""

    def __init__(self, stored: NcapArrays, reading: str, steps: int) -> None:
        columns = stored.columns("state_columns", *STATE_COLUMNS)
        commands = stored.columns("command_columns", *COMMAND_COLUMNS)
        self.states = stored.floats(f"{reading}_substep_state", steps, SUBSTEPS, None)[..., columns]
        self.commands = stored.floats(f"{reading}_substep_command", steps, SUBSTEPS, None)[..., commands]
        self.unlimited = stored.floats(f"{reading}_substep_command_unclipped", steps, SUBSTEPS, None)[..., commands]
        self.poses = stored.floats(f"{reading}_step_pose", steps, 4, 4)
        self.canbus = stored.floats(f"{reading}_step_canbus", steps, CAN_COLUMNS)
        self.speeds = stored.floats(f"{reading}_step_speed", steps)
        self.times = stored.integers(f"{reading}_step_time", steps)
