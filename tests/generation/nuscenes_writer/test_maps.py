"""Arc-line paths, map merging, masks."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.datasets.map_layers import read_road_map
from benchmark.geometry import Floats
from benchmark.machine.storage import write_json
from benchmark.road_map import DividerKind, Lane, RoadMap, as_multipolygon
from generation.nuscenes_writer.expansion import build_map_expansion, fit_arcline_path
from generation.nuscenes_writer.maps import draw_drivable_mask
from generation.nuscenes_writer.road_maps import merge_road_maps, pack_road_map, unpack_road_map
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root
from tests.hand_made import straight_road


def discretized(centerline: Floats) -> Floats:
    from nuscenes.map_expansion.arcline_path_utils import discretize_lane

    return np.array(discretize_lane(fit_arcline_path(centerline), 0.25), np.float64)


def clothoid(curvatures: list[float], step_m: float) -> Floats:
    """A path whose curvature runs through the given values."""
    curvature = np.interp(np.linspace(0, len(curvatures) - 1, 80), np.arange(len(curvatures)), curvatures)
    heading = np.cumsum(curvature * step_m)
    return np.asarray(np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]) * step_m, axis=0) + 500.0)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-0.15, 0.15), min_size=2, max_size=6), st.floats(0.2, 3.0))
def test_arcs_follow_any_road(curvatures: list[float], step_m: float) -> None:
    centerline = clothoid(curvatures, step_m)
    poses = discretized(centerline)
    line, found = shapely.LineString(centerline), shapely.LineString(poses[:, :2])
    assert shapely.distance(shapely.points(poses[:, :2]), line).max() < 0.1
    assert shapely.distance(shapely.points(centerline), found).max() < 0.1
    assert np.abs(poses[[0, -1], :2] - centerline[[0, -1]]).max() < 0.01


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=2, max_size=8))
def test_arcs_follow_any_polyline(points: list[tuple[float, float]]) -> None:
    centerline = np.array(points)
    paths = fit_arcline_path(centerline)
    if not paths:
        return
    joints = [path["start_pose"][:2] for path in paths[1:]]
    assert joints == [path["end_pose"][:2] for path in paths[:-1]]
    poses = discretized(centerline)
    moved = np.concatenate([[True], np.abs(np.diff(centerline, axis=0)).max(axis=1) > 1e-6])
    assert shapely.distance(shapely.points(poses[:, :2]), shapely.LineString(centerline[moved])).max() < 0.1


def test_a_circular_arc_is_few_pieces_with_the_right_headings() -> None:
    angle = np.linspace(0, np.pi / 2, 60)
    centerline = 20.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    paths = fit_arcline_path(centerline)
    assert len(paths) <= 2
    assert paths[0]["radius"] == pytest.approx(20.0, abs=0.05)
    assert paths[0]["start_pose"][2] == pytest.approx(0.0, abs=0.02)
    assert paths[-1]["end_pose"][2] == pytest.approx(np.pi / 2, abs=0.02)
    assert len(fit_arcline_path(np.column_stack([np.linspace(0, 400, 41), np.zeros(41)]))) == 1
    assert fit_arcline_path(np.full((5, 2), 3.0)) == []


def test_packing_is_exact() -> None:
    packed = pack_road_map(straight_road())
    again = unpack_road_map(packed)
    assert pack_road_map(again) == packed
    assert again.drivable_area.equals(straight_road().drivable_area)


def test_merging_pieces_gives_the_whole() -> None:
    whole = straight_road()
    pieces = [whole.near((0.0, 150.0, 220.0, 250.0)), whole.near((180.0, 150.0, 400.0, 250.0))]
    joined = merge_road_maps(pieces)
    assert set(joined.lanes) == set(whole.lanes)
    assert joined.drivable_area.symmetric_difference(whole.drivable_area).area < 0.01
    assert set(joined.ped_crossings) == {"crossing"}
    assert len(joined.dividers) == 3
    assert joined.canvas_m == whole.canvas_m


def test_a_canvas_is_made_where_the_source_has_none() -> None:
    road = RoadMap("boston-seaport", as_multipolygon(shapely.box(10, 10, 50.5, 30.2)))
    assert merge_road_maps([road]).canvas_m == (51.0, 31.0)
    assert merge_road_maps([RoadMap("boston-seaport", shapely.MultiPolygon())]).canvas_m == (1.0, 1.0)


def test_mask_has_holes_and_north_up() -> None:
    ring = shapely.box(10, 10, 90, 90).difference(shapely.box(30, 30, 60, 60))
    road = RoadMap("boston-seaport", as_multipolygon(ring), canvas_m=(100.0, 120.0))
    image = cv2.imdecode(np.frombuffer(draw_drivable_mask(road), np.uint8), cv2.IMREAD_UNCHANGED)
    assert image.shape == (1200, 1000)
    assert set(np.unique(image)) == {0, 255}
    assert (image[1200 - 200, 200], image[1200 - 450, 450], image[1200 - 950, 200]) == (255, 0, 0)
    assert (image == 255).mean() == pytest.approx(ring.area / 12000, abs=0.005)


def test_expansion_round_trip_with_connectors_and_bare_lanes(tmp_path: Path) -> None:
    road = straight_road()
    turn = np.column_stack([np.linspace(100, 110, 20), 194.75 + np.linspace(0, 3.16, 20) ** 2])
    bare = Lane("bare", turn, None, ("east-0",), ("elsewhere",), False)
    connector = Lane("turn", turn, None, ("east-0",), ("bare", "west-0"), True)
    lanes = {**road.lanes, "bare": bare, "turn": connector, "dot": Lane("dot", turn[[0, 0]], None, (), (), False)}
    painted = tuple(
        type(divider)(divider.identifier, divider.line, kind, divider.between_directions)
        for divider, kind in zip(
            road.dividers, (DividerKind.DASHED_YELLOW, DividerKind.SOLID_WHITE, DividerKind.UNPAINTED)
        )
    )
    write_json(
        tmp_path / "boston-seaport.json",
        build_map_expansion(RoadMap("boston-seaport", road.drivable_area, lanes, painted, canvas_m=(400.0, 400.0))),
    )
    found = read_road_map(tmp_path / "boston-seaport.json")
    assert set(found.lanes) == {*road.lanes, "bare", "turn"}
    assert found.lanes["turn"].is_connector
    assert not found.lanes["bare"].is_connector
    assert found.lanes["turn"].successors == ("east-0",)
    assert found.lanes["bare"].predecessors == ()
    surface = found.lanes["bare"].polygon
    assert surface is not None
    assert surface.contains(shapely.Point(turn[10]))
    assert {divider.identifier: divider.kind for divider in found.dividers} == {
        divider.identifier: divider.kind for divider in painted
    }


def test_all_four_cities_have_a_map(tmp_path: Path) -> None:
    from nuscenes.map_expansion.map_api import NuScenesMap

    write_root(tmp_path, [short_scene()])
    maps = {city: NuScenesMap(dataroot=str(tmp_path), map_name=city) for city in OFFICIAL_LOCATIONS}
    assert {city for city, found in maps.items() if found.node} == {"boston-seaport"}
    # Where there is a map of a city, nothing empty takes its place.
    path = tmp_path / "maps" / "expansion" / "singapore-queenstown.json"
    path.write_text('{"version": "1.4"}')
    write_root(tmp_path, [short_scene()])
    assert path.read_text() == '{"version": "1.4"}'
