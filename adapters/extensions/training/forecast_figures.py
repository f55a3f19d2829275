"""Whether a planner sees the others and knows where they go: what a diagnosis of its collisions rests on.

Two rules say which vehicles count and which forecast is of whom. *As diagnosed*: vehicles with a lidar point, matched
as `benchmark.metrics.diagnosis` matches, also with what appears later. *As seen*: vehicles that are at least 40 %
visible now, matched by the distance of the present centres alone; what nobody could see costs no recall.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from benchmark.constants import VEHICLE_CATEGORIES
from benchmark.datasets.sample_truth import HIDDEN
from benchmark.geometry import Floats
from benchmark.metrics.diagnosis import MATCH_WITHIN_M, forecasts_in_lidar, matched_forecasts
from benchmark.planning import Forecasts, Plan
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

NEAR_M: Final = 30.0
"""Vehicles farther away than this can hardly be met within three seconds."""


@dataclass(frozen=True, slots=True)
class ForecastFigures:
    """Figures over vehicles within `NEAR_M` of the ego, by one of the two rules.

    Attributes:
        vehicles: Annotated ones that count, over all samples.
        recall: Share of them that have a forecast.
        precision: Share of the forecasts of that area that are of an annotated object, whatever it is.
        least_error_m: Mean distance over 3 s of the best mode, over matched vehicles annotated to the end.
        likeliest_error_m: Of the most likely mode.
        standing_error_m: Of the forecast that all stay where they are.
    """

    vehicles: int
    recall: float
    precision: float
    least_error_m: float
    likeliest_error_m: float
    standing_error_m: float

    def as_log(self) -> dict[str, float]:
        """By name, rounded."""
        return {name: round(value, 4) for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True)
class _Compared:
    """One sample by one of the rules: forecasts in its lidar frame.

    `matched` are rows of the forecast by instance, `counted` numbers of the vehicles that count.
    """

    truth: SampleTruth
    forecasts: Forecasts
    matched: dict[str, int]
    counted: tuple[int, ...]


def forecast_figures(truths: Sequence[SampleTruth], plans: Sequence[Plan]) -> ForecastFigures | None:
    """Figures of forecasts against the recording, as diagnosed.

    ``None`` where there are no forecasts, no vehicles or no matches.
    """
    compared = []
    for truth, plan in zip(truths, plans, strict=True):
        if plan.forecasts is None:
            continue
        forecasts = forecasts_in_lidar(plan.forecasts, plan.frame, truth.lidar_ahead_m)
        lit = tuple(number for number in _vehicles_near(truth) if truth.has_lidar_points[number, 0])
        compared.append(_Compared(truth, forecasts, matched_forecasts(truth, forecasts), lit))
    return _figures(compared)


def seen_figures(
    truths: Sequence[SampleTruth], plans: Sequence[Plan], visible: Sequence[frozenset[str]]
) -> ForecastFigures | None:
    """Figures of forecasts against the recording, as seen: `visible` are S sets of `visible_instances`.

    ``None`` where there are no forecasts, no vehicles or no matches.
    """
    compared = []
    for truth, plan, seen in zip(truths, plans, visible, strict=True):
        if plan.forecasts is None:
            continue
        forecasts = forecasts_in_lidar(plan.forecasts, plan.frame, truth.lidar_ahead_m)
        counted = tuple(number for number in _vehicles_near(truth) if truth.instances[number] in seen)
        compared.append(_Compared(truth, forecasts, _nearest(truth, forecasts), counted))
    return _figures(compared)


def visible_instances(scene: Scene) -> tuple[frozenset[str], ...]:
    """Instances that can be seen at each keyframe of a scene: their level of visibility is not the least.

    The least means 40 % at most. Where a data set has no levels all that is annotated is visible.
    """
    known = scene.annotations
    seen = known.valid & (known.visibility != HIDDEN)
    return tuple(
        frozenset(scene.agents.ids[row] for row in np.flatnonzero(seen[:, number]))
        for number in range(len(scene.keyframes))
    )


def _figures(compared: Sequence[_Compared]) -> ForecastFigures | None:
    vehicles = matches = claimed = confirmed = 0
    errors_m: list[tuple[float, float, float]] = []
    for sample in compared:
        near = np.hypot(*_centres(sample.forecasts).T) <= NEAR_M
        claimed += int(np.sum(near))
        confirmed += sum(bool(near[row]) for row in sample.matched.values())
        vehicles += len(sample.counted)
        for number in sample.counted:
            row = sample.matched.get(sample.truth.instances[number])
            if row is None:
                continue
            matches += 1
            if sample.truth.annotated[number].all():
                errors_m.append(_errors(sample.truth.boxes[number], sample.forecasts, row))
    if not (vehicles and claimed and errors_m):
        return None
    return ForecastFigures(
        vehicles, matches / vehicles, confirmed / claimed, *(float(value) for value in np.mean(errors_m, axis=0))
    )


def _errors(boxes: Floats, forecasts: Forecasts, row: int) -> tuple[float, float, float]:
    """Mean distances over 3 s of the best mode, of the most likely one, and of standing still, metres."""
    driven = boxes[1:, :2]
    modes = np.linalg.norm(forecasts.trajectories[row] - driven, axis=-1).mean(-1)
    standing = np.linalg.norm(boxes[:1, :2] - driven, axis=-1).mean()
    return float(modes.min()), float(modes[int(np.argmax(forecasts.scores[row]))]), float(standing)


def _nearest(truth: SampleTruth, forecasts: Forecasts) -> dict[str, int]:
    """Row of the forecast by instance annotated now: one to one, nearest first, at most `MATCH_WITHIN_M` apart."""
    present = np.flatnonzero(truth.annotated[:, 0])
    offset = truth.boxes[present, None, 0, :2] - _centres(forecasts)
    distance = np.hypot(offset[..., 0], offset[..., 1])
    pairs = sorted(
        (float(distance[row, column]), truth.instances[present[row]], int(column))
        for row, column in np.argwhere(distance <= MATCH_WITHIN_M)
    )
    matched: dict[str, int] = {}
    taken: set[int] = set()
    for _, instance, column in pairs:
        if instance not in matched and column not in taken:
            matched[instance] = column
            taken.add(column)
    return matched


def _vehicles_near(truth: SampleTruth) -> list[int]:
    """Numbers of the vehicles that are annotated now within `NEAR_M`."""
    near = truth.annotated[:, 0] & (np.hypot(truth.boxes[:, 0, 0], truth.boxes[:, 0, 1]) <= NEAR_M)
    return [number for number in np.flatnonzero(near).tolist() if truth.categories[number] in VEHICLE_CATEGORIES]


def _centres(forecasts: Forecasts) -> Floats:
    """(A, 2) present centres."""
    return np.asarray(forecasts.boxes, np.float64).reshape(-1, 5)[:, :2]
