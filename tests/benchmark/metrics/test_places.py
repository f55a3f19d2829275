"""Where something happens, on the embedded town and on hand-made maps."""

import time
from collections.abc import Iterable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon

from benchmark.geometry import Floats, to_global
from benchmark.metrics.places import PlaceKind, classify_place, find_rings
from benchmark.road_map import Lane, RoadMap, as_multipolygon
from generation.sources.town.network import LaneRole, Town, TownLane, TownNodeKind
from generation.sources.town.towns import build_town
from tests.hand_made import straight_road


def box(x: float, y: float, yaw: float = 0.0) -> Floats:
    return np.array([x, y, 4.6, 1.9, yaw])


def on(line: Floats, share: float) -> Floats:
    """A car on a lane, part of the way along it."""
    index = min(int(share * (len(line) - 1)), len(line) - 2)
    step = line[index + 1] - line[index]
    return box(float(line[index, 0]), float(line[index, 1]), float(np.arctan2(step[1], step[0])))


def line_map(lines: dict[str, Floats], links: Iterable[tuple[str, str]] = (), **layers: object) -> RoadMap:
    """Lanes along lines, and nothing else unless given."""
    linked, lanes = tuple(links), {}
    for name, line in lines.items():
        following = tuple(after for before, after in linked if before == name)
        lanes[name] = Lane(name, line, None, following, tuple(b for b, after in linked if after == name), False)
    return replace(RoadMap("nowhere", as_multipolygon(shapely.box(0, 0, 1, 1)), lanes=lanes), **layers)  # type: ignore[arg-type]


def straight(start: tuple[float, float], end: tuple[float, float]) -> Floats:
    return np.linspace(start, end, 41)


def arc(radius: float, begin: float, end: float, center: tuple[float, float] = (0.0, 0.0)) -> Floats:
    angle = np.linspace(begin, end, 41)
    return np.asarray(np.array(center) + radius * np.column_stack([np.cos(angle), np.sin(angle)]))


@pytest.fixture(scope="module", params=("boston-seaport", "singapore-onenorth"))
def town(request: pytest.FixtureRequest) -> Town:
    return build_town(request.param, 0)


def test_the_town_has_one_roundabout_and_it_is_found(town: Town) -> None:
    (center,) = [node.position for node in town.layout.nodes.values() if node.kind is TownNodeKind.ROUNDABOUT]
    found = list(find_rings(town.road_map.lanes))
    assert found
    for ring in found:
        assert float(np.hypot(*(np.array(ring.centroid.coords[0]) - center))) < 1.0
        assert ring.area == pytest.approx(np.pi * 15.0**2, rel=0.02)


def test_lanes_of_the_town_are_named_by_what_they_are(town: Town) -> None:
    def place(lane: TownLane, share: float = 0.5) -> PlaceKind:
        return classify_place(town.road_map, on(lane.line, share), on(lane.line, share))

    nodes, on_roads, loops = town.layout.nodes, set(), 0
    expected = {TownNodeKind.ROUNDABOUT: PlaceKind.ROUNDABOUT, TownNodeKind.CROSSING: PlaceKind.JUNCTION}
    for lane in town.lanes.values():
        if lane.role is LaneRole.CAR_PARK:
            loops += 1
            assert {place(lane, share) for share in (0.2, 0.5, 0.8)} == {PlaceKind.CAR_PARK}, lane.name
        elif lane.road in nodes and nodes[lane.road].kind in expected:
            assert place(lane) is expected[nodes[lane.road].kind], lane.name
        elif lane.role is LaneRole.ROAD and np.hypot(*np.diff(lane.line, axis=0).T).sum() > 40.0:
            # Middles of long lanes, away from junctions.
            on_roads.add(place(lane))
    assert loops and on_roads <= {PlaceKind.BEND, PlaceKind.STRAIGHT} and PlaceKind.STRAIGHT in on_roads


def test_either_body_in_a_junction_counts() -> None:
    road_map, surface = straight_road(), shapely.box(190.0, 190.0, 210.0, 210.0)
    segments = {**road_map.road_segments, "junction": surface}
    road_map = replace(road_map, road_segments=segments, intersections=frozenset({"junction"}))
    outside, inside = box(180.0, 198.25), box(192.0, 198.25)
    assert classify_place(road_map, outside, outside) is PlaceKind.STRAIGHT
    assert classify_place(road_map, outside, inside) is PlaceKind.JUNCTION
    assert classify_place(road_map, inside, outside) is PlaceKind.JUNCTION


