"""The contract of policies, which move all agents of a scene, and the plans that they may know while they are driven.

Memory is a value that goes in and comes out, never an attribute. A policy sees who is where now and nothing of the
future but what is its own; the ego's plan is looked at by those alone who say that they know it. `check_policy` is the
contract as a function, for one's own policies.
"""

from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Final, Protocol, TypeVar

import numpy as np

from benchmark.closed_loop.plan_tracking import INSTANTS, SUBSTEP_US, Ego
from benchmark.constants import EGO_WHEELBASE_M, PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Bools, Floats, to_global, to_local

_STILL_M: Final = 0.15
"""Steps shorter than this have no direction that could be held."""
_WHOLE: Final = 1e-9


@dataclass(frozen=True, slots=True)
class ActivePlan:
    """Plan from the moment on that it takes effect.

    ``origin`` is (3,), the global rear axle at ``made_us``; ``waypoints`` are (N, 2), x forward and y left of that,
    metres, 0.5 s apart; N is 6 or more.
    """

    made_us: int
    effect_us: int
    origin: Floats
    waypoints: Floats

    def compute_targets(self, now_us: int, pose: Floats) -> Floats:
        """Targets of the ego: (6, 2) after 0.5, 1.0 .. 3.0 s, in the frame of the rear axle now, metres.

        ``pose`` is (3,) of the rear axle now, global.
        """
        if now_us == self.made_us:
            return np.asarray(self.waypoints[:PLAN_STEPS])
        steps = (now_us - self.made_us) / 1e6 / PLAN_STEP_S + np.arange(1, PLAN_STEPS + 1)
        held = extend_waypoints(self.waypoints, int(np.ceil(steps[-1])) + 1)
        knots = np.concatenate([np.zeros((1, 2)), held])
        return to_local(to_global(_interpolate_spline(knots, steps), self.origin), pose)


def extend_waypoints(waypoints: Floats, count: int) -> Floats:
    """(count or N, 2) waypoints that go on beyond N of them, with steps as long and turning as much as the last."""
    if count <= len(waypoints):
        return waypoints
    before = np.zeros(2) if len(waypoints) == 2 else waypoints[-3]
    first, step = waypoints[-2] - before, waypoints[-1] - waypoints[-2]
    turn = 0.0
    if min(np.hypot(*first), np.hypot(*step)) >= _STILL_M:
        turn = float(np.arctan2(first[0] * step[1] - first[1] * step[0], first @ step))
    cos, sin = np.cos(turn), np.sin(turn)
    held = [*waypoints]
    while len(held) < count:
        step = np.array([cos * step[0] - sin * step[1], sin * step[0] + cos * step[1]])
        held.append(held[-1] + step)
    return np.array(held)


def make_coasting_plan(ego: Ego, now_us: int) -> ActivePlan:
    """The plan of a car that is given none: constant speed and curvature."""
    seconds = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
    bend = np.tan(ego.steering) / EGO_WHEELBASE_M
    turned = ego.speed * bend * seconds
    # sin(t) / t and (1 - cos(t)) / t, which are 1 and 0 on a straight line.
    straight = np.abs(turned) < _WHOLE
    safe = np.where(straight, 1.0, turned)
    along, aside = np.where(straight, 1.0, np.sin(safe) / safe), np.where(straight, 0.0, (1 - np.cos(safe)) / safe)
    waypoints = ego.speed * seconds[:, None] * np.column_stack([along, aside])
    return ActivePlan(now_us, now_us, ego.pose, waypoints)


def _interpolate_spline(knots: Floats, steps: Floats) -> Floats:
    """(6, 2) points of a curve through knots at whole steps (cubic, Catmull and Rom)."""
    at = np.floor(steps + _WHOLE).astype(np.int64)
    share = (steps - at)[:, None]
    if (np.abs(share) < _WHOLE).all():
        return np.asarray(knots[at])
    last = len(knots) - 1
    here, after = knots[at], knots[np.minimum(at + 1, last)]
    before, beyond = knots[np.maximum(at - 1, 0)], knots[np.minimum(at + 2, last)]
    leaving, arriving = 0.5 * (after - before), 0.5 * (beyond - here)
    cubic = 2 * here - 2 * after + leaving + arriving
    square = -3 * here + 3 * after - 2 * leaving - arriving
    return np.asarray(((cubic * share + square) * share + leaving) * share + here)


