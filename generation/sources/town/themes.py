"""Themes of scenes: route of the ego, traffic around it, and light."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Floats
from benchmark.scene import Conditions
from generation.sources.town.curves import compute_headings, compute_lengths
from generation.sources.town.network import LaneRole, Town, TownLane
from generation.sources.town.paths import LEAD_M, RouteLeg, compute_lane_length, find_route
from generation.sources.town.speed import SECONDS

EGO_ROUTE_M = 285.0
_ROUTE_TRIES = 400


@dataclass(frozen=True, slots=True)
class RouteStretch:
    """One lane of the ego's route as a theme sees it, from ``begin_m`` to ``end_m`` after the ego's start."""

    lane: TownLane
    begin_m: float
    end_m: float


@dataclass(frozen=True, slots=True)
class SceneTheme:
    """A kind of scene; ``begins_on`` is where the ego starts.

    ``leader`` is ``none``, ``slow`` (a bus or truck) or ``stop-and-go``; ``companions`` are around the ego at the
    start, ``passing`` meet it later; ``parked`` is at most.
    """

    name: str
    title: str
    fits: Callable[[list[RouteStretch]], bool]
    begins_on: LaneRole = LaneRole.ROAD
    change_chance: float = 0.0
    leader: str = "none"
    companions: int = 5
    passing: int = 9
    parked: int = 8
    pedestrians: int = 6
    crossing: int = 1


def _is_straight_until(route: list[RouteStretch], distance_m: float) -> bool:
    early = [part.lane for part in route if part.begin_m < distance_m and part.end_m > 0]
    return all(lane.role in (LaneRole.ROAD, LaneRole.STRAIGHT) and "ring" not in lane.name for lane in early) and all(
        "pass." not in lane.name for lane in early
    )


def _is_multi_lane(route: list[RouteStretch], distance_m: float) -> bool:
    return all(
        len(part.lane.siblings) > 1
        for part in route
        if part.lane.role is LaneRole.ROAD and part.begin_m < distance_m and part.end_m > 0
    )


def _has_role(route: list[RouteStretch], role: LaneRole, nearest_m: float, farthest_m: float) -> bool:
    return any(part.lane.role is role and nearest_m <= part.begin_m <= farthest_m for part in route)


def _compute_bend(route: list[RouteStretch], distance_m: float) -> float:
    """Change of heading on roads, radians."""
    parts = [part for part in route if part.lane.role is LaneRole.ROAD and part.end_m > 0 and part.begin_m < distance_m]
    return sum(abs(float(np.ptp(compute_headings(part.lane.line)))) for part in parts)


def _fits_neighbours(route: list[RouteStretch]) -> bool:
    return _is_straight_until(route, 190.0) and _is_multi_lane(route, 190.0) and _compute_bend(route, 190.0) < 0.7


def _fits_roundabout(route: list[RouteStretch]) -> bool:
    long_way = any("/pass." in part.lane.name and part.begin_m < 140 for part in route)
    return _has_role(route, LaneRole.RING_ENTRY, 30.0, 75.0) and long_way and _avoids_car_park(route)


def _fits_left_turn(route: list[RouteStretch]) -> bool:
    return _has_role(route, LaneRole.LEFT, 45.0, 85.0) and _avoids_car_park(route)


def _fits_right_turn(route: list[RouteStretch]) -> bool:
    return _has_role(route, LaneRole.RIGHT, 45.0, 85.0) and _avoids_car_park(route)


def _avoids_car_park(route: list[RouteStretch]) -> bool:
    return all(part.lane.speed_mps >= 8.0 for part in route)


def _fits_car_park(route: list[RouteStretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    return start.lane.role is LaneRole.CAR_PARK and 14.0 < start.end_m < 26.0


def _fits_multi_lane_straight(route: list[RouteStretch]) -> bool:
    return _is_straight_until(route, 130.0) and _is_multi_lane(route, 130.0)


def _fits_curve(route: list[RouteStretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    return _is_straight_until(route, 150.0) and _compute_bend(route, 110.0) > 1.2 and start.end_m > 120.0


def _fits_oncoming(route: list[RouteStretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    single = len(start.lane.siblings) == 1 and start.lane.role is LaneRole.ROAD
    return single and start.end_m > 75.0 and _avoids_car_park(route) and start.lane.speed_mps <= 11.0


NEIGHBOURS = SceneTheme(
    "neighbours", "Four-lane road with cars on both sides", _fits_neighbours, change_chance=0.4, companions=7
)
ROUNDABOUT = SceneTheme("roundabout", "Roundabout with entering traffic", _fits_roundabout, passing=12)
LEFT = SceneTheme("left", "Left turn at a junction", _fits_left_turn, passing=12, crossing=2)
RIGHT = SceneTheme("right", "Right turn at a junction", _fits_right_turn, passing=12, crossing=2)
SLOW_LEADER = SceneTheme(
    "slow-leader", "Four-lane road, bus ahead", _fits_multi_lane_straight, leader="slow", passing=14, pedestrians=9
)
CAR_PARK = SceneTheme(
    "car-park", "Leaving a car park", _fits_car_park, LaneRole.CAR_PARK, companions=1, passing=14, parked=14
)
STOP_AND_GO = SceneTheme(
    "stop-and-go", "Stop-and-go traffic", _fits_multi_lane_straight, leader="stop-and-go", companions=8, passing=14
)
CURVE = SceneTheme(
    "curve", "Long bend with traffic", _fits_curve, change_chance=0.3, companions=7, passing=14, pedestrians=9
)
ONCOMING = SceneTheme(
    "oncoming", "Street with oncoming and parked cars", _fits_oncoming, passing=13, parked=12, pedestrians=8
)


@dataclass(frozen=True, slots=True)
class SceneProgramme:
    """A theme and the light and weather in which it is shown."""

    theme: SceneTheme
    look: Conditions


PROGRAMME = (
    SceneProgramme(NEIGHBOURS, Conditions.DAY),
    SceneProgramme(ROUNDABOUT, Conditions.DAY),
    SceneProgramme(LEFT, Conditions.DUSK),
    SceneProgramme(SLOW_LEADER, Conditions.RAIN),
    SceneProgramme(CAR_PARK, Conditions.DAY),
    SceneProgramme(CURVE, Conditions.DAY),
    SceneProgramme(STOP_AND_GO, Conditions.DUSK),
    SceneProgramme(ONCOMING, Conditions.RAIN),
    SceneProgramme(ROUNDABOUT, Conditions.DUSK),
    SceneProgramme(RIGHT, Conditions.DAY),
)
"""Scene ``index`` shows entry ``index % 10``; the towns of a split alternate with the index."""


def build_stretches(town: Town, legs: list[RouteLeg], start_m: float) -> list[RouteStretch]:
    """A route with distances from the ego's start."""
    parts, begin = [], -start_m
    for leg in legs:
        length = compute_lane_length(town.lanes[leg.lane])
        parts.append(RouteStretch(town.lanes[leg.lane], begin, begin + length))
        begin += length
    return parts


