"""CAN bus files of a scene: the recording's own where the source has them, else derived from the ego track.

Field names, units and frames are those of the nuScenes CAN bus expansion. Derived files are sparser than measured ones:
``pose``, ``ms_imu`` and ``steeranglefeedback`` have 50 messages a second, ``zoe_veh_info`` and ``zoesensors`` 25 and
``vehicle_monitor`` 2. What an ego track cannot tell (pedals, battery, lamps) has its resting value. The state at any
moment depends on nothing later than it, except in the first half second, where there is nothing earlier.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import EGO_WHEELBASE_M
from benchmark.datasets.can_bus import move_messages
from benchmark.datasets.scene_names import find_can_bus_file
from benchmark.geometry import Floats, rotation_matrix
from benchmark.machine.storage import canonical_json, read_json
from benchmark.scene import Scene
from generation.nuscenes_writer.plan import SourceInfo

MESSAGES: Final = ("ms_imu", "pose", "steeranglefeedback", "vehicle_monitor", "zoe_veh_info", "zoesensors")
_RATES_HZ: Final = dict(zip(MESSAGES, (50, 50, 50, 2, 25, 25)))
_GRAVITY: Final = 9.81
_STEERING_RATIO: Final = 14.9
"""Turns of the steering wheel per turn of the road wheels (Renault Zoe)."""
_WHEEL_RADIUS_M: Final = 0.31
_STEERING_LIMIT_RAD: Final = 7.7
_SLOWEST_STEERING_M_S: Final = 0.5
"""Below this speed the path says nothing of the steering; it is held."""
_FIT_FRAMES: Final = 7
"""Half a second at 12 Hz."""


def build_can_bus_files(
    scene: Scene, *, name: str, source: SourceInfo | None, source_scene: str, shift_us: int = 0
) -> dict[str, bytes]:
    """CAN bus files by path below the data root; ``source_scene`` is the recording's name in ``source``.

    ``shift_us`` is by how much the scene's times are later than the recording's.
    """
    if source is not None and source.root is not None:
        pattern = find_can_bus_file(source.root, source_scene, "*")
        recorded, own = sorted(pattern.parent.glob(pattern.name)), pattern.name.removesuffix("_*.json")
        if recorded:
            return {f"can_bus/{name}{path.name.removeprefix(own)}": _read_shifted(path, shift_us) for path in recorded}
    messages = derive_messages(scene)
    return {
        f"can_bus/{name}_{kind}.json": (canonical_json(content) + "\n").encode() for kind, content in messages.items()
    }


def _read_shifted(path: Path, shift_us: int) -> bytes:
    """A recorded file, or the same with its messages later; keys keep their order, which converters go by."""
    data = path.read_bytes()
    content = read_json(path) if shift_us else None
    moved = move_messages(content, shift_us)
    return (json.dumps(content, separators=(",", ":")) + "\n").encode() if moved else data


@dataclass(frozen=True, slots=True)
class CanBusEgoMotion:
    """Ego motion at T frames: (T,) microseconds, (T, 3) position of the rear axle, global, (T, 4) unit quaternions.

    Quaternions are of one hemisphere. Velocity, m/s, and acceleration, m/s^2, are (T, 3) in the ego frame, gravity
    included, as an accelerometer reads it; rotation rates, rad/s, are about the vertical only. ``steering`` is the (T,)
    steering wheel angle, radians, left positive.
    """

    utime: Floats
    position: Floats
    rotation: Floats
    velocity: Floats
    acceleration: Floats
    rotation_rate: Floats
    steering: Floats

    @classmethod
    def of(cls, scene: Scene) -> "CanBusEgoMotion":
        """Velocity and acceleration from a quadratic through the last half second of the recorded track."""
        yaw = np.unwrap(scene.ego.yaw)
        _, first, second = _fit_derivatives(scene.seconds, np.column_stack([scene.ego.position, yaw]))
        to_ego = rotation_matrix(scene.ego.rotation).transpose(0, 2, 1)
        velocity = np.einsum("tij,tj->ti", to_ego, first[:, :3])
        acceleration = np.einsum("tij,tj->ti", to_ego, second[:, :3] + [0.0, 0.0, _GRAVITY])
        rate = np.zeros_like(velocity)
        rate[:, 2] = first[:, 3]
        return cls(
            utime=scene.timestamps_us.astype(np.float64),
            position=scene.ego.position,
            rotation=_align_signs(scene.ego.rotation),
            velocity=velocity,
            acceleration=acceleration,
            rotation_rate=rate,
            steering=_compute_steering(velocity[:, 0], rate[:, 2]),
        )

    def at(self, utime: Floats) -> "CanBusEgoMotion":
        """Linear interpolation to other times."""

        def between(values: Floats) -> Floats:
            columns = values.reshape(len(values), -1).T
            return np.stack([np.interp(utime, self.utime, column) for column in columns], axis=-1)

        rotation = between(self.rotation)
        return CanBusEgoMotion(
            utime=utime,
            position=between(self.position),
            rotation=rotation / np.linalg.norm(rotation, axis=-1, keepdims=True),
            velocity=between(self.velocity),
            acceleration=between(self.acceleration),
            rotation_rate=between(self.rotation_rate),
            steering=between(self.steering)[:, 0],
        )


def derive_messages(scene: Scene) -> dict[str, Any]:
    """Content of all message files of a scene from its ego track: the six kinds of messages, ``meta`` and ``route``."""
    motion = CanBusEgoMotion.of(scene)
    first, last = int(scene.timestamps_us[0]), int(scene.timestamps_us[-1])
    content: dict[str, Any] = {}
    for kind, rate_hz in _RATES_HZ.items():
        utime = np.arange(first, last + 1, 1_000_000 // rate_hz, dtype=np.float64)
        columns = {name: _to_plain_lists(values) for name, values in _FIELDS[kind](motion.at(utime)).items()}
        content[kind] = [
            {"utime": int(time), **{name: values[row] for name, values in columns.items()}}
            for row, time in enumerate(utime)
        ]
    content["meta"] = {kind: _compute_statistics(content[kind]) for kind in MESSAGES}
    content["route"] = _build_route(scene.ego.position[:, :2])
    return content


def _fit_derivatives(seconds: Floats, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Value, first and second derivative of least-squares quadratics through the latest frames, each (T, C)."""
    fitted = []
    for frame in range(len(seconds)):
        window = slice(max(frame - _FIT_FRAMES + 1, 0), max(frame + 1, _FIT_FRAMES))
        time = seconds[window] - seconds[frame]
        degree = min(2, len(time) - 1)
        origin = values[frame]
        coefficients = np.linalg.lstsq(
            np.vander(time, degree + 1, increasing=True), values[window] - origin, rcond=None
        )[0]
        full = np.zeros((3, values.shape[1]))
        full[: degree + 1] = coefficients
        fitted.append([full[0] + origin, full[1], 2 * full[2]])
    value, first, second = np.array(fitted).transpose(1, 0, 2)
    return value, first, second


