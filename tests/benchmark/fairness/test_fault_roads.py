"""Roads of fault attribution: places beside lanes, turns, ends, signs, rings, handedness, and what maps give."""

import numpy as np
import pytest
from shapely.geometry import MultiPolygon, box

from benchmark.fairness.fault_roads import FaultRoads, RoadLane, derive_handedness, find_handedness
from benchmark.road_map import Handedness, Lane, RoadMap
from tests.benchmark.fairness.made_roads import EAST, LANE_M, lane, ring_lanes, straight_road, t_junction


def mirrored(roads: FaultRoads) -> FaultRoads:
    return FaultRoads(
        [
            RoadLane(
                part.identifier,
                part.centerline * [1.0, -1.0],
                None,
                part.width_m,
                part.successors,
                part.is_junction,
            )
            for part in roads.lanes
        ]
    )


def test_a_place_beside_a_lane_with_and_without_a_surface() -> None:
    roads = FaultRoads([lane("plain", [(0, 0), (10, 0)]), lane("bare", [(10, 0), (20, 0)], junction=True)])
    places = roads.locate(np.array([[5.0, 1.0], [12.0, -2.75], [21.0, 0.0]]), [0, 1])
    assert places.outside[0, 0] == pytest.approx(-0.75) and places.outside[1, 1] == pytest.approx(1.0)
    assert places.offset[:2].diagonal() == pytest.approx([1.0, -2.75])
    assert places.station[1, 1] == pytest.approx(2.0) and places.beyond[2].all()
    assert places.in_strip.tolist() == [[True, False], [False, False], [False, False]]
    assert roads.locate(np.zeros((2, 2)), []).outside.shape == (2, 0)


def test_an_empty_map_and_lanes_without_length_are_no_lanes() -> None:
    roads = FaultRoads([RoadLane("dot", np.zeros((2, 2)), None, 3.5, ("dot",), True)])
    assert roads.lanes == () and roads.near(np.zeros((1, 2)), 5.0).tolist() == []
    assert derive_handedness(roads) is None and roads.drivable_area is None


def test_turns_road_ends_and_signs() -> None:
    roads = t_junction(sign="YIELD", light="TRAFFIC_LIGHT")
    turn = {name: float(np.rad2deg(roads.turn[number])) for name, number in roads.index.items()}
    assert turn["w-e"] == 0.0 and turn["s-w"] > 30 and turn["s-e"] < -30
    ends = {name for name, number in roads.index.items() if roads.lanes[number].is_junction and roads.is_stem(number)}
    assert ends == {"s-w", "s-e"}
    assert roads.find_sign(roads.index["s-w"]) == "give" and roads.find_sign(roads.index["w-e"]) == "light"
    assert roads.find_sign(roads.index["e-w"]) is None
    assert t_junction(sign="TURN_STOP").find_sign(0) is None
    far = FaultRoads(
        [lane("in", [(-50, 0), (0, 0)], "on"), lane("on", [(0, 0), (9, 0)], junction=True)],
        stop_lines=[(box(-12, -2, -11, 2), "YIELD")],
    )
    assert far.find_sign(1) is None


def test_the_region_ahead_goes_as_far_as_one_drove() -> None:
    roads = t_junction()
    names = [roads.lanes[number].identifier for number in roads.reach_ahead(roads.index["w-in"], 85.0, 6.0)]
    assert set(names) == {"w-in", "w-e", "w-s"}
    assert roads.reach_ahead(roads.index["w-in"], 0.0, 6.0) == [roads.index["w-in"]]


@pytest.mark.parametrize(
    ("lanes", "is_ring"),
    [
        (ring_lanes(12.0), True),
        (ring_lanes(12.0, turn=-1), False),
        (ring_lanes(40.0), False),
        (ring_lanes(12.0, squeeze=0.3), False),
        (ring_lanes(12.0)[:3], False),
    ],
)
def test_a_ring_is_short_and_round_and_turns_to_the_far_side(lanes: list[RoadLane], is_ring: bool) -> None:
    every = np.arange(len(lanes))
    assert FaultRoads(lanes).are_rings(every, Handedness.RIGHT).tolist() == [is_ring] * len(lanes)
    roads = FaultRoads(lanes)
    assert mirrored(roads).are_rings(every, Handedness.LEFT).tolist() == [is_ring] * len(lanes)


def test_handedness_is_given_or_of_the_lanes_or_of_the_place() -> None:
    right = straight_road()
    left = mirrored(right)
    assert derive_handedness(right) is Handedness.RIGHT and derive_handedness(left) is Handedness.LEFT
    assert find_handedness("singapore-onenorth", right) is Handedness.RIGHT
    assert find_handedness("singapore-onenorth", right, Handedness.LEFT) is Handedness.LEFT
    assert find_handedness("singapore-onenorth", None) is Handedness.LEFT
    assert find_handedness("boston-seaport", FaultRoads([])) is Handedness.RIGHT
    assert find_handedness("nowhere", None) is Handedness.RIGHT


def test_widths_of_a_map_are_of_surfaces_and_of_neighbours() -> None:
    def part(name: str, x: float, half_m: float | None, before: tuple[str, ...], after: tuple[str, ...]) -> Lane:
        line = np.array([[x, EAST], [x + 10.0, EAST]])
        surface = None if half_m is None else box(x, EAST - half_m, x + 10.0, EAST + half_m)
        return Lane(name, line, surface, after, before, half_m is None)

    lanes = [
        part("narrow", 0.0, 1.5, (), ("between",)),
        part("between", 10.0, None, ("narrow",), ("wide", "absent")),
        part("wide", 20.0, 2.25, ("between",), ("beyond",)),
        part("beyond", 30.0, None, ("wide",), ("widest",)),
        part("widest", 40.0, 5.0, ("beyond",), ()),
        part("alone", 60.0, None, (), ()),
    ]
    road_map = RoadMap(
        "place",
        MultiPolygon([box(0, -5, 50, 0)]),
        {each.identifier: each for each in lanes},
        stop_lines={"stop": box(9, -4, 10, 0), "other": box(29, -4, 30, 0)},
        stop_line_types={"stop": "STOP_SIGN"},
    )
    roads = FaultRoads.of(road_map)
    widths = dict(zip((part.identifier for part in roads.lanes), roads.width.round(6).tolist(), strict=True))
    assert widths == {"narrow": 3.0, "between": 3.75, "wide": 4.5, "beyond": 4.5, "widest": 10.0, "alone": LANE_M}
    assert roads.find_sign(roads.index["between"]) == "give" and roads.find_sign(roads.index["beyond"]) is None
    assert roads.walkways is None and roads.drivable_area is not None
