"""Tests of the unit, frame, origin and time of plans: each compares them with the recording, as read and otherwise.

Plans are suspected only where another reading fits far better, for any planner: one that stands still, brakes or drives
straight through every bend passes. A test with too few samples says "not testable", which is not that plans fit.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.untrusted.files import Category


@dataclass(frozen=True, slots=True)
class ComparedPlans:
    """Plans and recordings of N samples with 3 s ahead: (N, 6, 2) metres of the lidar, x right, y forward."""

    plan: Floats
    recorded: Floats

    @classmethod
    def of(cls, plan: Floats, recorded: Floats) -> Self:
        """Those of (S, K, 2) plans whose (S, 6, 2) recording goes on for 3 s; it is NaN past its end."""
        complete = np.isfinite(recorded).all(axis=(1, 2))
        return cls(plan[complete, :PLAN_STEPS], recorded[complete])

    @classmethod
    def from_lists(cls, plan: list[Any], recorded: list[Any]) -> Self:
        """Plans and recording from lists; raises `ValueError` for other values."""
        shape = (-1, PLAN_STEPS, 2)
        compared = cls(np.array(plan, np.float64).reshape(shape), np.array(recorded, np.float64).reshape(shape))
        if compared.plan.shape != compared.recorded.shape:
            raise ValueError("plans and recordings must have the same number")
        return compared

    @classmethod
    def joined(cls, parts: "Iterable[ComparedPlans]") -> Self:
        """Plans of several scenes together; none of no scenes."""
        parts = [cls(np.empty((0, PLAN_STEPS, 2)), np.empty((0, PLAN_STEPS, 2))), *parts]
        return cls(np.concatenate([part.plan for part in parts]), np.concatenate([part.recorded for part in parts]))


FEWEST: Final = 10
FEWEST_STANDING: Final = 5
MOVED_M: Final = 3.0
BEGUN_M: Final = 0.5
ASIDE_M: Final = 2.0
STANDING_M: Final = 0.2
NOT_TESTABLE: Final = "not testable"
_BEGINS_AWAY: Final = 5.0
_SAME_PACE: Final = 0.5
_UNIT: Final = 10.0
_SUMMED: Final = 0.35
_DROVE_M: Final = 1e-3
"""Of a recorded car that did not move at all nothing can be said to grow."""
_SECOND_STEP: Final = 0.6
"""Offsets of a car that drives on have a second step like the first; a car that brakes still gets ahead in it."""
_HERE: Final = 0.2
_ONE_STEP_ON: Final = 0.5
_POINTS_A_STEP: Final = 5
"""Points at 10 Hz in the 0.5 s of a step."""
_FAR_OFF: Final = 0.5
_AT_10_HZ: Final = 0.2
_GOES_ON: Final = 0.5
_TURNED: Final = 0.8
_MIRRORED: Final = 0.5
_ORIGIN_M: Final = 0.5
_ONE_POINT: Final = 0.25

FrameName = Literal["lidar", "ego"]


@dataclass(frozen=True, slots=True)
class Misreading:
    """Another reading that fits plans far better; ``sentence`` has no full stop at its end.

    ``frame`` is the one in which the file or planner is read right, where that is all that is wrong.
    """

    category: Category
    sentence: str
    frame: FrameName | None = None


@dataclass(frozen=True, slots=True)
class Plausibility:
    """What each test measured on how many samples, or that it is not testable, and the first misreading, if any."""

    measured: dict[str, str]
    misreading: Misreading | None


TestFinding = str | Misreading
"""Result of a test: its measure, or the reading that fits better."""


def measure_plausibility(compared: ComparedPlans) -> Plausibility:
    """Measure plans against the recording."""
    # Plans may be as large as numbers get: squares of those are infinite, and no reading of such plans fits.
    with np.errstate(over="ignore", invalid="ignore"):
        findings = {name: test(_PlanSteps.of(compared)) for name, test in TESTS.items()}
    misreadings = (finding for finding in findings.values() if isinstance(finding, Misreading))
    measured = {
        name: finding.sentence if isinstance(finding, Misreading) else finding for name, finding in findings.items()
    }
    return Plausibility(measured, next(misreadings, None))


@dataclass(frozen=True, slots=True)
class _PlanSteps:
    """Plans (N, 6, 2) and recordings in metres, with what every test needs of them.

    ``size`` and ``gone`` are (N, 6) distances of planned and recorded positions from the present one; ``moved``: (N,)
    whether the recorded ego moves more than 3 m in 3 s.
    """

    plan: Floats
    recorded: Floats
    size: Floats
    gone: Floats
    moved: Bools

    @classmethod
    def of(cls, compared: ComparedPlans) -> "_PlanSteps":
        """Of plans."""
        size, recorded_distance = (np.linalg.norm(points, axis=2) for points in (compared.plan, compared.recorded))
        return cls(compared.plan, compared.recorded, size, recorded_distance, recorded_distance[:, -1] > MOVED_M)

    def misfit(self, plan: Floats, chosen: Bools) -> float:
        """Median over chosen samples of the mean distance from the recording, as a share of the way in 3 s."""
        away = np.linalg.norm(plan[chosen] - self.recorded[chosen], axis=2).mean(axis=1)
        return float(np.median(away / np.maximum(self.gone[chosen, -1], BEGUN_M)))


def _too_few(chosen: Bools, fewest: int) -> str | None:
    count = int(chosen.sum())
    return f"{NOT_TESTABLE} ({count} of {fewest} samples)" if count < fewest else None


def _check_position(steps: _PlanSteps) -> TestFinding:
    """Whether plans begin anywhere else and then move as the recorded car."""
    chosen = steps.moved
    if few := _too_few(chosen, FEWEST):
        return few
    begins = float(np.median(steps.size[chosen, 0] / np.maximum(steps.gone[chosen, 0], 1.0)))
    pace, recorded = (
        np.linalg.norm(np.diff(points[chosen], axis=1), axis=2) for points in (steps.plan, steps.recorded)
    )
    off = float(np.median(np.abs(pace - recorded).mean(axis=1) / np.maximum(recorded.mean(axis=1), 0.1)))
    if begins > _BEGINS_AWAY and off < _SAME_PACE:
        away_m = float(np.median(steps.size[chosen, 0]))
        return Misreading(
            "frame",
            f"its plans begin {away_m:.0f} m away and then move as the recorded car does: global coordinates would fit "
            f"(as read {steps.misfit(steps.plan, chosen):.3g}, from one waypoint to the next {off:.2f})",
        )
    return f"plans begin {begins:.2f} times as far away as the recorded car gets in 0.5 s ({int(chosen.sum())} samples)"


def _check_unit(steps: _PlanSteps) -> TestFinding:
    """Whether plans go many times as far as the recorded car."""
    chosen = steps.moved
    if few := _too_few(chosen, FEWEST):
        return few
    ratio = float(np.median(steps.size[chosen, -1] / steps.gone[chosen, -1]))
    if ratio > _UNIT:
        fits = "not metres"
        for name, scale in {"centimetres": 0.01, "millimetres": 0.001}.items():
            if 0.5 < ratio * scale < (2.0 if name == "centimetres" else np.inf):
                read, scaled = steps.misfit(steps.plan, chosen), steps.misfit(scale * steps.plan, chosen)
                fits = f"{name} would fit (as read {read:.3g}, in {name} {scaled:.2f})"
        return Misreading("unit", f"its plans go {ratio:.3g} times as far in 3 s as the recorded car: {fits}")
    return f"plans go {ratio:.2f} times as far as recorded ({int(chosen.sum())} samples)"


def _check_offsets(steps: _PlanSteps) -> TestFinding:
    """Whether waypoints are steps from one to the next."""
    size, recorded_distance, begun = steps.size, steps.gone, steps.size[:, 0] > BEGUN_M
    drove = begun & (recorded_distance[:, 0] > _DROVE_M)
    if few := _too_few(begun, FEWEST) or _too_few(drove, 1):
        return few
    last, second = (
        float(
            np.median(size[begun, step] / size[begun, 0])
            / np.median(recorded_distance[drove, step] / recorded_distance[drove, 0])
        )
        for step in (-1, 1)
    )
    read, summed = (steps.misfit(plan, drove) for plan in (steps.plan, np.cumsum(steps.plan, axis=1)))
    if last < _SUMMED and second < _SECOND_STEP and summed < read:
        return Misreading(
            "offsets",
            f"its plans grow {last:.2f} times as much from 0.5 s to 3 s as the recorded paths: offsets that were not "
            f"summed would fit (1/6; as read {read:.2f}, summed {summed:.2f})",
        )
    return f"plans grow {last:.2f} times as much as recorded ({int(begun.sum())} samples)"


def _check_delay(steps: _PlanSteps) -> TestFinding:
    """Whether the first waypoint is the present place."""
    chosen = steps.moved & (steps.gone[:, 0] > BEGUN_M)
    if few := _too_few(chosen, FEWEST):
        return few
    first_step_ratio = float(np.median(steps.size[chosen, 0] / steps.gone[chosen, 0]))
    second = np.linalg.norm(steps.plan[chosen, 1] - steps.recorded[chosen, 0], axis=1)
    late = float(np.median(second / steps.gone[chosen, 0]))
    if first_step_ratio < _HERE and late < _ONE_STEP_ON:
        read = float(np.median(np.linalg.norm(steps.plan - steps.recorded, axis=2)[chosen, 0] / steps.gone[chosen, 0]))
        return Misreading(
            "time",
            "its plans are one step late, the first waypoint is the present place: waypoints 0.5 s later would fit "
            f"(as read {read:.2f}, one step on {late:.2f}; error of the first step)",
        )
    return f"the first waypoint is {first_step_ratio:.2f} of the first recorded step ({int(chosen.sum())} samples)"


def _check_rate(steps: _PlanSteps) -> TestFinding:
    """Whether waypoints are 0.1 s apart."""
    chosen = steps.moved & (steps.gone[:, 0] > BEGUN_M)
    if few := _too_few(chosen, FEWEST):
        return few
    first, scale = steps.recorded[chosen, 0], steps.gone[chosen, 0]
    read = float(np.median(np.linalg.norm(steps.plan[chosen, 0] - first, axis=1) / scale))
    shares = np.arange(1, _POINTS_A_STEP + 1) / _POINTS_A_STEP
    between = np.linalg.norm(steps.plan[chosen, :_POINTS_A_STEP] - shares[:, None] * first[:, None], axis=2)
    fast = float(np.median(between.mean(axis=1) / scale))
    # A car that brakes hard covers the same distance, but hardly moves at the end.
    last_step = np.linalg.norm(steps.plan[chosen, -1] - steps.plan[chosen, -2], axis=1)
    goes_on = float(np.median(last_step / np.maximum(steps.size[chosen, 0], _DROVE_M)))
    if read > _FAR_OFF and fast < _AT_10_HZ and goes_on > _GOES_ON:
        return Misreading(
            "time",
            f"its plans cover a fifth of the recorded distance: points at 10 Hz would fit (as read {read:.2f}, 0.1 s "
            f"apart {fast:.2f}; error of the first 0.5 s)",
        )
    return f"as read {read:.2f}, 0.1 s apart {fast:.2f} ({int(chosen.sum())} samples)"


def _check_axes(steps: _PlanSteps) -> TestFinding:
    """Whether x and y are others."""
    chosen = steps.moved
    if few := _too_few(chosen, FEWEST):
        return few
    first, way = steps.plan[chosen, 0], steps.recorded[chosen, 0]
    scale = np.maximum(np.linalg.norm(way, axis=1), 0.5)

    def error(turned: Floats) -> float:
        return float(np.median(np.linalg.norm(turned - way, axis=1) / scale))

    x, y = first[:, 0], first[:, 1]
    turns: tuple[tuple[str, Floats, FrameName | None], ...] = (
        ("x and y look exchanged", np.stack([-y, x], axis=1), "ego"),
        ("x and y look exchanged and turned", np.stack([y, -x], axis=1), "lidar"),
        ("x and y look turned about", -first, None),
    )
    as_read = error(first)
    best, name, frame = min(((error(turned), name, frame) for name, turned, frame in turns), key=lambda turn: turn[0])
    if best < _TURNED * as_read:
        axes = {"ego": ": axes x forward, y left would fit", "lidar": ": axes x right, y forward would fit"}
        axes_text = "" if frame is None else axes[frame]
        return Misreading(
            "frame", f"{name}: as read {as_read:.2f}, turned {best:.2f} (error of the first step){axes_text}", frame
        )
    return f"as read {as_read:.2f}, best turned {best:.2f} ({int(chosen.sum())} samples)"


def _check_mirror(steps: _PlanSteps) -> TestFinding:
    """Whether left is right."""
    aside = np.abs(steps.recorded[:, -1, 0]) >= ASIDE_M
    if few := _too_few(aside, FEWEST):
        return few
    ours, way = steps.plan[aside, -1, 0], steps.recorded[aside, -1, 0]
    as_read, mirrored = float(np.median(np.abs(ours - way))), float(np.median(np.abs(-ours - way)))
    if mirrored < _MIRRORED * as_read:
        return Misreading("frame", f"left and right look exchanged: as read {as_read:.2f} m, mirrored {mirrored:.2f} m")
    return f"as read {as_read:.2f} m, mirrored {mirrored:.2f} m ({int(aside.sum())} samples)"


def _check_origin(steps: _PlanSteps) -> TestFinding:
    """Whether positions are of another point of the car."""
    standing = steps.gone.max(axis=1, initial=0.0) < STANDING_M
    standing &= np.linalg.norm(steps.plan[:, -1] - steps.plan[:, 0], axis=1) < BEGUN_M
    if few := _too_few(standing, FEWEST_STANDING):
        return few
    begins = steps.plan[standing, 0]
    away_m = float(np.median(np.linalg.norm(begins, axis=1)))
    # The offset to another point of the car is equal for all plans; a planner's errors are not.
    differ_m = float(np.median(np.linalg.norm(begins - np.median(begins, axis=0), axis=1)))
    if away_m > _ORIGIN_M and differ_m < _ONE_POINT * away_m:
        return Misreading(
            "origin",
            f"plans of a stationary car begin {away_m:.2f} m away: positions measured from another point of the car "
            "would fit (lidar and rear axle are 0.94 m apart)",
        )
    return f"plans of a stationary car begin {away_m:.2f} m away ({int(standing.sum())} samples)"


TESTS: Final[dict[str, Callable[[_PlanSteps], TestFinding]]] = {
    "position": _check_position,
    "unit": _check_unit,
    "offsets": _check_offsets,
    "delay": _check_delay,
    "rate": _check_rate,
    "axes": _check_axes,
    "mirror": _check_mirror,
    "origin": _check_origin,
}
"""By name, in the order in which the first that finds something is believed."""
