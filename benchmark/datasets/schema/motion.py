"""What recorded motion says against the tables: boxes that jump or lie across it, rotations in another order."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.implausible import Steps, in_another_order, lie_across, objects_across
from benchmark.datasets.schema import FaultList
from benchmark.datasets.schema.table_checks import CheckedTables, Row
from benchmark.geometry import Floats, yaw_of_quaternion
from benchmark.report.words import counted

_QUATERNIONS = "make sense only if they are read as x, y, z, w; nuScenes has w, x, y, z: reorder them"


@dataclass(frozen=True, slots=True)
class EgoAtSamples:
    """Poses of the ego at S samples of all scenes, scene by scene, in time order.

    Attributes:
        scene: (S,) number of the scene.
        logs: S tokens of logs.
        seconds: (S,) times.
        position: (S, 3) metres, global.
        rotation: (S, 4) quaternions as they stand in the table.
    """

    scene: NDArray[np.int64]
    logs: tuple[str, ...]
    seconds: Floats
    position: Floats
    rotation: Floats

    @classmethod
    def of(cls, tables: CheckedTables) -> "EgoAtSamples":
        """By any keyframe row of each sample."""
        pose_of: dict[str, Row] = {}
        for row in tables.having("sample_data", "sample_token", "ego_pose_token", "is_key_frame"):
            if row["is_key_frame"] and row["sample_token"] not in pose_of:
                pose = tables.get("ego_pose", row["ego_pose_token"], "translation", "rotation")
                if pose is not None:
                    pose_of[row["sample_token"]] = pose
        numbers = {row["token"]: number for number, row in enumerate(tables.having("scene", "log_token"))}
        logs = [row["log_token"] for row in tables.having("scene", "log_token")]
        samples = [
            (numbers[row["scene_token"]], row["timestamp"], pose_of[row["token"]])
            for row in tables.having("sample", "scene_token", "timestamp")
            if row["scene_token"] in numbers and row["token"] in pose_of
        ]
        samples.sort(key=lambda sample: sample[:2])
        return cls(
            scene=np.array([scene for scene, _, _ in samples], np.int64),
            logs=tuple(logs[scene] for scene, _, _ in samples),
            seconds=_seconds([time_us for _, time_us, _ in samples]),
            position=_columns([pose["translation"] for _, _, pose in samples], 3),
            rotation=_columns([pose["rotation"] for _, _, pose in samples], 4),
        )


def check_motion(tables: CheckedTables, ego: EgoAtSamples, faults: FaultList) -> None:
    """Note boxes that jump, boxes that lie across their motion, and rotations in the order x, y, z, w."""
    driven = Steps.of(ego.scene, ego.seconds, ego.position).directions(len(ego.scene))
    if in_another_order(ego.rotation, driven):
        faults.add("rotations in another order", "ego_pose", "", f"the rotations {_QUATERNIONS}", severity="warning")
    rows, times_us = _annotations(tables)
    if not rows:
        return
    rotation = _columns([row["rotation"] for row in rows], 4)
    if in_another_order(rotation):
        sentence = f"the rotations {_QUATERNIONS}"
        faults.add("rotations in another order", "sample_annotation", "", sentence, severity="warning")
    places: defaultdict[str, int] = defaultdict(lambda: len(places))
    owner = np.array([places[row["instance_token"]] for row in rows], np.int64)
    steps = Steps.of(owner, _seconds(times_us), _columns([row["translation"] for row in rows], 3))
    for step in np.flatnonzero(steps.jumps).tolist():
        row = rows[int(steps.row[step]) + 1]
        name = row["instance_token"]
        sentence = f"since its annotation before, instance {name} would have moved at {steps.speed[step]:.0f} m/s"
        faults.add("boxes that jump", "sample_annotation", row["token"], sentence, severity="warning")
    # A table has width before length.
    size = _columns([row["size"] for row in rows], 3)[:, [1, 0]]
    moving, across = objects_across(steps, yaw_of_quaternion(rotation), size)
    if lie_across(moving, across):
        sentence = (
            f"the boxes of {across} of {counted(moving, 'moving object')} lie across their motion: width and length "
            "are exchanged, or headings turned by 90 degrees"
        )
        faults.add("boxes across their motion", "sample_annotation", "", sentence, severity="warning")


def _annotations(tables: CheckedTables) -> tuple[list[Row], list[int]]:
    """Annotations that can be relied on, those of an instance together in time order, and their times."""
    fields = ("instance_token", "sample_token", "translation", "size", "rotation")
    found: list[tuple[str, int, Row]] = []
    for row in tables.having("sample_annotation", *fields):
        sample = tables.get("sample", row["sample_token"], "timestamp")
        if sample is not None:
            found.append((row["instance_token"], sample["timestamp"], row))
    found.sort(key=lambda each: each[:2])
    return [row for _, _, row in found], [time_us for _, time_us, _ in found]


def _seconds(times_us: Sequence[int]) -> Floats:
    """Since the first of all, so that nothing is lost to the size of the numbers."""
    times = np.array(times_us, np.int64)
    return np.asarray((times - (times.min() if len(times) else 0)) * 1e-6)


def _columns(values: Sequence[Any], width: int) -> Floats:
    return np.array(values, np.float64).reshape(-1, width)
