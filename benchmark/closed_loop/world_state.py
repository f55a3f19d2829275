"""A drive as values: what does not change while it lasts, and the world at one instant."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.agent_policy import ActivePlan, AgentPolicy, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import SUBSTEP_US, SUBSTEPS, Ego
from benchmark.closed_loop.simulation_state import CollisionEvent
from benchmark.constants import EGO_BODY_WIDTH_M, EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats

STEP_US: Final = SUBSTEPS * SUBSTEP_US
ENGINE: Final = "default"


@dataclass(frozen=True, slots=True)
class SimulationConfig:
    """All that does not change during a drive of N agents, from ``start_us``; no state is planned from ``end_us`` on.

    A plan takes effect ``latency_us`` later than it was made for, a whole number of sub-steps. ``blamed`` says if a
    contact is the ego's fault, which only then ends the drive; told the contact and the step that it is in. ``None``:
    every contact ends it.
    """

    scene: str
    start_us: int
    end_us: int
    start: Ego
    ids: tuple[str, ...]
    categories: tuple[str, ...]
    policy: AgentPolicy[Any]
    seed: int = 0
    latency_us: int = 0
    blamed: "Callable[[CollisionEvent, StepTrace], bool] | None" = None

    def __post_init__(self) -> None:
        if self.latency_us < 0 or self.latency_us % SUBSTEP_US:
            raise InputError(
                f"a latency of {self.latency_us / 1000:g} ms is not a multiple of the {SUBSTEP_US // 1000} ms step; "
                "use a multiple of it, or 0"
            )
        if self.end_us <= self.start_us:
            raise InputError(f"a drive of {self.scene} ends when it starts; set a later end")

    @property
    def name(self) -> str:
        """Short description: engine, agents, latency if any, and the stop condition if it is not any contact."""
        late = f" +{self.latency_us // 1000} ms" if self.latency_us else ""
        return f"{ENGINE} {self.policy.name}{late}{' until fault' if self.blamed else ''}"


@dataclass(frozen=True, slots=True)
class StepTrace:
    """The last step every 0.05 s, for films and terms of comfort.

    ``egos`` are (11, 6) values of `Ego`, from the state before to this one; ``boxes`` (10, N, 5) and ``present`` (10,
    N) are of the agents.
    """

    egos: Floats
    boxes: Floats
    present: Bools

    def then(self, later: "StepTrace") -> "StepTrace":
        """This part of a step and the one after it."""
        return StepTrace(
            np.concatenate([self.egos, later.egos[1:]]),
            np.concatenate([self.boxes, later.boxes]),
            np.concatenate([self.present, later.present]),
        )


@dataclass(frozen=True, slots=True)
class WorldState:
    """Everything at one planning instant, numbered from 0.

    Attributes:
        ignored: (N,) agents that overlapped the ego at the start, and never count.
        plans: Plans that are in force or will be, by when they take effect.
        contact: The touch that ends the drive, at most 0.05 s after it began.
        trace: Of the step that led here.
        passed: Touches before it that are not the ego's fault, where such do not end the drive; whom they were with is
            gone from the planning instant after them on.
    """

    step: int
    ego: Ego
    others: TrafficSnapshot
    memory: Any
    ignored: Bools
    plans: tuple[ActivePlan, ...] = ()
    contact: CollisionEvent | None = None
    trace: StepTrace | None = None
    passed: tuple[CollisionEvent, ...] = ()

    @property
    def time_us(self) -> int:
        """When it is."""
        return self.others.time_us


def compute_ego_boxes(egos: Floats) -> Floats:
    """(..., 5) boxes of the recording car, from (..., 6) values of `Ego`."""
    egos = np.asarray(egos, np.float64)
    boxes = np.empty((*egos.shape[:-1], 5))
    boxes[..., 0] = egos[..., 0] + EGO_CENTER_FROM_REAR_AXLE_M * np.cos(egos[..., 2])
    boxes[..., 1] = egos[..., 1] + EGO_CENTER_FROM_REAR_AXLE_M * np.sin(egos[..., 2])
    boxes[..., 2], boxes[..., 3] = EGO_LENGTH_M, EGO_BODY_WIDTH_M
    boxes[..., 4] = egos[..., 2]
    return boxes
