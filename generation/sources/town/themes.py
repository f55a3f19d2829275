"""What each scene is about: where the ego goes, who is around it, and in which light."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Floats
from benchmark.scene import Look
from generation.sources.town.curves import headings, lengths_along
from generation.sources.town.network import Role, Town, TownLane
from generation.sources.town.paths import LEAD_M, Leg, find_route, lane_length
from generation.sources.town.speed import SECONDS

EGO_ROUTE_M = 285.0
_ROUTE_TRIES = 400


@dataclass(frozen=True, slots=True)
class Stretch:
    """One lane of the ego's route as a theme sees it, from ``begin_m`` to ``end_m`` after the ego's start."""

    lane: TownLane
    begin_m: float
    end_m: float


@dataclass(frozen=True, slots=True)
class Theme:
    """A kind of scene.

    Attributes:
        fits: Whether a route suits the theme.
        begins_on: Role of the lane on which the ego starts.
        leader: ``none``, ``slow`` (a bus or truck) or ``stop-and-go``.
        companions: Vehicles around the ego at the start.
        passing: Vehicles that meet it later.
        parked: Most parked cars.
    """

    name: str
    title: str
    fits: Callable[[list[Stretch]], bool]
    begins_on: Role = Role.ROAD
    change_chance: float = 0.0
    leader: str = "none"
    companions: int = 5
    passing: int = 9
    parked: int = 8
    pedestrians: int = 6
    crossing: int = 1


def _straight_until(route: list[Stretch], distance_m: float) -> bool:
    early = [part.lane for part in route if part.begin_m < distance_m and part.end_m > 0]
    return all(lane.role in (Role.ROAD, Role.STRAIGHT) and "ring" not in lane.name for lane in early) and all(
        "pass." not in lane.name for lane in early
    )


def _multi_lane(route: list[Stretch], distance_m: float) -> bool:
    return all(
        len(part.lane.siblings) > 1
        for part in route
        if part.lane.role is Role.ROAD and part.begin_m < distance_m and part.end_m > 0
    )


def _has(route: list[Stretch], role: Role, nearest_m: float, farthest_m: float) -> bool:
    return any(part.lane.role is role and nearest_m <= part.begin_m <= farthest_m for part in route)


def _bend(route: list[Stretch], distance_m: float) -> float:
    """Change of heading on roads, radians."""
    parts = [part for part in route if part.lane.role is Role.ROAD and part.end_m > 0 and part.begin_m < distance_m]
    return sum(abs(float(np.ptp(headings(part.lane.line)))) for part in parts)


def _neighbours(route: list[Stretch]) -> bool:
    return _straight_until(route, 190.0) and _multi_lane(route, 190.0) and _bend(route, 190.0) < 0.7


def _roundabout(route: list[Stretch]) -> bool:
    long_way = any("/pass." in part.lane.name and part.begin_m < 140 for part in route)
    return _has(route, Role.RING_ENTRY, 30.0, 75.0) and long_way and _no_car_park(route)


def _left(route: list[Stretch]) -> bool:
    return _has(route, Role.LEFT, 45.0, 85.0) and _no_car_park(route)


def _right(route: list[Stretch]) -> bool:
    return _has(route, Role.RIGHT, 45.0, 85.0) and _no_car_park(route)


def _no_car_park(route: list[Stretch]) -> bool:
    return all(part.lane.speed_mps >= 8.0 for part in route)


def _car_park(route: list[Stretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    return start.lane.role is Role.CAR_PARK and 14.0 < start.end_m < 26.0


def _multi_lane_straight(route: list[Stretch]) -> bool:
    return _straight_until(route, 130.0) and _multi_lane(route, 130.0)


def _curve(route: list[Stretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    return _straight_until(route, 150.0) and _bend(route, 110.0) > 1.2 and start.end_m > 120.0


def _oncoming(route: list[Stretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    single = len(start.lane.siblings) == 1 and start.lane.role is Role.ROAD
    return single and start.end_m > 75.0 and _no_car_park(route) and start.lane.speed_mps <= 11.0


NEIGHBOURS = Theme("neighbours", "Four-lane road with cars on both sides", _neighbours, change_chance=0.4, companions=7)
ROUNDABOUT = Theme("roundabout", "Roundabout with entering traffic", _roundabout, passing=12)
LEFT = Theme("left", "Left turn at a junction", _left, passing=12, crossing=2)
RIGHT = Theme("right", "Right turn at a junction", _right, passing=12, crossing=2)
SLOW_LEADER = Theme(
    "slow-leader", "Four-lane road, bus ahead", _multi_lane_straight, leader="slow", passing=14, pedestrians=9
)
CAR_PARK = Theme("car-park", "Leaving a car park", _car_park, Role.CAR_PARK, companions=1, passing=14, parked=14)
STOP_AND_GO = Theme(
    "stop-and-go", "Stop-and-go traffic", _multi_lane_straight, leader="stop-and-go", companions=8, passing=14
)
CURVE = Theme("curve", "Long bend with traffic", _curve, change_chance=0.3, companions=7, passing=14, pedestrians=9)
ONCOMING = Theme("oncoming", "Street with oncoming and parked cars", _oncoming, passing=13, parked=12, pedestrians=8)


@dataclass(frozen=True, slots=True)
class Programme:
    """A theme and the light and weather in which it is shown."""

    theme: Theme
    look: Look


PROGRAMME = (
    Programme(NEIGHBOURS, Look.DAY),
    Programme(ROUNDABOUT, Look.DAY),
    Programme(LEFT, Look.DUSK),
    Programme(SLOW_LEADER, Look.RAIN),
    Programme(CAR_PARK, Look.DAY),
    Programme(CURVE, Look.DAY),
    Programme(STOP_AND_GO, Look.DUSK),
    Programme(ONCOMING, Look.RAIN),
    Programme(ROUNDABOUT, Look.DUSK),
    Programme(RIGHT, Look.DAY),
)
"""Scene ``index`` shows entry ``index % 10``; the towns of a split alternate with the index."""


def stretches(town: Town, legs: list[Leg], start_m: float) -> list[Stretch]:
    """A route with distances from the ego's start."""
    parts, begin = [], -start_m
    for leg in legs:
        length = lane_length(town.lanes[leg.lane])
        parts.append(Stretch(town.lanes[leg.lane], begin, begin + length))
        begin += length
    return parts


