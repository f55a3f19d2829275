"""Ground truth around one sample: everything that any collision or L2 protocol needs."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.planning import Command


class Roads(Protocol):
    """The roads around one sample, in its ego frame (x forward, y left of the rear axle), made when they are asked for.

    Nothing is kept: samples hold the map that they share and a pose, never a raster.
    """

    @property
    def has_kerbs(self) -> bool:
        """Whether the map says where roads are; without that nothing can be said of kerbs."""

    def kerb_lines(self) -> NDArray[np.float32]:
        """(N, 20, 2) edges of the road surface, each as 20 points at equal distances, metres."""

    def drivable_cells(self) -> NDArray[np.uint8]:
        """(1000, 1000) ones where a car may drive: row is y, column is x, cells of 0.1 m from -50 m."""

    def surely_drivable(self, points: Floats, margin_m: float) -> Bools:
        """(K,) whether all within a distance of each of (K, 2) points is drivable; False where that is not known."""


@dataclass(frozen=True, slots=True)
class SampleTruth:
    """Annotations now and at the six plan steps, in the lidar frame of the sample.

    Step k is the k-th following keyframe, which is what official protocols take; `by_clock` is the truth of steps that
    are half a second apart.

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
        axle_poses: (7, 3) global x, y, yaw of the rear axle now and at the six steps, held past the end of the scene;
            ``None``: they follow from the lidar's.
        seen_before: (M,) whether the object was annotated now or in the second before, and more than 40 % visible
            there; ``None``: those that are annotated now.
        roads: The roads around, or ``None`` where the data set has no map.
        timed: The same with steps at 0.5, 1.0, ... 3.0 s by the clock, where key frames of the future are not half a
            second apart (`benchmark.datasets.steps`); ``None`` where they are.
        at_two_hz: Whether key frames of the scene come at 2 Hz, so that they can be taken for steps at all.
        cut_short: Whether the recording goes on to the last step and yet a gap between key frames makes steps unknown.
        labelled: Whether objects were looked for now and at all steps that were recorded
            (`benchmark.datasets.annotated_objects`); where not, nothing can be said of contacts.
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
    axle_poses: Floats | None = None
    seen_before: Bools | None = None
    roads: Roads | None = None
    timed: "SampleTruth | None" = None
    at_two_hz: bool = True
    cut_short: bool = False
    labelled: bool = True

    @property
    def by_clock(self) -> "SampleTruth":
        """The truth whose steps are half a second apart: this one, unless key frames are not."""
        return self if self.timed is None else self.timed

    @property
    def complete(self) -> bool:
        """Whether all six steps of the future are known."""
        return bool(self.ego_future_valid.all())
