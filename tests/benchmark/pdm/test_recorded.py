"""From recordings to verdicts: through the map expansion nothing changes, and official verdicts are nearly met."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

from benchmark.datasets.map_layers import read_road_map
from benchmark.datasets.scenarionet import read_scenarionet
from benchmark.pdm.plan_scoring import score_scene_plans
from benchmark.pdm.road_polygons import build_road_polygons, build_route
from benchmark.planning import Plan, PlanFrame
from generation.nuscenes_writer.expansion import build_map_expansion
from tests.benchmark.pdm.test_road import crossing_map
from tests.hand_made import straight_road

SHARED = Path(__file__).resolve().parents[4] / "shared"
RECORDING = SHARED / "data" / "scenes" / "sd_nuscenes_v1.0-mini_scene-0655.pkl"
OFFICIAL = SHARED / "golden" / "pdm" / "scene-0655.npz"
NAMES = ("nc", "dac", "ddc", "ttc", "lk", "hc")


@pytest.mark.parametrize("named", [True, False])
def test_a_road_is_the_same_after_it_was_written_as_a_map_expansion(tmp_path: Path, named: bool) -> None:
    road_map = crossing_map(named=named)
    path = tmp_path / "boston-seaport.json"
    path.write_text(json.dumps(build_map_expansion(road_map)))
    route = build_route(np.array([[-50.0, 0.0, 0.0], [50.0, 0.0, 0.0]]))
    before, after = build_road_polygons(road_map, route), build_road_polygons(read_road_map(path), route)
    assert before.on_route == after.on_route
    for layer in ("lanes", "drivable", "intersections"):
        pairs = list(zip(getattr(before, layer), getattr(after, layer), strict=True))
        assert pairs and max(shapely.symmetric_difference(a, b).area for a, b in pairs) < 1e-3


def test_road_segments_that_are_no_intersections_stay_none(tmp_path: Path) -> None:
    path = tmp_path / "boston-seaport.json"
    path.write_text(json.dumps(build_map_expansion(straight_road())))
    route = build_route(np.array([[50.0, 198.25, 0.0], [90.0, 198.25, 0.0]]))
    road = build_road_polygons(read_road_map(path), route)
    assert road.intersections == () and len(road.lanes) == 4 and sum(road.on_route) == 2


@pytest.mark.skipif(not (RECORDING.is_file() and OFFICIAL.is_file()), reason="the recordings are not here")
def test_a_recorded_scene_comes_to_nearly_all_official_verdicts() -> None:
    # Speeds are taken from other poses (12 Hz) than the official set's, and intersections are derived anew.
    scene = read_scenarionet(RECORDING)
    with np.load(OFFICIAL) as stored:
        official = {name: stored[f"lqr_{name}"] for name in NAMES}
        plans, frames, ghosts = stored["plans"], stored["keyframe"].tolist(), np.arange(10) % 2 == 1
        usual = np.flatnonzero(stored["uses_drivable_area"] & ~ghosts)
    same = []
    for number in range(plans.shape[1]):
        given: list[Plan | None] = [None] * len(scene.keyframes)
        for sample in usual:
            given[frames[sample]] = Plan(plans[sample, number, :, :2], PlanFrame.EGO)
        found = score_scene_plans(scene, given)
        for sample in usual:
            verdict = found[frames[sample]]
            assert verdict is not None
            same += [getattr(verdict, name) == official[name][sample, number] for name in NAMES]
    assert len(same) == 17 * len(usual) * 6 and np.mean(same) > 0.95
