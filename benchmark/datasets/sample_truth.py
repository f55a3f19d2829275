"""`SampleTruth` of every sample of a scene: recorded futures seen from the lidar of each keyframe."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import COMMAND_LATERAL_M, PLAN_STEPS
from benchmark.datasets.annotated import nearest_valid
from benchmark.datasets.labelled import labelled_keyframes
from benchmark.datasets.roads_around import RoadsAround, RoadSurfaces
from benchmark.datasets.steps import KeyFrameSteps, TimedSteps, other_interval_us, values_at
from benchmark.geometry import Bools, Floats, poses_between, to_local, wrap_angle, yaw_of_quaternion
from benchmark.planning import Command
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

HIDDEN = 1
"""nuScenes' visibility level of what is visible to 40 % at most."""
KEYFRAMES_BEFORE = 2
"""Keyframes before the present in which an object may have been seen: the last second."""


def truth_of_scene(scene: Scene, sample_tokens: Sequence[str], steps: int = PLAN_STEPS) -> tuple[SampleTruth, ...]:
    """Recorded truth around each sample, in time order, for protocols.

    Args:
        scene: The scene; its annotations are used as they are, never the interpolated tracks.
        steps: How many steps ahead; six are what protocols take.
    """
    lidar_poses = planar_lidar_poses(scene)
    boxes_yaw = yaw_of_quaternion(scene.annotations.rotation)
    surfaces = None if scene.road_map.drivable_area.is_empty else RoadSurfaces(scene.road_map)
    labelled = labelled_keyframes(scene.annotations.valid.sum(axis=0))
    clock = KeyFrameSteps.of(scene)
    truths = (
        _truth(scene, token, index, lidar_poses, boxes_yaw, surfaces, labelled, steps)
        for index, token in enumerate(sample_tokens)
    )
    if other_interval_us(clock.times_us) is not None:
        truths = (replace(truth, at_two_hz=False) for truth in truths)
    return tuple(
        truth
        if clock.are_key_frames(truth.index, steps)
        else _with_timed(truth, scene, boxes_yaw, clock.at(truth.index, np.arange(steps + 1)))
        for truth in truths
    )


def planar_lidar_poses(scene: Scene) -> Floats:
    """(K, 3) global x, y of LIDAR_TOP at the keyframes, and the heading of the car."""
    pose = scene.ego.pose[scene.keyframes]
    ahead_m = float(scene.lidar.translation[0])
    pose[:, :2] += ahead_m * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    return pose


def command_of(future: Floats, valid: Bools) -> Command:
    """Driving command from the recorded future: the side on which its last waypoint lies.

    Right or left from 2 m of lateral displacement at the last valid waypoint, else straight.

    Args:
        future: (6, 2+) recorded lidar positions, x right.
        valid: (6,) whether each exists.
    """
    if not valid.any():
        return Command.STRAIGHT
    lateral_m = float(future[np.flatnonzero(valid)[-1], 0])
    if lateral_m >= COMMAND_LATERAL_M:
        return Command.RIGHT
    return Command.LEFT if lateral_m <= -COMMAND_LATERAL_M else Command.STRAIGHT


def ego_future(lidar_poses: Floats, index: int, count: int = PLAN_STEPS) -> tuple[Floats, Bools]:
    """Recorded lidar poses at the plan's steps, in the lidar frame of a keyframe.

    Args:
        lidar_poses: (K, 3) global poses at the keyframes.

    Returns:
        (N, 3) x right, y forward, yaw (held past the end) and (N,) whether the keyframe exists.
    """
    steps = index + 1 + np.arange(count)
    valid = steps < len(lidar_poses)
    return _in_lidar(lidar_poses[np.minimum(steps, len(lidar_poses) - 1)], lidar_poses[index]), valid


def recorded_command(scene: Scene, clock: KeyFrameSteps, lidar_poses: Floats, index: int) -> Command:
    """Driving command of a sample: from the key frames ahead, or from the same times where those are irregular.

    Args:
        lidar_poses: (K, 3) global poses of the lidar at the key frames.
    """
    if clock.are_key_frames(index, PLAN_STEPS):
        return command_of(*ego_future(lidar_poses, index))
    return _timed_command(scene, lidar_poses[index], clock.at(index, np.arange(1, PLAN_STEPS + 1)))


def _timed_command(scene: Scene, lidar_pose: Floats, steps: TimedSteps) -> Command:
    """The command from where the car was at some times; a gap in between says nothing against where it came to."""
    return command_of(_timed_future(scene, lidar_pose, steps), steps.recorded)


def _timed_future(scene: Scene, lidar_pose: Floats, steps: TimedSteps) -> Floats:
    """(N, 3) poses of the lidar at some times, in its frame at the sample."""
    axle = values_at(scene.ego.pose, scene.timestamps_us, steps.times_us)
    return _in_lidar(_lidar_of(axle, float(scene.lidar.translation[0])), lidar_pose)


def _lidar_of(axle_poses: Floats, ahead_m: float) -> Floats:
    """Poses (..., 3) of the lidar from those of the rear axle."""
    ahead = ahead_m * np.stack([np.cos(axle_poses[..., 2]), np.sin(axle_poses[..., 2])], axis=-1)
    return np.concatenate([axle_poses[..., :2] + ahead, axle_poses[..., 2:]], axis=-1)


