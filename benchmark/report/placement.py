"""Where things of a sheet and plans of run records are: everything in the sheet's own metres."""

from dataclasses import dataclass

import numpy as np

from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Floats, ego_footprints, to_global, wrap_angle
from benchmark.protocols.exact import INSTANTS_PER_STEP, compute_plan_boxes
from benchmark.records.row_schema import SampleRow
from benchmark.records.scene_pages import PageAgent, ScenePage
from benchmark.waypoints import points_in_lidar, waypoints_in_lidar


@dataclass(frozen=True, slots=True)
class PlacedForecasts:
    """Motion that a planner expects of others: (A, 5) present boxes, (A, 6, 2) centres in the most likely mode."""

    boxes: Floats
    paths: Floats


@dataclass(frozen=True, slots=True)
class PlacedPlan:
    """A plan: (6, 2) waypoints of the lidar origin, and (M, 6, 2) other modes, those that are the plan itself left out.

    ``footprints`` (30, 5) are the ego's rectangle at 0.1, 0.2, ... 3.0 s, as ``exact`` compares it, ``start`` (5,) that
    at the sample.
    """

    waypoints: Floats
    footprints: Floats
    start: Floats
    modes: Floats
    forecasts: PlacedForecasts | None

    @property
    def at_waypoints(self) -> Floats:
        """(6, 5) the footprints at the waypoints alone."""
        return self.footprints[INSTANTS_PER_STEP - 1 :: INSTANTS_PER_STEP]


def ego_pose(sheet: ScenePage, frame: int) -> Floats:
    """(3,) x, y, yaw of the recorded rear axle."""
    return np.array([sheet.ego.x_m[frame], sheet.ego.y_m[frame], sheet.ego.yaw_rad[frame]])


def ego_box(sheet: ScenePage, frame: int) -> Floats:
    """(5,) the recorded body of the ego."""
    x, y, yaw = ego_pose(sheet, frame)
    ahead = sheet.ego.centre_ahead_m
    return np.array([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), sheet.ego.length_m, sheet.ego.width_m, yaw])


def agent_box(agent: PageAgent, frame: int) -> Floats | None:
    """(5,) the box of an object, or ``None`` where it is not there."""
    place = frame - agent.first
    if not 0 <= place < len(agent.x_m):
        return None
    x, y, yaw = agent.x_m[place], agent.y_m[place], agent.yaw_rad[place]
    if x is None or y is None or yaw is None:
        return None
    return np.array([x, y, agent.size_m[0], agent.size_m[1], yaw])


def agent_box_at(sheet: ScenePage, agent: PageAgent, seconds: float) -> Floats | None:
    """(5,) box of an object in seconds since the first frame, ``None`` if missing at the frame before or after."""
    times = frame_seconds(sheet)
    if not times[0] <= seconds <= times[-1] + 1e-6:
        return None
    after = min(int(np.searchsorted(times, seconds - 1e-6)), len(times) - 1)
    before = max(after - 1, 0)
    first, second = agent_box(agent, before), agent_box(agent, after)
    if second is None or first is None or after == before:
        return second if abs(times[after] - seconds) < 1e-6 else None
    share = (seconds - times[before]) / (times[after] - times[before])
    step = second - first
    step[4] = wrap_angle(step[4])
    return np.asarray(first + share * step)


def frame_seconds(sheet: ScenePage) -> Floats:
    """(T,) time of each frame since the first, seconds."""
    return (np.array(sheet.timestamps_us, np.int64) - sheet.timestamps_us[0]) / 1e6


