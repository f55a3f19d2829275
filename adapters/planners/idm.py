"""``idm``: follows its lane and keeps distance by the intelligent-driver model (`benchmark.dynamics.idm`).

Privileged: sees the map and all boxes, but not the future, traffic lights or right of way. Its forecasts, one mode
each, make its collisions diagnosable; they include those behind, which it expects to drive on and does not plan for.
"""

from dataclasses import asdict, dataclass

import numpy as np

from benchmark.constants import (
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_LENGTH_M,
    EGO_WIDTH_M,
    PLAN_STEP_S,
    PLAN_STEPS,
)
from benchmark.dynamics.idm import DriverParameters, idm_acceleration
from benchmark.dynamics.lane_path import LanePath, build_lane_path, build_straight_path
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.planning import Forecasts, Observation, Plan, PlanFrame, SceneInfo
from benchmark.scene import Scene

_CROSSING_RAD = np.deg2rad(40.0)
_ONCOMING_RAD = np.deg2rad(135.0)


@dataclass(frozen=True, slots=True)
class Obstacles:
    """Others along a path at each of K instants, all (A, K).

    `rear` and `front` are arc lengths in metres, infinite outside the corridor; `speed` is along the path, m/s,
    negative when oncoming.
    """

    rear: Floats
    front: Floats
    speed: Floats


@dataclass(frozen=True, slots=True)
class _ExpectedPlaces:
    """Places beside a path where A others are expected at K instants.

    `crossing`, `ahead` (whether it can be met at all) and `heading` of the path beside it now are (A,); `along`, arc
    length, and `left` of the path in metres are (A, K).
    """

    crossing: Bools
    ahead: Bools
    heading: Floats
    along: Floats
    left: Floats


def obstacles_along(
    path: LanePath, boxes: Floats, velocity: Floats, seconds: Floats, *, side_margin_m: float, foresight_s: float
) -> Obstacles:
    """Others that will be in the corridor, `side_margin_m` wider than the car on each side.

    Objects along the path keep their velocity relative to it, sideways only for `foresight_s`, so that the cars of the
    next lane stay there in a bend. An oncoming object keeps to its side. A crossing one goes straight on. `boxes` are
    (A, 5) present ones and `velocity` (A, 2) m/s, global; `seconds` (K,) instants from now.
    """
    expected = _expect_places(path, boxes, velocity, seconds, foresight_s)
    # A box is turned to the path as now, unless it goes straight on where the path does not.
    heading_there = np.where(expected.crossing[:, None], path.heading_at(expected.along), expected.heading[:, None])
    half_along, half_across = _half_extents(boxes, heading_there)
    inside = np.abs(expected.left) - half_across < 0.5 * EGO_WIDTH_M + side_margin_m
    # Objects before the start or beyond the end of the path have no position along it.
    inside &= expected.ahead[:, None] & (expected.along > 0.0) & (expected.along < path.arc_length[-1])
    return Obstacles(
        rear=np.where(inside, expected.along - half_along, np.inf),
        front=np.where(inside, expected.along + half_along, np.inf),
        speed=_along_and_left(velocity[:, None], heading_there)[0],
    )


def expected_centres(path: LanePath, boxes: Floats, velocity: Floats, seconds: Floats, *, foresight_s: float) -> Floats:
    """Expected centres, (A, K, 2) global metres, as in `obstacles_along`; beyond its ends the path goes straight on."""
    now_and_then = np.concatenate([[0.0], seconds])
    expected = _expect_places(path, boxes, velocity, now_and_then, foresight_s)
    beside = _to_points(path, expected.along, expected.left)
    # Far from a bend, path coordinates distort positions; the motion is added to the true position instead.
    following = boxes[:, None, :2] + beside[:, 1:] - beside[:, :1]
    straight = boxes[:, None, :2] + velocity[:, None] * seconds[:, None]
    return np.where(expected.crossing[:, None, None], straight, following)


