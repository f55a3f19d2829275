"""Other vehicles: who starts where. One may drive ahead of the ego and one behind it; others keep away from its way."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.geometry import Floats, to_local, wrap_angle
from generation.sources.town.curves import compute_headings, compute_lengths
from generation.sources.town.network import LaneRole, Town, TownLane
from generation.sources.town.paths import (
    RouteLeg,
    VehicleBody,
    VehiclePath,
    build_path,
    compute_body_boxes,
    compute_fastest_start,
    compute_lane_length,
    find_route,
)
from generation.sources.town.speed import FRAMES, SECONDS, DriverHabits
from generation.sources.town.world import ParticipantTrack, TownWorld

_ROUTE_AHEAD_M = 270.0
_LEAST_SECONDS_SEEN = 4
_COMPANION_REACH_M = (38.0, 5.5)
_PULL_OUT_M = 13.0
_PULLING_OUT_REACH_M = 25.0
_KEPT_AWAY_S = 4.25
"""Between the ego and most others at the same place."""
_HEAVY_ROLES = (LaneRole.ROAD, LaneRole.STRAIGHT, LaneRole.LEFT)


@dataclass(frozen=True, slots=True)
class VehicleFleet:
    """Vehicles of the traffic, and the shares of their kinds, which add up to one."""

    bodies: tuple[VehicleBody, ...]
    shares: tuple[float, ...]

    def draw(self, rng: np.random.Generator) -> VehicleBody:
        """A vehicle of the fleet with its own size."""
        body = self.bodies[int(rng.choice(len(self.bodies), p=np.array(self.shares)))]
        scale = float(rng.uniform(0.95, 1.05))
        return VehicleBody(
            body.category,
            round(body.length * scale, 2),
            round(body.width * float(rng.uniform(0.97, 1.03)), 2),
            round(body.height * float(rng.uniform(0.95, 1.06)), 2),
            body.wheelbase * scale,
            body.center_ahead * scale,
        )


COMPACT = VehicleBody("vehicle.car", 4.1, 1.78, 1.5, 2.55, 1.35)
SEDAN = VehicleBody("vehicle.car", 4.75, 1.88, 1.5, 2.8, 1.4)
SUV = VehicleBody("vehicle.car", 4.8, 1.98, 1.78, 2.85, 1.42)
VAN = VehicleBody("vehicle.car", 5.2, 2.02, 2.1, 3.1, 1.5)
TRUCK = VehicleBody("vehicle.truck", 7.2, 2.4, 3.0, 4.1, 2.3)
BUS = VehicleBody("vehicle.bus.rigid", 11.0, 2.55, 3.2, 5.6, 2.6)
MOTORCYCLE = VehicleBody("vehicle.motorcycle", 2.1, 0.8, 1.5, 1.4, 0.7)
BICYCLE = VehicleBody("vehicle.bicycle", 1.75, 0.65, 1.6, 1.05, 0.52)

CARS = VehicleFleet((COMPACT, SEDAN, SUV, VAN), (0.25, 0.4, 0.27, 0.08))
MIXED = VehicleFleet((COMPACT, SEDAN, SUV, VAN, TRUCK, BUS, MOTORCYCLE), (0.21, 0.33, 0.22, 0.07, 0.08, 0.04, 0.05))


@dataclass(frozen=True, slots=True)
class VehicleStart:
    """Start of a drive: front axle along the lane, negative for a lane before it, and to the left of its middle.

    With ``pull_out_m`` it is in the middle after so many metres.
    """

    lane: str
    along_m: float
    speed_mps: float
    lateral_m: float = 0.0
    pull_out_m: float = 0.0


def add_vehicle(
    world: TownWorld,
    start: VehicleStart,
    body: VehicleBody,
    rng: np.random.Generator,
    *,
    likes: Callable[[TownLane], float],
    habits: DriverHabits,
    change_chance: float = 0.15,
) -> bool:
    """Plan a vehicle and add it if it can drive there and is seen for some seconds; says whether it was added.

    ``likes`` weighs each lane for its route, ``change_chance`` is that of a lane change per road.
    """
    heavy = body.length > 6.0

    def weight(lane: TownLane) -> float:
        return 0.0 if heavy and lane.role not in _HEAVY_ROLES else likes(lane)

    route = find_route(
        world.town, start.lane, start.along_m, _ROUTE_AHEAD_M, rng, likes=weight, change_chance=change_chance
    )
    if route is None or (heavy and any(world.town.lanes[leg.lane].role not in _HEAVY_ROLES for leg in route[0])):
        return False
    path = build_path(world.town, *route, body, lateral_m=start.lateral_m, pull_out_m=start.pull_out_m)
    return add_on_path(world, path, start.speed_mps, habits)


def add_on_path(world: TownWorld, path: VehiclePath, speed_mps: float, habits: DriverHabits) -> bool:
    """`add_vehicle` on a path that is known."""
    speed = min(speed_mps, compute_fastest_start(path))
    rear = world.drive(path, start_mps=int(speed + 0.3), habits=habits)
    if rear is None:
        return False
    boxes = compute_body_boxes(rear, path.body)
    if world.ego_rear is not None and world.present(boxes).sum() < _LEAST_SECONDS_SEEN * FRAME_HZ:
        return False
    if world.surprises_ego(boxes):
        return False
    world.tracks.append(ParticipantTrack(path.body.category, path.body.height, boxes, parked=False))
    return True


def draw_habits(rng: np.random.Generator, eagerness: tuple[float, float], *, near_ego: float = 0.2) -> DriverHabits:
    """Habits of one of many; ``near_ego`` is the share of those who come close to the ego's way in time."""
    return DriverHabits(
        float(rng.uniform(*eagerness)),
        draw_natural_pace(rng),
        ego_gap_s=1.25 if rng.random() < near_ego else _KEPT_AWAY_S,
    )


