"""``idm``: follows its lane and keeps distance by the intelligent-driver model.

Privileged: sees the map and all boxes, but not the future. The model is that of Treiber, Hennecke and Helbing (2000),
equations 1-3, with two of its authors' own corrections: a car that is faster than it wants to be brakes comfortably
(Treiber and Kesting, "Traffic Flow Dynamics", 2013, improved model), and a gap that is small but does not close is no
emergency (Kesting, Treiber and Helbing 2010, enhanced model, with leaders that keep their speed). Without
them it brakes so hard behind a close leader that the car behind hits it. Traffic lights and right of way are not seen.

What it expects of the others (`adapters.baselines.obstacles`) it gives as forecasts, one mode each, so that its
collisions can be diagnosed. They include those behind, which it expects to drive on and does not plan for.
"""

from dataclasses import asdict, dataclass

import numpy as np

from adapters.baselines.obstacles import Obstacles, expected_centres, obstacles_along
from benchmark.constants import (
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_LENGTH_M,
    PLAN_STEP_S,
    PLAN_STEPS,
)
from benchmark.dynamics.lane_path import Path, lane_path, straight_path
from benchmark.geometry import Floats, to_local, wrap_angle
from benchmark.planning import Forecasts, Observation, Plan, PlanFrame, SceneInfo
from benchmark.scene import Scene

_SUBSTEPS = 5
_DT = PLAN_STEP_S / _SUBSTEPS
_SECONDS = _DT * np.arange(PLAN_STEPS * _SUBSTEPS)
_HORIZON_S = PLAN_STEP_S * PLAN_STEPS
_STEP_SECONDS = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
_MILLIMETRES = 3
"""Decimals of forecasts: a record holds thirty of them a sample, and more digits say nothing."""
_EXPONENT = 4
"""How acceleration falls off towards the wanted speed."""


@dataclass(frozen=True, slots=True)
class DriverSettings:
    """What kind of driver.

    Attributes:
        speed_limit: Wanted speed on a free road unless the car is faster already, m/s.
        time_gap_s: Wanted time gap to the leader.
        standstill_gap_m: Wanted gap at standstill.
        acceleration: Largest acceleration, m/s^2.
        comfortable_braking: m/s^2.
        hardest_braking: m/s^2.
        coolness: Trust in the leader, 0 (the original model) to 1.
        lateral_acceleration: In bends, m/s^2.
        foresight_s: For how long others of the same direction are expected to keep moving sideways.
        side_margin_m: Room beside the car that counts as its corridor.
        sight_m: Others further away are not looked at.
    """

    speed_limit: float = 13.9
    time_gap_s: float = 1.0
    standstill_gap_m: float = 2.0
    acceleration: float = 1.0
    comfortable_braking: float = 1.5
    hardest_braking: float = 7.0
    coolness: float = 0.99
    lateral_acceleration: float = 2.5
    foresight_s: float = 1.5
    side_margin_m: float = 0.3
    sight_m: float = 70.0


class IntelligentDriver:
    """Lane following with intelligent-driver distance keeping."""

    name = "idm"

    def __init__(self) -> None:
        self._driver = DriverSettings()
        self.settings = asdict(self._driver)
        self._scene: Scene | None = None

    def reset(self, scene: SceneInfo) -> None:
        """Forget the scene."""
        self._scene = None

    def reveal(self, scene: Scene) -> None:
        """Take map and boxes; only the present and the past of the boxes are looked at."""
        self._scene = scene

    def plan(self, observation: Observation) -> Plan:
        """Plan along the lane.

        Args:
            observation: Ego motion, command and time.

        Returns:
            Waypoints of the rear axle, ego frame, and where it expects the others.

        Raises:
            RuntimeError: If no scene was revealed.
        """
        if self._scene is None:
            raise RuntimeError("idm plans only after reveal(scene)")
        pose, speed = observation.ego.pose, max(float(observation.ego.velocity[0]), 0.0)
        fastest = max(speed, min(speed + self._driver.acceleration * _HORIZON_S, self._driver.speed_limit))
        length_m = fastest * (_HORIZON_S + self._driver.time_gap_s) + 20.0
        path = lane_path(self._scene.road_map, pose, observation.command, speed, length_m)
        if path is None:
            path = straight_path(pose, length_m)
        boxes, velocity = _others_now(self._scene, observation, self._driver.sight_m)
        obstacles = obstacles_along(
            path,
            boxes,
            velocity,
            _SECONDS,
            side_margin_m=self._driver.side_margin_m,
            foresight_s=self._driver.foresight_s,
        )
        travelled = drive(path, speed, obstacles, self._driver)
        centres = expected_centres(path, boxes, velocity, _STEP_SECONDS, foresight_s=self._driver.foresight_s)
        return Plan(to_local(path.at(travelled), pose), PlanFrame.EGO, forecasts=_forecasts(boxes, centres, pose))


