"""Signs that plans use the recorded future; they prove nothing, and honest planners set the limits.

A plan is compared with the recorded future on the samples that were unpredictable. A sample's *surprise* is how
far the recorded future is from the nearest of eight simple continuations of the motion so far: to stand, to keep the
speed, to keep the acceleration, to keep half of it, each straight ahead and along the recorded path itself. So what
surprises is when a car brakes, starts or speeds up, not where the road goes. A plan *hits* where its error is less
than a fifth of the surprise. The limits and how often honest planners come near them: docs/extensions/submissions.md,
``docs/studies/leaks.md``.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Floats

SURPRISE_M: Final = 0.5
"""Root mean square over the plan's steps from which a recorded future counts as a surprise, metres."""
HIT_SHARE_OF_SURPRISE: Final = 0.2
MOVES_M: Final = 1.0
"""A sample on which the recorded car goes no farther says nothing: a plan to stand still is right."""
BRAKES_BY_M_S: Final = 2.0
"""A car that is so much slower after 3 s has braked."""
NOT_YET_BRAKING_M_S2: Final = -0.5

LEAST_ERROR_M: Final = 0.25
"""Median distance at 3 s below which no published or own planner was seen."""
LEAST_GROWTH: Final = 3.0
"""Errors of planners grow with time, by 8 times and more from 0.5 s to 3 s; those of a blurred future do not."""
SMALL_AT_FIRST_M: Final = 0.5
"""A planner that is as far off at once is off, not informed."""
MOST_HITS: Final = 0.08
LEAST_RATIO: Final = 0.5
"""Median of error over surprise."""
LEAST_RATIO_BRAKING: Final = 0.3
LEAST_RATIO_IN_DANGER: Final = 0.7
"""Median of error over surprise where the recorded future was dangerous, over that elsewhere."""
FEWEST: Final = 10
"""Of fewer samples nothing is said."""
FEWEST_HITS: Final = 5


@dataclass(frozen=True, slots=True)
class LeakSample:
    """Plan and recorded future, (6, 2) each in one frame, at a sample whose recording goes on for 3 s.

    ``ahead`` is the (2,) unit direction of the car there; ``speeds`` are the recorded ones, m/s, of the last two steps;
    ``dangerous`` tells whether a car that keeps speed and direction touches an object.
    """

    planned: Floats
    recorded: Floats
    ahead: Floats
    speeds: tuple[float, float]
    dangerous: bool


@dataclass(frozen=True, slots=True)
class LeakFigures:
    """Figures of plans beside the recorded future; ``None`` where there are too few samples.

    Attributes:
        moving: Samples on which the recorded car moves.
        error_m: Median error at 3 s there; ``first_m`` at 0.5 s; ``growth`` is the former over the latter.
        growth_in_danger: Growth on the dangerous ones of them.
        surprises: Samples whose future surprises, of which the plan ``hits`` some.
        ratio: Median of error over surprise on them.
        ratio_in_danger: The same on the dangerous ones, over that on the others.
        braking: Samples after which the recorded car brakes, and does not yet.
    """

    moving: int
    error_m: float | None
    growth: float | None
    first_m: float | None
    growth_in_danger: float | None
    first_in_danger_m: float | None
    surprises: int
    hits: int
    ratio: float | None
    ratio_in_danger: float | None
    braking: int
    ratio_braking: float | None

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    @property
    def suspicions(self) -> tuple[str, ...]:
        """Signs that no honest planner showed, each as text with its figure; empty if there are none."""
        sentences = []
        if _below(self.error_m, LEAST_ERROR_M):
            sentences.append(
                f"the median plan is {self.error_m:.2f} m from the recorded future after 3 s (planners: over "
                f"{LEAST_ERROR_M} m)"
            )
        if _below(self.growth, LEAST_GROWTH) and _below(self.first_m, SMALL_AT_FIRST_M):
            sentences.append(
                f"errors grow {self.growth:.1f} times from 0.5 s to 3 s (planners: over {LEAST_GROWTH:.0f} times)"
            )
        elif _below(self.growth_in_danger, LEAST_GROWTH) and _below(self.first_in_danger_m, SMALL_AT_FIRST_M):
            sentences.append(
                f"where the recorded future was dangerous errors grow {self.growth_in_danger:.1f} times from 0.5 s to "
                f"3 s (planners: over {LEAST_GROWTH:.0f} times)"
            )
        if self.hits >= FEWEST_HITS and self.hits > MOST_HITS * self.surprises:
            sentences.append(
                f"{self.hits} of {self.surprises} unpredictable futures are matched (planners: at most {MOST_HITS:.0%})"
            )
        if _below(self.ratio, LEAST_RATIO):
            sentences.append(
                f"the median error is {self.ratio:.2f} times the surprise of the future (planners: over {LEAST_RATIO})"
            )
        if _below(self.ratio_braking, LEAST_RATIO_BRAKING):
            sentences.append(
                f"plans anticipate when the recorded car brakes: error over surprise {self.ratio_braking:.2f} at "
                f"{self.braking} samples before it does (planners: over {LEAST_RATIO_BRAKING})"
            )
        if _below(self.ratio_in_danger, LEAST_RATIO_IN_DANGER):
            sentences.append(
                f"plans are better where the recorded future was dangerous, {self.ratio_in_danger:.2f} times the error "
                f"elsewhere at equal surprise (planners: over {LEAST_RATIO_IN_DANGER})"
            )
        return tuple(sentences)