def draw_natural_pace(rng: np.random.Generator) -> Floats:
    """(SECONDS,) factors near one: no driver keeps a speed exactly."""
    period, phase = float(rng.uniform(7.0, 16.0)), float(rng.uniform(0.0, 2 * np.pi))
    return np.asarray(1.0 + float(rng.uniform(0.03, 0.12)) * np.sin(2 * np.pi * np.arange(SECONDS) / period + phase))


def weigh_any_lane(lane: TownLane) -> float:
    """Weight of a lane for a driver who goes anywhere but rarely to the car park."""
    return 0.1 if lane.role is LaneRole.CAR_PARK else 1.0


def build_route_weights(town: Town, legs: list[RouteLeg]) -> Callable[[TownLane], float]:
    """Weights for a driver who prefers to go where a route goes."""
    turns = {(town.lanes[leg.lane].road, town.lanes[leg.lane].role) for leg in legs}

    def likes(lane: TownLane) -> float:
        return weigh_any_lane(lane) * (8.0 if (lane.road, lane.role) in turns else 1.0)

    return likes


@dataclass(frozen=True, slots=True)
class LanePoints:
    """All points of all lanes of a town: (N, 3) poses, and (N,) arc length along the lane that ``names`` names."""

    names: tuple[str, ...]
    poses: Floats
    along: Floats

    @classmethod
    def of(cls, town: Town) -> "LanePoints":
        """Collect them."""
        names, poses, along = [], [], []
        for name, lane in town.lanes.items():
            names += [name] * len(lane.line)
            poses.append(np.column_stack([lane.line, compute_headings(lane.line)]))
            along.append(compute_lengths(lane.line))
        return cls(tuple(names), np.concatenate(poses), np.concatenate(along))


def add_companions(
    world: TownWorld,
    points: LanePoints,
    legs: list[RouteLeg],
    rng: np.random.Generator,
    *,
    wanted: int,
    fleet: VehicleFleet = CARS,
) -> None:
    """Vehicles beside, ahead of and behind the ego at the start, which tend to go where it goes."""
    assert world.ego_rear is not None
    local = to_local(points.poses[:, :2], world.ego_rear[0])
    turned = np.abs(wrap_angle(points.poses[:, 2] - world.ego_rear[0, 2]))
    near = (np.abs(local[:, 0]) < _COMPANION_REACH_M[0]) & (np.abs(local[:, 1]) < _COMPANION_REACH_M[1])
    choices = np.flatnonzero(near & (turned < 0.5))
    added = 0
    likes = build_route_weights(world.town, legs)
    ego_speed = float(np.hypot(*(world.ego_rear[2, :2] - world.ego_rear[0, :2]))) * FRAME_HZ / 2
    for choice in rng.permutation(choices)[: 5 * wanted].tolist():
        if added >= wanted:
            return
        start = VehicleStart(points.names[choice], float(points.along[choice]), max(ego_speed, 3.0))
        habits = draw_habits(rng, (0.85, 1.1))
        added += add_vehicle(world, start, fleet.draw(rng), rng, likes=likes, habits=habits, change_chance=0.0)


