"""Figures of a planner on scenes that it has not learned from: plans, use of the images, detections, forecasts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import HORIZON_STEPS, VEHICLE_CATEGORIES
from benchmark.datasets.roots import DataSet
from benchmark.datasets.sample_truth import HIDDEN
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.metrics.diagnosis import MATCH_WITHIN_M, match_forecasts, to_lidar_frame
from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.planning import CameraView, Forecasts, Observation, Plan, Planner, SceneInfo
from benchmark.protocols import find_protocol
from benchmark.protocols.contract import ProtocolOutcomes
from benchmark.report.words import pluralise
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

NEAR_M: Final = 30.0
"""Vehicles farther away than this can hardly be met within three seconds."""


@dataclass(frozen=True, slots=True)
class ForecastFigures:
    """Figures over vehicles within `NEAR_M` of the ego, by one of the two rules.

    `recall` is the share of vehicles with a forecast, `precision` that of forecasts of any annotated object. Errors are
    mean distances over 3 s, of vehicles annotated to the end: of the best mode, the likeliest one, and standing still.
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
class _MatchedForecasts:
    """One sample's forecasts in its lidar frame; `matched` are rows by instance, `counted` vehicles that count."""

    truth: SampleTruth
    forecasts: Forecasts
    matched: dict[str, int]
    counted: tuple[int, ...]


def forecast_figures(truths: Sequence[SampleTruth], plans: Sequence[Plan]) -> ForecastFigures | None:
    """Figures of forecasts against the recording, as diagnosed; ``None`` without forecasts, vehicles or matches."""
    compared = []
    for truth, plan in zip(truths, plans, strict=True):
        if plan.forecasts is None:
            continue
        forecasts = to_lidar_frame(plan.forecasts, plan.frame, truth.lidar_ahead_m)
        lit = tuple(number for number in _vehicles_near(truth) if truth.has_lidar_points[number, 0])
        compared.append(_MatchedForecasts(truth, forecasts, match_forecasts(truth, forecasts), lit))
    return _figures(compared)


def visible_forecast_figures(
    truths: Sequence[SampleTruth], plans: Sequence[Plan], visible: Sequence[frozenset[str]]
) -> ForecastFigures | None:
    """Figures of forecasts as seen, by `visible_instances`; ``None`` without forecasts, vehicles or matches."""
    compared = []
    for truth, plan, instances in zip(truths, plans, visible, strict=True):
        if plan.forecasts is None:
            continue
        forecasts = to_lidar_frame(plan.forecasts, plan.frame, truth.lidar_ahead_m)
        counted = tuple(number for number in _vehicles_near(truth) if truth.instances[number] in instances)
        compared.append(_MatchedForecasts(truth, forecasts, _match_nearest(truth, forecasts), counted))
    return _figures(compared)


def visible_instances(scene: Scene) -> tuple[frozenset[str], ...]:
    """Instances of each keyframe above the least visibility (40 % at most); all where a data set has no levels."""
    known = scene.annotations
    is_visible = known.valid & (known.visibility != HIDDEN)
    return tuple(
        frozenset(scene.agents.ids[row] for row in np.flatnonzero(is_visible[:, number]))
        for number in range(len(scene.keyframes))
    )


def _figures(compared: Sequence[_MatchedForecasts]) -> ForecastFigures | None:
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


def _match_nearest(truth: SampleTruth, forecasts: Forecasts) -> dict[str, int]:
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


_BLANK_GREY: Final = 128


class ImageCondition(StrEnum):
    """Images that a planner is shown.

    ``own``: its cameras'; ``blank``: grey; ``shuffled``: another scene's at the same sample, with its own calibration.
    """

    OWN = "own"
    BLANK = "blank"
    SHUFFLED = "shuffled"


@dataclass(frozen=True, slots=True)
class PlanFigures:
    """Figures of samples recorded to 3 s: mean distances, and share of plans that touch anything (``exact``)."""

    samples: int
    l2_1s_m: float
    l2_2s_m: float
    l2_3s_m: float
    collisions: float

    def as_log(self) -> dict[str, float]:
        """By name, rounded."""
        return {name: round(value, 4) for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True)
class EvaluatedPlans:
    """S plans beside what happened, of samples recorded to 3 s; `visible` as of `visible_instances`."""

    truths: Sequence[SampleTruth]
    plans: Sequence[Plan]
    visible: Sequence[frozenset[str]]

    def outcomes(self) -> ProtocolOutcomes:
        """Outcomes of the plans under the protocol ``exact``."""
        pairs = zip(self.truths, self.plans, strict=True)
        waypoints = [plan.waypoints_in_lidar(truth.lidar_ahead_m) for truth, plan in pairs]
        return find_protocol("exact").evaluate(self.truths, np.array(waypoints))

    def figures(self) -> PlanFigures:
        """Figures of the plans."""
        outcomes = self.outcomes()
        l2 = {name: float(outcomes.l2[:, step - 1].mean()) for name, step in HORIZON_STEPS.items()}
        collisions = float(outcomes.collision.any(-1).mean())
        return PlanFigures(len(self.truths), l2["1s"], l2["2s"], l2["3s"], collisions)

    def diagnosed_forecasts(self) -> ForecastFigures | None:
        """Figures of the forecasts as collisions are diagnosed; ``None`` as in `forecast_figures`."""
        return forecast_figures(self.truths, self.plans)

    def visible_forecasts(self) -> ForecastFigures | None:
        """Figures of the forecasts of what can be seen; ``None`` as in `visible_forecast_figures`."""
        return visible_forecast_figures(self.truths, self.plans, self.visible)


