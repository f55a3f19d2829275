"""Whether a planner sees the others and knows where they go: what a diagnosis of its collisions rests on."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from benchmark.constants import VEHICLE_CATEGORIES
from benchmark.metrics.diagnosis import forecasts_in_lidar, matched_forecasts
from benchmark.planning import Plan
from benchmark.truth import SampleTruth

NEAR_M: Final = 30.0
"""Vehicles farther away than this can hardly be met within three seconds."""


@dataclass(frozen=True, slots=True)
class ForecastFigures:
    """Figures over vehicles within `NEAR_M` of the ego, matched as `benchmark.metrics.diagnosis` matches.

    Attributes:
        vehicles: Annotated ones, with at least one lidar point, over all samples.
        recall: Share of them that have a forecast.
        precision: Share of the forecasts of that area that are of an annotated object.
        least_error_m: Mean distance over 3 s of the best mode, over matched vehicles annotated to the end.
        likeliest_error_m: Of the most likely mode.
        standing_error_m: Of the forecast that everybody stays where it is.
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


def forecast_figures(truths: Sequence[SampleTruth], plans: Sequence[Plan]) -> ForecastFigures | None:
    """Compare forecasts with what happened.

    Args:
        truths: S samples.
        plans: S plans with their forecasts.

    Returns:
        The figures; ``None`` where there are no forecasts, no vehicles or no matches.
    """
    vehicles = matches = claimed = confirmed = 0
    errors_m: list[tuple[float, float, float]] = []
    for truth, plan in zip(truths, plans, strict=True):
        if plan.forecasts is None:
            continue
        forecasts = forecasts_in_lidar(plan.forecasts, plan.frame, truth.lidar_ahead_m)
        matched = matched_forecasts(truth, forecasts)
        centres = np.asarray(forecasts.boxes, np.float64).reshape(-1, 5)[:, :2]
        near = np.hypot(centres[:, 0], centres[:, 1]) <= NEAR_M
        claimed += int(np.sum(near))
        confirmed += sum(bool(near[row]) for row in matched.values())
        for number, (instance, category) in enumerate(zip(truth.instances, truth.categories, strict=True)):
            if not _counts(truth, number, category):
                continue
            vehicles += 1
            row = matched.get(instance)
            if row is None:
                continue
            matches += 1
            if truth.annotated[number].all():
                driven = truth.boxes[number, 1:, :2]
                modes = np.linalg.norm(forecasts.trajectories[row] - driven, axis=-1).mean(-1)
                standing = np.linalg.norm(truth.boxes[number, :1, :2] - driven, axis=-1).mean()
                likeliest = modes[int(np.argmax(forecasts.scores[row]))]
                errors_m.append((float(modes.min()), float(likeliest), float(standing)))
    if not (vehicles and claimed and errors_m):
        return None
    return ForecastFigures(
        vehicles, matches / vehicles, confirmed / claimed, *(float(value) for value in np.mean(errors_m, axis=0))
    )


def _counts(truth: SampleTruth, number: int, category: str) -> bool:
    """Whether an object is a vehicle nearby that can be seen now."""
    seen = truth.annotated[number, 0] and truth.has_lidar_points[number, 0]
    near = np.hypot(*truth.boxes[number, 0, :2]) <= NEAR_M
    return bool(seen and near and category in VEHICLE_CATEGORIES)