def _expect_places(
    path: LanePath, boxes: Floats, velocity: Floats, seconds: Floats, foresight_s: float
) -> _ExpectedPlaces:
    along, left = path.project(boxes[:, :2])
    heading = path.heading_at(along)
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])
    turned = np.abs(wrap_angle(np.where(np.hypot(*velocity.T) > 0.3, direction, boxes[:, 4]) - heading))
    crossing, oncoming = (turned > _CROSSING_RAD) & (turned < _ONCOMING_RAD), turned >= _ONCOMING_RAD

    forward, sideways = _along_and_left(velocity, heading)
    # A follower behind cannot be a leader, even if its extrapolation drives through the ego.
    ahead = crossing | (along > 0.0)
    sideways_s = np.where(oncoming[:, None], 0.0, np.minimum(seconds, foresight_s))
    straight = boxes[:, None, :2] + velocity[:, None] * seconds[:, None]
    straight_along, straight_left = path.project(straight)
    return _ExpectedPlaces(
        crossing=crossing,
        ahead=ahead,
        heading=heading,
        along=np.where(crossing[:, None], straight_along, along[:, None] + forward[:, None] * seconds),
        left=np.where(crossing[:, None], straight_left, left[:, None] + sideways[:, None] * sideways_s),
    )


def _to_points(path: LanePath, along: Floats, left: Floats) -> Floats:
    """(..., 2) points beside a path; the inverse of `LanePath.project`."""
    on_path = np.clip(along, 0.0, path.arc_length[-1])
    heading = np.interp(on_path, path.arc_length, path.heading)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    to_the_left = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
    return np.asarray(path.at(on_path) + (along - on_path)[..., None] * direction + left[..., None] * to_the_left)


def _along_and_left(velocity: Floats, heading: Floats) -> tuple[Floats, Floats]:
    cos, sin = np.cos(heading), np.sin(heading)
    return velocity[..., 0] * cos + velocity[..., 1] * sin, velocity[..., 1] * cos - velocity[..., 0] * sin


