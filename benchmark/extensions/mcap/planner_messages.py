"""What planners did, on a scene's timeline: plans with their verdicts by ``exact``, and drives."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from benchmark.constants import EGO_HEIGHT_M, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.extensions.mcap.timeline import MAP, Primitives, Timeline
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.machine.storage import sanitise_file_name
from benchmark.records.drive_schema import EpisodeRow, ScoredContact
from benchmark.records.fault import blames_ego
from benchmark.records.row_schema import OutcomeRow, SampleRow
from benchmark.report.fault_words import describe_fault
from benchmark.report.palette import CONTACT, EGO
from benchmark.report.placement import PlacedPlan, place_lidar, place_plan, place_waypoints
from benchmark.scene import Scene

JUDGE: Final = "exact"
_HORIZONS: Final = (2, 4, 6)
"""Steps of half a second until 1, 2 and 3 s."""
_SHOWN_S: Final = 0.5
_POSES: Final = {"step_s": "0.5", "poses": "lidar origin now, then at 0.5, 1.0, ... 3.0 s"}
_THREES: Final = {"type": "array", "minItems": 3, "maxItems": 3}
VERDICT: Final[dict[str, Any]] = {
    "title": "challenger.Verdict",
    "type": "object",
    "properties": {
        "planner": {"type": "string"},
        "protocol": {"type": "string"},
        "version": {"type": "integer"},
        "collision": {**_THREES, "items": {"type": ["boolean", "null"]}},
        "l2": {**_THREES, "items": {"type": ["number", "null"]}},
        "gap_m": {"type": ["number", "null"]},
        "failed": {"type": "boolean"},
    },
    "required": ["planner", "protocol", "version", "collision", "l2", "gap_m", "failed"],
}
STEP: Final[dict[str, Any]] = {
    "title": "challenger.Step",
    "type": "object",
    "properties": {
        "planner": {"type": "string"},
        **{name: {"type": "number"} for name in ("speed", "acceleration", "yaw_rate", "wheel_angle")},
    },
    "required": ["planner", "speed", "acceleration", "yaw_rate", "wheel_angle"],
}


def add_plans(
    timeline: Timeline, make: Primitives, scene: Scene, planner: str, rows: Sequence[SampleRow], version: int
) -> None:
    """Plans of one planner: poses, a line that shows contact, verdicts as numbers, and events."""
    name = sanitise_file_name(planner)
    topic, marks, verdict = f"/plan/{name}", f"/plan/{name}/marks", f"/verdict/{name}"
    timeline.metadata[topic] = {"planner": planner, **_POSES}
    timeline.schemas[verdict] = VERDICT
    for row in rows:
        frame = _find_frame(scene, row)
        outcome = row.outcomes.get(JUDGE)
        _add_events(timeline, make, planner, row)
        timeline.add(row.timestamp_us, verdict, describe_verdict(planner, version, row, outcome))
        height = float(scene.ego.position[frame, 2])
        placed = place_plan(row, scene.ego.pose[frame])
        if placed is None:
            words = make.text(f"{planner}: failed", scene.ego.position[frame] + [0, 0, 3.0], make.colour(CONTACT))
            timeline.add(row.timestamp_us, marks, _briefly(make, row.timestamp_us, texts=[words]))
            continue
        start = place_lidar(scene.ego.pose[frame], row.lidar_ahead_m)[:2]
        timeline.add(row.timestamp_us, topic, _make_poses(make, row.timestamp_us, placed, start, height))
        points = np.column_stack([np.vstack([start, placed.waypoints]), np.full(PLAN_STEPS + 1, height)])
        step = _find_first(outcome)
        colour = make.colour(EGO if step is None else CONTACT)
        parts = {"lines": [make.line(points, colour, 0.25)]}
        if step is not None:
            x, y, length, width, yaw = placed.at_waypoints[step]
            pose = make.planar_pose(x, y, height + EGO_HEIGHT_M / 2, yaw)
            parts["cubes"] = [make.cube(pose, np.array([length, width, EGO_HEIGHT_M]), make.colour(CONTACT, 0.5))]
            words = f"{planner}: collides in {0.5 * (step + 1):.1f} s"
            parts["texts"] = [make.text(words, np.array([x, y, height + 3.0]), colour)]
        timeline.add(row.timestamp_us, marks, _briefly(make, row.timestamp_us, **parts))


def _briefly(make: Primitives, time_us: int, **parts: Any) -> Any:
    lifetime = make.messages.Duration(0, int(_SHOWN_S * 1e9))
    return make.update([make.entity(time_us, "plan", lifetime=lifetime, **parts)])


def _make_poses(make: Primitives, time_us: int, plan: PlacedPlan, start: Floats, height: float) -> Any:
    """The lidar origin now, at (2,) ``start``, and at the waypoints, headed as ``exact`` turns the body there."""
    points = np.vstack([start, plan.waypoints])
    yaws = [plan.start[4], *plan.at_waypoints[:, 4]]
    poses = [make.planar_pose(x, y, height, yaw) for (x, y), yaw in zip(points, yaws, strict=True)]
    return make.messages.PosesInFrame(timestamp=make.time(time_us), frame_id=MAP, poses=poses)


def _find_frame(scene: Scene, row: SampleRow) -> int:
    if 0 <= row.index < len(scene.keyframes):
        frame = int(scene.keyframes[row.index])
        if int(scene.timestamps_us[frame]) == row.timestamp_us:
            return frame
    raise InputError(
        f"a record has sample {row.index} of {scene.name} at another time than the data set: it is of another; "
        "choose the right ROOT or --out"
    )


def _find_first(outcome: OutcomeRow | None) -> int | None:
    """Index of the first step that touches something."""
    return next((step for step, hit in enumerate((outcome and outcome.collision) or ()) if hit), None)


def describe_verdict(planner: str, version: int, row: SampleRow, outcome: OutcomeRow | None) -> dict[str, Any]:
    """What ``exact`` says of a sample, as `VERDICT` has it; contacts and distances at 1, 2 and 3 s."""
    hit = None if outcome is None else outcome.collision
    severity = row.severity
    near = None if severity is None else severity.near
    gap = None if severity is None else 0.0 if severity.contact is not None else near and near.least_gap_m
    return {
        "planner": planner,
        "protocol": JUDGE,
        "version": version,
        "collision": [None if hit is None else any(hit[:steps]) for steps in _HORIZONS],
        "l2": [None if outcome is None else outcome.l2[steps - 1] for steps in _HORIZONS],
        "gap_m": gap,
        "failed": row.status == "failed",
    }


def _add_events(timeline: Timeline, make: Primitives, planner: str, row: SampleRow) -> None:
    time_us = row.timestamp_us
    if row.status == "failed":
        timeline.add(time_us, "/log", make.log(time_us, "Error", f"{planner} failed", JUDGE))
    if row.severity is None:
        return
    contact, near = row.severity.contact, row.severity.near
    if contact is not None:
        whom = "the adversary" if contact.adversary else "another"
        kind = f"{contact.kind}, {describe_fault(contact)}"
        words = f"{planner}: plan touches {whom} in {contact.time_s:.1f} s ({kind}; {contact.agent})"
        level = "Warning" if blames_ego(contact.fault) is False else "Error"
        timeline.add(time_us, "/log", make.log(time_us, level, words, JUDGE))
    elif near is not None and near.tet_s > 0:
        words = f"{planner}: near miss, {near.least_gap_m:.1f} m from the adversary"
        timeline.add(time_us, "/log", make.log(time_us, "Warning", words, JUDGE))


def add_drive(timeline: Timeline, make: Primitives, scene: Scene, planner: str, row: EpisodeRow, world: str) -> None:
    """One drive: where the planner's ego was, its body, state and plans, and what it touched."""
    name = "/".join([sanitise_file_name(planner), *filter(None, [row.family, str(row.run or "")])])
    topic, steps, frame = f"/drive/{name}", f"/drive/{name}/state", f"ego/{name}"
    timeline.schemas[steps] = STEP
    timeline.metadata[topic] = {"planner": planner, "measured": world}
    if not row.ticks.time_us:
        return
    heights = np.interp(row.ticks.time_us, scene.timestamps_us, scene.ego.position[:, 2])
    for time_us, state, height in zip(row.ticks.time_us, row.ticks.ego, heights, strict=True):
        x, y, yaw, speed, acceleration, yaw_rate, angle = state
        pose = make.planar_pose(x, y, height, yaw)
        sent = make.messages.PoseInFrame(timestamp=make.time(time_us), frame_id=MAP, pose=pose)
        timeline.add(time_us, topic, sent)
        moved = make.transform(time_us, MAP, frame, np.array([x, y, height]), quaternion_from_yaw(np.array(yaw)))
        timeline.add(time_us, "/tf", make.messages.FrameTransforms(transforms=[moved]))
        state_now = {"speed": speed, "acceleration": acceleration, "yaw_rate": yaw_rate, "wheel_angle": angle}
        timeline.add(time_us, steps, {"planner": planner, **state_now})
    first, last = row.ticks.time_us[0], row.ticks.time_us[-1]
    timeline.add(first, f"{topic}/body", make.ego_body(first, frame, EGO, 0.5))
    _add_driven_plans(timeline, make, scene, f"{topic}/plan", planner, row)
    begin = row.ticks.time_us[row.primed - 1] if len(row.ticks.time_us) >= row.primed else first
    for contact in (*row.passed, *([row.contact] if row.contact is not None else [])):
        at = begin + round(1e6 * contact.seconds)
        level, words = _describe_contact(planner, contact)
        timeline.add(at, "/log", make.log(at, level, words, "drive"))
    if row.failure is not None:
        timeline.add(last, "/log", make.log(last, "Error", f"{planner} failed: {row.failure.reason}", "drive"))


