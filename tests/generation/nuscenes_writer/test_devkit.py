"""The unmodified devkit, and our own reader, open what the writer writes."""

import io
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from tests.generation.nuscenes_writer.written_roots import SolidRenderer, short_scene, with_adversary

matplotlib.use("Agg")
SCENES = ("scene-9901", "scene-9902")


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [with_adversary(short_scene(SCENES[0])), short_scene(SCENES[1])]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, scenes: list[Scene]) -> Path:
    root = tmp_path_factory.mktemp("written")
    plan = DataSetPlan(root=root, split="adv", renderer=SolidRenderer())
    keys = [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={}) for scene in scenes]
    finish_data_set(plan, keys)
    return root


@pytest.fixture(scope="module")
def nusc(root: Path) -> Any:
    from nuscenes import NuScenes

    return NuScenes("v1.0-trainval", str(root), verbose=False)


def test_boxes_and_velocities(nusc: Any, scenes: list[Scene]) -> None:
    sample = nusc.sample[2]
    annotation = nusc.get("sample_annotation", sample["anns"][1])
    assert nusc.box_velocity(annotation["token"])[:2] == pytest.approx([10.0, 0.0])
    sweep = next(row for row in nusc.sample_data if row["channel"] == "CAM_FRONT" and not row["is_key_frame"])
    boxes = nusc.get_boxes(sweep["token"])
    assert len(boxes) == 3
    assert sorted(sample["data"]) == sorted(["LIDAR_TOP", *(camera.name for camera in scenes[0].cameras)])


def test_listing_and_rendering(nusc: Any, tmp_path: Path) -> None:
    listed = io.StringIO()
    with redirect_stdout(listed):
        nusc.list_scenes()
    assert all(name in listed.getvalue() for name in SCENES)
    sample = nusc.sample[1]
    nusc.render_sample(sample["token"], out_path=str(tmp_path / "sample.png"), verbose=False)
    nusc.render_sample_data(sample["data"]["LIDAR_TOP"], out_path=str(tmp_path / "lidar.png"), verbose=False)
    nusc.render_annotation(sample["anns"][0], out_path=str(tmp_path / "annotation.png"))
    pyplot.close("all")
    assert len(list(tmp_path.glob("*.png"))) == 3


def test_map_mask_is_where_the_road_is(nusc: Any, scenes: list[Scene]) -> None:
    mask = nusc.map[0]["mask"]
    x, y = np.array([100.0, 100.0, 100.0, 1.0]), np.array([193.2, 206.8, 207.3, 10.0])
    assert mask.is_on_mask(x, y).tolist() == [True, True, False, False]


def test_map_expansion(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nuscenes.map_expansion import map_api

    def patch(polygon: Any, **style: Any) -> PathPatch:
        rings = (polygon.exterior, *polygon.interiors)
        return PathPatch(Outline.make_compound_path(*(Outline(np.array(ring.coords)) for ring in rings)), **style)

    # descartes, which the devkit draws polygons with, does not work with shapely 2, whatever the map.
    monkeypatch.setattr(map_api.descartes, "PolygonPatch", patch)
    road = map_api.NuScenesMap(str(root), "boston-seaport")
    assert road.get_closest_lane(100.0, 198.0) == "east-0"
    poses = np.array(road.discretize_lanes(["west-1"], 1.0)["west-1"])
    assert poses[0] == pytest.approx([400.0, 205.25, -np.pi])
    assert poses[-1][:2] == pytest.approx([0.0, 205.25])
    layers = ["drivable_area", "lane", "ped_crossing", "walkway", "lane_divider", "road_divider"]
    mask = road.get_map_mask((152.0, 200.0, 30.0, 30.0), 0, layers, (300, 300))
    covered = mask.reshape(len(layers), -1).mean(axis=1)
    assert covered[:4] == pytest.approx([14 / 30, 14 / 30, 4 * 14 / 900, 4 / 30], abs=0.02)
    assert (covered[4:] > 0).all()
    figure, axes = road.render_map_patch((50.0, 180.0, 110.0, 220.0), figsize=(3, 3))
    assert axes.patches
    pyplot.close(figure)


def test_can_bus(root: Path) -> None:
    from nuscenes.can_bus.can_bus_api import NuScenesCanBus

    can_bus = NuScenesCanBus(str(root))
    pose = can_bus.get_messages(SCENES[0], "pose")
    assert pose[30]["vel"] == pytest.approx([8.0, 0.0, 0.0], abs=1e-3)
    assert all(can_bus.get_messages(SCENES[1], kind) for kind in can_bus.all_messages)
    route, driven = can_bus.get_pose_and_route(SCENES[0])
    assert np.abs(np.interp(driven[:, 0], route[:, 0], route[:, 1]) - driven[:, 1]).max() < 0.01


def test_custom_split(nusc: Any) -> None:
    from nuscenes.eval.common.loaders import (
        add_center_dist,
        filter_eval_boxes,
        get_samples_of_custom_split,
        load_gt_of_sample_tokens,
    )
    from nuscenes.eval.detection.data_classes import DetectionBox
    from nuscenes.utils.splits import get_scenes_of_split

    assert get_scenes_of_split("adv", nusc) == list(SCENES)
    tokens = get_samples_of_custom_split("adv", nusc)
    assert tokens == [sample["token"] for sample in nusc.sample]
    boxes = load_gt_of_sample_tokens(nusc, tokens, DetectionBox)
    reach = dict.fromkeys(("car", "truck", "pedestrian"), 1000.0)
    kept = filter_eval_boxes(nusc, add_center_dist(nusc, boxes), reach)
    assert len(kept.all) == 2 * 3 * 5
    assert {box.detection_name for box in kept.all} == {"car"}


def test_round_trip_through_our_reader(root: Path, scenes: list[Scene]) -> None:
    data = NuScenesData.open(root)
    assert data.scene_names("adv") == SCENES
    for written in scenes:
        found = data.scene(written.name)
        order = [found.agents.ids.index(name) for name in written.agents.ids]
        assert found.timestamps_us[found.keyframes].tolist() == written.timestamps_us[written.keyframes].tolist()
        known = len(found.timestamps_us)
        assert np.array_equal(found.ego.position, written.ego.position[:known])
        assert found.adversaries == written.adversaries
        for field in ("position", "rotation", "size", "valid", "attribute", "visibility", "num_radar_pts"):
            expected = getattr(written.annotations, field)
            assert np.array_equal(getattr(found.annotations, field)[order], expected), field
        assert set(found.road_map.lanes) == set(written.road_map.lanes)
        kinds = {divider.identifier: divider.kind for divider in found.road_map.dividers}
        assert kinds == {divider.identifier: divider.kind for divider in written.road_map.dividers}
        assert found.road_map.is_drivable(written.ego.position[:, :2]).all()
    observation = next(iter(data.observations(SCENES[0])))
    image = observation.views["CAM_FRONT_RIGHT"].load()
    expected_colour = [50, 40, 0]
    assert np.abs(image.astype(int) - expected_colour).max() <= 4
    assert observation.ego.source == "can_bus"
