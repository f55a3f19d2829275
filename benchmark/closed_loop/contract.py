"""The contract of policies: memory is a value that goes in and comes out, never an attribute.

A policy moves all agents of a scene. It sees who is where now and nothing of the future but what is its own; the ego's
plan is looked at by those alone who say that they know it. `check_policy` is the contract as a function, for one's own
policies.
"""

from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from benchmark.closed_loop.following import INSTANTS, SUBSTEP_US
from benchmark.closed_loop.plans_in_force import PlanInForce
from benchmark.geometry import Bools, Floats

Memory = TypeVar("Memory")


@dataclass(frozen=True, slots=True)
class Moment:
    """All road users at one instant.

    Attributes:
        time_us: Time of the instant.
        ego: (5,) the ego's box.
        ego_speed: m/s.
        boxes: (N, 5) of the agents; where one is not there, any finite values.
        present: (N,) which are there.
        velocity: (N, 2) m/s.
        plan: The ego's plan in force, for policies that are allowed to know it; ``None`` before there is any.
    """

    time_us: int
    ego: Floats
    ego_speed: float
    boxes: Floats
    present: Bools
    velocity: Floats
    plan: PlanInForce | None = None


@dataclass(frozen=True, slots=True)
class Moved:
    """Motion of the agents in a sub-step.

    Attributes:
        boxes: (2, N, 5) after 0.05 and 0.1 s.
        present: (2, N) which are there.
        velocity: (N, 2) after 0.1 s, m/s.
    """

    boxes: Floats
    present: Bools
    velocity: Floats


class AgentPolicy(Protocol[Memory]):
    """How the others behave.

    Attributes:
        name: Part of the name of what was measured.
        draws: Whether `act` draws anything; if not, its key is 0.
    """

    @property
    def name(self) -> str:
        """As above."""

    @property
    def draws(self) -> bool:
        """As above."""

    def init(self, time_us: int, key: int) -> tuple[Memory, Moved]:
        """The beginning.

        Args:
            time_us: When.
            key: All random numbers are drawn from this alone.

        Returns:
            Its memory, and all agents at ``time_us``, in both rows.
        """

    def act(self, memory: Memory, moment: Moment, key: int) -> tuple[Memory, Moved]:
        """The next 0.1 s.

        Args:
            memory: As the last call returned it.
            moment: Now.
            key: Of this sub-step.

        Returns:
            The memory after it, and the motion of all agents.
        """


def check_policy(policy: AgentPolicy[Any], moment: Moment, steps: int = 5) -> None:
    """Hold a policy to the contract: the same calls give the same bytes, and nothing that was given is changed.

    Args:
        policy: Any policy.
        moment: A beginning: its time, its ego; the agents are the policy's own.
        steps: Sub-steps to take.

    Raises:
        ValueError: If it is broken; says how.
    """
    runs = []
    for _ in range(2):
        memory, moved = policy.init(moment.time_us, 7)
        seen: list[Any] = [moved]
        time = moment.time_us
        for step in range(steps):
            now = Moment(time, moment.ego, moment.ego_speed, moved.boxes[1], moved.present[1], moved.velocity)
            before = _bytes(memory), _bytes(now)
            again = policy.act(memory, now, step)
            memory_after, moved = policy.act(memory, now, step)
            if _bytes(again) != _bytes((memory_after, moved)):
                raise ValueError(f"{policy.name} answers the same call differently: its memory is not in its memory")
            if (_bytes(memory), _bytes(now)) != before:
                raise ValueError(f"{policy.name} changes what it is given")
            _require_shape(policy.name, moved, len(now.boxes))
            memory, time = memory_after, time + SUBSTEP_US
            seen.append((memory, moved))
        runs.append(_bytes(seen))
    if runs[0] != runs[1]:
        raise ValueError(f"{policy.name} is not the same twice from the same key")


def _require_shape(name: str, moved: Moved, count: int) -> None:
    if moved.boxes.shape != (INSTANTS, count, 5) or moved.present.shape != (INSTANTS, count):
        raise ValueError(f"{name} answers boxes {moved.boxes.shape} for {count} agents at {INSTANTS} instants")
    if moved.velocity.shape != (count, 2):
        raise ValueError(f"{name} answers velocities {moved.velocity.shape} for {count} agents")
    if not (np.isfinite(moved.boxes).all() and np.isfinite(moved.velocity).all()):
        raise ValueError(f"{name} answers boxes or velocities that are not finite")


def _bytes(value: Any) -> Any:
    """A value that can be compared to the last bit."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if is_dataclass(value):
        return type(value).__name__, [_bytes(getattr(value, field.name)) for field in fields(value)]
    if isinstance(value, tuple | list):
        return [_bytes(each) for each in value]
    return value
