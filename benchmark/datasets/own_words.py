"""Words of ScenarioNet files that are written here, beside those that every such file has.

What ScenarioNet has a place for stands there, once, and can be edited there. What it has none for stands under `OWN`:
of the file in its metadata, of a track in the metadata of the track, of a part of the map in that part.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_HEIGHT_M
from benchmark.geometry import Floats
from benchmark.scene import EgoTrack, Scene

OWN: Final = "challenger_bench"
DATASET: Final = "challenger-bench"
SCHEMA: Final = 1
ADVERSARIES: Final = "adversaries"
"""In the metadata of a file: names of the tracks that are adversaries."""
IS_ADVERSARY: Final = "is_adversary"
"""In the metadata of each track of a file that is written here."""
RING_PREFIX: Final = "boundary_"
"""What parts of the map that are rings of the drivable area are called after, as in files of nuScenes."""

NEEDS_A_PACKAGE: Final = (
    "writing OpenSCENARIO needs the package scenariogeneration; install it with: pip install "
    "'challenger-bench[openscenario]'"
)


@dataclass(frozen=True, slots=True)
class Exchanged:
    """A scene and how it was made, as a file carries both.

    Attributes:
        source_scene: Name of the recorded scene that it was made from; its own name for a recording.
        report: What ``challenger.json`` says of how it was made; JSON values.
    """

    scene: Scene
    source_scene: str
    report: Mapping[str, Any] = field(default_factory=dict)


def ego_center(ego: EgoTrack) -> Floats:
    """(T, 3) centre of the ego's body, which is what positions of tracks are; `EgoTrack` has the rear axle."""
    yaw = ego.yaw
    ahead = EGO_CENTER_FROM_REAR_AXLE_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
    return np.column_stack([ego.position[:, :2] + ahead, ego.position[:, 2] + 0.5 * EGO_HEIGHT_M])


def track_digest(position: Floats, yaw: Floats, size: Floats, valid: Any) -> str:
    """Hash of a track, 64 hexadecimal digits, by which an edited one is known.

    Args:
        position: (T, 3) metres.
        yaw: (T,) radians.
        size: (3,) metres.
        valid: (T,) whether it is there; where it is not, nothing counts.
    """
    there = np.asarray(valid, np.bool_)
    parts = (np.asarray(position, "<f8")[there], np.asarray(yaw, "<f8")[there], np.asarray(size, "<f8"))
    return hashlib.sha256(there.tobytes() + b"".join(part.tobytes() for part in parts)).hexdigest()
