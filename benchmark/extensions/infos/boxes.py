"""Annotated boxes of a scene as arrays: what they are at a sample, how fast they move, where they go."""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import DETECTION_CLASS_OF_CATEGORY
from benchmark.datasets.tables import Row
from benchmark.extensions.infos.frames import SensorFrame, compute_tilted_angle
from benchmark.extensions.infos.scene_rows import SceneTableRows
from benchmark.geometry import Bools, Floats, rotation_matrix

Indices = NDArray[np.int64]

NO_BOX: Final = -1
_LONGEST_GAP_S: Final = 1.5
"""Between two boxes that a velocity is taken from, on each side."""


@dataclass(frozen=True, slots=True)
class SceneBoxes:
    """All A annotations of a scene in the order of the file: centres (A, 3) and rotations (A, 3, 3), global.

    `size` is (A, 3) width, length, height; `prev` and `next` are (A,) indices of the same object's boxes, -1 for none.
    """

    rows: tuple[Row, ...]
    position: Floats
    size: Floats
    rotation: Floats
    time_us: NDArray[np.int64]
    prev: Indices
    next: Indices

    @classmethod
    def of(cls, rows: SceneTableRows) -> Self:
        """All annotations of a scene."""
        annotations = tuple(rows.annotations.values())
        index = {row["token"]: number for number, row in enumerate(annotations)}
        time_us = {row["token"]: row["timestamp"] for row in rows.samples}

        def column(name: str, width: int) -> Floats:
            return np.array([row[name] for row in annotations], np.float64).reshape(len(annotations), width)

        def linked(name: str) -> Indices:
            return np.array([index[row[name]] if row[name] else NO_BOX for row in annotations], np.int64)

        return cls(
            rows=annotations,
            position=column("translation", 3),
            size=column("size", 3),
            rotation=rotation_matrix(column("rotation", 4)),
            time_us=np.array([time_us[row["sample_token"]] for row in annotations], np.int64),
            prev=linked("prev"),
            next=linked("next"),
        )

    def following(self, boxes: Indices, steps: int) -> Indices:
        """The next K annotations of objects, however far away in time: (N, K) indices, -1 from where a track ends."""
        following_boxes = np.full((len(boxes), steps), NO_BOX)
        at = boxes
        for step in range(steps):
            at = np.where(at == NO_BOX, NO_BOX, self.next[at])
            following_boxes[:, step] = at
        return following_boxes

    def velocity(self, boxes: Indices) -> Floats:
        """Global (N, 3) m/s from the boxes before and after, as nuscenes-devkit takes them.

        NaN for objects with one box and across gaps of more than 1.5 s a side.
        """
        before = np.where(self.prev[boxes] == NO_BOX, boxes, self.prev[boxes])
        after = np.where(self.next[boxes] == NO_BOX, boxes, self.next[boxes])
        seconds = 1e-6 * self.time_us[after] - 1e-6 * self.time_us[before]
        sides = (before != boxes).astype(np.int64) + (after != boxes)
        known: Bools = (sides > 0) & (seconds <= _LONGEST_GAP_S * sides)
        moved = self.position[after] - self.position[before]
        seconds = np.where(known, seconds, 1.0)
        return np.where(known[:, None], moved / seconds[:, None], np.nan)


def build_annotation_keys(
    scene: SceneTableRows, boxes: SceneBoxes, here: Indices, lidar: SensorFrame
) -> dict[str, Any]:
    """Keys of the N boxes of a sample that all three repositories share; ``here`` is (N,) in the order of the file.

    ``gt_boxes`` (N, 7) have width, length, height and the tilted angle, ``gt_velocity`` is (N, 2). Lists of nothing
    become floats, as numpy makes them.
    """
    rows = [boxes.rows[number] for number in here]
    angle = compute_tilted_angle(lidar.local_rotation(boxes.rotation[here]))
    centre = lidar.local(boxes.position[here])
    velocity = boxes.velocity(here)
    velocity[:, 2] = 0.0
    categories = [scene.categories[row["instance_token"]] for row in rows]
    lidar_points, radar_points = ([row[f"num_{kind}_pts"] for row in rows] for kind in ("lidar", "radar"))
    return {
        "gt_boxes": np.concatenate([centre, boxes.size[here], angle[:, None]], axis=1),
        "gt_names": np.array([DETECTION_CLASS_OF_CATEGORY.get(name, name) for name in categories]),
        "gt_velocity": (velocity @ lidar.rotation)[:, :2],
        "num_lidar_pts": np.array(lidar_points),
        "num_radar_pts": np.array(radar_points),
        "valid_flag": np.array([sum(points) > 0 for points in zip(lidar_points, radar_points)], np.bool_),
    }