def _align_signs(rotation: Floats) -> Floats:
    """Quaternions with signs such that neighbours can be averaged."""
    flips = np.einsum("ti,ti->t", rotation[1:], rotation[:-1]) < 0
    sign = np.where(np.concatenate([[False], np.cumsum(flips) % 2 == 1]), -1.0, 1.0)
    return np.asarray(rotation * sign[:, None])


def _compute_steering(speed: Floats, yaw_rate: Floats) -> Floats:
    """Steering wheel angle of a kinematic bicycle, held where the car hardly moves."""
    moving = np.abs(speed) >= _SLOWEST_STEERING_M_S
    road_wheel = np.arctan(EGO_WHEELBASE_M * yaw_rate / np.where(moving, speed, 1.0))
    source = np.maximum.accumulate(np.where(moving, np.arange(len(speed)), -1))
    held = np.where(source >= 0, road_wheel[np.maximum(source, 0)], 0.0)
    return np.clip(_STEERING_RATIO * held, -_STEERING_LIMIT_RAD, _STEERING_LIMIT_RAD)


def _build_pose(motion: CanBusEgoMotion) -> dict[str, Floats]:
    return {
        "accel": motion.acceleration,
        "orientation": motion.rotation,
        "pos": motion.position,
        "rotation_rate": motion.rotation_rate,
        "vel": motion.velocity,
    }


def _build_imu(motion: CanBusEgoMotion) -> dict[str, Floats]:
    return {"linear_accel": motion.acceleration, "q": motion.rotation, "rotation_rate": motion.rotation_rate}


def _build_steering_feedback(motion: CanBusEgoMotion) -> dict[str, Floats]:
    return {"value": motion.steering}


