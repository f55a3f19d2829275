"""Plans beside what was recorded: what the tests of this folder measure on."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats


@dataclass(frozen=True, slots=True)
class ComparedPlans:
    """Plans of N samples whose recording goes on for 3 s.

    Attributes:
        plan: (N, 6, 2) planned positions of the lidar as they are read, x right, y forward, metres.
        recorded: (N, 6, 2) recorded positions of the lidar, likewise.
    """

    plan: Floats
    recorded: Floats

    @classmethod
    def of(cls, plan: Floats, recorded: Floats) -> Self:
        """Plans of any samples.

        Args:
            plan: (S, K, 2) planned positions; 6 steps at least.
            recorded: (S, 6, 2) recorded positions, NaN where the recording has ended.

        Returns:
            Those whose recording goes on for 3 s.
        """
        complete = np.isfinite(recorded).all(axis=(1, 2))
        return cls(plan[complete, :PLAN_STEPS], recorded[complete])

    @classmethod
    def from_lists(cls, plan: list[Any], recorded: list[Any]) -> Self:
        """What was written as lists; raises `ValueError` for what is none."""
        shape = (-1, PLAN_STEPS, 2)
        made = cls(np.array(plan, np.float64).reshape(shape), np.array(recorded, np.float64).reshape(shape))
        if made.plan.shape != made.recorded.shape:
            raise ValueError("there is a plan for each recording")
        return made

    @classmethod
    def joined(cls, parts: "Iterable[ComparedPlans]") -> Self:
        """Plans of several scenes together; none of no scenes."""
        parts = [cls(np.empty((0, PLAN_STEPS, 2)), np.empty((0, PLAN_STEPS, 2))), *parts]
        return cls(np.concatenate([part.plan for part in parts]), np.concatenate([part.recorded for part in parts]))