Memory = TypeVar("Memory")


@dataclass(frozen=True, slots=True)
class TrafficSnapshot:
    """All road users at one instant.

    Attributes:
        time_us: Time of the instant.
        ego: (5,) the ego's box.
        ego_speed: m/s.
        boxes: (N, 5) of the agents; where one is not there, any finite values.
        present: (N,) which are there.
        velocity: (N, 2) m/s.
        plan: The ego's plan in force, for policies that are allowed to know it; ``None`` before there is any.
        ego_after: (5,) the ego's box 0.1 s later, which the contract of other simulators' traffic tells; or ``None``.
    """

    time_us: int
    ego: Floats
    ego_speed: float
    boxes: Floats
    present: Bools
    velocity: Floats
    plan: ActivePlan | None = None
    ego_after: Floats | None = None


@dataclass(frozen=True, slots=True)
class AgentMotion:
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

    def init(self, time_us: int, key: int) -> tuple[Memory, AgentMotion]:
        """The beginning.

        Args:
            time_us: When.
            key: All random numbers are drawn from this alone.

        Returns:
            Its memory, and all agents at ``time_us``, in both rows.
        """

    def act(self, memory: Memory, moment: TrafficSnapshot, key: int) -> tuple[Memory, AgentMotion]:
        """The next 0.1 s.

        Args:
            memory: As the last call returned it.
            moment: Now.
            key: Of this sub-step.

        Returns:
            The memory after it, and the motion of all agents.
        """


def check_policy(policy: AgentPolicy[Any], moment: TrafficSnapshot, steps: int = 5) -> None:
    """Hold a policy to the contract: the same calls give the same bytes, and nothing that was given is changed.

    ``moment`` is a beginning: its time, its ego; the agents are the policy's own. `ValueError` says how it is broken.
    """
    runs = []
    for _ in range(2):
        memory, moved = policy.init(moment.time_us, 7)
        outputs: list[Any] = [moved]
        time = moment.time_us
        for step in range(steps):
            now = TrafficSnapshot(time, moment.ego, moment.ego_speed, moved.boxes[1], moved.present[1], moved.velocity)
            before = _to_comparable(memory), _to_comparable(now)
            again = policy.act(memory, now, step)
            memory_after, moved = policy.act(memory, now, step)
            if _to_comparable(again) != _to_comparable((memory_after, moved)):
                raise ValueError(f"{policy.name} gives two results for one call; keep all of its state in `memory`")
            if (_to_comparable(memory), _to_comparable(now)) != before:
                raise ValueError(f"{policy.name} modifies its arguments; copy them first")
            _require_shape(policy.name, moved, len(now.boxes))
            memory, time = memory_after, time + SUBSTEP_US
            outputs.append((memory, moved))
        runs.append(_to_comparable(outputs))
    if runs[0] != runs[1]:
        raise ValueError(f"{policy.name} gives two results for one key; draw random numbers from the key only")


def _require_shape(name: str, moved: AgentMotion, count: int) -> None:
    if moved.boxes.shape != (INSTANTS, count, 5) or moved.present.shape != (INSTANTS, count):
        raise ValueError(f"{name} returns boxes of shape {moved.boxes.shape} for {count} agents at {INSTANTS} instants")
    if moved.velocity.shape != (count, 2):
        raise ValueError(f"{name} returns velocities of shape {moved.velocity.shape} for {count} agents")
    if not (np.isfinite(moved.boxes).all() and np.isfinite(moved.velocity).all()):
        raise ValueError(f"{name} returns boxes or velocities that are not finite")


def _to_comparable(value: Any) -> Any:
    """A value that can be compared to the last bit."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if is_dataclass(value):
        return type(value).__name__, [_to_comparable(getattr(value, field.name)) for field in fields(value)]
    if isinstance(value, tuple | list):
        return [_to_comparable(item) for item in value]
    return value
