"""Submitted plans beside the recorded future that their planner must not have seen (`benchmark.metrics.leaks`)."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.closed_loop.courses import recorded_poses
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.extensions.submissions.findings import Level, Said
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.metrics.leaks import LeakFigures, Moment, leak_figures
from benchmark.planning import Plan, PlanFrame
from benchmark.protocols import protocol
from benchmark.records.drive_schema import DriveRow
from benchmark.records.drives import DriveRecord
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord
from benchmark.runs.judging import plan_of
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_FORWARD: Final = np.array([0.0, 1.0])
"""Of the lidar's frame."""
NEAR_M: Final = 0.5
"""A driven car that is no farther from where the recorded one was then may be compared with its future."""
NEAR_RAD: Final = 0.17
"""The same of its heading."""
_PLANNED_US: Final = round(1e6 * PLAN_STEP_S) * np.arange(1, PLAN_STEPS + 1)
_BEFORE_US: Final = round(1e6 * PLAN_STEP_S) * np.array([-2, -1, 0])


def leak_findings(record: RunRecord | DriveRecord, data: "DataSet") -> Iterator[Said]:
    """Signs that plans knew the recorded future, one finding at most; none of privileged planners."""
    facts = record.run if isinstance(record, RunRecord) else record.facts
    if facts.planner.privileged:
        return
    if said := figures_of(record, data).suspicions:
        yield (
            Level.SUSPICIOUS,
            f"{'; '.join(said)}. It proves nothing: ask how it plans (docs/extensions/submissions.md)",
        )


def figures_of(record: RunRecord | DriveRecord, data: "DataSet") -> LeakFigures:
    """Figures that compare the plans of a record with the recorded future."""
    if isinstance(record, DriveRecord):
        return leak_figures([each for row in record.rows for each in _moments_of_drive(row, data.scene(row.scene))])
    scenes = groupby(record.rows, key=lambda row: row.scene)
    return leak_figures(
        [each for name, rows in scenes for each in moments_of_run(list(rows), data.truth(name)).values()]
    )


def moments_of_run(rows: Sequence[SampleRow], truths: Sequence[SampleTruth]) -> dict[int, Moment]:
    """Moments of one scene of a run, by number: a plan, a recorded second before and 3 s after."""
    steps = [None if row.recorded_future[0] is None else np.array(row.recorded_future[0][:2], float) for row in rows]
    speeds: dict[int, tuple[float, float]] = {}
    for index, row in enumerate(rows):
        before, now = (steps[index - 2], steps[index - 1]) if index >= 2 else (None, None)
        # Speeds and what is planned are compared at steps of half a second.
        regular = all(truth.timed is None for truth in truths[max(index - 2, 0) : index + 1])
        if row.plan is not None and row.complete and before is not None and now is not None and regular:
            speeds[index] = (float(np.hypot(*before)) / PLAN_STEP_S, float(np.hypot(*now)) / PLAN_STEP_S)
    dangerous = _dangerous([truths[index] for index in speeds], [now for _, now in speeds.values()])
    found = {}
    for (index, speed), danger in zip(speeds.items(), dangerous):
        row = rows[index]
        assert row.plan is not None, "chosen above"
        planned = plan_of(row.plan.model_dump()).judged.waypoints_in_lidar(row.lidar_ahead_m)
        recorded = np.array(row.recorded_future, float)[:, :2]
        found[index] = Moment(planned, recorded, _FORWARD, speed, bool(danger))
    return found


def _dangerous(truths: Sequence[SampleTruth], speeds: Sequence[float]) -> Bools:
    """(N,) whether a car that keeps its speed and direction touches an object within 3 s."""
    if not truths:
        return np.zeros(0, bool)
    times = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
    kept = np.array(speeds)[:, None, None] * times[:, None] * _FORWARD
    return np.asarray(protocol("exact").evaluate(truths, kept).collision.any(axis=1))


def _moments_of_drive(row: DriveRow, scene: Scene) -> list[Moment]:
    """Instants of a drive at which the car was where the recorded one was, long enough before the recording ends.

    None of them counts as dangerous: the actions of others in a drive depend on the drive.
    """
    found = []
    times = np.array(row.ticks.time_us[row.primed :], np.int64)
    first, last = int(scene.timestamps_us[0]), int(scene.timestamps_us[-1])
    ahead_m = float(scene.lidar.translation[0])
    for time, state, plan in zip(times, row.ticks.ego[row.primed :], row.plans[row.primed :]):
        if time + _PLANNED_US[-1] > last or time + _BEFORE_US[0] < first:
            continue
        pose = np.array(state[:3])
        poses = recorded_poses(scene, time + np.concatenate([_BEFORE_US, _PLANNED_US]))
        now = poses[len(_BEFORE_US) - 1]
        if np.hypot(*(pose - now)[:2]) > NEAR_M or abs(float(wrap_angle(pose[2] - now[2]))) > NEAR_RAD:
            continue
        before, speed = np.hypot(*np.diff(poses[: len(_BEFORE_US), :2], axis=0).T) / PLAN_STEP_S
        planned = Plan(np.array(plan.waypoints, np.float64), PlanFrame(plan.frame)).judged.waypoints_in_lidar(ahead_m)
        recorded = _lidar_of(poses[len(_BEFORE_US) :], pose, ahead_m)
        found.append(Moment(planned, recorded, _FORWARD, (float(before), float(speed)), False))
    return found


def _lidar_of(poses: Floats, seen_from: Floats, ahead_m: float) -> Floats:
    """(N, 2) the lidar's origin at poses of the rear axle, in the lidar's frame (x right, y forward) at one of them."""
    heading = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    local = to_local(poses[:, :2] + ahead_m * heading, seen_from)
    return np.stack([-local[:, 1], local[:, 0] - ahead_m], axis=1)