@dataclass(frozen=True, slots=True)
class PairedMeanDifference:
    """A mean difference over paired samples, with its 95 % interval over scenes; ``None`` for fewer than two scenes."""

    value: float
    low: float | None
    high: float | None

    @classmethod
    def of(cls, rate: Rate) -> Self:
        """Difference from a mean with its interval, rounded."""
        ends = (None if bound is None else round(bound, 4) for bound in (rate.low, rate.high))
        return cls(round(rate.value or 0.0, 4), *ends)

    def said(self, digits: int) -> str:
        """Text for readers."""
        texts = ["-" if value is None else f"{value:+.{digits}f}" for value in (self.value, self.low, self.high)]
        return f"{texts[0]} [{texts[1]}, {texts[2]}]"


@dataclass(frozen=True, slots=True)
class ImageAblation:
    """Losses from other images than its cameras'; `collisions_pt` are percentage points of plans that touch in 3 s."""

    l2_3s_m: PairedMeanDifference
    collisions_pt: PairedMeanDifference

    @classmethod
    def between(cls, own: EvaluatedPlans, other: EvaluatedPlans) -> Self:
        """Loss between the plans of the same samples with its own images and with others."""
        pairs = [
            np.stack([outcomes.l2[:, -1], 100.0 * outcomes.collision.any(-1)], axis=-1)
            for outcomes in (own.outcomes(), other.outcomes())
        ]
        lost = pairs[1] - pairs[0]
        scenes = [truth.scene for truth in own.truths]
        return cls(
            *(
                PairedMeanDifference.of(rate)
                for rate in compute_ratios_over_scenes(lost, np.ones_like(lost), scenes, seed=0)
            )
        )

    def said(self) -> str:
        """Text for readers."""
        return f"L2 at 3 s {self.l2_3s_m.said(2)} m, collisions {self.collisions_pt.said(1)} points"

    @classmethod
    def from_log(cls, log: Mapping[str, Mapping[str, Any]]) -> Self:
        """Read what `dataclasses.asdict` made of one."""
        return cls(**{name: PairedMeanDifference(**values) for name, values in log.items()})


def plan_figures(
    planner: Planner,
    data: DataSet,
    scenes: Sequence[str],
    *,
    images: ImageCondition = ImageCondition.OWN,
    every: int = 1,
) -> PlanFigures:
    """The figures of plans alone; arguments and errors as of `evaluate_plans`."""
    return evaluate_plans(planner, data, scenes, images=images, every=every).figures()


def evaluate_plans(
    planner: Planner,
    data: DataSet,
    scenes: Sequence[str],
    *,
    images: ImageCondition = ImageCondition.OWN,
    every: int = 1,
) -> EvaluatedPlans:
    """Plans of a planner beside what happened, of one in `every` samples; planners with memory see all of them."""
    truths, plans, visible = [], [], []
    for number, name in enumerate(scenes):
        scene = data.scene(name)
        visible_by_frame = visible_instances(scene)
        planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
        for observation, truth in zip(observe_with_images(data, scenes, number, images), data.truth(name), strict=True):
            plan = planner.plan(observation)
            if truth.complete and truth.index % every == 0:
                truths.append(truth)
                plans.append(plan)
                visible.append(visible_by_frame[truth.index])
    if not truths:
        raise InputError(
            f"none of the {pluralise(len(scenes), 'scene')} has a sample followed by three recorded seconds"
        )
    return EvaluatedPlans(truths, plans, visible)


def observe_with_images(
    data: DataSet, scenes: Sequence[str], number: int, images: ImageCondition
) -> Iterator[Observation]:
    """Observations of a scene in time order, with the chosen images; `number` is its place among `scenes`."""
    if images is ImageCondition.OWN:
        yield from data.observations(scenes[number])
        return
    if images is ImageCondition.BLANK:
        for observation in data.observations(scenes[number]):
            yield replace(observation, views={key: _blank(view) for key, view in observation.views.items()})
        return
    if len(scenes) < 2:
        raise InputError("images cannot be shuffled between scenes if there is only one; give more scenes")
    other_views: list[Mapping[str, CameraView]] = [
        observation.views for observation in data.observations(scenes[(number + 1) % len(scenes)])
    ]
    for observation in data.observations(scenes[number]):
        other = other_views[observation.index % len(other_views)]
        views = {key: replace(view, load=other[key].load) for key, view in observation.views.items()}
        yield replace(observation, views=views)


def _blank(view: CameraView) -> CameraView:
    def grey() -> NDArray[np.uint8]:
        return np.full((view.camera.height, view.camera.width, 3), _BLANK_GREY, np.uint8)

    return replace(view, load=grey)