def _build_vehicle_monitor(motion: CanBusEgoMotion) -> dict[str, Floats]:
    rest = np.zeros(len(motion.utime))
    rpm = _compute_wheel_rpm(motion)
    return {
        "available_distance": rest + 150.0,
        "battery_level": rest + 80.0,
        "brake": rest,
        "brake_switch": rest + 1.0,
        "gear_position": rest + 7.0,
        "left_signal": rest,
        "rear_left_rpm": rpm,
        "rear_right_rpm": rpm,
        "right_signal": rest,
        "steering": np.rad2deg(motion.steering),
        "steering_speed": rest,
        "throttle": rest,
        "vehicle_speed": 3.6 * motion.velocity[:, 0],
        "yaw_rate": np.rad2deg(motion.rotation_rate[:, 2]),
    }


def _build_zoe_veh_info(motion: CanBusEgoMotion) -> dict[str, Floats]:
    rest, rpm = np.zeros(len(motion.utime)), _compute_wheel_rpm(motion)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(motion.position[:, :2], axis=0), axis=1))])
    steering_deg = np.rad2deg(motion.steering)
    wheels = dict.fromkeys(("FL_wheel_speed", "FR_wheel_speed", "RL_wheel_speed", "RR_wheel_speed"), rpm)
    resting = ("left_solar", "meanEffTorque", "pedal_cc", "regen", "requestedTorqueAfterProc", "right_solar")
    return {
        **wheels,
        **dict.fromkeys(resting, rest),
        "longitudinal_accel": motion.acceleration[:, 0],
        "odom": travelled,
        "odom_speed": 3.6 * motion.velocity[:, 0],
        "steer_corrected": steering_deg,
        "steer_offset_can": rest,
        "steer_raw": steering_deg,
        "transversal_accel": motion.acceleration[:, 1],
    }


def _build_zoe_sensors(motion: CanBusEgoMotion) -> dict[str, Floats]:
    rest = np.zeros(len(motion.utime))
    steering = 0.5 + 0.5 * motion.steering / _STEERING_LIMIT_RAD
    return {"brake_sensor": rest + 0.166, "steering_sensor": steering, "throttle_sensor": rest + 0.105}


def _compute_wheel_rpm(motion: CanBusEgoMotion) -> Floats:
    return motion.velocity[:, 0] / (2 * np.pi * _WHEEL_RADIUS_M) * 60.0


_FIELDS: Final[Mapping[str, Callable[[CanBusEgoMotion], dict[str, Floats]]]] = {
    "ms_imu": _build_imu,
    "pose": _build_pose,
    "steeranglefeedback": _build_steering_feedback,
    "vehicle_monitor": _build_vehicle_monitor,
    "zoe_veh_info": _build_zoe_veh_info,
    "zoesensors": _build_zoe_sensors,
}


def _to_plain_lists(values: Floats) -> list[Any]:
    """Lists of rounded numbers, without negative zeros."""
    rounded: list[Any] = (np.round(values, 6) + 0.0).tolist()
    return rounded


def _compute_statistics(messages: list[dict[str, Any]]) -> dict[str, Any]:
    """Summary of one kind of message, with the keys that nuScenes' ``meta`` files have."""
    utime = [message["utime"] for message in messages]
    span = (utime[-1] - utime[0]) * 1e-6
    stats: dict[str, Any] = {}
    for name in messages[0]:
        if name == "utime":
            continue
        values = np.array([message[name] for message in messages], np.float64).reshape(len(messages), -1)
        steps = np.diff(values, axis=0) if len(values) > 1 else np.zeros((1, values.shape[1]))
        summary = [_summarise(column, step) for column, step in zip(values.T, steps.T)]
        stats[name] = summary[0] if len(summary) == 1 else {str(axis): item for axis, item in enumerate(summary)}
    return {
        "message_count": len(messages),
        "message_freq": len(messages) / span if span > 0 else 0.0,
        "timespan": span,
        "var_stats": stats,
    }


def _summarise(values: Floats, steps: Floats) -> dict[str, float]:
    parts = {"": values, "diff_": steps}
    return {
        f"{prefix}{kind}": float(np.round(getattr(np, kind)(of), 6))
        for prefix, of in parts.items()
        for kind in ("max", "mean", "min", "std")
    }


def _build_route(path: Floats, spacing_m: float = 0.5) -> list[list[float]]:
    """The driven path about every half metre, as nuScenes' baseline route: a list of x and y."""
    route = [path[0]]
    for point in path[1:]:
        if np.hypot(*(point - route[-1])) >= spacing_m:
            route.append(point)
    route.append(path[-1])
    return [_to_plain_lists(point) for point in route]
