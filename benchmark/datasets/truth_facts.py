"""Truth and inputs that a scene has, so that a record marks numbers without a basis, and signs of wrong tables."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.datasets.annotated_objects import find_labelled_keyframes
from benchmark.datasets.categories import KNOWN
from benchmark.datasets.steps import find_irregular_interval_us
from benchmark.geometry import Bools, Floats, wrap_angle, yaw_of_quaternion
from benchmark.records.run_schema import InputFacts, TruthFacts
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

FASTEST_M_S: Final = 60.0
"""Nothing on a road is faster."""
MOVING_M_S: Final = 3.0
"""Slower objects, and people, may move to any side of theirs."""
ACROSS_RAD: Final = np.radians(60.0)
"""From here on a box lies across its motion; a car that slides or turns stays far below."""
WIDER: Final = 1.1
"""A moving object is longer than wide; what is nearly square says nothing."""
UPRIGHT: Final = 0.7
"""Least vertical part of a car's own vertical: 45 degrees of roll and pitch together."""
SENSIBLE_SHARE: Final = 0.9
"""Of the rotations of a data set that is read in the right order, at least; in a wrong one it is less than half."""
MISFIT_SHARE: Final = 0.2
"""Of the samples, at which the recorded ego is off the drivable area: more, and the map is of another place."""
LEAST_MOVING: Final = 3
"""Fewer moving objects say nothing of how boxes lie."""


@dataclass(frozen=True, slots=True)
class AnnotationSteps:
    """S steps of objects from one annotation (``row``) to the next, over all objects of a scene, in m/s and radians."""

    row: NDArray[np.int64]
    owner: NDArray[np.int64]
    speed: Floats
    direction: Floats

    @classmethod
    def of(cls, owner: NDArray[np.int64], seconds: Floats, position: Floats) -> "AnnotationSteps":
        """Steps of R annotations, those of an object together in time order; none where time does not go on.

        ``owner`` is (R,), the number of the object, ``seconds`` (R,), ``position`` (R, 2) in metres.
        """
        elapsed, moved = np.diff(seconds), np.diff(position[:, :2], axis=0)
        row = np.flatnonzero((owner[1:] == owner[:-1]) & (elapsed > 0.0))
        away = moved[row]
        return cls(row, owner[row], np.hypot(*away.T) / elapsed[row], np.arctan2(away[:, 1], away[:, 0]))

    @property
    def jumps(self) -> Bools:
        """(S,) whether a step is faster than anything on a road."""
        return self.speed > FASTEST_M_S

    @property
    def drives(self) -> Bools:
        """(S,) whether a step tells where an object drives to."""
        return (self.speed > MOVING_M_S) & ~self.jumps

    def directions(self, count: int) -> Floats:
        """(R,) where the owner of each of R annotations drives to from there, radians; NaN where it does not."""
        directions = np.full(count, np.nan)
        directions[self.row[self.drives]] = self.direction[self.drives]
        return directions


def count_objects_across(steps: AnnotationSteps, yaw: Floats, size: Floats) -> tuple[int, int]:
    """Number of objects that move, and of those that lie across their motion at most of their moving steps.

    A box lies across its motion if its heading, (R,) radians, is at right angles to it or its (R, 2) size, length and
    width, is wider than long.
    """
    driving = steps.drives
    row, owner = steps.row[driving], steps.owner[driving]
    # Driving backwards counts as along.
    turned = np.abs(wrap_angle(2.0 * (steps.direction[driving] - yaw[row]))) / 2.0 > ACROSS_RAD
    across = turned | (size[row, 1] > WIDER * size[row, 0])
    objects, which, count = np.unique(owner, return_inverse=True, return_counts=True)
    most = np.bincount(which, weights=across, minlength=len(objects)) > 0.5 * count
    return len(objects), int(np.count_nonzero(most))


def are_boxes_across(moving: int, across: int) -> bool:
    """Whether boxes have width and length exchanged, or headings of another convention, by `count_objects_across`."""
    return moving >= LEAST_MOVING and across > 0.5 * moving


