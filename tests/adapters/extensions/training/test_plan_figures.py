"""Figures of plans and of forecasts, and what a planner is shown for them."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.extensions.training.plan_figures import (
    NEAR_M,
    ImageAblation,
    ImageCondition,
    evaluate_plans,
    forecast_figures,
    observe_with_images,
    plan_figures,
    visible_forecast_figures,
    visible_instances,
)
from adapters.planners.constant_velocity import ConstantVelocity
from benchmark.constants import VEHICLE_CATEGORIES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.sample_truth import HIDDEN
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.planning import Forecasts, Observation, Plan, PlanFrame, SceneInfo
from benchmark.truth import SampleTruth
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

SCENES = ("scene-9901", "scene-9902")


class Late:
    """Stops where it is; remembers how often it was asked and reset."""

    name = "late"

    def __init__(self) -> None:
        self.asked, self.resets = 0, 0

    def reset(self, scene: SceneInfo) -> None:
        self.resets += 1

    def plan(self, observation: Observation) -> Plan:
        self.asked += 1
        return Plan(np.zeros((6, 2)), PlanFrame.LIDAR)


def test_distances_are_those_of_the_recording(data: NuScenesData) -> None:
    figures = plan_figures(ConstantVelocity(), data, SCENES)
    # The ego keeps its 8 m/s.
    assert figures.samples == 2 * 4 and figures.l2_3s_m < 0.01
    standing = plan_figures(Late(), data, SCENES)
    assert (standing.l2_1s_m, standing.l2_2s_m, standing.l2_3s_m) == pytest.approx((8.0, 16.0, 24.0), abs=0.01)


def test_a_planner_sees_all_samples_where_some_are_judged(data: NuScenesData) -> None:
    planner = Late()
    figures = plan_figures(planner, data, SCENES, every=2)
    assert figures.samples == 2 * 2 and planner.asked == 2 * 10 and planner.resets == 2


def test_what_is_lost_is_the_difference_of_the_figures_and_travels_through_a_file(data: NuScenesData) -> None:
    own, other = (evaluate_plans(planner, data, SCENES) for planner in (ConstantVelocity(), Late()))
    lost, (before, after) = ImageAblation.between(own, other), (own.figures(), other.figures())
    assert lost.l2_3s_m.value == pytest.approx(after.l2_3s_m - before.l2_3s_m, abs=1e-3)
    assert lost.collisions_pt.value == pytest.approx(100 * (after.collisions - before.collisions), abs=1e-3)
    assert lost.l2_3s_m.low is not None and lost.l2_3s_m.high is not None
    assert 0 < lost.l2_3s_m.low <= lost.l2_3s_m.value <= lost.l2_3s_m.high
    assert ImageAblation.from_log(json.loads(json.dumps(asdict(lost)))) == lost
    assert (
        ImageAblation.between(own, own).said()
        == "L2 at 3 s +0.00 [+0.00, +0.00] m, collisions +0.0 [+0.0, +0.0] points"
    )
    alone = [evaluate_plans(planner, data, SCENES[:1]) for planner in (ConstantVelocity(), Late())]
    assert ImageAblation.between(*alone).l2_3s_m.said(0) == "+24 [-, -]"


def test_images_are_changed_and_nothing_else(data: NuScenesData) -> None:
    own = list(data.observations(SCENES[0]))
    other = list(data.observations(SCENES[1]))
    for kind in ImageCondition:
        seen = list(observe_with_images(data, SCENES, 0, kind))
        for index, (observation, mine) in enumerate(zip(seen, own, strict=True)):
            assert observation.ego.velocity.tolist() == mine.ego.velocity.tolist()
            assert observation.command == mine.command
            for name, view in observation.views.items():
                pixels, camera = view.load(), mine.views[name].camera
                assert pixels.shape == (camera.height, camera.width, 3) and pixels.dtype == np.uint8
                assert (view.global_T_ego == mine.views[name].global_T_ego).all()
                if kind is ImageCondition.BLANK:
                    assert (pixels == pixels[0, 0, 0]).all()
                else:
                    source = mine if kind is ImageCondition.OWN else other[index]
                    assert (pixels == source.views[name].load()).all()


def test_what_cannot_be_measured_is_a_sentence(data: NuScenesData, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be shuffled"):
        plan_figures(Late(), data, SCENES[:1], images=ImageCondition.SHUFFLED)
    write_root(tmp_path, [short_scene("scene-9903", seconds=2.0)])
    with pytest.raises(InputError, match="none of the 1 scene has a sample"):
        plan_figures(Late(), NuScenesData.open(tmp_path), ["scene-9903"])


# --- forecasts

AWAY_M = np.array([1.0, 0.0])


@pytest.fixture(scope="module")
def truths(data: NuScenesData) -> list[SampleTruth]:
    return [truth for truth in data.truth("scene-9901") if truth.complete]


def expecting(boxes: Floats, paths: Floats) -> Plan:
    """A plan with one wrong mode beside each path, the wrong one the less likely."""
    modes = np.stack([paths, paths + 20.0], axis=1)
    return Plan(
        np.zeros((6, 2)), PlanFrame.LIDAR, forecasts=Forecasts(boxes, modes, np.tile([0.8, 0.2], (len(boxes), 1)))
    )


def standing(boxes: Floats) -> Plan:
    return expecting(boxes, np.repeat(boxes[:, None, :2], 6, axis=1))


def seen(truth: SampleTruth) -> list[int]:
    return [number for number in range(len(truth.instances)) if truth.annotated[number, 0]]


def perfect(truth: SampleTruth) -> Plan:
    return expecting(truth.boxes[seen(truth), 0], truth.boxes[seen(truth), 1:, :2])


def test_errors_are_of_the_modes_that_they_name(truths: list[SampleTruth]) -> None:
    plans = [perfect(truth) for truth in truths]
    found = forecast_figures(truths, plans)
    assert found is not None and found.vehicles > 0 and found.recall == found.precision == 1.0
    assert found.least_error_m == pytest.approx(0.0, abs=1e-9) and found.likeliest_error_m == found.least_error_m
    for plan in plans:
        assert plan.forecasts is not None
        plan.forecasts.trajectories[:, 1] = plan.forecasts.trajectories[:, 0]
        plan.forecasts.trajectories[:, 0] += AWAY_M
    found = forecast_figures(truths, plans)
    assert found is not None
    assert found.likeliest_error_m == pytest.approx(1.0) and found.least_error_m == pytest.approx(0.0, abs=1e-9)


def test_ghosts_cost_precision_and_the_blind_lose_recall(truths: list[SampleTruth]) -> None:
    boxes = [truth.boxes[seen(truth), 0] for truth in truths]
    ghosts = [standing(np.concatenate([each, each - [0.0, 9.0, 0.0, 0.0, 0.0]])) for each in boxes]
    found = forecast_figures(truths, ghosts)
    assert found is not None and found.recall == 1.0 and found.precision < 1.0
    assert found.likeliest_error_m == pytest.approx(found.standing_error_m)
    assert forecast_figures(truths, [replace(plan, forecasts=None) for plan in ghosts]) is None
    half = forecast_figures(truths, [ghosts[0], *(standing(np.zeros((0, 5))) for _ in truths[1:])])
    assert half is not None and half.recall < 1.0
    # Two forecasts of one vehicle are one match, that of the nearer.
    twice = [standing(np.concatenate([each, each + [0.2, 0.0, 0.0, 0.0, 0.0]])) for each in boxes]
    visible = visible_forecast_figures(truths, twice, [frozenset(truth.instances) for truth in truths])
    assert visible is not None and visible.recall == 1.0 and visible.precision == pytest.approx(0.5, abs=0.1)
    assert visible.likeliest_error_m == pytest.approx(visible.standing_error_m)


def test_who_cannot_be_seen_costs_no_recall_and_whoever_forecasts_them_no_precision(truths: list[SampleTruth]) -> None:
    plans, everybody = [perfect(truth) for truth in truths], [frozenset(truth.instances) for truth in truths]
    all_seen = visible_forecast_figures(truths, plans, everybody)
    assert all_seen is not None and all_seen.recall == all_seen.precision == 1.0
    one = next(
        truth.instances[number]
        for truth in truths
        for number in seen(truth)
        if truth.categories[number] in VEHICLE_CATEGORIES and np.hypot(*truth.boxes[number, 0, :2]) < NEAR_M
    )
    hidden = [each - {one} for each in everybody]
    fewer = visible_forecast_figures(truths, plans, hidden)
    assert fewer is None or (fewer.vehicles < all_seen.vehicles and fewer.precision == 1.0)
    missed = []
    for truth in truths:
        rows = [number for number in seen(truth) if truth.instances[number] != one]
        missed.append(expecting(truth.boxes[rows, 0], truth.boxes[rows, 1:, :2]))
    found = visible_forecast_figures(truths, missed, everybody)
    assert found is None or found.recall < 1.0
    assert visible_forecast_figures(truths, missed, hidden) == fewer


@pytest.mark.parametrize(("away_m", "found"), [(1.9, True), (2.1, False)])
def test_what_is_seen_is_matched_within_two_metres_of_its_centre_whatever_its_size(
    truths: list[SampleTruth], away_m: float, found: bool
) -> None:
    """The rule of diagnosis measures from the axis of what is long and compares areas; this one does neither."""
    truth = truths[0]
    number = next(number for number in seen(truth) if truth.categories[number] in VEHICLE_CATEGORIES)
    box = truth.boxes[number, 0] * [1, 1, 10, 10, 1] + [away_m, 0.0, 0.0, 0.0, 0.0]
    figures = visible_forecast_figures([truth], [standing(box[None])], [frozenset([truth.instances[number]])])
    assert (figures is not None) == found
    assert figures is None or (figures.recall == 1.0 and figures.vehicles == 1)


def test_who_is_hardly_visible_is_not_visible(data: NuScenesData) -> None:
    scene = data.scene("scene-9901")
    known, instance = scene.annotations, scene.agents.ids[0]

    def visible(visibility: np.ndarray[Any, Any]) -> Sequence[frozenset[str]]:
        return visible_instances(replace(scene, annotations=replace(known, visibility=visibility)))

    hardly = known.visibility.copy()
    hardly[0, 0] = HIDDEN
    assert known.valid[0, 0] and instance in visible(known.visibility)[0]
    assert instance not in visible(hardly)[0] and len(visible(hardly)) == len(scene.keyframes)
    assert [len(each) for each in visible(np.zeros_like(hardly))] == known.valid.sum(0).tolist()