def compute_leak_figures(moments: Sequence[LeakSample]) -> LeakFigures:
    """Figures of the samples that have a plan and a recorded future of 3 s, and a second before it."""
    errors = np.array([_distances(moment.planned, moment.recorded) for moment in moments]).reshape(-1, PLAN_STEPS)
    error = np.sqrt((errors**2).mean(axis=1))
    surprise = np.array([measure_surprise_m(moment) for moment in moments])
    recorded_reach_m = np.array([np.hypot(*moment.recorded.T).max() for moment in moments])
    danger = np.array([moment.dangerous for moment in moments], bool)
    braking = np.array([_brakes_later(moment) for moment in moments], bool)
    moving = (recorded_reach_m > MOVES_M) & np.isfinite(error)
    surprising = (surprise >= SURPRISE_M) & np.isfinite(error)
    ratio = error / np.maximum(surprise, SURPRISE_M)
    growth, first = _growth(errors[moving])
    growth_in_danger, first_in_danger = _growth(errors[moving & danger])
    return LeakFigures(
        moving=int(moving.sum()),
        error_m=_median(errors[moving, -1]),
        growth=growth,
        first_m=first,
        growth_in_danger=growth_in_danger,
        first_in_danger_m=first_in_danger,
        surprises=int(surprising.sum()),
        hits=int((ratio[surprising] < HIT_SHARE_OF_SURPRISE).sum()),
        ratio=_median(ratio[surprising]),
        ratio_in_danger=_quotient(_median(ratio[surprising & danger]), _median(ratio[surprising & ~danger])),
        braking=int((braking & moving).sum()),
        ratio_braking=_median(ratio[braking & moving]),
    )


def measure_surprise_m(moment: LeakSample) -> float:
    """How far the recorded future is from the nearest simple continuation: root mean square over the steps, metres."""
    before, now = moment.speeds
    acceleration = (now - before) / PLAN_STEP_S
    times = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
    travels = [np.zeros(PLAN_STEPS), *(_compute_travel(now, share * acceleration, times) for share in (0.0, 0.5, 1.0))]
    continued = np.array(
        [
            path
            for travel in travels
            for path in (travel[:, None] * moment.ahead, _find_points_along(moment.recorded, travel))
        ]
    )
    return float(np.sqrt(((continued - moment.recorded) ** 2).sum(axis=2).mean(axis=1)).min())


def _compute_travel(speed: float, acceleration: float, times: Floats) -> Floats:
    """Distances covered at a constant acceleration, which ends where the car stands."""
    driven = times if acceleration >= 0 else np.minimum(times, speed / -acceleration)
    return speed * driven + acceleration * driven**2 / 2


def _find_points_along(recorded: Floats, way: Floats) -> Floats:
    """Points at distances along a recorded path, which goes on straight beyond its end."""
    path = np.vstack([np.zeros(2), recorded])
    steps = np.diff(path, axis=0)
    lengths = np.hypot(*steps.T)
    moved = lengths > 1e-3
    if not moved.any():
        return np.zeros((len(way), 2))
    corners = np.vstack([path[:1], path[1:][moved]])
    at = np.concatenate([[0.0], np.cumsum(lengths[moved])])
    onward = steps[moved][-1] / lengths[moved][-1]
    within = np.stack([np.interp(way, at, corners[:, axis]) for axis in (0, 1)], axis=1)
    beyond: Floats = np.maximum(way - at[-1], 0.0)[:, None] * onward
    return within + beyond


def _brakes_later(moment: LeakSample) -> bool:
    before, now = moment.speeds
    last = np.hypot(*(moment.recorded[-1] - moment.recorded[-2])) / PLAN_STEP_S
    return bool((now - before) / PLAN_STEP_S > NOT_YET_BRAKING_M_S2 and last < now - BRAKES_BY_M_S)


def _distances(planned: Floats, recorded: Floats) -> Floats:
    distances: Floats = np.hypot(*(planned - recorded).T)
    return distances


def _growth(errors: Floats) -> tuple[float | None, float | None]:
    """How much the median error grows from the first step to the last, and the first."""
    if len(errors) < FEWEST:
        return None, None
    first, last = np.median(errors[:, 0]), np.median(errors[:, -1])
    # Errors of plans that equal the future do not grow.
    return float(last / max(first, 1e-3)), float(first)


def _median(values: Floats) -> float | None:
    return float(np.median(values)) if len(values) >= FEWEST else None


def _quotient(over: float | None, under: float | None) -> float | None:
    return None if over is None or under is None else over / max(under, 1e-3)


def _below(value: float | None, limit: float) -> bool:
    return value is not None and value < limit