def test_without_junction_surfaces_crossing_lanes_tell() -> None:
    lines = {"a": np.repeat(straight((-40, 0), (40, 0)), 2, axis=0), "b": straight((3, -40), (3, 40))}
    assert classify_place(line_map(lines), box(0, 0), box(0, 0)) is PlaceKind.JUNCTION
    assert classify_place(line_map(lines), box(-20, 0), box(-20, 0)) is PlaceKind.STRAIGHT
    assert classify_place(line_map(lines), box(-20, 0), box(-4, 0)) is PlaceKind.JUNCTION


def test_lanes_that_part_or_merge_are_no_junction() -> None:
    parting = {"before": straight((-40, 0), (0, 0)), "on": straight((0, 0), (40, 0)), "off": straight((0, 0), (30, 20))}
    mapped = line_map(parting, [("before", "on"), ("before", "off")])
    assert classify_place(mapped, box(0, 0), box(2, 0)) is PlaceKind.STRAIGHT


def test_an_empty_map_and_a_place_without_lanes_are_unknown() -> None:
    assert classify_place(line_map({}), box(0, 0), box(1, 1)) is PlaceKind.UNKNOWN
    lanes = {"a": straight((-40, 0), (40, 0))}
    assert classify_place(line_map(lanes), box(0, 30), box(0, 30)) is PlaceKind.UNKNOWN
    # A lane that leads elsewhere is not the ego's.
    assert classify_place(line_map(lanes), box(0, 0, np.pi), box(0, 0)) is PlaceKind.UNKNOWN


@pytest.mark.parametrize(
    ("radius", "place"), [(30.0, PlaceKind.BEND), (90.0, PlaceKind.BEND), (200.0, PlaceKind.STRAIGHT)]
)
@pytest.mark.parametrize("pieces", [1, 4])
def test_bends_are_told_by_radius_however_the_lane_is_cut(radius: float, place: PlaceKind, pieces: int) -> None:
    span = 60.0 / radius
    edges = np.linspace(-np.pi / 2, -np.pi / 2 + span, pieces + 1)
    lines = {f"lane-{index}": arc(radius, edges[index], edges[index + 1]) for index in range(pieces)}
    mapped = line_map(lines, [(f"lane-{index}", f"lane-{index + 1}") for index in range(pieces - 1)])
    for share in (0.4, 0.5, 0.6):
        angle = -np.pi / 2 + share * span
        car = box(radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2)
        assert classify_place(mapped, car, car) is place


@pytest.mark.parametrize("radius", [6.0, 35.0])
@pytest.mark.parametrize("clockwise", [False, True])
def test_a_ring_of_lanes_is_a_roundabout_either_way_round(radius: float, clockwise: bool) -> None:
    sign = -1.0 if clockwise else 1.0
    quarters = np.linspace(0.0, sign * 2 * np.pi, 5)
    lines = {f"ring-{index}": arc(radius, quarters[index], quarters[index + 1]) for index in range(4)}
    lines["in"] = straight((radius + 40.0, 0.0), (radius, 0.0))
    links = [(f"ring-{index}", f"ring-{(index + 1) % 4}") for index in range(4)]
    mapped = line_map(lines, [*links, ("in", "ring-0")])
    near, far = box(radius + 3.0, 0.0, np.pi), box(radius + 20.0, 0.0, np.pi)
    assert classify_place(mapped, near, near) is PlaceKind.ROUNDABOUT
    assert classify_place(mapped, far, far) is not PlaceKind.ROUNDABOUT
    (ring,) = find_rings(mapped.lanes)
    assert ring.area == pytest.approx(np.pi * radius**2, rel=0.05)


def block(side: float, corner: float) -> dict[str, Floats]:
    """A closed way round a block with rounded corners."""
    half, lines = 0.5 * side, {}
    for index in range(4):
        turn = np.array([0.0, 0.0, index * np.pi / 2])
        lines[f"{index}-street"] = to_global(straight((corner - half, -half), (half - corner, -half)), turn)
        corner_arc = arc(corner, -np.pi / 2, 0.0, (half - corner, corner - half))
        lines[f"{index}-turn"] = to_global(corner_arc, turn)
    return lines


