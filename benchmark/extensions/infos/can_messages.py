"""CAN bus messages as the converters take them: in the order of the file, some of them one message too late."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np

from benchmark.datasets.schema.beside import CAN_BUS, CAN_BUS_POSE, require_records
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import read_json
from benchmark.untrusted.files import one_line

OFFICIAL_NAME: Final = re.compile(r"scene-\d\d\d\d")
"""Names of scenes that the devkit's reader takes."""
_NUMBERED: Final = re.compile(r"scene-(\d{4})(?!\d)")
_WITHOUT: Final = frozenset({*range(161, 169), *range(170, 177), *range(309, 315)})
"""Numbers of scenes whose messages the devkit does not hand out."""
VECTOR_VALUES: Final = 18
_MEASURED: Final = 16

Message = Mapping[str, Any]


class Measured(NamedTuple):
    """The messages nearest to a time: three numbers each, and the angle of the steering wheel."""

    acceleration: Sequence[float]
    rotation_rate: Sequence[float]
    velocity: Sequence[float]
    steering: float


@dataclass(frozen=True, slots=True)
class CanMessages:
    """Messages of a scene in the order of the files; none where a file is missing.

    Attributes:
        pose: Position, orientation, acceleration, rotation rate, velocity, in the order of the file's keys.
        steering: Angle of the steering wheel.
    """

    pose: Sequence[Message]
    steering: Sequence[Message]

    @classmethod
    def read(cls, root: Path, scene: str, *, as_converted: bool) -> Self:
        """Read the two files of a scene.

        Args:
            as_converted: Whether names that are not ``scene-dddd`` have none, as for the devkit.
        """
        number = _NUMBERED.match(scene)
        hidden = number is not None and int(number[1]) in _WITHOUT
        if hidden or (as_converted and not OFFICIAL_NAME.fullmatch(scene)):
            return cls((), ())
        kinds = {**CAN_BUS, "pose": {**CAN_BUS["pose"], **CAN_BUS_POSE}}
        found = []
        for kind in ("pose", "steeranglefeedback"):
            path = root / "can_bus" / f"{scene}_{kind}.json"
            messages = read_json(path) if path.is_file() else []
            found.append(require_records(path, "message", messages, kinds[kind]))
        return cls(*found)

    def vector(self, time_us: int) -> Floats:
        """The vector ``can_bus`` of an info.

        Position and orientation are those of the last message up to now; all else is of the one after it, at which the
        converters' search stopped.

        Returns:
            (18,) zeros where there are no messages.
        """
        if not self.pose:
            return np.zeros(VECTOR_VALUES)
        last = stopped = self.pose[0]
        for stopped in self.pose:
            if stopped["utime"] > time_us:
                break
            last = stopped
        others = [name for name in last if name not in ("utime", "pos", "orientation")]
        try:
            values = [*last["pos"], *last["orientation"], *(value for name in others for value in stopped[name])]
            vector = np.array([*values, 0.0, 0.0], np.float64)
        except (KeyError, TypeError, ValueError):
            vector = np.zeros(0)
        if vector.shape != (VECTOR_VALUES,):
            raise InputError(
                f"pose messages of the CAN bus at {last['utime']} do not hold the {_MEASURED} numbers that official "
                f"code takes ({', '.join(map(one_line, last))}); fetch or make the files again"
            )
        return vector

    def nearest(self, time_us: int) -> Measured | None:
        """The messages that are nearest in time, the later one of two; ``None`` where a kind is missing."""
        if not self.pose or not self.steering:
            return None
        pose, wheel = (_nearest(messages, time_us) for messages in (self.pose, self.steering))
        return Measured(pose["accel"], pose["rotation_rate"], pose["vel"], wheel["value"])


def _nearest(messages: Sequence[Message], time_us: int) -> Message:
    away = np.abs(np.array([message["utime"] for message in messages], np.int64) - time_us)
    return messages[len(away) - 1 - int(np.argmin(away[::-1]))]
