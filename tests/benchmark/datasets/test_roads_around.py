"""Kerb lines and drivable cells around a sample: what is cut out, in which frame, and the shortcut beside them."""

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely.geometry.polygon import orient

from benchmark.datasets.sample_truth import LINE_POINTS, SampleRoads, SceneRoadSurfaces, compute_truth
from benchmark.geometry import to_global
from benchmark.road_map import RoadMap, as_multipolygon
from tests.hand_made import Car, scene_on_straight_road


def crossing() -> SceneRoadSurfaces:
    roads = [shapely.box(-300.0, -7.0, 300.0, 7.0), shapely.box(20.0, -90.0, 36.0, 90.0)]
    surface = as_multipolygon(shapely.union_all(roads).difference(shapely.Point(28.0, 0.0).buffer(2.0)))
    segments = {str(number): polygon for number, polygon in enumerate(surface.geoms)}
    return SceneRoadSurfaces(RoadMap("made-up", surface, road_segments=segments))


POSES = st.tuples(st.floats(-60, 60), st.floats(-12, 12), st.floats(-3.2, 3.2)).map(np.array)


@settings(max_examples=20, deadline=None)
@given(POSES)
def test_kerb_lines_are_the_edges_within_the_patch(pose: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
    surfaces = crossing()
    lines = SampleRoads(surfaces, pose).kerb_lines()
    patch = shapely.Polygon(to_global(np.array([[51.0, 24.8], [-51.0, 24.8], [-51.0, -24.8], [51.0, -24.8]]), pose))
    edges = surfaces.road_map.drivable_area.boundary.intersection(patch)
    # Whether an edge along the border of the patch is in it is for rounding to say.
    assume(edges.intersection(patch.boundary).length == 0.0)
    # Points lie on edges, at equal distances along each, and all edges are there.
    points = shapely.points(to_global(lines.astype(np.float64).reshape(-1, 2), pose))
    assert len(points) == 0 or shapely.distance(points, edges).max() < 1e-4
    whole = shapely.get_parts(shapely.line_merge(edges)) if not edges.is_empty else np.array([])
    if all(isinstance(part, shapely.LineString) for part in whole):
        assert len(lines) == len(whole)
        missed = [shapely.distance(part.interpolate(0.5, normalized=True), edges) for part in whole]
        assert max(missed, default=0.0) < 1e-6


def test_a_straight_kerb_has_twenty_points_at_equal_distances() -> None:
    lines = SampleRoads(crossing(), np.array([-150.0, 2.0, 0.0])).kerb_lines()
    assert lines.shape == (2, LINE_POINTS, 2) and lines.dtype == np.float32
    assert sorted({round(float(y), 4) for y in lines[..., 1].ravel()}) == [-9.0, 5.0]
    steps = np.abs(np.diff(lines[..., 0], axis=1))
    assert steps == pytest.approx(np.full_like(steps, 102.0 / 19), abs=1e-3)


def test_the_surface_is_on_the_right_of_its_edges() -> None:
    surfaces = crossing()
    rings = shapely.get_parts(surfaces.road_edges)
    assert [shapely.is_ccw(ring) for ring in rings] == [False, True]
    outline = orient(surfaces.road_map.drivable_area.geoms[0], -1.0)
    assert shapely.get_num_coordinates(surfaces.road_edges) == shapely.get_num_coordinates(outline)


@settings(max_examples=20, deadline=None)
@given(POSES, st.integers(0, 2**32))
def test_drivable_cells_are_where_the_map_is(pose: np.ndarray[tuple[int], np.dtype[np.float64]], seed: int) -> None:
    roads = SampleRoads(crossing(), pose)
    cells = roads.drivable_cells()
    places = np.random.default_rng(seed).uniform(-49.0, 49.0, (200, 2))
    column, row = np.round((places + 50.0) * 10.0).astype(int).T
    there = to_global(places, pose)
    area = roads.surfaces.road_map.drivable_area
    sure = shapely.distance(shapely.points(there), area.boundary) > 0.15
    inside = roads.surfaces.road_map.is_drivable(there)
    assert (cells[row, column].astype(bool) == inside)[sure].all()
    clear = roads.surely_drivable(places, 2.5)
    assert all(shapely.Point(place).buffer(2.4).within(area) for place in there[clear])
    far_inside = inside & (shapely.distance(shapely.points(there), area.boundary) > 2.6)
    assert clear[far_inside & (np.abs(places).max(axis=1) < 47.4)].all()


def test_a_long_drive_is_cut_from_the_same_map_however_it_began() -> None:
    shared, alone = crossing(), crossing()
    for x in np.linspace(-250.0, 250.0, 11):
        pose = np.array([x, 1.0, 0.1])
        first, second = (SampleRoads(surfaces, pose) for surfaces in (shared, alone))
        alone._near = None
        assert np.allclose(np.sort(first.kerb_lines(), axis=0), np.sort(second.kerb_lines(), axis=0), atol=1e-4)
        assert (first.drivable_cells() != second.drivable_cells()).sum() == 0


def test_samples_have_roads_poses_and_who_was_seen_before() -> None:
    scene = scene_on_straight_road((Car(x=75.0, y=200.0, speed=0.0), Car(x=90.0, y=200.0, speed=0.0)), seconds=5.0)
    scene.annotations.visibility[1] = 1
    truths = compute_truth(scene, [str(index) for index in range(len(scene.keyframes))])
    first = truths[0]
    assert first.roads is not None and first.axle_poses is not None and first.seen_before is not None
    assert first.seen_before.tolist() == [True, False]
    assert first.axle_poses == pytest.approx(scene.ego.pose[scene.keyframes[:7]])
    assert (first.axle_poses[1:] != first.axle_poses[0]).any()
    last = truths[-1].axle_poses
    assert last is not None and (last == last[0]).all()
    assert len(first.roads.kerb_lines()) and first.roads.drivable_cells().any()
    scene.annotations.visibility[1, 3:] = 4
    again = compute_truth(scene, [str(index) for index in range(len(scene.keyframes))])
    assert [bool(truth.seen_before is not None and truth.seen_before[1]) for truth in again[:5]] == [
        False, False, False, True, True,
    ]  # fmt: skip
