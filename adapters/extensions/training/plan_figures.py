"""How well a planner drives on scenes that it has not learned from, and whether it looks at the images."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from adapters.extensions.training.forecast_figures import (
    ForecastFigures,
    forecast_figures,
    seen_figures,
    visible_instances,
)
from benchmark.constants import HORIZON_STEPS
from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.metrics.rates import Rate, ratios_over_scenes
from benchmark.planning import CameraView, Observation, Plan, Planner, SceneInfo
from benchmark.protocols import protocol
from benchmark.protocols.contract import Outcomes
from benchmark.report.words import counted
from benchmark.truth import SampleTruth

_BLANK_GREY: Final = 128


class Images(StrEnum):
    """Images that a planner is shown.

    ``own``: what its cameras saw. ``blank``: grey. ``shuffled``: what the same cameras saw in another scene at a sample
    of the same number, with its own calibration and ego motion.
    """

    OWN = "own"
    BLANK = "blank"
    SHUFFLED = "shuffled"


@dataclass(frozen=True, slots=True)
class PlanFigures:
    """Figures over samples whose recording reaches 3 s: mean distance from the recorded position.

    `collisions` is the share whose plan touches anything within 3 s, by the protocol ``exact``.
    """

    samples: int
    l2_1s_m: float
    l2_2s_m: float
    l2_3s_m: float
    collisions: float

    def as_log(self) -> dict[str, float]:
        """By name, rounded."""
        return {name: round(value, 4) for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True)
class JudgedPlans:
    """S plans beside what happened, of samples whose recording reaches 3 s.

    `visible` are instances that can be seen (`adapters.extensions.training.forecast_figures.visible_instances`).
    """

    truths: Sequence[SampleTruth]
    plans: Sequence[Plan]
    visible: Sequence[frozenset[str]]

    def outcomes(self) -> Outcomes:
        """Outcomes of the plans under the protocol ``exact``."""
        pairs = zip(self.truths, self.plans, strict=True)
        waypoints = [plan.waypoints_in_lidar(truth.lidar_ahead_m) for truth, plan in pairs]
        return protocol("exact").evaluate(self.truths, np.array(waypoints))

    def figures(self) -> PlanFigures:
        """Figures of the plans."""
        outcomes = self.outcomes()
        l2 = {name: float(outcomes.l2[:, step - 1].mean()) for name, step in HORIZON_STEPS.items()}
        collisions = float(outcomes.collision.any(-1).mean())
        return PlanFigures(len(self.truths), l2["1s"], l2["2s"], l2["3s"], collisions)

    def as_diagnosed(self) -> ForecastFigures | None:
        """Figures of the forecasts as collisions are diagnosed; ``None`` as in `forecast_figures`."""
        return forecast_figures(self.truths, self.plans)

    def as_seen(self) -> ForecastFigures | None:
        """Figures of the forecasts of what can be seen; ``None`` as in `seen_figures`."""
        return seen_figures(self.truths, self.plans, self.visible)


@dataclass(frozen=True, slots=True)
class Difference:
    """A mean difference over paired samples, with its 95 % interval over scenes; ``None`` for fewer than two scenes."""

    value: float
    low: float | None
    high: float | None

    @classmethod
    def of(cls, rate: Rate) -> Self:
        """Difference from a mean with its interval, rounded."""
        ends = (None if each is None else round(each, 4) for each in (rate.low, rate.high))
        return cls(round(rate.value or 0.0, 4), *ends)

    def said(self, digits: int) -> str:
        """Text for readers."""
        shown = ["-" if each is None else f"{each:+.{digits}f}" for each in (self.value, self.low, self.high)]
        return f"{shown[0]} [{shown[1]}, {shown[2]}]"


@dataclass(frozen=True, slots=True)
class Loss:
    """Losses of plans when a planner is shown something else than what its cameras saw.

    `collisions_pt` are more plans that touch anything within 3 s, percentage points.
    """

    l2_3s_m: Difference
    collisions_pt: Difference

    @classmethod
    def between(cls, own: JudgedPlans, other: JudgedPlans) -> Self:
        """Loss between the plans of the same samples with its own images and with others."""
        pairs = [
            np.stack([outcomes.l2[:, -1], 100.0 * outcomes.collision.any(-1)], axis=-1)
            for outcomes in (own.outcomes(), other.outcomes())
        ]
        lost = pairs[1] - pairs[0]
        scenes = [truth.scene for truth in own.truths]
        return cls(*(Difference.of(rate) for rate in ratios_over_scenes(lost, np.ones_like(lost), scenes, seed=0)))

    def said(self) -> str:
        """Text for readers."""
        return f"L2 at 3 s {self.l2_3s_m.said(2)} m, collisions {self.collisions_pt.said(1)} points"

    @classmethod
    def from_log(cls, log: Mapping[str, Mapping[str, Any]]) -> Self:
        """Read what `dataclasses.asdict` made of one."""
        return cls(**{name: Difference(**values) for name, values in log.items()})


def plan_figures(
    planner: Planner, data: DataSet, scenes: Sequence[str], *, images: Images = Images.OWN, every: int = 1
) -> PlanFigures:
    """The figures of plans alone; arguments and errors as of `judged_plans`."""
    return judged_plans(planner, data, scenes, images=images, every=every).figures()


def judged_plans(
    planner: Planner, data: DataSet, scenes: Sequence[str], *, images: Images = Images.OWN, every: int = 1
) -> JudgedPlans:
    """Plans of a planner, beside what happened.

    One in `every` samples is judged; planners with memory see all of them. An `InputError` says that no sample is
    complete, or that shuffling has only one scene.
    """
    truths, plans, visible = [], [], []
    for number, name in enumerate(scenes):
        scene = data.scene(name)
        seen = visible_instances(scene)
        planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
        for observation, truth in zip(shown(data, scenes, number, images), data.truth(name), strict=True):
            plan = planner.plan(observation)
            if truth.complete and truth.index % every == 0:
                truths.append(truth)
                plans.append(plan)
                visible.append(seen[truth.index])
    if not truths:
        raise InputError(
            f"none of the {counted(len(scenes), 'scene')} has a sample with three recorded seconds after it"
        )
    return JudgedPlans(truths, plans, visible)


def shown(data: DataSet, scenes: Sequence[str], number: int, images: Images) -> Iterator[Observation]:
    """Observations of a scene, in time order, with the images that a planner is to be shown.

    `number` is the place of the scene among `scenes`; images are those of its own cameras, blank ones, or those of
    another scene.
    """
    if images is Images.OWN:
        yield from data.observations(scenes[number])
        return
    if images is Images.BLANK:
        for observation in data.observations(scenes[number]):
            yield replace(observation, views={key: _blank(view) for key, view in observation.views.items()})
        return
    if len(scenes) < 2:
        raise InputError("images cannot be shuffled between scenes where there is only one")
    others: list[Mapping[str, CameraView]] = [
        observation.views for observation in data.observations(scenes[(number + 1) % len(scenes)])
    ]
    for observation in data.observations(scenes[number]):
        other = others[observation.index % len(others)]
        views = {key: replace(view, load=other[key].load) for key, view in observation.views.items()}
        yield replace(observation, views=views)


def _blank(view: CameraView) -> CameraView:
    def grey() -> NDArray[np.uint8]:
        return np.full((view.camera.height, view.camera.width, 3), _BLANK_GREY, np.uint8)

    return replace(view, load=grey)
