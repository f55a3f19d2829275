"""Themes of scenes: route of the ego, traffic around it, traffic lights, and light."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from benchmark.geometry import Floats
from benchmark.scene import Conditions
from generation.sources.town.curves import compute_headings, compute_lengths
from generation.sources.town.network import LaneRole, Town, TownLane
from generation.sources.town.paths import LEAD_M, RouteLeg, compute_lane_length, find_route

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
    """A kind of place: how the ego comes through it, and who else is there at most.

    ``begins_on`` is where the ego starts. ``title`` may name the ``{near}`` and the ``{far}`` side of traffic.
    """

    name: str
    title: str
    fits: Callable[[list[RouteStretch]], bool]
    begins_on: LaneRole = LaneRole.ROAD
    change_chance: float = 0.0
    companions: int = 1
    passing: int = 7
    pulling_out: int = 1
    parked: int = 30
    pedestrians: int = 20
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


def _avoids_car_park(route: list[RouteStretch]) -> bool:
    return all(part.lane.speed_mps >= 8.0 for part in route)


def _fits_avenue(route: list[RouteStretch]) -> bool:
    return _is_straight_until(route, 190.0) and _is_multi_lane(route, 190.0)


def _fits_street(route: list[RouteStretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    single = len(start.lane.siblings) == 1 and start.lane.role is LaneRole.ROAD
    return single and _is_straight_until(route, 110.0) and start.lane.speed_mps <= 10.0 and _avoids_car_park(route)


def _fits_bend(route: list[RouteStretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    return _is_straight_until(route, 150.0) and _compute_bend(route, 110.0) > 1.2 and start.end_m > 110.0


def _fits_crossing(route: list[RouteStretch]) -> bool:
    return _is_straight_until(route, 130.0) and _has_role(route, LaneRole.STRAIGHT, 0.0, 85.0)


def _fits_far_turn(route: list[RouteStretch]) -> bool:
    return _has_role(route, LaneRole.LEFT, 0.0, 85.0) and _avoids_car_park(route)


def _fits_near_turn(route: list[RouteStretch]) -> bool:
    return _has_role(route, LaneRole.RIGHT, 0.0, 85.0) and _avoids_car_park(route)


def _fits_roundabout(route: list[RouteStretch]) -> bool:
    long_way = any("/pass." in part.lane.name and part.begin_m < 140 for part in route)
    return _has_role(route, LaneRole.RING_ENTRY, 30.0, 75.0) and long_way and _avoids_car_park(route)


def _fits_car_park(route: list[RouteStretch]) -> bool:
    start = next(part for part in route if part.end_m > 0)
    return start.lane.role is LaneRole.CAR_PARK and 14.0 < start.end_m < 26.0


AVENUE = SceneTheme("avenue", "Four-lane road", _fits_avenue, change_chance=0.2, companions=2)
STREET = SceneTheme("street", "Street with parked cars", _fits_street, pulling_out=2, parked=40, pedestrians=26)
BEND = SceneTheme("bend", "Long bend", _fits_bend)
CROSSING = SceneTheme("crossing", "Straight on at a junction with traffic lights", _fits_crossing, crossing=2)
FAR_TURN = SceneTheme("far-turn", "Turn to the {far} at a junction, across oncoming traffic", _fits_far_turn)
NEAR_TURN = SceneTheme("near-turn", "Turn to the {near} at a junction", _fits_near_turn, crossing=2)
ROUNDABOUT = SceneTheme("roundabout", "Roundabout", _fits_roundabout, passing=8)
CAR_PARK = SceneTheme("car-park", "Leaving a car park", _fits_car_park, LaneRole.CAR_PARK, companions=0, parked=40)


class EgoLight(StrEnum):
    """Traffic lights that the ego meets first: green, red at the start, red when it comes, or red until the end."""

    GREEN = "green"
    WAITS = "waits"
    RED = "red"
    STOPS = "stops"


_HALT_AHEAD_M = {
    EgoLight.GREEN: (-np.inf, np.inf),
    EgoLight.WAITS: (11.0, 12.0),
    EgoLight.RED: (35.0, 70.0),
    EgoLight.STOPS: (50.0, 120.0),
}
"""Metres from the ego's start to the end of the first lane that ends at traffic lights."""


@dataclass(frozen=True, slots=True)
class SceneProgramme:
    """A theme, the light and weather in which it is shown, traffic lights, and who drives with the ego."""

    theme: SceneTheme
    look: Conditions
    light: EgoLight = EgoLight.GREEN
    leader: bool = False
    follower: bool = False


