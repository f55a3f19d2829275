"""What really happened around one sample: everything that any collision or L2 protocol needs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.planning import Command


@dataclass(frozen=True, slots=True)
class SampleTruth:
    """Annotated keyframes now and at the six plan steps, in the lidar frame of the sample.

    The frame is planar: x right, y forward, origin at LIDAR_TOP, yaw counter-clockwise from +x (straight ahead is
    pi/2). M objects are those annotated at any of the seven keyframes.

    Attributes:
        scene: Scene name.
        sample_token: Sample token.
        index: Number of the sample in its scene.
        timestamp_us: Keyframe time.
        lidar_pose: (3,) global x, y, yaw; yaw is the heading of the car.
        lidar_ahead_m: Lidar origin ahead of the rear axle.
        ego_future: (6, 3) x, y, yaw of the recorded lidar origin; held where ``ego_future_valid`` is False.
        ego_future_valid: (6,) False past the end of the scene.
        command: From the last valid recorded waypoint.
        instances: M instance identifiers.
        categories: M nuScenes category names.
        boxes: (M, 7, 5) boxes at steps 0..6, size as annotated at each; held where not annotated.
        annotated: (M, 7) whether the object is annotated at the step.
        has_points: (M, 7) whether its lidar and radar counts there add up to more than zero.
        has_lidar_points: (M, 7) whether its lidar count there is more than zero.
        adversaries: Instances that were made to be adversaries, as far as the data set says.
    """

    scene: str
    sample_token: str
    index: int
    timestamp_us: int
    lidar_pose: Floats
    lidar_ahead_m: float
    ego_future: Floats
    ego_future_valid: Bools
    command: Command
    instances: tuple[str, ...]
    categories: tuple[str, ...]
    boxes: Floats
    annotated: Bools
    has_points: NDArray[np.bool_]
    has_lidar_points: NDArray[np.bool_]
    adversaries: frozenset[str] = frozenset()

    @property
    def complete(self) -> bool:
        """Whether all six future keyframes exist."""
        return bool(self.ego_future_valid.all())