def drive(path: Path, speed: float, obstacles: Obstacles, driver: DriverSettings) -> Floats:
    """Intelligent-driver motion along a path.

    Args:
        path: The path.
        speed: Now, m/s.
        obstacles: Others along it.
        driver: Speeds, accelerations and distances that the driver keeps to.

    Returns:
        (6,) distance travelled at the plan's steps, metres.
    """
    wanted = max(speed, driver.speed_limit)
    allowed = np.minimum(np.sqrt(driver.lateral_acceleration / np.maximum(path.curvature, 1e-4)), wanted)
    travelled, distances = 0.0, []
    for step in range(PLAN_STEPS * _SUBSTEPS):
        free_speed = _speed_for_bends(path, allowed, travelled, driver)
        gap, leader_speed = _leader(obstacles, step, travelled)
        acceleration = _acceleration(speed, free_speed, gap, leader_speed, driver)
        faster = max(speed + acceleration * _DT, 0.0)
        travelled += 0.5 * (speed + faster) * _DT
        speed = faster
        if (step + 1) % _SUBSTEPS == 0:
            distances.append(travelled)
    return np.array(distances)


def _speed_for_bends(path: Path, allowed: Floats, travelled: float, driver: DriverSettings) -> float:
    """Highest speed now from which each bend ahead can be reached at its own speed by comfortable braking."""
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


def _acceleration(speed: float, free_speed: float, gap: float, leader_speed: float, driver: DriverSettings) -> float:
    """The intelligent-driver model with the corrections that the module names; braking is limited by the tyres."""
    ratio = speed / max(free_speed, 0.1)
    if ratio <= 1.0:
        free = driver.acceleration * (1.0 - ratio**_EXPONENT)
    else:
        sharpness = driver.acceleration * _EXPONENT / driver.comfortable_braking
        free = -driver.comfortable_braking * (1.0 - ratio**-sharpness)
    if not np.isfinite(gap):
        return free
    gap = max(gap, 0.1)
    closing = speed - leader_speed
    braking_distance = speed * closing / (2 * np.sqrt(driver.acceleration * driver.comfortable_braking))
    wanted_gap = driver.standstill_gap_m + max(speed * driver.time_gap_s + braking_distance, 0.0)
    following = free - driver.acceleration * (wanted_gap / gap) ** 2
    # What would do if the leader went on as it does now: a driver who trusts it lets the gap grow gently.
    trusting = -(max(closing, 0.0) ** 2) / (2 * gap)
    if following < trusting:
        beyond = trusting + driver.comfortable_braking * np.tanh((following - trusting) / driver.comfortable_braking)
        following = (1.0 - driver.coolness) * following + driver.coolness * beyond
    return max(float(following), -driver.hardest_braking)


def _others_now(scene: Scene, observation: Observation, sight_m: float) -> tuple[Floats, Floats]:
    """Boxes now and their velocities, (A, 5) and (A, 2), of everything within sight.

    The velocity is that of the last half second, or of the next one for what has just appeared, as in the devkit.
    """
    now, agents = observation.index, scene.agents
    frame, before, after = (int(scene.keyframes[at]) for at in (now, max(now - 1, 0), min(now + 1, _last(scene))))
    near = np.hypot(*(agents.position[:, frame, :2] - observation.ego.pose[:2]).T) < sight_m
    rows = np.flatnonzero(agents.valid[:, frame] & near)
    here, seconds = agents.position[rows, frame, :2], scene.seconds
    velocity = np.zeros((len(rows), 2))
    for start, end in ((frame, after), (before, frame)):
        if end > start:
            moved = agents.position[rows, end, :2] - agents.position[rows, start, :2]
            known = agents.valid[rows, start] & agents.valid[rows, end]
            velocity = np.where(known[:, None], moved / (seconds[end] - seconds[start]), velocity)
    return np.column_stack([here, agents.boxes[rows, frame, 2:]]), velocity


def _forecasts(boxes: Floats, centres: Floats, pose: Floats) -> Forecasts:
    """Present boxes (A, 5) and expected centres (A, 6, 2), both global, as forecasts of one mode in the ego frame."""
    local = np.column_stack([to_local(boxes[:, :2], pose), boxes[:, 2:4], wrap_angle(boxes[:, 4] - pose[2])])
    return Forecasts(
        boxes=np.round(local, _MILLIMETRES),
        trajectories=np.round(to_local(centres, pose), _MILLIMETRES)[:, None],
        scores=np.ones((len(boxes), 1)),
    )


def _last(scene: Scene) -> int:
    return len(scene.keyframes) - 1