def _add_driven_plans(
    timeline: Timeline, make: Primitives, scene: Scene, topic: str, planner: str, row: EpisodeRow
) -> None:
    """The plan of each planning instant of a drive; those that are shorter than 3 s are left out."""
    timeline.metadata[topic] = {"planner": planner, **_POSES}
    ahead_m = float(scene.lidar.translation[0])
    heights = np.interp(row.ticks.time_us, scene.timestamps_us, scene.ego.position[:, 2])
    # A failed drive has an instant without a plan.
    instants = zip(row.ticks.time_us, row.ticks.ego, heights, row.plans, strict=False)
    for index, (time_us, state, height, plan) in enumerate(instants):
        axle = np.array(state[:3])
        try:
            waypoints = np.array(plan.waypoints, np.float64).reshape(len(plan.waypoints), 2)
        except ValueError as error:
            raise InputError(
                f"plan {index} of a drive of {row.scene} by {planner!r} is no list of x and y ({error}); run "
                "challenger-bench drive again"
            ) from error
        placed = place_waypoints(waypoints, plan.frame, ahead_m, axle)
        if placed is not None:
            start = place_lidar(axle, ahead_m)[:2]
            timeline.add(time_us, topic, _make_poses(make, time_us, placed, start, height))


def _describe_contact(planner: str, contact: ScoredContact) -> tuple[str, str]:
    whom = "the adversary" if contact.adversary else contact.category
    kind = f"{contact.kind}, {describe_fault(contact)}"
    words = f"{planner} touches {whom} ({kind}, {contact.impact_speed:.1f} m/s; {contact.agent})"
    return "Error" if blames_ego(contact.fault) else "Warning", words
