import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import shapely

from benchmark.datasets.map_layers import read_road_map
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.road_map import RoadMap
from generation.extensions.magicdrive.bev_map import MAP_CHANNELS, MapLayers, draw_clip_maps
from generation.extensions.magicdrive.clip import build_clip
from generation.nuscenes_writer.expansion import build_map_expansion
from generation.nuscenes_writer.road_maps import merge_road_maps, pack_road_map, unpack_road_map
from tests.generation.extensions.magicdrive.busy_scenes import busy_scene


def devkit_masks(root: Path, location: str, pose: Floats, monkeypatch: pytest.MonkeyPatch) -> Any:
    """What the devkit draws, as the model's data loader asks for it."""
    from nuscenes.map_expansion import map_api

    def strokes(lines: Any, mask: Any) -> Any:
        # The devkit's own loop over the parts of a line fails with shapely 2.
        for line in shapely.get_parts(lines):
            corners = np.asarray(line.coords, np.int32).reshape(-1, 2)
            cv2.polylines(mask, [corners], False, (1.0,), 2)
        return mask

    monkeypatch.setattr(map_api.NuScenesMapExplorer, "mask_for_lines", staticmethod(strokes))
    road_map = map_api.NuScenesMap(dataroot=str(root), map_name=location)
    angle = float(np.degrees(pose[2]))
    masks = road_map.get_map_mask((pose[0], pose[1], 100.0, 100.0), angle, list(MAP_CHANNELS), (200, 200))
    return masks.transpose(0, 2, 1).astype(bool)


def written(root: Path, road_map: RoadMap) -> Path:
    path = root / "maps" / "expansion" / f"{road_map.location}.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(build_map_expansion(road_map)))
    return path


def assert_alike(found: Bools, slow: Bools) -> None:
    differing = (found != slow).mean(axis=(1, 2))
    dividers = [MAP_CHANNELS.index(name) for name in ("road_divider", "lane_divider")]
    assert np.delete(differing, dividers).max() < 0.0002
    # Where a divider leaves the map its end lies on the border of a cell, and dust decides to which side it is cut.
    assert differing[dividers].max() < 0.005


@pytest.mark.parametrize("turn_deg", [0.0, 31.0, -117.0])
def test_every_channel_is_the_devkits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turn_deg: float) -> None:
    path = written(tmp_path, busy_scene().road_map)
    pose = np.array([61.3, 196.8, np.deg2rad(turn_deg)])
    found, slow = (
        MapLayers(read_road_map(path)).masks(pose),
        devkit_masks(tmp_path, "boston-seaport", pose, monkeypatch),
    )
    assert found.shape == slow.shape == (8, 200, 200)
    assert all(channel.any() for channel in found)
    assert_alike(found, slow)


def test_first_index_goes_right_and_second_ahead() -> None:
    road = RoadMap("boston-seaport", shapely.MultiPolygon([shapely.box(20.0, -10.0, 30.0, -5.0)]))
    # The car at the origin looks along +x: lidar x is global -y, lidar y is global +x.
    mask = MapLayers(road).masks(np.array([0.0, 0.0, -np.pi / 2]))[0]
    right, ahead = np.nonzero(mask)
    assert (right.min(), right.max()) == (110, 120) and (ahead.min(), ahead.max()) == (140, 160)


def test_islands_in_holes_survive() -> None:
    ring = shapely.box(-40, -40, 40, 40).difference(shapely.box(-20, -20, 20, 20))
    island = shapely.box(-5, -5, 5, 5)
    for order in ([ring, island], [island, ring]):
        mask = MapLayers(RoadMap("x", shapely.MultiPolygon(order))).masks(np.zeros(3))[0]
        assert mask[100, 100] and not mask[75, 75] and mask[40, 40]


def test_twice_the_cells_show_the_same() -> None:
    scene = busy_scene(9 / 12)
    pose = np.array([61.3, 196.8, 0.4])
    fine = MapLayers(scene.road_map).masks(pose, cells=400)
    coarse = MapLayers(scene.road_map).masks(pose)
    assert abs(fine.mean(axis=(1, 2)) - coarse.mean(axis=(1, 2)))[[0, 2, 4, 7]].max() < 0.01
    assert build_clip(scene, range(9), height=424, width=800).maps.shape == (9, 8, 400, 400)


def test_a_standing_car_sees_the_same_map() -> None:
    scene = busy_scene(9 / 12)
    lidar = np.tile(np.eye(4), (3, 1, 1))
    lidar[:, :2, 3] = [60.0, 197.0]
    maps = draw_clip_maps(scene, lidar)
    assert (maps[0] == maps[1]).all() and maps[0].any()


def test_a_scene_without_a_map_is_refused_in_one_sentence() -> None:
    scene = busy_scene(9 / 12)
    bare = replace(scene, road_map=RoadMap("singapore-onenorth", shapely.MultiPolygon()))
    with pytest.raises(InputError, match=r"singapore-onenorth\.json into maps/expansion"):
        build_clip(bare, range(9))


def test_road_blocks_travel_with_a_map(tmp_path: Path) -> None:
    road_map = busy_scene().road_map
    read = read_road_map(written(tmp_path, road_map))
    assert {name: shape.area for name, shape in read.road_blocks.items()} == {"east": 980.0, "west": 980.0}
    assert set(read.near((0.0, 190.0, 10.0, 199.0)).road_blocks) == {"east"}
    packed = pack_road_map(road_map)
    assert unpack_road_map(packed).road_blocks == road_map.road_blocks
    assert merge_road_maps([road_map, road_map]).road_blocks == road_map.road_blocks
    del packed["road_blocks"]
    assert unpack_road_map(packed).road_blocks == {}
