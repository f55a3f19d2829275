"""Recordings as NeuroNCAP's engine reads them, from nuScenes format, and three scenarios for any, to run offline."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.can_bus import CanMessages
from benchmark.datasets.scene_names import find_can_bus_file
from benchmark.datasets.schema.sidecar_files import CAN_BUS, CAN_BUS_POSE
from benchmark.datasets.schema.tables import ValueKind
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.actors import FURTHER_VEHICLES, KEPT_CLASSES, Actor, Integers, compute_heading
from benchmark.extensions.neuroncap.scenarios import STEP_S, Jitter, Scenario, ScenarioActor
from benchmark.geometry import Floats, transform_matrix
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches
from benchmark.scene import Scene

Singles = NDArray[np.float32]
CAN_COLUMNS = 16
"""Of a CAN row: position 3, rotation w x y z, acceleration 3, rotation rate 3, velocity 3."""


@dataclass(frozen=True, slots=True)
class NeuroncapRecording:
    """One scene with F keyframes and its actors, in order of first appearance.

    `poses` are (F, 4, 4) rear axle to global, `canbus` (F, 16) rows, `steering_wheel` (F,) radians.
    """

    times: Integers
    poses: Floats
    canbus: Singles
    steering_wheel: Singles
    actors: tuple[Actor, ...]

    @property
    def path(self) -> Floats:
        """(F, 3) x, y, yaw of all frames."""
        return np.array([[*pose[:2, 3], compute_heading(pose)] for pose in self.poses])


def select_messages(times: Integers, message_times: Integers, values: Floats) -> Singles:
    """Messages of (F,) frames in single precision: the first one at or after each, the last one if none is.

    ``message_times`` are (M,), rising; ``values`` (M, ...) become (F, ...).
    """
    at = np.minimum(np.searchsorted(message_times, times), len(message_times) - 1)
    return np.asarray(values[at], np.float32)


def select_steering(times: Integers, message_times: Integers, degrees: Floats) -> Singles:
    """(F,) angle of the steering wheel in radians, from (M,) messages in degrees."""
    # Multiplied by pi, then divided by 180, each rounded, as in the published code.
    return np.asarray(select_messages(times, message_times, degrees) * np.float32(np.pi) / np.float32(180), np.float32)


@dataclass(frozen=True, slots=True)
class NeuroncapAnnotations:
    """A annotations of I instances, in the data set's order; `frame` and `instance` are (A,) indices.

    `translation` is (A, 3) box centre, global, metres, `rotation` (A, 4) w, x, y, z, `size` (A, 3) width, length,
    height.
    """

    frame: Integers
    instance: Integers
    translation: Floats
    rotation: Floats
    size: Floats
    tokens: Sequence[str]
    categories: Sequence[str]


def build_actors(annotations: NeuroncapAnnotations, times: Integers, switches: NeuroncapSwitches) -> tuple[Actor, ...]:
    """Actors of the recording, of the classes that the engine keeps, in order of first appearance.

    The size is that of the first annotation; a gap between annotations is driven through in a straight line. The
    switches decide whether construction and emergency vehicles are kept.
    """
    kept_classes = {*KEPT_CLASSES, *(FURTHER_VEHICLES if switches.classes == "paper" else ())}
    actors = []
    for instance in dict.fromkeys(annotations.instance.tolist()):
        kind = [*annotations.categories[instance].split("."), ""][1]
        if kind not in kept_classes:
            continue
        rows = np.flatnonzero(annotations.instance == instance)
        rows = rows[np.argsort(annotations.frame[rows], kind="stable")]
        poses = [transform_matrix(annotations.rotation[row], annotations.translation[row]) for row in rows]
        stamps = times[annotations.frame[rows]]
        actors.append(Actor(annotations.tokens[instance], kind, annotations.size[rows[0]], stamps, np.array(poses)))
    return tuple(actors)


START_FRAME: Final = 4
PRIMING_STEPS: Final = 2
DURATION_S: Final = 8.0
MEETING_FRAMES: Final = 12
"""From the start to the meeting."""
LEAST_DRIVEN_M: Final = 15.0
"""Least distance that the ego drives until the meeting; a slower ego would meet no actor."""
_CANDIDATES: Final = 3
"""Cars of the recording of which one is drawn."""
_CROSSING_M_S: Final = 6.0
_CROSSING_S: Final = 5.0
"""Before and after the meeting."""


def build_own_scenarios(recording: NeuroncapRecording) -> dict[str, Scenario]:
    """Scenarios of a recording by family; none where it is too short, has no car, or its ego hardly moves."""
    meeting = START_FRAME + MEETING_FRAMES
    cars = tuple(actor.uuid for actor in recording.actors if actor.kind == "car")[:_CANDIDATES]
    if not cars or meeting + MEETING_FRAMES // 2 >= len(recording.times):
        return {}
    if float(np.hypot(*(recording.path[meeting] - recording.path[START_FRAME])[:2])) < LEAST_DRIVEN_M:
        return {}
    yaw = float(recording.path[meeting, 2])
    place, seconds = recording.poses[meeting, :3, 3], (recording.times - recording.times[0]) / 1e6
    stands = (np.array([0.0, float(seconds[-1])]), np.stack([place, place]))
    oncoming = _build_oncoming_track(recording, seconds, meeting)
    aside = _CROSSING_M_S * _CROSSING_S * np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    crosses = (seconds[meeting] + np.array([-_CROSSING_S, _CROSSING_S]), np.stack([place - aside, place + aside]))
    return {
        "stationary": _build_scenario(cars, *stands, yaw, Jitter(3.0, 1.0, yaw, 0.5)),
        "frontal": _build_scenario(cars, *oncoming, yaw + np.pi, Jitter(3.0, 0.75, yaw)),
        "side": _build_scenario(cars, *crosses, yaw + np.pi / 2, Jitter(1.0, 0.5, yaw + np.pi / 2)),
    }


def _build_oncoming_track(recording: NeuroncapRecording, seconds: Floats, meeting: int) -> tuple[Floats, Floats]:
    """Times and places of an actor that comes the ego's way backwards, as fast as the ego came.

    Beyond the recording's end the way goes on straight: it begins so far ahead that it does not appear from nothing.
    """
    times = seconds[START_FRAME] - 1.0 + np.arange(0.0, DURATION_S + 3.0)
    mirrored_times = 2 * seconds[meeting] - times
    places = np.column_stack([np.interp(mirrored_times, seconds, column) for column in recording.poses[:, :3, 3].T])
    last = (recording.poses[-1, :3, 3] - recording.poses[-2, :3, 3]) / STEP_S
    return times, places + np.maximum(mirrored_times - seconds[-1], 0.0)[:, None] * last


def _build_scenario(cars: tuple[str, ...], times: Floats, positions: Floats, yaw: float, jitter: Jitter) -> Scenario:
    target = ScenarioActor(
        mode="override",
        uuids=cars,
        drawn=True,
        is_target=True,
        times=times,
        positions=positions,
        initial_yaw=yaw,
        jitter=jitter,
    )
    return Scenario(START_FRAME, PRIMING_STEPS, DURATION_S, start_jitter=1, actors=(target,))


_POSE: Final[dict[str, ValueKind]] = {
    "utime": CAN_BUS["pose"]["utime"],
    **CAN_BUS_POSE,
    **{name: CAN_BUS["pose"][name] for name in ("accel", "rotation_rate", "vel")},
}
"""Fields of a CAN row, in its order."""
_WHEEL: Final[dict[str, ValueKind]] = {
    "utime": CAN_BUS["pose"]["utime"],
    "steer_corrected": CAN_BUS["steeranglefeedback"]["value"],
}


def read_recording(scene: Scene, root: Path, switches: NeuroncapSwitches) -> NeuroncapRecording:
    """A scene as the engine reads it, with the CAN bus below the root of its data set, which it must have."""
    times = scene.timestamps_us[scene.keyframes]
    motion, wheel = (
        _read_messages(root, scene.name, "pose", _POSE),
        _read_messages(root, scene.name, "zoe_veh_info", _WHEEL),
    )
    ego = scene.ego
    poses = [transform_matrix(ego.rotation[frame], ego.position[frame]) for frame in scene.keyframes]
    return NeuroncapRecording(
        times=times,
        poses=np.array(poses),
        canbus=select_messages(times, motion.times_us, motion.values),
        steering_wheel=select_steering(times, wheel.times_us, wheel.values[:, 0]),
        actors=build_actors(read_annotations(scene), times, switches),
    )


def has_can_bus(scene: str, root: Path) -> bool:
    """Whether a data set has the CAN bus messages of a scene that the engine reads."""
    return all(find_can_bus_file(root, scene, message).is_file() for message in ("pose", "zoe_veh_info"))


def _read_messages(root: Path, scene: str, message: str, fields: dict[str, ValueKind]) -> CanMessages:
    path = find_can_bus_file(root, scene, message)
    messages = CanMessages.read(path, fields)
    if messages is None:
        raise InputError(
            f"NeuroNCAP's engine starts the ego from the CAN bus, but {path} holds nothing; get the CAN bus "
            "expansion, or leave the scene out"
        )
    return messages


def read_annotations(scene: Scene) -> NeuroncapAnnotations:
    """Annotations keyframe by keyframe, each in the data set's order."""
    known = scene.annotations
    frame, agent = np.nonzero(known.valid.T)
    size: Floats = known.size[agent, frame][:, [1, 0, 2]]
    return NeuroncapAnnotations(
        frame=frame,
        instance=agent,
        translation=known.position[agent, frame],
        rotation=known.rotation[agent, frame],
        size=size,
        tokens=scene.agents.ids,
        categories=scene.agents.categories,
    )
