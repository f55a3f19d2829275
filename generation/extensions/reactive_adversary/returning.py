"""Motions that end on the adversary's own recording: in its lane, and clear of all who keep to their recordings.

In the moving frame of the recorded vehicle the offsets along and aside, with their rates, fade to zero by polynomials
of fifth degree, whose second derivatives begin and end at zero.
"""

from typing import Final

import numpy as np

from benchmark.dynamics.bicycle import DriverLimits
from benchmark.geometry import Bools, Floats, wrap_angle
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.braking import brake_on_path

OVER_S: Final = (3.0, 5.0, 8.0)
"""How long a return takes."""
MOST_M_S2: Final = 1.5
"""Along and across, beside what the recorded vehicle does itself."""
_BEND_1_M: Final = 0.12
"""Curvature beside the recorded one; half of what steering allows."""
_STEADY_M_S2: Final = 0.05
_SLOWEST_M_S: Final = 0.5
"""Below it headings are held rather than derived."""
_BACKWARDS_M_S: Final = 0.1
_TURNED_RAD: Final = 0.5
_JUMP_RAD: Final = 0.15
"""Of headings that differ from their motion's direction when the return begins."""


def find_recorded_rest(scene: Scene, agent: int, frame: int) -> Floats | None:
    """(K + 1, 3) a recording from a frame to the scene's last, braked where it ends; ``None`` if it ended before."""
    agents = scene.agents
    absent = np.flatnonzero(~agents.valid[agent, frame:])
    rest = slice(frame, frame + int(absent[0]) if len(absent) else None)
    poses = np.column_stack([agents.position[agent, rest, :2], agents.yaw[agent, rest]])
    if not len(poses):
        return None
    seconds = scene.seconds[frame:] - scene.seconds[frame]
    return brake_on_path(poses, len(poses) - 1, seconds, DriverLimits().acceleration_m_s2)


def build_returns(motions: Floats, executed: int, recorded: Floats, seconds: Floats) -> tuple[Floats, Bools]:
    """(3, N, W, K + 1) x, y, yaw of N motions that return from a frame on in each of W times; and which drivers can.

    ``motions`` are (N, F, 3) from the planning frame on, ``recorded`` (K + 1, 3) as of `find_recorded_rest` and
    ``seconds`` (K + 1,) its times.
    """
    at = min(executed, motions.shape[1] - 1, len(seconds) - 1)
    before, after = max(at - 1, 0), max(at, 1)
    yaw = np.unwrap(recorded[:, 2])
    velocity, turning = np.gradient(recorded[:, :2], seconds, axis=0), np.gradient(yaw, seconds)
    cos, sin = np.cos(yaw[at]), np.sin(yaw[at])
    to_own = np.array([[cos, sin], [-sin, cos]])
    speed = (motions[:, after, :2] - motions[:, before, :2]) / (seconds[after] - seconds[before])
    offset = (motions[:, at, :2] - recorded[at, :2]) @ to_own.T
    rate = (speed - velocity[at]) @ to_own.T + turning[at] * np.column_stack([offset[:, 1], -offset[:, 0]])
    over = np.array(OVER_S)[:, None]
    share = np.minimum((seconds[at:] - seconds[at]) / over, 1.0)
    fade = _fade(share, over)
    # (2, N, W, K) offsets along and aside, their rates and second derivatives.
    place, moving, bending = (
        offset.T[..., None, None] * first + rate.T[..., None, None] * second for first, second in fade
    )
    heading = np.stack([np.cos(yaw[at:]), np.sin(yaw[at:])])
    forward = (velocity[at:].T * heading).sum(axis=0) + moving[0] - turning[at:] * place[1]
    turned = np.arctan((moving[1] + turning[at:] * place[0]) / np.maximum(forward, _SLOWEST_M_S))
    jump = wrap_angle(motions[:, at, 2, None] - yaw[at] - turned[..., 0])
    can = (np.abs(bending) <= MOST_M_S2).all(axis=(0, 3)) & (forward >= -_BACKWARDS_M_S).all(axis=2)
    can &= (np.abs(bending[1]) <= _BEND_1_M * forward**2 + _STEADY_M_S2).all(axis=2)
    can &= (np.abs(turned) <= _TURNED_RAD).all(axis=2) & (np.abs(jump) <= _JUMP_RAD)
    columns = np.empty((3, *can.shape, len(seconds)))
    columns[..., :at] = motions[:, :at].transpose(2, 0, 1)[:, :, None]
    columns[0, ..., at:] = recorded[at:, 0] + heading[0] * place[0] - heading[1] * place[1]
    columns[1, ..., at:] = recorded[at:, 1] + heading[1] * place[0] + heading[0] * place[1]
    columns[2, ..., at:] = wrap_angle(yaw[at:] + turned + jump[..., None] * fade[0][0])
    return columns, can


def _fade(share: Floats, over: Floats) -> tuple[tuple[Floats, Floats], ...]:
    """Value, rate and second derivative of an offset of 1, and of one of 0 with the rate 1, at shares of the time."""
    values = (
        1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2),
        over * share * (1.0 - share**2 * (6.0 - 8.0 * share + 3.0 * share**2)),
    )
    rates = (
        -30.0 * share**2 * (1.0 - share) ** 2 / over,
        1.0 - share**2 * (18.0 - 32.0 * share + 15.0 * share**2),
    )
    seconds = (
        -60.0 * share * (1.0 - 3.0 * share + 2.0 * share**2) / over**2,
        -share * (36.0 - 96.0 * share + 60.0 * share**2) / over,
    )
    return values, rates, seconds
