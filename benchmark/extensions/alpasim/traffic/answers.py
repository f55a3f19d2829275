"""Answer of ``simulate``: where each road user is at the time that was asked for, as AlpaSim's runtime takes it.

One that is not in it, or has poses on one side of that time alone, is not there. What the runtime fails at is refused
by name, and so is NaN, which it draws.
"""

from collections.abc import Collection, Mapping
from typing import Any, Final

import numpy as np

from benchmark.extensions.alpasim.poses import Poses, decode_trajectory
from benchmark.extensions.alpasim.traffic.session_log import EGO, LoggedTrack
from benchmark.geometry import Floats
from benchmark.untrusted.files import to_one_line

JUMP_M_S: Final = 70.0
"""Nobody drives as fast."""
_NO_SIZE: Final = np.ones(3)


class TrafficAnswerError(Exception):
    """An answer that cannot be taken; the sentence begins with its name."""


def read_traffic(message: Any, query_us: int, known: Collection[str]) -> dict[str, tuple[Floats, Floats]]:
    """Position and quaternion of each road user who is there, by its name; the ego is passed over.

    Raises:
        TrafficAnswerError: If a name is not among the known, times do not rise, a pose has NaN, or a quaternion is not
            unit.
    """
    found = {}
    for update in message.object_trajectory_updates:
        name = update.object_id
        if name == EGO:
            continue
        if name not in known:
            raise TrafficAnswerError(f"unknown object: {to_one_line(name, 60)!r} was not in the session")
        poses = decode_trajectory(update.trajectory)
        _require_sound(poses, name)
        if len(poses) and poses.times_us[0] <= query_us <= poses.times_us[-1]:
            found[name] = LoggedTrack(name, "", _NO_SIZE, poses).at(query_us)
    return found


def _require_sound(poses: Poses, name: str) -> None:
    who = to_one_line(name, 60)
    if not (np.diff(poses.times_us) > 0).all():
        raise TrafficAnswerError(f"times not rising: each pose of {who!r} must be later than the one before")
    if not (np.isfinite(poses.position).all() and np.isfinite(poses.rotation).all()):
        raise TrafficAnswerError(f"NaN: a pose of {who!r} has NaN or infinity")
    if not poses.are_unit:
        raise TrafficAnswerError(f"quaternion not unit: a rotation of {who!r} has another length than 1")


def find_faults(
    message: Any,
    query_us: int,
    tracks: Collection[LoggedTrack],
    before: Mapping[str, Floats],
    step_s: float,
) -> tuple[list[str], dict[str, Floats]]:
    """What the runtime would fail at, or show as a road user that is gone, jumps or is drawn twice; and who is where.

    ``before`` are positions (3,) of the query so many seconds earlier.
    """
    try:
        found = read_traffic(message, query_us, [track.uuid for track in tracks])
    except TrafficAnswerError as error:
        return [str(error).split(":")[0]], {}
    names = [update.object_id for update in message.object_trajectory_updates]
    faults = ["one object twice"] if len(set(names)) < len(names) else []
    faults += ["EGO in the answer"] if EGO in names else []
    faults += [f"gone: {track.uuid}" for track in tracks if track.covers(query_us) and track.uuid not in found]
    faults += [
        f"jump: {name}"
        for name, (position, _) in found.items()
        if name in before and np.hypot(*(position - before[name])[:2]) > JUMP_M_S * step_s
    ]
    return faults, {name: position for name, (position, _) in found.items()}
