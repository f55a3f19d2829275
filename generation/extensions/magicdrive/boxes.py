"""Boxes with identities, as the model is told about them (sections 4.2 and 9)."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import DETECTION_CLASS_OF_CATEGORY, DETECTION_CLASSES
from benchmark.geometry import Bools, Floats, rotation_matrix
from benchmark.scene import Scene
from generation.extensions.magicdrive.annotations_12hz import BoxTracks, box_tracks
from generation.extensions.magicdrive.conditions import ABSENT_CLASS
from generation.extensions.magicdrive.sensor_frames import SensorFrames

_CLASS_OF_ADVERSARY: Final = {"vehicle.emergency.police": "car", "vehicle.emergency.ambulance": "truck"}
"""An adversary that nobody sees would make its scene worthless."""
# Front, left, up of each corner as signs; faces right and left, each from the front bottom edge over the top.
_CORNER_SIGNS: Final = np.array(
    [(1, -1, 0), (1, -1, 1), (-1, -1, 1), (-1, -1, 0), (1, 1, 0), (1, 1, 1), (-1, 1, 1), (-1, 1, 0)], np.float64
)


@dataclass(frozen=True, slots=True)
class ClipBoxes:
    """The boxes of a clip; n slots, one for each object that appears in it, in the order of their names.

    Attributes:
        ids: Instance identifiers of the slots; empty where the one slot is padding.
        corners: (T, n, 8, 3) metres, lidar frame of the frame, half a height too high as in the model's training; 0
            where the object is absent.
        true_corners: (T, n, 8, 3) the same where the objects really are.
        classes: (T, n) index into `DETECTION_CLASSES`, -1 where the object is absent.
        masks: (V, T, n) 1 where any true corner lies in front of the camera's lens, else 0.
    """

    ids: tuple[str, ...]
    corners: NDArray[np.float32]
    true_corners: NDArray[np.float32]
    classes: NDArray[np.int64]
    masks: NDArray[np.int64]

    @property
    def present(self) -> Bools:
        """(T, n) whether the object is there."""
        return np.asarray(self.classes != ABSENT_CLASS)


def clip_boxes(scene: Scene, frames: NDArray[np.int64], sensors: SensorFrames) -> ClipBoxes:
    """Boxes of all objects that the model can draw, adversaries among them, at (T,) frames.

    There is one absent box where there is none.
    """
    tracks = box_tracks(scene, frames)
    classes = [_class_index(scene, index) for index in range(len(scene.agents))]
    shown = [
        index
        for index in sorted(range(len(scene.agents)), key=lambda index: scene.agents.ids[index])
        if classes[index] is not None and tracks.valid[index].any()
    ]
    if not shown:
        return _padding(len(frames), len(sensors.cameras))
    there = tracks.valid[shown].T
    centre, yaw = in_lidar_frame(tracks, shown, sensors.lidar)
    size = tracks.size[shown].transpose(1, 0, 2)
    true_corners = corners_of(centre - [0.0, 0.0, 0.5] * size, size, yaw)
    # The model takes an annotation's centre for the middle of the box's floor, and was trained so.
    raised = corners_of(centre, size, yaw)
    masks = in_front(true_corners, sensors.camera_from_lidar) & there
    numbers = np.array([classes[index] for index in shown], dtype=np.int64)
    return ClipBoxes(
        ids=tuple(scene.agents.ids[index] for index in shown),
        corners=np.where(there[..., None, None], raised, 0.0).astype(np.float32),
        true_corners=np.where(there[..., None, None], true_corners, 0.0).astype(np.float32),
        classes=np.where(there, numbers, ABSENT_CLASS),
        masks=masks.astype(np.int64),
    )


def in_lidar_frame(tracks: BoxTracks, shown: list[int], lidar: Floats) -> tuple[Floats, Floats]:
    """Centres, (T, n, 3), and headings, (T, n), of n boxes as the lidar sees them at T frames.

    Headings are those of the boxes' length, radians counter-clockwise from the lidar's x axis; ``lidar`` is
    (T, 4, 4), lidar frame to global frame.
    """
    turn = lidar[:, :3, :3]
    offset = tracks.position[shown].transpose(1, 0, 2) - lidar[:, None, :3, 3]
    centre = offset @ turn
    rotation = turn.transpose(0, 2, 1)[:, None] @ rotation_matrix(tracks.rotation[shown]).transpose(1, 0, 2, 3)
    # The devkit's heading of a tilted box: roll and pitch are taken off on the side of the lidar.
    return centre, np.arctan2(-rotation[..., 0, 1], rotation[..., 0, 0])


def corners_of(floor: Floats, size: Floats, yaw: Floats) -> Floats:
    """Corners of upright boxes in the model's order.

    Args:
        floor: (..., 3) middle of the floor, metres.
        size: (..., 3) length, width, height, metres.
        yaw: (...) heading of the length, radians.

    Returns:
        (..., 8, 3) front right bottom, front right top, rear right top, rear right bottom, then the same on the left.
    """
    ahead, left, up = np.moveaxis(_CORNER_SIGNS * size[..., None, :] * [0.5, 0.5, 1.0], -1, 0)
    cos, sin = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    return np.asarray(floor[..., None, :] + np.stack([ahead * cos - left * sin, ahead * sin + left * cos, up], axis=-1))


def in_front(corners: Floats, camera_from_lidar: Floats) -> Bools:
    """Which boxes have a corner in front of a camera's lens, inside its image or not.

    (V, T, n) verdicts on (T, n, 8, 3) corners, lidar frame, metres; ``camera_from_lidar`` is (V, T, 4, 4), lidar
    frame to camera axes.
    """
    towards, offset = camera_from_lidar[:, :, 2, :3], camera_from_lidar[:, :, 2, 3]
    depth = np.einsum("vta,tnca->vtnc", towards, corners) + offset[..., None, None]
    return np.asarray((depth > 0.0).any(axis=-1))


def _class_index(scene: Scene, agent: int) -> int | None:
    category = scene.agents.categories[agent]
    name = DETECTION_CLASS_OF_CATEGORY.get(category)
    if name is None and scene.agents.ids[agent] in scene.adversaries:
        name = _CLASS_OF_ADVERSARY.get(category)
    return None if name is None else DETECTION_CLASSES.index(name)


def _padding(frames: int, views: int) -> ClipBoxes:
    """One box that is never there: the model wants at least one."""
    corners = np.zeros((frames, 1, 8, 3), dtype=np.float32)
    classes = np.full((frames, 1), ABSENT_CLASS, dtype=np.int64)
    return ClipBoxes((), corners, corners, classes, np.zeros((views, frames, 1), dtype=np.int64))
