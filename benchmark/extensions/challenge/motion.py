"""Whether somebody could have driven what a changed vehicle does, from its keyframes alone.

An entry holds half a second between poses. Each condition below follows from the limits at every instant, so that
whoever keeps them meets it: mean accelerations are at most the largest one; over half a second the rear axle's way can
leave its mean heading by what the yaw rate allows. What breaks one of them breaks a limit somewhere in between.
"""

from collections.abc import Iterator

import numpy as np

from benchmark.dynamics.bicycle import rear_axle
from benchmark.extensions.challenge.rules import Motion
from benchmark.geometry import Floats, wrap_angle
from benchmark.records.challenge import Reason


def broken_limits(seconds: Floats, boxes: Floats, rules: Motion) -> Iterator[Reason]:
    """Limits that a track breaks where it is changed, at most one reason for each.

    Takes (K,) seconds from the first keyframe at which the track differs, and (K, 5) boxes there.
    """
    if len(boxes) < 2:
        return
    span = np.diff(seconds)
    along, across, turn = _steps(seconds, boxes)
    yaw_rate = turn / span
    # A lateral acceleration that changes its sign in the middle displaces the axle by a quarter of it times the time.
    sideways = rules.sideways_m_s + rules.lateral_m_s2 * span / 4
    measured: list[tuple[str, Floats, Floats | float, str]] = [
        ("yaw_rate_rad_s", np.abs(yaw_rate), rules.yaw_rate_rad_s * rules.tolerance, "rad/s of yaw rate"),
        ("lateral_m_s2", np.abs(yaw_rate * along), rules.lateral_m_s2 * rules.tolerance, "m/s^2 across"),
        ("sideways_m_s", np.abs(across), sideways * rules.tolerance, "m/s sideways"),
        ("backwards_m_s", -along, np.full(len(along), rules.backwards_m_s), "m/s backwards"),
    ]
    if len(boxes) > 2:
        acceleration = np.diff(along) / (0.5 * (span[:-1] + span[1:]))
        measured += [
            ("acceleration_m_s2", acceleration, rules.acceleration_m_s2 * rules.tolerance, "m/s^2 forwards"),
            ("braking_m_s2", -acceleration, rules.braking_m_s2 * rules.tolerance, "m/s^2 of braking"),
        ]
    for rule, values, limit, unit in measured:
        excess = values - limit
        at = int(np.argmax(excess))
        if excess[at] > 0:
            most = float(np.broadcast_to(limit, values.shape)[at])
            yield Reason(
                rule=f"motion.{rule}",
                sentence=f"asks for {values[at]:.3g} {unit} at {seconds[at]:.1f} s; {most:.3g} are allowed",
            )


def broken_launch(seconds: Floats, boxes: Floats, rules: Motion) -> Reason | None:
    """Reason why a vehicle jumps where its recorded track ends, or ``None``.

    Takes (3,) seconds and (3, 5) boxes: the last two keyframes as recorded, and the first changed one.
    """
    first, second = np.diff(seconds)
    before, after = np.diff(boxes[:, :2], axis=0)
    expected = before / first * second
    off = float(np.hypot(*(after - expected)))
    most = rules.launch_m_s2 * 0.5 * second * (first + second) + rules.launch_m
    if off <= most:
        return None
    return Reason(
        rule="motion.launch_m_s2",
        sentence=f"jumps at {seconds[1]:.1f} s, where its recorded track ends: {off:.3g} m from where it was going; "
        f"{most:.3g} m are allowed",
    )


def _steps(seconds: Floats, boxes: Floats) -> tuple[Floats, Floats, Floats]:
    """(K - 1,) mean speed of the rear axle along and across its mean heading, and (K - 1,) turn, radians."""
    axle = rear_axle(boxes[:, [0, 1, 4]], float(boxes[0, 2]))
    turn = wrap_angle(np.diff(axle[:, 2]))
    heading = axle[:-1, 2] + 0.5 * turn
    step = np.diff(axle[:, :2], axis=0) / np.diff(seconds)[:, None]
    # The way along an arc is longer than its chord.
    longer = 1.0 / np.sinc(turn / (2 * np.pi))
    along = (step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)) * longer
    across = step[:, 1] * np.cos(heading) - step[:, 0] * np.sin(heading)
    return along, across, turn