def add_passing(
    world: TownWorld,
    points: LanePoints,
    rng: np.random.Generator,
    *,
    wanted: int,
    attempts: int,
    fleet: VehicleFleet = MIXED,
) -> None:
    """Vehicles that would be near the ego at some moment of the scene: oncoming, crossing, merging."""
    assert world.ego_rear is not None
    added = 0
    for _ in range(attempts):
        if added >= wanted:
            return
        frame = int(rng.integers(FRAMES))
        distance = np.hypot(*(points.poses[:, :2] - world.ego_rear[frame, :2]).T)
        choices = np.flatnonzero((distance > 3.0) & (distance < 40.0))
        if not len(choices):
            continue
        choice = int(choices[int(rng.integers(len(choices)))])
        lane = world.town.lanes[points.names[choice]]
        speed = 0.8 * lane.speed_mps
        back = speed * frame / FRAME_HZ * float(rng.uniform(0.6, 1.0))
        if back > 130.0 or (lane.role is LaneRole.CAR_PARK and rng.random() < 0.6):
            continue
        start = VehicleStart(lane.name, float(points.along[choice]) - back, speed)
        habits = draw_habits(rng, (0.8, 1.05))
        added += add_vehicle(world, start, fleet.draw(rng), rng, likes=weigh_any_lane, habits=habits)


def add_pulling_out(
    world: TownWorld, points: LanePoints, near: Floats, rng: np.random.Generator, *, wanted: int
) -> None:
    """Cars that leave their place at the kerb near the (K, 2) points of the ego's way, when they find a gap."""
    kerb = [place.pose for place in world.town.standing if not place.in_car_park]
    added = 0
    for index in rng.permutation(len(kerb)).tolist():
        if added >= wanted:
            return
        pose = kerb[index]
        if np.hypot(*(near - pose[:2]).T).min() > _PULLING_OUT_REACH_M:
            continue
        local = to_local(points.poses[:, :2], pose)
        turned = np.abs(wrap_angle(points.poses[:, 2] - pose[2]))
        beside = np.flatnonzero((np.abs(local[:, 0]) < 1.5) & (turned < 0.3) & (np.abs(local[:, 1]) < 4.0))
        if not len(beside):
            continue
        choice = int(beside[np.argmin(np.abs(local[beside, 1]))])
        begin = int(rng.integers(2, 12))
        pace = np.where(np.arange(SECONDS) < begin, 0.0, draw_natural_pace(rng))
        start = VehicleStart(
            points.names[choice], float(points.along[choice]), 0.0, -float(local[choice, 1]), _PULL_OUT_M
        )
        habits = DriverHabits(float(rng.uniform(0.75, 0.95)), pace, ego_gap_s=2.0)
        added += add_vehicle(world, start, CARS.draw(rng), rng, likes=weigh_any_lane, habits=habits, change_chance=0.0)


def add_cycles(world: TownWorld, points: LanePoints, rng: np.random.Generator, *, wanted: int, attempts: int) -> None:
    """Cyclists at the right edge of single-lane roads near the ego's way."""
    assert world.ego_rear is not None
    added = 0
    slow = np.full(SECONDS, 0.45)
    for _ in range(attempts):
        if added >= wanted:
            return
        frame = int(rng.integers(FRAMES))
        distance = np.hypot(*(points.poses[:, :2] - world.ego_rear[frame, :2]).T)
        choice = int(rng.choice(np.flatnonzero(distance < 45.0)))
        lane = world.town.lanes[points.names[choice]]
        if lane.role is not LaneRole.ROAD or compute_lane_length(lane) < 40.0 or lane.index != len(lane.siblings) - 1:
            continue
        start = VehicleStart(lane.name, float(points.along[choice]), 4.0, lateral_m=-1.05)
        body = VehicleFleet((BICYCLE,), (1.0,)).draw(rng)
        habits = DriverHabits(1.0, slow, ego_gap_s=_KEPT_AWAY_S)
        added += add_vehicle(world, start, body, rng, likes=weigh_any_lane, habits=habits, change_chance=0.0)