def _in_lidar(poses: Floats, frame: Floats) -> Floats:
    """Poses (..., 3) in the planar lidar frame: x right, y forward, straight ahead is pi/2."""
    local = to_local(poses[..., :2], frame)
    yaw = wrap_angle(poses[..., 2] - frame[2] + np.pi / 2)
    return np.stack([-local[..., 1], local[..., 0], yaw], axis=-1)


def _truth(
    scene: Scene,
    token: str,
    index: int,
    lidar_poses: Floats,
    boxes_yaw: Floats,
    surfaces: RoadSurfaces | None,
    labelled: Bools,
    count: int,
) -> SampleTruth:
    known = scene.annotations
    axle_poses = scene.ego.pose[scene.keyframes]
    steps = index + np.arange(count + 1)
    exists = steps < len(scene.keyframes)
    steps = np.minimum(steps, len(scene.keyframes) - 1)
    seen = np.flatnonzero((known.valid[:, steps] & exists).any(axis=-1))
    annotated: NDArray[np.bool_] = known.valid[seen][:, steps] & exists
    rows, columns = seen[:, None], steps[nearest_valid(annotated)] if len(seen) else np.zeros((0, count + 1), np.int64)
    poses = np.concatenate([known.position[rows, columns, :2], boxes_yaw[rows, columns][..., None]], axis=-1)
    local = _in_lidar(poses, lidar_poses[index])
    boxes = np.concatenate([local[..., :2], known.size[rows, columns, :2], local[..., 2:]], axis=-1)
    lidar_points, radar_points = known.num_lidar_pts[rows, columns], known.num_radar_pts[rows, columns]
    future, future_valid = ego_future(lidar_poses, index, count)
    past = slice(max(index - KEYFRAMES_BEFORE, 0), index + 1)
    return SampleTruth(
        scene=scene.name,
        sample_token=token,
        index=index,
        timestamp_us=int(scene.timestamps_us[scene.keyframes[index]]),
        lidar_pose=lidar_poses[index],
        lidar_ahead_m=float(scene.lidar.translation[0]),
        ego_future=future,
        ego_future_valid=future_valid,
        command=command_of(future, future_valid),
        instances=tuple(scene.agents.ids[row] for row in seen),
        categories=tuple(scene.agents.categories[row] for row in seen),
        boxes=boxes,
        annotated=annotated,
        has_points=annotated & (lidar_points + radar_points > 0),
        has_lidar_points=annotated & (lidar_points > 0),
        adversaries=frozenset(scene.adversaries),
        axle_poses=axle_poses[steps],
        seen_before=(known.valid[seen, past] & (known.visibility[seen, past] != HIDDEN)).any(axis=-1),
        roads=None if surfaces is None else RoadsAround(surfaces, axle_poses[index]),
        labelled=bool(labelled[index : index + count + 1].all()),
    )


def _with_timed(truth: SampleTruth, scene: Scene, boxes_yaw: Floats, steps: TimedSteps) -> SampleTruth:
    """A truth whose steps are key frames, and beside it that of the times of steps.

    The ego is interpolated between frames, objects between the key frames around a time: they are there if they are
    annotated at both, have the size and points of the nearer one, and do not exist at times that are not known.
    """
    known = scene.annotations
    there = known.valid[:, steps.before] & known.valid[:, steps.after] & steps.known
    seen = np.flatnonzero(there.any(axis=-1))
    annotated: NDArray[np.bool_] = there[seen]
    held = nearest_valid(annotated) if len(seen) else np.zeros(annotated.shape, np.int64)
    rows, nearest = seen[:, None], steps.nearest[held]
    poses = np.concatenate([known.position[..., :2], boxes_yaw[..., None]], axis=-1)
    between = poses_between(poses[rows, steps.before[held]], poses[rows, steps.after[held]], steps.fraction[held])
    local = _in_lidar(between, truth.lidar_pose)
    lidar_points, radar_points = known.num_lidar_pts[rows, nearest], known.num_radar_pts[rows, nearest]
    # Steps become unknown once and for all, so that the last known one is held.
    last = np.minimum(np.arange(len(steps.known)), np.count_nonzero(steps.known) - 1)
    future = _timed_future(scene, truth.lidar_pose, steps)
    command = command_of(future[1:], steps.recorded[1:])
    timed = replace(
        truth,
        command=command,
        ego_future=future[last][1:],
        ego_future_valid=steps.known[1:],
        instances=tuple(scene.agents.ids[row] for row in seen),
        categories=tuple(scene.agents.categories[row] for row in seen),
        boxes=np.concatenate([local[..., :2], known.size[rows, nearest, :2], local[..., 2:]], axis=-1),
        annotated=annotated,
        has_points=annotated & (lidar_points + radar_points > 0),
        has_lidar_points=annotated & (lidar_points > 0),
        axle_poses=values_at(scene.ego.pose, scene.timestamps_us, steps.times_us)[last],
        seen_before=None,
        cut_short=bool(steps.recorded.all() and not steps.known.all()),
    )
    return replace(truth, command=command, timed=timed)
