from collections.abc import Iterable

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Polygon

from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.geometry import wrap_angle
from benchmark.road_map import DividerKind
from generation.sources.town.curves import build_turn, compute_headings, compute_lengths
from generation.sources.town.network import LaneRole, Town, TownNodeKind
from generation.sources.town.towns import build_town

LOCATIONS = OFFICIAL_LOCATIONS


@pytest.fixture(scope="module", params=LOCATIONS)
def town(request: pytest.FixtureRequest) -> Town:
    return build_town(request.param, 0)


def _covered(town: Town, shapes: Iterable[Polygon]) -> list[float]:
    drivable = town.road_map.drivable_area.buffer(0.02)
    return [shape.difference(drivable).area for shape in shapes]


def test_coordinates_are_positive_and_inside_the_canvas(town: Town) -> None:
    x_min, y_min, x_max, y_max = town.road_map.drivable_area.bounds
    assert x_min > 0 and y_min > 0
    assert x_max < town.road_map.canvas_m[0] and y_max < town.road_map.canvas_m[1]


def test_drivable_area_is_one_valid_piece_that_covers_every_lane(town: Town) -> None:
    drivable = town.road_map.drivable_area
    assert drivable.is_valid and len(drivable.geoms) == 1
    polygons = [lane.polygon for lane in town.road_map.lanes.values() if lane.polygon is not None]
    assert max(_covered(town, polygons)) < 1e-3
    assert max(_covered(town, town.road_map.road_segments.values())) < 1e-3
    assert max(_covered(town, town.road_map.carparks.values())) < 1e-3


def test_drivable_area_has_holes_only_where_blocks_and_islands_are(town: Town) -> None:
    holes = [Polygon(ring) for part in town.road_map.drivable_area.geoms for ring in part.interiors]
    assert len(holes) == 5  # four blocks and the island of the roundabout
    assert min(hole.area for hole in holes) > 300.0


def test_lane_seams_are_drivable_across_the_whole_lane(town: Town) -> None:
    for name, followers in town.successors.items():
        for follower in followers:
            seam, heading = town.lanes[follower].line[0], compute_headings(town.lanes[follower].line)[0]
            across = np.linspace(-1.6, 1.6, 9)[:, None] * np.array([-np.sin(heading), np.cos(heading)])
            for ahead in (-0.3, 0.0, 0.3):
                points = seam + across + ahead * np.array([np.cos(heading), np.sin(heading)])
                assert town.road_map.is_drivable(points).all(), (name, follower)


def test_lanes_meet_end_to_start_with_the_same_heading(town: Town) -> None:
    for name, followers in town.successors.items():
        for follower in followers:
            first, second = town.lanes[name].line, town.lanes[follower].line
            assert np.hypot(*(first[-1] - second[0])) < 1e-6
            assert abs(wrap_angle(compute_headings(first)[-1] - compute_headings(second)[0])) < np.deg2rad(4.0), (
                name,
                follower,
            )


def test_connectivity_is_mutual_and_complete(town: Town) -> None:
    lanes = town.road_map.lanes
    for lane in lanes.values():
        assert all(lane.identifier in lanes[name].predecessors for name in lane.successors)
        assert all(lane.identifier in lanes[name].successors for name in lane.predecessors)
    edge = {road.name for road in town.layout.roads.values() for end in road.ends if end.startswith("X")}
    loose = {lane.road for lane in town.lanes.values() if not town.successors[lane.name]}
    loose |= {lane.road for lane in town.lanes.values() if not town.predecessors[lane.name]}
    assert loose == edge


def _onwards(town: Town, name: str) -> tuple[str, ...]:
    return town.successors[name] + town.lanes[name].siblings


def test_every_lane_can_be_reached_by_following_and_changing_lanes(town: Town) -> None:
    roads = [
        name for name, lane in town.lanes.items() if lane.role in (LaneRole.ROAD, LaneRole.RING, LaneRole.CAR_PARK)
    ]
    inner = [name for name in roads if town.successors[name] and town.predecessors[name]]
    for start in (inner[0], inner[-1]):
        reached, waiting = {start}, [start]
        while waiting:
            for name in _onwards(town, waiting.pop()):
                if name not in reached:
                    reached.add(name)
                    waiting.append(name)
        assert set(inner) <= reached


