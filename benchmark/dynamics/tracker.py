"""The LQR tracker of the physics: what it asks of pedals and steering wheel at every frame of every candidate.

The lateral regulator predicts lateral and heading error over its look-ahead with a model that is linear in the errors,
in the steering angle and in the path's curvature. Its coefficients depend on the speed alone, and speeds can be known
before any steering: so all coefficients are computed for all frames at once, and a frame costs a dozen operations.
"""

from dataclasses import dataclass

import numpy as np

from benchmark.dynamics.reference_path import ReferencePath
from benchmark.geometry import Bools, Floats

LOOK_AHEAD_STEPS = 10
LATERAL_WEIGHT, HEADING_WEIGHT, SPEED_WEIGHT = 1.0, 10.0, 10.0
STOPPING_GAIN, STOPPING_SPEED = 0.5, 0.2

_STEP = np.arange(LOOK_AHEAD_STEPS, dtype=np.float64)
_LATER = LOOK_AHEAD_STEPS - 1.0 - _STEP
_LATER_SUM = _STEP.sum() - np.cumsum(_STEP)
_RESPONSE = np.stack([_LATER, _LATER_SUM + _STEP * _LATER, _STEP * _LATER_SUM, np.ones_like(_STEP), _STEP])
"""(5, 10) What a turn per metre in each step of the look-ahead does to the errors at its end.

With p + q j metres travelled in step j, the lateral error grows by [p^2, p q, q^2] times the first three rows, the
heading error by [p, q] times the last two.
"""


def compute_cruising_gain(dt: float) -> float:
    """Acceleration per excess of speed: one constant acceleration over the look-ahead, least squares."""
    span = LOOK_AHEAD_STEPS * dt
    return -(SPEED_WEIGHT * span) / (SPEED_WEIGHT * span**2 + 1.0)


def find_speeds_ahead(path: ReferencePath, steps: int) -> Floats:
    """Speeds (S, B) that the tracker aims at: those of the path at the end of the look-ahead."""
    return np.asarray(path.speed[np.minimum(np.arange(steps) + LOOK_AHEAD_STEPS, len(path.speed) - 1)])


@dataclass(frozen=True, slots=True)
class SteeringLaw:
    """Steering rate as a function of the errors, for S frames and B candidates.

    Attributes:
        position: (S, 2, B) of the path, local frame.
        heading: (S, B) of the path, local frame.
        gain: (S, 4, B) steering rate per dx, dy (local frame), heading error, steering angle.
        bend: (S, B) steering rate that the path's own curvature asks for.
        turn: (S, B) heading at the end of the look-ahead per steering angle.
        bend_turn: (S, B) heading that the path gains until then.
        full_turn: (S, B) steering rate per whole turn of that heading.
        turn_rad: (B,) 2 pi.
    """

    position: Floats
    heading: Floats
    gain: Floats
    bend: Floats
    turn: Floats
    bend_turn: Floats
    full_turn: Floats
    turn_rad: Floats

    def steering_rate(self, step: int, pose: Floats, steering: Floats) -> Floats:
        """(B,) steering rate of one frame, radians per unit of time; zero where the controller for stopping is at work.

        ``pose`` is (3, B) x, y, yaw in the local frame, ``steering`` (B,) the angle of the road wheels, radians.
        """
        error = np.empty((4, len(steering)))
        np.subtract(pose[:2], self.position[step], out=error[:2])
        heading = np.subtract(pose[2], self.heading[step], out=error[2])
        heading -= self.turn_rad * np.rint(heading / self.turn_rad)
        error[3] = steering
        final = steering * self.turn[step]
        final += heading
        final -= self.bend_turn[step]
        final /= self.turn_rad
        np.rint(final, out=final)
        final *= self.full_turn[step]
        error *= self.gain[step]
        error[:2] += error[2:]
        rate: Floats = error[0] + error[1]
        rate -= self.bend[step]
        rate -= final
        return rate


def compute_steering_law(
    path: ReferencePath, speed: Floats, acceleration: Floats, stopping: Bools, *, wheelbase_m: float, dt: float
) -> SteeringLaw:
    """Gains of the lateral regulator for frames 0 to S - 1.

    Minimises lateral^2 + 10 heading^2 + rate^2 at the end of the look-ahead over one constant steering rate. Arrays are
    (S, B); the look-ahead assumes that ``acceleration`` is obeyed; nothing is steered where ``stopping``; the wheelbase
    is the one that the tracker assumes.
    """
    steps, count = speed.shape
    basis = np.empty((steps, 5, count))
    travel, growth = basis[:, 3], basis[:, 4]
    np.multiply(speed, dt, out=travel)
    np.multiply(acceleration, dt**2, out=growth)
    np.multiply(basis[:, 3:], travel[:, None], out=basis[:, :2])
    np.multiply(growth, growth, out=basis[:, 2])
    # Steering angle held, and one unit of steering rate.
    held, swept = _RESPONSE.sum(axis=1) / wheelbase_m, _RESPONSE @ _STEP * dt / wheelbase_m
    response = np.zeros((4, 5))
    response[0, :3], response[1, 3:], response[2, :3], response[3, 3:] = held[:3], held[3:], swept[:3], swept[3:]
    held_lateral, held_heading, swept_lateral, swept_heading = (response @ basis).transpose(1, 0, 2)
    bend = _compute_window_responses(path.curvature, steps) * basis
    bend_lateral, bend_heading = bend[:, 0] + bend[:, 1] + bend[:, 2], bend[:, 3] + bend[:, 4]

    cost = LATERAL_WEIGHT * swept_lateral**2 + HEADING_WEIGHT * swept_heading**2 + 1.0
    per_lateral, per_heading = -LATERAL_WEIGHT * swept_lateral / cost, -HEADING_WEIGHT * swept_heading / cost
    per_lateral[stopping] = per_heading[stopping] = 0.0
    gain = np.empty((steps, 4, count))
    np.multiply(per_lateral, -path.direction[:steps, 1], out=gain[:, 0])
    np.multiply(per_lateral, path.direction[:steps, 0], out=gain[:, 1])
    gain[:, 2] = per_lateral * held_heading * wheelbase_m + per_heading
    gain[:, 3] = per_lateral * held_lateral + per_heading * held_heading
    return SteeringLaw(
        position=path.position,
        heading=path.heading,
        gain=gain,
        bend=per_lateral * bend_lateral + per_heading * bend_heading,
        turn=held_heading,
        bend_turn=bend_heading,
        full_turn=per_heading * (2.0 * np.pi),
        turn_rad=np.full(count, 2.0 * np.pi),
    )


def _compute_window_responses(curvature: Floats, steps: int) -> Floats:
    """(S, 5, B) responses to the curvature in each look-ahead; the path's last curvature goes on behind its end."""
    frames = np.minimum(np.arange(steps + LOOK_AHEAD_STEPS), len(curvature) - 1)
    windows = np.lib.stride_tricks.sliding_window_view(curvature[frames], LOOK_AHEAD_STEPS, axis=0)
    return np.asarray(_RESPONSE @ windows[:steps].transpose(0, 2, 1))