def ego_route(town: Town, theme: Theme, rng: np.random.Generator) -> tuple[list[Leg], float] | None:
    """A random route that suits a theme: legs and start as from `find_route`, or ``None`` if the town has none."""
    names = [name for name, lane in town.lanes.items() if lane.role is theme.begins_on and town.predecessors[name]]
    for _ in range(_ROUTE_TRIES):
        name = names[int(rng.integers(len(names)))]
        start = float(rng.uniform(LEAD_M, max(lane_length(town.lanes[name]) - 20.0, LEAD_M + 1.0)))
        route = find_route(town, name, start, EGO_ROUTE_M, rng, likes=_ego_likes, change_chance=theme.change_chance)
        if route is not None and theme.fits(stretches(town, *route)):
            return route
    return None


def _ego_likes(lane: TownLane) -> float:
    return 0.0 if lane.role is Role.CAR_PARK else 1.0


def leader_pace(theme: Theme, rng: np.random.Generator) -> Floats:
    """(SECONDS,) factors on the leader's speed."""
    second = np.arange(SECONDS)
    if theme.leader == "slow":
        return np.full(SECONDS, float(rng.uniform(0.5, 0.62)))
    begin, period = float(rng.uniform(1.5, 4.5)), float(rng.uniform(12.0, 13.5))
    return np.where(((second - begin) % period) < 7.0, 0.0, 0.65)


def route_points(town: Town, legs: list[Leg], start_m: float, length_m: float) -> Floats:
    """(K, 2) points of a route, about 2 m apart, from its start for a length."""
    lines = [town.lanes[leg.lane].line for leg in legs]
    line = np.concatenate(lines)
    along = lengths_along(line) - start_m
    return np.asarray(line[(along >= 0) & (along <= length_m)])