def test_traffic_keeps_right_and_circulates_counter_clockwise(town: Town) -> None:
    for road in town.layout.roads.values():
        forward = LineString(town.lanes[f"{road.name}/f0"].line)
        middle = LineString(town.layout.roads[road.name].reference)
        point = forward.interpolate(0.5, normalized=True)
        along = middle.project(point)
        near, ahead = middle.interpolate(along), middle.interpolate(along + 1.0)
        cross = (ahead.x - near.x) * (point.y - near.y) - (ahead.y - near.y) * (point.x - near.x)
        assert cross < 0, road.name
    (center,) = [node for node in town.layout.nodes.values() if node.kind is TownNodeKind.ROUNDABOUT]
    for lane in town.lanes.values():
        if lane.role is LaneRole.RING:
            angle = np.unwrap(np.arctan2(*(lane.line - center.position)[:, ::-1].T))
            assert angle[-1] > angle[0]


def test_a_town_has_everything_that_scenes_need(town: Town) -> None:
    arms = {name: sum(name in road.ends for road in town.layout.roads.values()) for name in town.layout.nodes}
    crossings = sorted(arms[node.name] for node in town.layout.nodes.values() if node.kind is TownNodeKind.CROSSING)
    assert crossings[0] == 3 and crossings[-1] == 4
    assert {lane.role for lane in town.lanes.values()} == set(LaneRole)
    assert max(len(lane.siblings) for lane in town.lanes.values()) == 2
    kinds = {divider.kind for divider in town.road_map.dividers}
    assert kinds >= {DividerKind.DASHED_WHITE, DividerKind.SOLID_WHITE, DividerKind.SOLID_YELLOW}
    for layer in (
        town.road_map.ped_crossings,
        town.road_map.stop_lines,
        town.road_map.walkways,
        town.road_map.carparks,
    ):
        assert layer and all(shape.is_valid and not shape.is_empty for shape in layer.values())
    turns = [float(np.ptp(compute_headings(lane.line))) for lane in town.lanes.values() if lane.role is LaneRole.ROAD]
    assert max(turns) > np.deg2rad(80.0)


def test_pavements_do_not_overlap_the_road(town: Town) -> None:
    drivable = town.road_map.drivable_area
    assert max(shape.intersection(drivable).area for shape in town.road_map.walkways.values()) < 0.01


def test_pavements_are_valid_in_the_mirror_too() -> None:
    town = build_town("singapore-queenstown", 2)

    assert all(shape.is_valid for shape in town.shown_map.walkways.values())
    shapely.union_all([town.shown_map.drivable_area, *town.shown_map.walkways.values()])


def test_stop_lines_are_on_the_incoming_side(town: Town) -> None:
    for name, area in town.road_map.stop_lines.items():
        road, end = name.removeprefix("town0/").split("/")
        incoming = town.lanes[f"{road}/{'f' if end == 'end' else 'b'}0"]
        assert area.intersects(LineString(incoming.line))
        outgoing = town.lanes[f"{road}/{'b' if end == 'end' else 'f'}0"]
        assert not area.intersects(LineString(outgoing.line))


def test_connectors_are_no_tighter_than_a_car_can_steer(town: Town) -> None:
    for lane in town.lanes.values():
        curvature = np.abs(np.gradient(compute_headings(lane.line))) / np.gradient(compute_lengths(lane.line))
        assert curvature.max() < 1 / 5.0, lane.name


@settings(max_examples=20, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(10.0, 60.0), st.floats(10.0, 60.0), st.floats(-2.2, 2.2))
def test_turns_join_their_ends_smoothly(heading: float, first: float, second: float, change: float) -> None:
    start = np.array([100.0, 200.0])
    corner = start + first * np.array([np.cos(heading), np.sin(heading)])
    end = corner + second * np.array([np.cos(heading + change), np.sin(heading + change)])
    line = build_turn(start, heading, end, heading + change, step_m=0.5)
    assert np.allclose(line[0], start) and np.allclose(line[-1], end)
    steps = np.abs(np.diff(compute_headings(line)))
    assert steps.max() < 0.35
    # A corner of few degrees between legs of very different lengths is cut by next to nothing.
    assert compute_lengths(line)[-1] <= 1.001 * (first + second)
