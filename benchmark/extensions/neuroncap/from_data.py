"""Recordings for NeuroNCAP's engine from a data set in nuScenes format: frames, annotations, CAN bus."""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.datasets.can_bus import CanMessages
from benchmark.datasets.schema.beside import CAN_BUS, CAN_BUS_POSE
from benchmark.datasets.schema.kinds import Kind
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.recording import (
    Annotations,
    Recording,
    actors_of,
    at_frames,
    steering_at_frames,
)
from benchmark.geometry import Floats, transform_matrix
from benchmark.records.neuroncap_switches import Switches
from benchmark.scene import Scene

_POSE: Final[dict[str, Kind]] = {
    "utime": CAN_BUS["pose"]["utime"],
    **CAN_BUS_POSE,
    **{name: CAN_BUS["pose"][name] for name in ("accel", "rotation_rate", "vel")},
}
"""Fields of a CAN row, in its order."""
_WHEEL: Final[dict[str, Kind]] = {
    "utime": CAN_BUS["pose"]["utime"],
    "steer_corrected": CAN_BUS["steeranglefeedback"]["value"],
}


def recording_of(scene: Scene, root: Path, switches: Switches) -> Recording:
    """A scene as the engine reads it, with the CAN bus below the root of its data set, which it must have."""
    times = scene.timestamps_us[scene.keyframes]
    motion, wheel = _messages(root, scene.name, "pose", _POSE), _messages(root, scene.name, "zoe_veh_info", _WHEEL)
    ego = scene.ego
    poses = [transform_matrix(ego.rotation[frame], ego.position[frame]) for frame in scene.keyframes]
    return Recording(
        times=times,
        poses=np.array(poses),
        canbus=at_frames(times, motion.times_us, motion.values),
        steering_wheel=steering_at_frames(times, wheel.times_us, wheel.values[:, 0]),
        actors=actors_of(annotations_of(scene), times, switches),
    )


def has_can_bus(scene: str, root: Path) -> bool:
    """Whether a data set has what the engine reads of the CAN bus of a scene."""
    return all((root / "can_bus" / f"{scene}_{message}.json").is_file() for message in ("pose", "zoe_veh_info"))


def _messages(root: Path, scene: str, message: str, fields: dict[str, Kind]) -> CanMessages:
    path = root / "can_bus" / f"{scene}_{message}.json"
    found = CanMessages.read(path, fields)
    if found is None:
        raise InputError(
            f"NeuroNCAP's engine starts its car from the CAN bus, and there is nothing in {path}; get the CAN bus "
            "expansion, or leave the scene out"
        )
    return found


def annotations_of(scene: Scene) -> Annotations:
    """Annotations keyframe by keyframe, each in the data set's order."""
    known = scene.annotations
    frame, agent = np.nonzero(known.valid.T)
    size: Floats = known.size[agent, frame][:, [1, 0, 2]]
    return Annotations(
        frame=frame,
        instance=agent,
        translation=known.position[agent, frame],
        rotation=known.rotation[agent, frame],
        size=size,
        tokens=scene.agents.ids,
        categories=scene.agents.categories,
    )
