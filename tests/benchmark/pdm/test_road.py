"""The road: what is on the route, intersections that maps do not name, borders."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely.geometry import MultiPolygon

from benchmark.pdm.road_polygons import (
    EXTENSION_M,
    RoadPolygons,
    SurfaceKind,
    build_road_polygons,
    build_route,
    derive_intersections,
    find_lanes_on_route,
    locate_on_road,
)
from benchmark.road_map import Lane, RoadMap
from tests.hand_made import straight_road

EAST = build_route(np.column_stack([np.linspace(50, 130, 100), np.full(100, 198.25), np.zeros(100)]))


def lane(name: str, *points: tuple[float, float], connector: bool = False, width_m: float | None = 3.5) -> Lane:
    line = np.array(points, np.float64)
    surface = None if width_m is None else shapely.LineString(line).buffer(width_m / 2, cap_style="flat")
    return Lane(name, line, surface, (), (), connector)


def crossing_map(*, named: bool = True) -> RoadMap:
    """Two one-way streets that cross at the origin; with or without the word that the middle is connectors."""
    lanes = (
        lane("west", (-60, 0), (-6, 0)),
        lane("east", (6, 0), (60, 0)),
        lane("south", (0, -60), (0, -6)),
        lane("north", (0, 6), (0, 60)),
        lane("straight-on", (-6, 0), (6, 0), connector=named, width_m=None if named else 3.5),
        lane("upwards", (0, -6), (0, 6), connector=named, width_m=None if named else 3.5),
    )
    area = shapely.union_all([shapely.box(-60, -3, 60, 3), shapely.box(-3, -60, 3, 60)])
    return RoadMap("boston-seaport", MultiPolygon([area]), {each.identifier: each for each in lanes})


def test_lanes_of_the_route_are_those_under_it_and_beside_it_in_its_direction() -> None:
    lanes = straight_road().lanes
    found = dict(zip(lanes, find_lanes_on_route(list(lanes.values()), EAST)))
    assert found == {"east-0": True, "east-1": True, "west-0": False, "west-1": False}


def test_thirty_metres_of_the_extension_make_lanes_lanes_of_the_route() -> None:
    end = EAST[len(EAST) - EXTENSION_M - 1]
    near, far = (lane("ahead", (end[0] + gap, end[1]), (end[0] + gap + 20, end[1])) for gap in (20, 40))
    across = lane("across", (end[0] - 10, end[1] - 20), (end[0] - 10, end[1] + 20))
    assert find_lanes_on_route([near, far, across], EAST).tolist() == [True, False, False]


def test_lanes_ahead_of_or_behind_others_are_not_beside_them() -> None:
    lanes = [lane("on", (50, 198.25), (100, 198.25)), lane("next", (140, 198.25), (150, 194.0))]
    assert find_lanes_on_route(lanes, EAST[:60]).tolist()[0] is True
    short = build_route(np.column_stack([np.linspace(50, 60, 20), np.full(20, 198.25), np.full(20, np.pi / 2)]))
    assert find_lanes_on_route(lanes, short).tolist() == [True, False]


@pytest.mark.parametrize("named", [True, False])
def test_a_map_without_intersections_gets_them_where_lanes_cross(named: bool) -> None:
    road_map = crossing_map(named=named)
    lanes = list(road_map.lanes.values())
    road = build_road_polygons(road_map, build_route(np.array([[-50.0, 0.0, 0.0], [50.0, 0.0, 0.0]])))
    (found,) = road.intersections
    assert found.contains(shapely.Point(0, 0)) and not found.intersects(shapely.Point(0, 20))
    assert 30.0 < found.area < 144.0
    assert not derive_intersections(road_map, lanes[:4], [each.polygon or shapely.Polygon() for each in lanes[:4]])


def test_a_map_with_road_segments_keeps_to_what_it_says_and_connectors_without_a_surface_are_strips() -> None:
    road_map = replace(crossing_map(), road_segments={"block": shapely.box(-60, -3, -6, 3)})
    assert build_road_polygons(road_map, EAST).intersections == ()
    road = build_road_polygons(crossing_map(), EAST)
    assert sorted(round(shape.area) for shape in road.lanes) == [42, 42, 189, 189, 189, 189]


def test_a_corner_on_a_border_is_outside() -> None:
    state = np.zeros((1, 1, 11))
    # The right corners of the car lie on the edge of the first area; 1 mm more holds them.
    for margin, outside in ((0.0, True), (1e-3, False)):
        area = shapely.box(-5, -1.85 / 2 - margin, 10, 5)
        road = RoadPolygons.of([(SurfaceKind.DRIVABLE_AREA, area, False), (SurfaceKind.LANE, area, True)])
        found = locate_on_road(road, state)
        assert bool(found.non_drivable[0, 0]) is outside and not found.oncoming[0, 0]


def test_a_slit_between_two_surfaces_is_not_drivable() -> None:
    halves, state = [shapely.box(-5, -5, 1.39, 5), shapely.box(1.39, -5, 10, 5)], np.zeros((1, 1, 11))
    state[0, 0, 0] = -4.084 / 2
    for areas, outside in ((halves, True), ([shapely.union_all(halves)], False)):
        road = RoadPolygons.of([(SurfaceKind.DRIVABLE_AREA, area, False) for area in areas])
        assert bool(locate_on_road(road, state).non_drivable[0, 0]) is outside
