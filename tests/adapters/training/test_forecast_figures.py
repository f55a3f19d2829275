"""Figures of forecasts: what is seen, what is claimed, and how far off it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.training.forecast_figures import ForecastFigures, forecast_figures
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.geometry import Floats
from benchmark.planning import Forecasts, Plan, PlanFrame
from benchmark.truth import SampleTruth
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

AWAY_M = np.array([1.0, 0.0])


@pytest.fixture(scope="module")
def truths(tmp_path_factory: pytest.TempPathFactory) -> list[SampleTruth]:
    root: Path = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene("scene-9901", seconds=5.0)])
    return [truth for truth in NuScenesData.open(root).truth("scene-9901") if truth.complete]


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
