"""Recorded drive: lidar path, its command, and CAN messages as converters take them, some one message too late."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np

from benchmark.constants import COMMAND_LATERAL_M, EGO_LENGTH_M, EGO_WHEELBASE_M, EGO_WIDTH_M, PLAN_STEP_S, PLAN_STEPS
from benchmark.datasets.scene_names import find_can_bus_file, find_table_name_below, is_devkit_name
from benchmark.datasets.schema.sidecar_files import CAN_BUS, CAN_BUS_POSE, require_records
from benchmark.errors import InputError
from benchmark.extensions.infos.frames import SensorFrame, compute_roll
from benchmark.extensions.infos.scene_rows import SceneTableRows
from benchmark.geometry import Floats
from benchmark.machine.storage import read_json
from benchmark.untrusted.files import to_one_line

_NUMBERED: Final = re.compile(r"scene-(\d{4})(?!\d)")
_WITHOUT: Final = frozenset({*range(161, 169), *range(170, 177), *range(309, 315)})
"""Numbers of scenes whose messages the devkit does not hand out."""
VECTOR_VALUES: Final = 18
_MEASURED: Final = 16

Message = Mapping[str, Any]


class NearestMessages(NamedTuple):
    """The messages nearest to a time: three numbers each, and the angle of the steering wheel."""

    acceleration: Sequence[float]
    rotation_rate: Sequence[float]
    velocity: Sequence[float]
    steering: float


@dataclass(frozen=True, slots=True)
class ConverterCanMessages:
    """Messages of a scene in the order of the files; none where a file is missing.

    A `pose` has position, orientation, acceleration, rotation rate, velocity, in the order of the file's keys.
    """

    pose: Sequence[Message]
    steering: Sequence[Message]

    @classmethod
    def read(cls, root: Path, scene: str, *, as_converted: bool) -> Self:
        """Read both files of a scene; ``as_converted``, names but ``scene-dddd`` have none, as for the devkit."""
        scene = find_table_name_below(root, scene)
        number = _NUMBERED.match(scene)
        hidden = number is not None and int(number[1]) in _WITHOUT
        if hidden or (as_converted and not is_devkit_name(scene)):
            return cls((), ())
        kinds = {**CAN_BUS, "pose": {**CAN_BUS["pose"], **CAN_BUS_POSE}}
        message_lists = []
        for kind in ("pose", "steeranglefeedback"):
            path = find_can_bus_file(root, scene, kind)
            messages = read_json(path) if path.is_file() else []
            message_lists.append(require_records(path, "message", messages, kinds[kind]))
        return cls(*message_lists)

    def vector(self, time_us: int) -> Floats:
        """The (18,) vector ``can_bus`` of an info; zeros where there are no messages.

        Position and orientation are those of the last message up to now; all else is of the one after it, at which the
        converters' search stopped.
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
                f"code reads ({', '.join(map(to_one_line, last))}); fetch or make the files again"
            )
        return vector

    def nearest(self, time_us: int) -> NearestMessages | None:
        """The messages that are nearest in time, the later one of two; ``None`` where a kind is missing."""
        if not self.pose or not self.steering:
            return None
        pose, wheel = (_find_nearest(messages, time_us) for messages in (self.pose, self.steering))
        return NearestMessages(pose["accel"], pose["rotation_rate"], pose["vel"], wheel["value"])


def _find_nearest(messages: Sequence[Message], time_us: int) -> Message:
    away = np.abs(np.array([message["utime"] for message in messages], np.int64) - time_us)
    return messages[len(away) - 1 - int(np.argmin(away[::-1]))]


def has_can_bus(root: Path, scene: str) -> bool:
    """Whether a root has messages of a scene's pose."""
    return find_can_bus_file(root, scene, "pose").is_file()


HISTORY_STEPS: Final = 2
_RIGHT, _LEFT, _STRAIGHT = range(3)
_LEFT_HAND_TRAFFIC: Final = "singapore"
STATUS_VALUES: Final = 10