_DAY, _DUSK, _NIGHT, _RAIN = Conditions.DAY, Conditions.DUSK, Conditions.NIGHT, Conditions.RAIN
_GREEN, _WAITS, _RED, _STOPS = EgoLight.GREEN, EgoLight.WAITS, EgoLight.RED, EgoLight.STOPS

PROGRAMME = (
    SceneProgramme(AVENUE, _DAY, leader=True),
    SceneProgramme(STREET, _DAY),
    SceneProgramme(FAR_TURN, _DUSK, _WAITS),
    SceneProgramme(ROUNDABOUT, _DAY, follower=True),
    SceneProgramme(CROSSING, _RAIN, _RED),
    SceneProgramme(CAR_PARK, _DAY),
    SceneProgramme(BEND, _NIGHT, leader=True),
    SceneProgramme(STREET, _DAY, leader=True),
    SceneProgramme(CROSSING, _DAY, _STOPS, follower=True),
    SceneProgramme(AVENUE, _DUSK, follower=True),
    SceneProgramme(NEAR_TURN, _RAIN, _RED),
    SceneProgramme(STREET, _NIGHT),
    SceneProgramme(CROSSING, _DAY, _WAITS, leader=True),
    SceneProgramme(ROUNDABOUT, _DUSK),
    SceneProgramme(CROSSING, _DAY, _RED),
    SceneProgramme(AVENUE, _RAIN, leader=True, follower=True),
    SceneProgramme(STREET, _DUSK, follower=True),
    SceneProgramme(FAR_TURN, _DAY, _RED),
    SceneProgramme(CAR_PARK, _NIGHT),
    SceneProgramme(CROSSING, _DAY, _WAITS),
    SceneProgramme(AVENUE, _NIGHT, _STOPS),
    SceneProgramme(BEND, _RAIN, follower=True),
    SceneProgramme(STREET, _DAY, leader=True),
    SceneProgramme(NEAR_TURN, _DAY, _WAITS),
    SceneProgramme(AVENUE, _DAY, leader=True),
    SceneProgramme(CROSSING, _DUSK, _WAITS, leader=True),
    SceneProgramme(ROUNDABOUT, _RAIN),
    SceneProgramme(STREET, _RAIN, leader=True),
    SceneProgramme(CROSSING, _NIGHT, _STOPS),
    SceneProgramme(AVENUE, _DAY, leader=True),
)
"""Scene ``index`` shows entry ``index % 30``; the towns of a split alternate with the index."""


def build_stretches(town: Town, legs: list[RouteLeg], start_m: float) -> list[RouteStretch]:
    """A route with distances from the ego's start."""
    parts, begin = [], -start_m
    for leg in legs:
        length = compute_lane_length(town.lanes[leg.lane])
        parts.append(RouteStretch(town.lanes[leg.lane], begin, begin + length))
        begin += length
    return parts


def draw_ego_route(
    town: Town, programme: SceneProgramme, rng: np.random.Generator
) -> tuple[list[RouteLeg], float] | None:
    """A random route that suits a programme: legs and start as from `find_route`; ``None`` if the town has none."""
    theme = programme.theme
    names = [name for name, lane in town.lanes.items() if lane.role is theme.begins_on and town.predecessors[name]]
    if programme.light is EgoLight.WAITS:
        names = [name for name in names if name in town.signals]
    for _ in range(_ROUTE_TRIES):
        name = names[int(rng.integers(len(names)))]
        length = compute_lane_length(town.lanes[name])
        start = float(rng.uniform(LEAD_M, max(length - 20.0, LEAD_M + 1.0)))
        if programme.light is EgoLight.WAITS:
            start = length - 11.7
        route = find_route(
            town, name, start, EGO_ROUTE_M, rng, likes=_weigh_ego_lane, change_chance=theme.change_chance
        )
        if route is None:
            continue
        stretches, (nearest, farthest) = build_stretches(town, *route), _HALT_AHEAD_M[programme.light]
        halts = [part.end_m for part in stretches if part.lane.name in town.signals and part.end_m > 0]
        if nearest <= min(halts, default=0.0 if np.isinf(nearest) else -1.0) <= farthest and theme.fits(stretches):
            return route
    return None


def _weigh_ego_lane(lane: TownLane) -> float:
    return 0.0 if lane.role is LaneRole.CAR_PARK else 1.0


def compute_route_points(town: Town, legs: list[RouteLeg], start_m: float, length_m: float) -> Floats:
    """(K, 2) points of a route, about 2 m apart, from its start for a length."""
    lines = [town.lanes[leg.lane].line for leg in legs]
    line = np.concatenate(lines)
    along = compute_lengths(line) - start_m
    return np.asarray(line[(along >= 0) & (along <= length_m)])
