"""Figures of forecasts: what is seen, what is claimed, and how far off it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.extensions.training.plan_figures import (
    NEAR_M,
    ForecastFigures,
    forecast_figures,
    visible_forecast_figures,
    visible_instances,
)
from benchmark.constants import VEHICLE_CATEGORIES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.sample_truth import HIDDEN
from benchmark.geometry import Floats
from benchmark.planning import Forecasts, Plan, PlanFrame
from benchmark.truth import SampleTruth
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

AWAY_M = np.array([1.0, 0.0])


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root: Path = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene("scene-9901", seconds=5.0)])
    return NuScenesData.open(root)


@pytest.fixture(scope="module")
def truths(data: NuScenesData) -> list[SampleTruth]:
    return [truth for truth in data.truth("scene-9901") if truth.complete]


def expecting(boxes: Floats, paths: Floats) -> Plan:
    """A plan with one wrong mode beside each path, the wrong one the less likely."""
    modes = np.stack([paths, paths + 20.0], axis=1)
    scores = np.tile([0.8, 0.2], (len(boxes), 1))
    return Plan(np.zeros((6, 2)), PlanFrame.LIDAR, forecasts=Forecasts(boxes, modes, scores))


def seen(truth: SampleTruth) -> list[int]:
    return [number for number in range(len(truth.instances)) if truth.annotated[number, 0]]


def perfect(truth: SampleTruth) -> Plan:
    return expecting(truth.boxes[seen(truth), 0], truth.boxes[seen(truth), 1:, :2])


def measured(truths: list[SampleTruth], plans: list[Plan]) -> ForecastFigures:
    found = forecast_figures(truths, plans)
    assert found is not None
    return found


def test_a_clairvoyant_misses_nothing(truths: list[SampleTruth]) -> None:
    found = measured(truths, [perfect(truth) for truth in truths])
    assert found.vehicles > 0 and found.recall == 1.0 and found.precision == 1.0
    assert found.least_error_m == pytest.approx(0.0, abs=1e-9) and found.likeliest_error_m == found.least_error_m


def test_errors_are_of_the_modes_that_they_name(truths: list[SampleTruth]) -> None:
    plans = [perfect(truth) for truth in truths]
    for plan in plans:
        assert plan.forecasts is not None
        plan.forecasts.trajectories[:, 1] = plan.forecasts.trajectories[:, 0]
        plan.forecasts.trajectories[:, 0] += AWAY_M
    found = measured(truths, plans)
    assert found.likeliest_error_m == pytest.approx(1.0) and found.least_error_m == pytest.approx(0.0, abs=1e-9)


def test_ghosts_cost_precision_and_the_blind_lose_recall(truths: list[SampleTruth]) -> None:
    plans = []
    for truth in truths:
        boxes = truth.boxes[seen(truth), 0]
        ghosts = boxes + np.array([0.0, -9.0, 0.0, 0.0, 0.0])
        both = np.concatenate([boxes, ghosts])
        plans.append(expecting(both, np.repeat(both[:, None, :2], 6, axis=1)))
    found = measured(truths, plans)
    assert found.recall == 1.0 and found.precision < 1.0
    assert found.likeliest_error_m == pytest.approx(found.standing_error_m)
    blind = [replace(plan, forecasts=None) for plan in plans]
    assert forecast_figures(truths, blind) is None
    half = measured(truths, [*plans[:1], *(expecting(np.zeros((0, 5)), np.zeros((0, 6, 2))) for _ in truths[1:])])
    assert half.recall < 1.0


def everybody(truths: list[SampleTruth]) -> list[frozenset[str]]:
    return [frozenset(truth.instances) for truth in truths]


def test_who_cannot_be_seen_costs_no_recall_and_whoever_forecasts_them_no_precision(truths: list[SampleTruth]) -> None:
    plans = [perfect(truth) for truth in truths]
    all_seen = visible_forecast_figures(truths, plans, everybody(truths))
    assert all_seen is not None and all_seen.recall == all_seen.precision == 1.0
    one = next(
        truth.instances[number]
        for truth in truths
        for number in seen(truth)
        if truth.categories[number] in VEHICLE_CATEGORIES and np.hypot(*truth.boxes[number, 0, :2]) < NEAR_M
    )
    hidden = [each - {one} for each in everybody(truths)]
    fewer = visible_forecast_figures(truths, plans, hidden)
    assert fewer is None or (fewer.vehicles < all_seen.vehicles and fewer.precision == 1.0)
    missed = [without(truth, plan, one) for truth, plan in zip(truths, plans, strict=True)]
    found = visible_forecast_figures(truths, missed, everybody(truths))
    assert found is None or found.recall < 1.0
    assert visible_forecast_figures(truths, missed, hidden) == fewer


def without(truth: SampleTruth, plan: Plan, instance: str) -> Plan:
    """The perfect plan without the forecast of one object."""
    assert plan.forecasts is not None
    kept = [place for place, number in enumerate(seen(truth)) if truth.instances[number] != instance]
    forecasts = plan.forecasts
    return replace(
        plan, forecasts=Forecasts(forecasts.boxes[kept], forecasts.trajectories[kept], forecasts.scores[kept])
    )


@pytest.mark.parametrize(("away_m", "found"), [(1.9, True), (2.1, False)])
def test_what_is_seen_is_matched_within_two_metres_of_its_centre_whatever_its_size(
    truths: list[SampleTruth], away_m: float, found: bool
) -> None:
    """The rule of diagnosis measures from the axis of what is long and compares areas; this one does neither."""
    truth = truths[0]
    number = next(number for number in seen(truth) if truth.categories[number] in VEHICLE_CATEGORIES)
    box = truth.boxes[number, 0] + np.array([away_m, 0.0, 0.0, 0.0, 0.0])
    box[2:4] *= 10.0
    plan = expecting(box[None], np.repeat(box[None, None, :2], 6, axis=1))
    alone = [frozenset([truth.instances[number]])]
    figures = visible_forecast_figures([truth], [plan], alone)
    assert (figures is not None) == found
    if figures is not None:
        assert figures.recall == 1.0 and figures.vehicles == 1


def test_two_forecasts_of_one_vehicle_are_one_match(truths: list[SampleTruth]) -> None:
    plans = []
    for truth in truths:
        boxes = truth.boxes[seen(truth), 0]
        twice = np.concatenate([boxes, boxes + np.array([0.2, 0.0, 0.0, 0.0, 0.0])])
        plans.append(expecting(twice, np.repeat(twice[:, None, :2], 6, axis=1)))
    found = visible_forecast_figures(truths, plans, everybody(truths))
    assert found is not None and found.recall == 1.0 and found.precision == pytest.approx(0.5, abs=0.1)
    # The nearer one is the match.
    assert found.likeliest_error_m == pytest.approx(found.standing_error_m)


def test_who_is_hardly_visible_is_not_visible(data: NuScenesData) -> None:
    scene = data.scene("scene-9901")
    known = scene.annotations
    hardly = known.visibility.copy()
    hardly[0, 0] = HIDDEN
    instance = scene.agents.ids[0]
    assert known.valid[0, 0] and instance in visible_instances(scene)[0]
    changed = visible_instances(replace(scene, annotations=replace(known, visibility=hardly)))
    assert instance not in changed[0] and len(changed) == len(scene.keyframes)
    untold = visible_instances(replace(scene, annotations=replace(known, visibility=np.zeros_like(hardly))))
    assert [len(each) for each in untold] == known.valid.sum(0).tolist()