@dataclass(frozen=True, slots=True)
class EgoTrajectory:
    """Ego at all S samples of a scene, in time order; `origin` (S, 3) is the lidar's, global, `place` by token."""

    frames: tuple[SensorFrame, ...]
    origin: Floats
    place: dict[str, int]
    times_us: tuple[int, ...]

    @classmethod
    def of(cls, rows: SceneTableRows) -> Self:
        """Raises `InputError` if a sample has no lidar."""
        frames = tuple(rows.frame(rows.lidar(sample)) for sample in rows.samples_in_time_order)
        return cls(
            frames=frames,
            origin=np.array([frame.origin for frame in frames]),
            place={sample["token"]: number for number, sample in enumerate(rows.samples_in_time_order)},
            times_us=tuple(sample["timestamp"] for sample in rows.samples_in_time_order),
        )

    def path(self, at: int) -> dict[str, Floats]:
        """Two steps back and six ahead, in the lidar frame of a sample.

        ``gt_ego_his_trajs`` are (2, 2) offsets, the older first; ``gt_ego_fut_trajs`` (6, 2), 0 after the end of the
        scene (``gt_ego_fut_masks``); ``gt_ego_fut_cmd`` is (3,) right, left or straight.
        """
        last = len(self.frames) - 1
        planar = self.frames[at].local(self.origin)[:, :2]
        ahead = planar[[min(at + step, last) for step in range(PLAN_STEPS + 1)]]
        command = np.zeros(3)
        command[_compute_command(float(ahead[-1, 0]))] = 1.0
        steps = np.diff(planar, axis=0) if last else np.zeros((1, 2))
        return {
            # Poses before the recording are extrapolated: the first step is repeated.
            "gt_ego_his_trajs": steps[[max(at - back, 0) for back in range(HISTORY_STEPS, 0, -1)]],
            "gt_ego_fut_trajs": np.diff(ahead, axis=0),
            "gt_ego_fut_masks": np.array([float(at + step <= last) for step in range(1, PLAN_STEPS + 1)]),
            "gt_ego_fut_cmd": command,
        }

    def features(self, at: int, path: dict[str, Floats], can: ConverterCanMessages, location: str) -> Floats:
        """VAD's (9,) velocity, acceleration, rate of the angle, length and width of the car, speed, curvature.

        Times between samples are taken for half a second, long or short, and the angle is a roll (`compute_roll`), so
        that on flat roads the car seems to drive along the y axis and never to turn.
        """
        first = max(at - 1, 0)
        poses = [self.frames[number].pose for number in (first, min(first + 1, len(self.frames) - 1))]
        speed = np.linalg.norm(poses[1][1][:2] - poses[0][1][:2]) / PLAN_STEP_S
        angles = [float(compute_roll(rotation)) for rotation, _ in poses]
        ahead = float(compute_roll(self.frames[at].pose[0])) + np.pi / 2
        measured = can.nearest(self.times_us[at])
        if measured is None:
            travelled = path["gt_ego_his_trajs"][-1] + path["gt_ego_fut_trajs"][0]
            forward, curvature = float(np.linalg.norm(travelled)), 0.0
        else:
            forward, steering = measured.velocity[0], measured.steering
            sign = -1.0 if location.startswith(_LEFT_HAND_TRAFFIC) else 1.0
            curvature = 2 * sign * steering / EGO_WHEELBASE_M
        return np.array(
            [
                speed * np.cos(ahead),
                speed * np.sin(ahead),
                *can.vector(self.times_us[at])[7:9],
                (angles[1] - angles[0]) / PLAN_STEP_S,
                EGO_LENGTH_M,
                EGO_WIDTH_M,
                forward,
                curvature,
            ]
        )


def _compute_command(lateral_m: float) -> int:
    if lateral_m >= COMMAND_LATERAL_M:
        return _RIGHT
    return _LEFT if lateral_m <= -COMMAND_LATERAL_M else _STRAIGHT


def compute_ego_status(can: ConverterCanMessages, time_us: int) -> Floats:
    """SparseDrive's (10,) acceleration, rotation rate, velocity, steering angle; zeros where any of them is missing."""
    messages = can.nearest(time_us)
    if messages is None:
        return np.zeros(STATUS_VALUES)
    return np.array([*messages.acceleration, *messages.rotation_rate, *messages.velocity, messages.steering])


def to_single_precision(values: dict[str, Any]) -> dict[str, Any]:
    """Arrays as they are stored: cast at the very end."""
    return {name: np.asarray(value, np.float32) for name, value in values.items()}