def place_plan(row: SampleRow, axle: Floats) -> PlacedPlan | None:
    """Put a stored plan at the (3,) pose of the rear axle at its sample, ``None`` where the planner failed."""
    if row.plan is None:
        return None
    plan, ahead = row.plan, row.lidar_ahead_m
    lidar = place_lidar(axle, ahead)
    try:
        judged = np.array(plan.waypoints[:PLAN_STEPS], np.float64).reshape(PLAN_STEPS, 2)
        waypoints = waypoints_in_lidar(judged, plan.frame, ahead)
        modes = np.array([mode[:PLAN_STEPS] for mode in plan.modes or []], np.float64).reshape(-1, PLAN_STEPS, 2)
        forecasts = None if plan.forecasts is None else _forecasts(row, lidar)
    except (ValueError, IndexError) as error:
        raise InputError(
            f"the plan of {row.scene} at sample {row.index} has lists of the wrong lengths ({error}); run "
            "challenger-bench eval again"
        ) from error
    modes = waypoints_in_lidar(modes, plan.frame, ahead) if len(modes) else modes
    other = np.abs(modes - waypoints).max(axis=(1, 2)) > 0.05
    return PlacedPlan(
        waypoints=to_global(waypoints, lidar),
        footprints=_boxes_of(compute_plan_boxes(waypoints), lidar),
        start=_boxes_of(ego_footprints(np.array([0.0, 0.0, np.pi / 2])), lidar),
        modes=to_global(modes[other], lidar),
        forecasts=forecasts,
    )


def place_waypoints(waypoints: Floats, frame: str, ahead_m: float, axle: Floats) -> PlacedPlan | None:
    """Put (N, 2) waypoints of frame ``lidar`` or ``ego`` where they were planned, to 3 s, without modes and forecasts.

    ``None`` where they are shorter. ``axle`` is the (3,) pose of the rear axle, ``ahead_m`` the lidar origin ahead of
    it.
    """
    if len(waypoints) < PLAN_STEPS:
        return None
    lidar = place_lidar(axle, ahead_m)
    judged = waypoints_in_lidar(np.asarray(waypoints[:PLAN_STEPS], np.float64), frame, ahead_m)
    return PlacedPlan(
        waypoints=to_global(judged, lidar),
        footprints=_boxes_of(compute_plan_boxes(judged), lidar),
        start=_boxes_of(ego_footprints(np.array([0.0, 0.0, np.pi / 2])), lidar),
        modes=np.empty((0, PLAN_STEPS, 2)),
        forecasts=None,
    )


def place_lidar(axle: Floats, ahead_m: float) -> Floats:
    """(3,) pose of the lidar at a (3,) pose of the rear axle."""
    heading = np.array([np.cos(axle[2]), np.sin(axle[2])])
    # The lidar frame's first axis points to the right.
    return np.array([*(axle[:2] + ahead_m * heading), axle[2] - np.pi / 2])


def _forecasts(row: SampleRow, lidar: Floats) -> PlacedForecasts:
    assert row.plan is not None and row.plan.forecasts is not None
    given = row.plan.forecasts
    boxes = np.array(given.boxes, np.float64).reshape(-1, 5)
    likeliest = [modes[int(np.argmax(scores))] for modes, scores in zip(given.trajectories, given.scores, strict=True)]
    paths = np.array(likeliest, np.float64).reshape(len(boxes), PLAN_STEPS, 2)
    if row.plan.frame == "ego":
        boxes = np.column_stack(
            [points_in_lidar(boxes[:, :2], row.lidar_ahead_m), boxes[:, 2:4], boxes[:, 4] + np.pi / 2]
        )
        paths = points_in_lidar(paths, row.lidar_ahead_m)
    return PlacedForecasts(_boxes_of(boxes, lidar), to_global(paths, lidar))


def _boxes_of(boxes: Floats, frame_pose: Floats) -> Floats:
    """Boxes (..., 5) of a frame in the metres of its pose."""
    return np.concatenate(
        [to_global(boxes[..., :2], frame_pose), boxes[..., 2:4], boxes[..., 4:] + frame_pose[2]], axis=-1
    )


def find_plan_instant(seconds: float) -> int:
    """Which footprint of a `PlacedPlan` is that of a time after the sample; the nearest one."""
    last = PLAN_STEPS * INSTANTS_PER_STEP
    return min(max(round(seconds * INSTANTS_PER_STEP / PLAN_STEP_S), 1), last) - 1
