"""Plans while they are driven: where each wants the ego to be at any time, also beyond its end.

Beyond its last waypoint a plan goes on at the speed and the curvature of its last two steps. With a latency a plan is
driven that is older than the car's place: it is held in the global frame that it was made in.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.closed_loop.following import Ego
from benchmark.constants import EGO_WHEELBASE_M, PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Floats, to_global, to_local

_STILL_M: Final = 0.15
"""Steps shorter than this have no direction that could be held."""
_WHOLE: Final = 1e-9


@dataclass(frozen=True, slots=True)
class PlanInForce:
    """Plan from the moment on that it takes effect.

    Attributes:
        made_us: Time that it was made for.
        effect_us: When it takes effect.
        origin: (3,) rear axle at ``made_us``, global.
        waypoints: (N, 2) x forward and y left of that, metres, 0.5 s apart; N is 6 or more.
    """

    made_us: int
    effect_us: int
    origin: Floats
    waypoints: Floats

    def targets(self, now_us: int, pose: Floats) -> Floats:
        """Targets of the ego: (6, 2) after 0.5, 1.0 .. 3.0 s, in the frame of the rear axle now, metres.

        ``pose`` is (3,) of the rear axle now, global.
        """
        if now_us == self.made_us:
            return np.asarray(self.waypoints[:PLAN_STEPS])
        steps = (now_us - self.made_us) / 1e6 / PLAN_STEP_S + np.arange(1, PLAN_STEPS + 1)
        held = held_waypoints(self.waypoints, int(np.ceil(steps[-1])) + 1)
        knots = np.concatenate([np.zeros((1, 2)), held])
        return to_local(to_global(_between(knots, steps), self.origin), pose)


def held_waypoints(waypoints: Floats, count: int) -> Floats:
    """(count or N, 2) waypoints that go on beyond N of them.

    Beyond the last, each step is as long as the one before and turns as much as that turned.
    """
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


def coasting(ego: Ego, now_us: int) -> PlanInForce:
    """The plan of a car that is given none: constant speed and curvature."""
    seconds = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
    bend = np.tan(ego.steering) / EGO_WHEELBASE_M
    turned = ego.speed * bend * seconds
    # sin(t) / t and (1 - cos(t)) / t, which are 1 and 0 on a straight line.
    straight = np.abs(turned) < _WHOLE
    safe = np.where(straight, 1.0, turned)
    along, aside = np.where(straight, 1.0, np.sin(safe) / safe), np.where(straight, 0.0, (1 - np.cos(safe)) / safe)
    waypoints = ego.speed * seconds[:, None] * np.column_stack([along, aside])
    return PlanInForce(now_us, now_us, ego.pose, waypoints)


def _between(knots: Floats, steps: Floats) -> Floats:
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
