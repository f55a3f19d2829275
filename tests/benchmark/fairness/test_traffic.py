"""Headways against a slow reference, figures of roads made by hand, and rates that are means over seeds."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from adapters.models import build_baseline
from adapters.registry import planner_factory
from benchmark.datasets.roots import DataSet
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.fairness.assessment_tables import TRAFFIC_LABELS, format_traffic
from benchmark.fairness.traffic import measure_figures, measure_headways, measure_scenes
from benchmark.geometry import Floats, box_corners
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.records.statistics import TrafficStatistics
from benchmark.scene import Scene
from tests.benchmark.fake_data import FakeData
from tests.generation.labels.recorded_roads import BUSY, recorded, write_source
from tests.generation.nuscenes_writer.written_roots import with_adversary
from tests.hand_made import Car, scene_on_straight_road, without_frames

PLANNERS = {"stop": 1, "constant-velocity": 1, "noisy-log": 2}


def polygon(box: Floats) -> shapely.Polygon:
    return shapely.Polygon(box_corners(box))


def slow_headways(tracks: ContinuousTracks, times: Floats) -> tuple[list[float], list[float]]:
    """One pair, one instant after the other, by polygons."""
    leaders, followers = [], []
    for now in times.tolist():
        leader, follower = np.inf, np.inf
        for agent, category in enumerate(tracks.categories):
            boxes, present = tracks.agents_at(np.array([now]))
            ego = polygon(tracks.ego_at(np.array([now]))[0])
            here = polygon(boxes[agent, 0]) if present[agent, 0] else None
            if not category.startswith("vehicle.") or (here is not None and here.intersects(ego)):
                continue
            for step in range(1, 41):
                then = np.array([now + 0.1 * step])
                if then[0] > tracks.seconds[-1] + 1e-9:
                    break
                if here is not None and here.intersects(polygon(tracks.ego_at(then)[0])):
                    leader = min(leader, 0.1 * step)
                boxes, present = tracks.agents_at(then)
                if present[agent, 0] and ego.intersects(polygon(boxes[agent, 0])):
                    follower = min(follower, 0.1 * step)
        leaders.append(leader)
        followers.append(follower)
    return leaders, followers


@pytest.mark.parametrize("seed", range(4))
def test_headways_are_those_of_the_slow_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = ("vehicle.car", "vehicle.bicycle", "human.pedestrian.adult")
    cars = tuple(
        Car(x, y, speed, yaw, kinds[row % 3])
        for row, (x, y, speed, yaw) in enumerate(
            rng.uniform((20.0, 194.0, 0.0, -np.pi), (110.0, 203.0, 14.0, np.pi), (12, 4)).tolist()
        )
    )
    scene = without_frames(scene_on_straight_road(cars, ego_speed=rng.uniform(0.0, 12.0), seconds=5.0), 0, slice(3, 6))
    tracks, times = ContinuousTracks.of_scene(scene), scene.seconds[scene.keyframes]
    found, expected = measure_headways(tracks, times), slow_headways(tracks, times)
    assert np.isfinite(np.concatenate(expected)).any()
    for fast, slow in zip(found, expected, strict=True):
        assert fast == pytest.approx(np.array(slow), abs=1e-9)


def headways(*cars: Car, speed: float = 8.0) -> tuple[Any, Any]:
    """At the first sample."""
    tracks = ContinuousTracks.of_scene(scene_on_straight_road(cars, ego_speed=speed))
    leader, follower = measure_headways(tracks, np.array([0.0]))
    return float(leader[0]), float(follower[0])


def test_a_leader_is_what_stands_where_the_ego_will_be_and_a_follower_who_comes_to_where_it_is() -> None:
    # The ego's front is 53.432 m, its rear 49.348 m; 20 m further is 2.5 s.
    assert headways(Car(53.432 + 20.0 + 2.3, 198.25, 8.0)) == (pytest.approx(2.5), np.inf)
    assert headways(Car(49.348 - 20.0 - 2.3, 198.25, 10.0)) == (np.inf, pytest.approx(2.0))
    assert headways(Car(53.432 + 36.0 + 2.3, 198.25, 8.0)) == (np.inf, np.inf), "beyond 4 s"
    assert headways(Car(60.0, 198.25), speed=0.0) == (np.inf, np.inf), "who stands has no leader"
    assert headways(Car(53.0, 198.25, 0.0)) == (np.inf, np.inf), "who touches now does not count"
    assert headways(Car(70.0, 198.25, 0.0, category="human.pedestrian.adult")) == (np.inf, np.inf)
    assert headways() == (np.inf, np.inf)


def figures(scene: Scene) -> dict[str, Any]:
    found = measure_scenes(FakeData({scene.name: scene}), [scene.name], {}, build_baseline)
    return {name: figure.value for name, figure in found.figures.items()}


def test_figures_of_a_road_made_by_hand() -> None:
    cars = (
        Car(58.0, 205.25, 0.0), Car(66.0, 205.25, 0.0), Car(70.0, 201.75, 8.0, np.pi),
        Car(60.0, 190.0, 1.0, np.pi / 2, category="human.pedestrian.adult"),
    )  # fmt: skip
    scene = scene_on_straight_road(cars, ego_speed=4.0, seconds=4.0)
    found = figures(scene)
    assert found["speed_m_s"] == pytest.approx(4.0) and found["standing"] == 0.0 and found["turning"] == 0.0
    assert found["acceleration_m_s2"] == pytest.approx(0.0, abs=1e-6) and found["curvature_1_m"] == 0.0
    assert found["junction"] == 0.0 and found["crossing"] == 0.0
    assert found["pedestrians"] == 1.0 and 3.5 < found["road_users"] <= 4.0
    assert found["oncoming"] > 0.8 and 2 / 3 <= found["parked"] < 0.8
    assert "adversary_within_2_m" not in found and set(found) <= set(TRAFFIC_LABELS)


def test_an_empty_road_has_no_shares_of_road_users() -> None:
    found = figures(scene_on_straight_road(()))
    assert found["parked"] is None and found["hidden"] is None and found["leader_headway_s"] is None
    assert found["road_users"] is None, "a scene without any annotation says nothing of who is around"


def test_who_is_behind_a_truck_is_hidden() -> None:
    truck = Car(60.0, 201.75, 0.0, category="vehicle.truck", size=(12.0, 2.5, 3.5))
    behind = Car(60.0, 206.0, 0.0, category="human.pedestrian.adult", size=(0.6, 0.6, 1.7))
    shares = [
        figures(scene_on_straight_road(cars, ego_x=57.0, ego_speed=0.0))["hidden"]
        for cars in ((truck, behind), (behind,))
    ]
    assert shares == [0.5, 0.0]


def test_samples_without_labels_or_future_say_nothing_of_others() -> None:
    scene = scene_on_straight_road(tuple(Car(60.0 + 8.0 * row, 198.25, 8.0) for row in range(4)), seconds=5.0)
    data = FakeData({scene.name: scene})
    truths = data.truth(scene.name)
    assert measure_figures(scene, truths)["leader_within_3_s"][1].sum() == 4.0
    valid = scene.annotations.valid.copy()
    valid[:, :2] = False
    scene = replace(scene, annotations=replace(scene.annotations, valid=valid))
    found = measure_figures(scene, FakeData({scene.name: scene}).truth(scene.name))
    assert found["road_users"][1].tolist() == [0.0, 0.0, *[1.0] * 8]


def test_the_adversary_is_counted_where_it_is_near() -> None:
    near, far = (with_adversary(scene_on_straight_road((Car(50.0, y, 8.0),))) for y in (194.75, 192.25))
    assert figures(near)["adversary_within_2_m"] == 1.0
    found = figures(far)
    assert found["adversary_within_2_m"] == 0.0 and found["adversary_within_5_m"] == 1.0


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    scenes = [recorded("scene-0001", seconds=6.0), recorded("scene-0002", (*BUSY, Car(72.0, 198.25, 4.0)), seconds=6.0)]
    return write_source(tmp_path_factory.mktemp("traffic") / "val", *scenes)


@pytest.fixture(scope="module")
def traffic(root: DataSet) -> Any:
    return measure_scenes(root, root.scene_names(None), PLANNERS, build_baseline)


def test_rates_are_the_mean_of_the_runs_of_all_seeds(root: DataSet, traffic: Any, tmp_path: Path) -> None:
    for name, draws in PLANNERS.items():
        runs = [
            evaluate(root, "val", planner_factory(name, seed=seed), tmp_path, EvalSettings(("exact",), seed=seed))
            for seed in range(draws)
        ]
        for column in ("collision", "l2"):
            of_runs = [run.summary.protocols["exact"].columns[column] for run in runs]
            for horizon, rate in getattr(traffic.planners[name], column).items():
                values: list[Any] = [run[horizon].value for run in of_runs]
                assert rate.value == pytest.approx(np.mean(values), abs=1e-4), (name, column, horizon)
                assert rate.denominator == draws * of_runs[0][horizon].denominator
    assert traffic.planners["constant-velocity"].scenes["scene-0002"] > 0.0


def test_scenes_are_measured_alike_by_any_number_of_workers(root: DataSet, traffic: Any) -> None:
    assert measure_scenes(root, root.scene_names(None), PLANNERS, build_baseline, workers=2) == traffic
    speed = traffic.figures["leader_within_3_s"]
    assert list(speed.scenes) == ["scene-0001", "scene-0002"] and speed.scenes["scene-0002"] == 1.0
    assert speed.value == pytest.approx(np.mean([*speed.scenes.values()]))


class Broken:
    """Plans for every so many-th sample."""

    name = "broken"

    def __init__(self, every: int) -> None:
        self.every = every

    def reset(self, scene: object) -> None: ...

    def plan(self, observation: Any) -> Any:
        if observation.index % self.every != self.every - 1:
            raise ValueError("no plan")
        return build_baseline("stop").plan(observation)


@pytest.mark.parametrize(("every", "counted"), [(1, 12), (2, 6), (100, 0)])
def test_a_sample_without_a_plan_is_no_sample_without_contact(root: DataSet, every: int, counted: int) -> None:
    found = measure_scenes(root, root.scene_names(None), {"broken": 1}, lambda name, seed: Broken(every))
    rate = found.planners["broken"].collision["3s"]
    assert rate.denominator == counted and (rate.value is None) == (counted == 0)


def test_a_scene_of_one_frame_is_named_and_nothing_else_changes(root: DataSet, traffic: Any) -> None:
    scenes: Sequence[Scene] = [root.scene(name) for name in root.scene_names(None)]
    one = replace(scenes[0], name="scene-0003").first_frames(1)
    found = measure_scenes(FakeData({one.name: one}), [one.name], PLANNERS, build_baseline)
    assert found == TrafficStatistics(figures={}, planners={}, not_measured=("scene-0003",))
    assert "A single frame: scene-0003." in format_traffic(found)
    text = format_traffic(traffic)
    assert "leader within 3 s, %" in text and "noisy-log " in text and "nan" not in text