def test_streets_round_a_block_and_going_back_and_forth_between_two_turning_places_are_no_roundabout() -> None:
    back_and_forth = {
        "there": straight((-30, -3), (30, -3)), "turn": arc(3.0, -np.pi / 2, np.pi / 2, (30.0, 0.0)),
        "back": straight((30, 3), (-30, 3)), "again": arc(3.0, np.pi / 2, 3 * np.pi / 2, (-30.0, 0.0)),
    }  # fmt: skip
    blocks = (block(side, corner) for side, corner in ((60.0, 8.0), (50.0, 12.0), (30.0, 5.0), (40.0, 10.0)))
    for lines in (back_and_forth, *blocks):
        names = [*lines]
        assert not list(find_rings(line_map(lines, list(zip(names, [*names[1:], names[0]], strict=True))).lanes))


def test_a_lane_that_follows_itself_or_is_missing_does_no_harm() -> None:
    lines = {"a": straight((-10, 0), (10, 0)), "ring": arc(10.0, 0.0, 2 * np.pi, (40.0, 0.0))}
    mapped = line_map(lines, [("a", "a"), ("a", "gone"), ("gone", "a"), ("ring", "ring")])
    assert [ring.area for ring in find_rings(mapped.lanes)] == [pytest.approx(np.pi * 100.0, rel=0.02)]
    assert classify_place(mapped, box(0, 0), box(0, 0)) is PlaceKind.STRAIGHT


def test_many_short_lanes_that_part_and_merge_take_no_time() -> None:
    lines, links = {}, []
    for row, side in product(range(25), "ab"):
        lines[f"{row:02d}{side}"] = straight((5.0 * row, 0), (5.0 * row + 5, 0))
        links += [(f"{row:02d}{side}", f"{row + 1:02d}{other}") for other in "ab"]
    begin = time.process_time()
    assert not list(find_rings(line_map(lines, links).lanes))
    assert time.process_time() - begin < 5.0


def test_a_parking_strip_on_a_road_is_not_a_car_park() -> None:
    road, strip = shapely.box(-50, -5, 50, 5), shapely.box(-50, 3, 50, 8)
    mapped = line_map({"a": straight((-40, 0), (40, 0))}, road_segments={"road": road}, carparks={"strip": strip})
    assert classify_place(mapped, box(0, 4), box(0, 0)) is PlaceKind.STRAIGHT
    assert classify_place(mapped, box(0, 4), box(0, 6.5)) is PlaceKind.CAR_PARK


@settings(max_examples=10, deadline=None)
@given(angle=st.floats(-np.pi, np.pi), x=st.floats(-500, 500), y=st.floats(-500, 500), mirrored=st.booleans())
def test_moving_turning_and_mirroring_the_world_change_nothing(
    angle: float, x: float, y: float, mirrored: bool
) -> None:
    lines = {
        "a": straight((-40, 0), (40, 0)),
        "b": straight((20, -40), (20, 40)),
        "ring": arc(12.0, 0.0, 2 * np.pi, (80.0, 0.0)),
        "bend": arc(30.0, 0.0, 1.5, (-100.0, 0.0)),
    }
    flip = np.array([1.0, -1.0 if mirrored else 1.0])
    pose = np.array([x, y, angle])
    mapped = line_map({name: to_global(line * flip, pose) for name, line in lines.items()}, [("ring", "ring")])
    cars = {
        PlaceKind.STRAIGHT: box(-20, 0),
        PlaceKind.JUNCTION: box(18, 0),
        PlaceKind.ROUNDABOUT: box(66, 0),
        PlaceKind.BEND: on(lines["bend"], 0.5),
    }
    for place, car in cars.items():
        center = to_global(car[:2] * flip, pose)
        moved = np.array([*center, *car[2:4], flip[1] * car[4] + angle])
        assert classify_place(mapped, moved, moved) is place


def test_surfaces_count_their_inside_only_and_a_road_that_is_not_called_a_junction_is_none() -> None:
    ring_road = Polygon(shapely.box(-20, -20, 20, 20).exterior, [shapely.box(-5, -5, 5, 5).exterior])
    lines = {"a": straight((-40, 0), (40, 0))}
    mapped = line_map(lines, road_segments={"j": ring_road}, intersections=frozenset({"j"}))
    assert classify_place(mapped, box(10, 0), box(10, 0)) is PlaceKind.JUNCTION
    assert classify_place(mapped, box(0, 0), box(0, 0)) is PlaceKind.STRAIGHT
    crossing = {**lines, "b": straight((0, -40), (0, 40))}
    mapped = line_map(crossing, road_segments={"road": shapely.box(-50, -50, 50, 50)})
    assert classify_place(mapped, box(0, 0), box(0, 0)) is PlaceKind.STRAIGHT