def _half_extents(boxes: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """(A, K) half lengths of boxes along and across a direction."""
    turn = boxes[:, None, 4] - heading
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    half_length, half_width = 0.5 * boxes[:, None, 2], 0.5 * boxes[:, None, 3]
    return half_length * cos + half_width * sin, half_length * sin + half_width * cos


_SUBSTEPS = 5
_DT = PLAN_STEP_S / _SUBSTEPS
_SECONDS = _DT * np.arange(PLAN_STEPS * _SUBSTEPS)
_HORIZON_S = PLAN_STEP_S * PLAN_STEPS
_STEP_SECONDS = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
_MILLIMETRES = 3
"""Decimals of forecasts: a record holds thirty of them a sample, and more digits say nothing."""


class IntelligentDriver:
    """Lane following with intelligent-driver distance keeping."""

    name = "idm"

    def __init__(self) -> None:
        self._driver = DriverParameters()
        self.settings = asdict(self._driver)
        self._scene: Scene | None = None

    def reset(self, scene: SceneInfo) -> None:
        """Forget the scene."""
        self._scene = None

    def reveal(self, scene: Scene) -> None:
        """Take map and boxes; only the present and the past of the boxes are looked at."""
        self._scene = scene

    def plan(self, observation: Observation) -> Plan:
        """Waypoints of the rear axle along the lane, ego frame, and where it expects the others."""
        if self._scene is None:
            raise RuntimeError("idm plans only after reveal(scene)")
        pose, speed = observation.ego.pose, max(float(observation.ego.velocity[0]), 0.0)
        fastest = max(speed, min(speed + self._driver.acceleration * _HORIZON_S, self._driver.speed_limit))
        length_m = fastest * (_HORIZON_S + self._driver.time_gap_s) + 20.0
        path = build_lane_path(self._scene.road_map, pose, observation.command, speed, length_m)
        if path is None:
            path = build_straight_path(pose, length_m)
        boxes, velocity = _observe_others(self._scene, observation, self._driver.sight_m)
        obstacles = obstacles_along(
            path,
            boxes,
            velocity,
            _SECONDS,
            side_margin_m=self._driver.side_margin_m,
            foresight_s=self._driver.foresight_s,
        )
        travelled = simulate_motion(path, speed, obstacles, self._driver)
        centres = expected_centres(path, boxes, velocity, _STEP_SECONDS, foresight_s=self._driver.foresight_s)
        return Plan(to_local(path.at(travelled), pose), PlanFrame.EGO, forecasts=_forecasts(boxes, centres, pose))


def simulate_motion(path: LanePath, speed: float, obstacles: Obstacles, driver: DriverParameters) -> Floats:
    """Distances travelled, (6,) metres at the plan's steps, by the intelligent-driver model from a speed in m/s."""
    desired_speed = max(speed, driver.speed_limit)
    allowed = np.minimum(np.sqrt(driver.lateral_acceleration / np.maximum(path.curvature, 1e-4)), desired_speed)
    travelled, distances = 0.0, []
    for step in range(PLAN_STEPS * _SUBSTEPS):
        free_speed = _speed_for_bends(path, allowed, travelled, driver)
        gap, leader_speed = _leader(obstacles, step, travelled)
        acceleration = idm_acceleration(speed, free_speed, gap, leader_speed, driver)
        faster = max(speed + acceleration * _DT, 0.0)
        travelled += 0.5 * (speed + faster) * _DT
        speed = faster
        if (step + 1) % _SUBSTEPS == 0:
            distances.append(travelled)
    return np.array(distances)


def _speed_for_bends(path: LanePath, allowed: Floats, travelled: float, driver: DriverParameters) -> float:
    """Highest speed now from which comfortable braking reaches each bend ahead at its own speed."""
    ahead = path.arc_length - travelled
    reachable = np.sqrt(allowed**2 + 2 * driver.comfortable_braking * np.maximum(ahead, 0.0))
    return float(np.where(ahead >= -1.0, reachable, np.inf).min(initial=allowed.max()))


def _leader(obstacles: Obstacles, step: int, travelled: float) -> tuple[float, float]:
    """Gap to the nearest other whose middle is ahead of the ego's front, and its speed; what is beside cannot lead."""
    if len(obstacles.speed) == 0:
        return np.inf, 0.0
    rear, bumper = obstacles.rear[:, step], travelled + EGO_CENTER_FROM_REAR_AXLE_M + EGO_LENGTH_M / 2
    gaps = np.where(rear + obstacles.front[:, step] > 2 * bumper, rear, np.inf) - bumper
    nearest = int(gaps.argmin())
    return float(gaps[nearest]), float(obstacles.speed[nearest, step])


def _observe_others(scene: Scene, observation: Observation, sight_m: float) -> tuple[Floats, Floats]:
    """Boxes now and their velocities, (A, 5) and (A, 2), of everything within sight.

    The velocity is that of the last half second, or of the next one for what has just appeared, as in the devkit.
    """
    now, agents = observation.index, scene.agents
    frame, previous, following = (
        int(scene.keyframes[at]) for at in (now, max(now - 1, 0), min(now + 1, _last_key_frame(scene)))
    )
    in_sight = np.hypot(*(agents.position[:, frame, :2] - observation.ego.pose[:2]).T) < sight_m
    rows = np.flatnonzero(agents.valid[:, frame] & in_sight)
    positions, seconds = agents.position[rows, frame, :2], scene.seconds
    velocity = np.zeros((len(rows), 2))
    for start, end in ((frame, following), (previous, frame)):
        if end > start:
            moved = agents.position[rows, end, :2] - agents.position[rows, start, :2]
            known = agents.valid[rows, start] & agents.valid[rows, end]
            velocity = np.where(known[:, None], moved / (seconds[end] - seconds[start]), velocity)
    return np.column_stack([positions, agents.boxes[rows, frame, 2:]]), velocity


def _forecasts(boxes: Floats, centres: Floats, pose: Floats) -> Forecasts:
    """Present boxes (A, 5) and expected centres (A, 6, 2), both global, as forecasts of one mode in the ego frame."""
    local = np.column_stack([to_local(boxes[:, :2], pose), boxes[:, 2:4], wrap_angle(boxes[:, 4] - pose[2])])
    return Forecasts(
        boxes=np.round(local, _MILLIMETRES),
        trajectories=np.round(to_local(centres, pose), _MILLIMETRES)[:, None],
        scores=np.ones((len(boxes), 1)),
    )


def _last_key_frame(scene: Scene) -> int:
    return len(scene.keyframes) - 1