def are_rotations_xyzw(quaternions: Floats, direction: Floats | None = None) -> bool:
    """Whether (R, 4) rotations, read as w, x, y, z, make sense only as x, y, z, w.

    That is, most are upside down, lie on a side or look away from ``direction`` (the object's motion, NaN where it does
    not move; not asked without it) as they are read, and hardly any does in the other order.
    """
    if not len(quaternions):
        return False
    other = np.roll(quaternions, 1, axis=-1)
    return (
        _compute_plausible_share(quaternions, direction) < 0.5
        and _compute_plausible_share(other, direction) >= SENSIBLE_SHARE
    )


def _compute_plausible_share(quaternions: Floats, direction: Floats | None) -> float:
    """Share of rotations that stand upright, and look where the motion goes."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        upright = (w * w - x * x - y * y + z * z) / (w * w + x * x + y * y + z * z) > UPRIGHT
    if direction is not None:
        away = np.abs(wrap_angle(yaw_of_quaternion(quaternions) - np.nan_to_num(direction)))
        upright &= np.isnan(direction) | (away < np.pi / 4)
    return float(upright.mean())


def find_scene_inputs(scene: Scene, *, lidar: bool) -> InputFacts:
    """Look at map, rig, boxes and rotations of a scene; ``lidar`` tells whether its data set says where that sits."""
    known, ego, seconds = scene.annotations, scene.ego, scene.seconds[scene.keyframes]
    owner, at = np.nonzero(known.valid)
    rotation = known.rotation[owner, at]
    steps = AnnotationSteps.of(owner, seconds[at], known.position[owner, at, :2])
    moving, across = count_objects_across(steps, yaw_of_quaternion(rotation), known.size[owner, at, :2])
    position, area = ego.position[scene.keyframes, :2], scene.road_map.drivable_area
    driven = AnnotationSteps.of(np.zeros(len(seconds), np.int64), seconds, position).directions(len(seconds))
    return InputFacts(
        samples=len(seconds),
        lanes=len(scene.road_map.lanes),
        off_road=None if area.is_empty else int(np.count_nonzero(~scene.road_map.is_drivable(position))),
        cameras=len(scene.cameras),
        lidar=lidar,
        jumps=int(np.count_nonzero(steps.jumps)),
        moving=moving,
        across=across,
        turned_quaternions=are_rotations_xyzw(ego.rotation[scene.keyframes], driven) or are_rotations_xyzw(rotation),
    )


MOTIONLESS_S: Final = 5.0
"""A scene at least so long in which the ego pose is the same number throughout has most likely none. A car that waits
is never so still: its recorded pose trembles by hundredths of a millimetre."""


def compute_truth_facts(data: "DataSet", name: str, truths: Sequence[SampleTruth]) -> TruthFacts:
    """Count annotations in a scene and key frames that are no steps, and look at all other inputs."""
    scene = data.scene(name)
    valid = scene.annotations.valid
    unknown: Counter[str] = Counter()
    for category, keyframe_count in zip(scene.agents.categories, valid.sum(axis=1).tolist(), strict=True):
        if category not in KNOWN:
            unknown[category] += keyframe_count
    interval_us = find_irregular_interval_us([truth.timestamp_us for truth in truths])
    labelled = find_labelled_keyframes(valid.sum(axis=0))
    return TruthFacts(
        annotations=int(valid.sum()),
        unlabelled=sum(not labelled[now : now + PLAN_STEPS + 1].all() for now in range(len(labelled))),
        without_size=data.annotation_counts([name])[name].annotations - int(valid.sum()),
        unknown=dict(sorted(unknown.items())),
        motionless=_is_motionless(scene),
        irregular=sum(truth.timed is not None for truth in truths),
        cut_short=sum(truth.by_clock.cut_short for truth in truths),
        interval_s=None if interval_us is None else round(interval_us * 1e-6, 6),
        inputs=find_scene_inputs(scene, lidar=data.has_lidar(name)),
    )


def _is_motionless(scene: Scene) -> bool:
    seconds = scene.seconds[scene.keyframes]
    poses = np.unique(scene.ego.pose[scene.keyframes], axis=0)
    return bool(seconds[-1] - seconds[0] >= MOTIONLESS_S and len(poses) == 1)
