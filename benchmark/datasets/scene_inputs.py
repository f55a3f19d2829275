"""What a scene holds of what planners and metrics want beside annotations, and what of it cannot be."""

import numpy as np

from benchmark.datasets.implausible import Steps, in_another_order, objects_across
from benchmark.geometry import yaw_of_quaternion
from benchmark.records.run_schema import InputFacts
from benchmark.scene import Scene


def scene_inputs(scene: Scene, *, lidar: bool) -> InputFacts:
    """Look at map, rig, boxes and rotations of a scene.

    Args:
        lidar: Whether its data set says where the lidar sits.
    """
    known, ego, seconds = scene.annotations, scene.ego, scene.seconds[scene.keyframes]
    owner, at = np.nonzero(known.valid)
    rotation = known.rotation[owner, at]
    steps = Steps.of(owner, seconds[at], known.position[owner, at, :2])
    moving, across = objects_across(steps, yaw_of_quaternion(rotation), known.size[owner, at, :2])
    position, area = ego.position[scene.keyframes, :2], scene.road_map.drivable_area
    driven = Steps.of(np.zeros(len(seconds), np.int64), seconds, position).directions(len(seconds))
    return InputFacts(
        samples=len(seconds),
        lanes=len(scene.road_map.lanes),
        off_road=None if area.is_empty else int(np.count_nonzero(~scene.road_map.is_drivable(position))),
        cameras=len(scene.cameras),
        lidar=lidar,
        jumps=int(np.count_nonzero(steps.jumps)),
        moving=moving,
        across=across,
        turned_quaternions=in_another_order(ego.rotation[scene.keyframes], driven) or in_another_order(rotation),
    )
