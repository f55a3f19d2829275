"""The drivable area as a grid, against the point test of every node."""

import numpy as np
import pytest
import shapely
from shapely.geometry import MultiPolygon

from benchmark.geometry import Bools, Floats, to_global
from benchmark.road_map import DrivableRaster, RoadMap, as_multipolygon
from generation.sources.town import build_town_scene


def slow_cells(road_map: RoadMap, pose: Floats, half_extent_m: float, resolution_m: float) -> Bools:
    """Node after node."""
    count = round(2 * half_extent_m / resolution_m)
    cells = np.zeros((count, count), np.bool_)
    for right in range(count):
        for forward in range(count):
            ahead, aside = forward * resolution_m - half_extent_m, right * resolution_m - half_extent_m
            cells[right, forward] = road_map.is_drivable(to_global(np.array([ahead, -aside]), pose))
    return cells


def scattered(seed: int) -> MultiPolygon:
    """Roads, slivers, specks smaller than any block, and holes of all these kinds."""
    rng = np.random.default_rng(seed)
    shapes = []
    for _ in range(40):
        middle, turn = rng.uniform(-25.0, 25.0, 2), rng.uniform(0.0, np.pi)
        length, width = rng.choice([0.3, 3.0, 30.0]), rng.choice([0.05, 0.6, 6.0])
        box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
        shapes.append(shapely.affinity.translate(shapely.affinity.rotate(box, turn, use_radians=True), *middle))
    added, cut = shapely.union_all(shapes[::2]), shapely.union_all(shapes[1::2])
    return as_multipolygon(shapely.difference(added, cut))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("half_extent_m", "resolution_m"), [(16.0, 0.5), (15.5, 1.0), (7.0, 0.4)])
def test_every_node_is_as_the_point_test_says(seed: int, half_extent_m: float, resolution_m: float) -> None:
    road_map = RoadMap("nowhere", scattered(seed))
    shapely.prepare(road_map.drivable_area)
    pose = np.array([1.3, -2.1, 0.7 * seed])
    raster = DrivableRaster.around(road_map, pose, half_extent_m=half_extent_m, resolution_m=resolution_m)
    assert np.array_equal(raster.cells, slow_cells(road_map, pose, half_extent_m, resolution_m))
    assert 0.0 < raster.cells.mean() < 1.0


def test_nodes_of_the_town() -> None:
    scene = build_town_scene("val", 0)
    shapely.prepare(scene.road_map.drivable_area)
    pose = scene.ego.pose[100]
    raster = DrivableRaster.around(scene.road_map, pose, half_extent_m=30.0, resolution_m=1.0)
    assert np.array_equal(raster.cells, slow_cells(scene.road_map, pose, 30.0, 1.0))


@pytest.mark.parametrize("area", [MultiPolygon(), MultiPolygon([shapely.box(-99.0, -99.0, 99.0, 99.0)])])
def test_nothing_and_everything(area: MultiPolygon) -> None:
    raster = DrivableRaster.around(RoadMap("nowhere", area), np.array([0.0, 0.0, 0.3]))
    assert raster.cells.all() == bool(area.area) and raster.cells.any() == bool(area.area)