def draw_ego_route(town: Town, theme: SceneTheme, rng: np.random.Generator) -> tuple[list[RouteLeg], float] | None:
    """A random route that suits a theme: legs and start as from `find_route`, or ``None`` if the town has none."""
    names = [name for name, lane in town.lanes.items() if lane.role is theme.begins_on and town.predecessors[name]]
    for _ in range(_ROUTE_TRIES):
        name = names[int(rng.integers(len(names)))]
        start = float(rng.uniform(LEAD_M, max(compute_lane_length(town.lanes[name]) - 20.0, LEAD_M + 1.0)))
        route = find_route(
            town, name, start, EGO_ROUTE_M, rng, likes=_weigh_ego_lane, change_chance=theme.change_chance
        )
        if route is not None and theme.fits(build_stretches(town, *route)):
            return route
    return None


def _weigh_ego_lane(lane: TownLane) -> float:
    return 0.0 if lane.role is LaneRole.CAR_PARK else 1.0


def draw_leader_pace(theme: SceneTheme, rng: np.random.Generator) -> Floats:
    """(SECONDS,) factors on the leader's speed."""
    second = np.arange(SECONDS)
    if theme.leader == "slow":
        return np.full(SECONDS, float(rng.uniform(0.5, 0.62)))
    begin, period = float(rng.uniform(1.5, 4.5)), float(rng.uniform(12.0, 13.5))
    return np.where(((second - begin) % period) < 7.0, 0.0, 0.65)


def compute_route_points(town: Town, legs: list[RouteLeg], start_m: float, length_m: float) -> Floats:
    """(K, 2) points of a route, about 2 m apart, from its start for a length."""
    lines = [town.lanes[leg.lane].line for leg in legs]
    line = np.concatenate(lines)
    along = compute_lengths(line) - start_m
    return np.asarray(line[(along >= 0) & (along <= length_m)])
