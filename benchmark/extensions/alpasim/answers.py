"""Answer of ``drive``: a trajectory in the local frame, of any length and rate, as a plan.

What AlpaSim's runtime would fail at or misunderstand is refused by name; what it takes is taken, with a note where a
plan needs more than the answer says.
"""

from typing import Any, Final

import numpy as np

from benchmark.constants import LONGEST_PLAN_STEPS, PLAN_STEP_S, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.extensions.alpasim.poses import SECOND_US, Poses, decode_trajectory
from benchmark.geometry import Floats, rotation_matrix
from benchmark.planning import AnswerNote, Plan, PlanFrame

_START_US: Final = 1000
_MODES: Final = 64


class EgodriverAnswerError(Exception):
    """An answer that cannot be driven; the sentence begins with its name."""


def read_answer(message: Any, now: Poses) -> tuple[Plan, AnswerNote]:
    """The plan of a ``DriveResponse`` for a car at one pose, which has the time now, and what was peculiar.

    The first 3 to 8 s count, every half second between two poses. Where less than 3 s are there, the last pose is held,
    as AlpaSim does it. Modes are sampled trajectories that reach as far; ``unstructured_debug_info``, a pickle by
    convention, is never read. Heights and headings are not part of a plan.

    Raises:
        EgodriverAnswerError: If the answer is empty, has one pose, times that do not rise, NaN, a quaternion that is
            not unit, a start more than 1 ms away from now, or nothing later.
    """
    waypoints, reach_s = _interpolate(decode_trajectory(message.trajectory), now)
    steps = min(max(int((reach_s + 1e-6) / PLAN_STEP_S), PLAN_STEPS), LONGEST_PLAN_STEPS)
    notes = [] if reach_s + 1e-6 >= PLAN_STEPS * PLAN_STEP_S else [f"ends after {reach_s:.1f} s, last pose held"]
    notes += ["terminate_session"] if message.terminate_session else []
    modes = []
    for sampled in message.debug_info.sampled_trajectories[:_MODES]:
        try:
            alternative, reach_of_mode_s = _interpolate(decode_trajectory(sampled), now)
        except EgodriverAnswerError:
            continue
        modes += [alternative[:steps]] if reach_of_mode_s + 1e-6 >= steps * PLAN_STEP_S else []
    try:
        plan = Plan(waypoints[:steps], PlanFrame.EGO, modes=np.array(modes) if modes else None)
    except InputError as error:
        raise EgodriverAnswerError(f"far away: {error}") from error
    return plan, AnswerNote("; ".join(notes), ends_drive=message.terminate_session)


def _interpolate(poses: Poses, now: Poses) -> tuple[Floats, float]:
    """(16, 2) waypoints in the rig now, the last pose held, and how many seconds of them are there."""
    _require_sound(poses, int(now.times_us[-1]))
    local = ((poses.position - now.position[-1]) @ rotation_matrix(now.rotation[-1]))[:, :2]
    seconds = (poses.times_us - now.times_us[-1]) / SECOND_US
    wanted = PLAN_STEP_S * np.arange(1, LONGEST_PLAN_STEPS + 1)
    columns = [np.interp(wanted, seconds, local[:, axis]) for axis in range(2)]
    return np.stack(columns, axis=-1), float(seconds[-1])


def _require_sound(poses: Poses, now_us: int) -> None:
    times = poses.times_us
    if not len(poses):
        raise EgodriverAnswerError("empty: the trajectory has no poses")
    if len(poses) == 1:
        raise EgodriverAnswerError("one pose: a trajectory needs two or more")
    if not (np.diff(times) > 0).all():
        raise EgodriverAnswerError("times not rising: each pose must be later than the one before")
    if not (np.isfinite(poses.position).all() and np.isfinite(poses.rotation).all()):
        raise EgodriverAnswerError("NaN: a pose has NaN or infinity")
    if not poses.are_unit:
        raise EgodriverAnswerError("quaternion not unit: a rotation has another length than 1")
    if times[-1] <= now_us:
        raise EgodriverAnswerError(f"all in the past: the last pose is {(now_us - int(times[-1])) / 1000:.3f} ms old")
    off_us = int(times[0]) - now_us
    if abs(off_us) > _START_US:
        raise EgodriverAnswerError(
            f"start off by {off_us / 1000:+.3f} ms: the first pose must be that of now, with time_now_us"
        )
