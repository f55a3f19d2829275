"""From a scene of a data set to the arrays that training frames are read from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from adapters.camera_inputs import MINIATURE_IMAGE, RGB_MEAN_STD, camera_images, can_bus_vector, lidar_pose
from adapters.camera_inputs import lidar_to_image as lidar_to_image_of
from adapters.checkpoints.anchor_files import detected_classes, map_lines
from adapters.extensions.training.frames import DRIVABLE_CELLS, DRIVABLE_HALF_M, FUTURE_STEPS, LINE_POINTS
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.datasets.roots import DataSet
from benchmark.datasets.sample_truth import compute_planar_lidar_poses
from benchmark.datasets.steps import require_two_hz
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, to_global, to_local
from benchmark.planning import Observation
from benchmark.records.driven_ego import DrivenEgoTargets, read_driven_ego_targets
from benchmark.records.off_path import find_followable_positions, read_excursions
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

SHORTEST_LINE_M: Final = 1.0
"""Corners of map elements that are shorter inside the rectangle are not learned."""
Arrays = dict[str, NDArray[np.generic]]


@dataclass(frozen=True, slots=True)
class _AgentMotion:
    """N agents at K key frames, global frame: (N, K, 3) metres, unit vectors and m/s, zero with one key frame only."""

    position: Floats
    heading: Floats
    velocity: Floats


def scene_arrays(data: DataSet, name: str) -> Arrays:
    """Arrays of K key frames of a scene by name: those of `TrainingFrame` with a leading K.

    What differs in number is put end to end; ``box_starts`` and ``line_starts`` (K + 1,) are where each frame begins.
    """
    scene, truths = data.scene(name), data.truth(name)
    require_two_hz(scene, "training")
    excursions, driven = read_excursions(data.provenance(), name), read_driven_ego_targets(data.provenance(), name)
    if driven is not None and len(driven.commands) != len(truths):
        raise InputError(f"{name} of {data.root} has a drive with another number of key frames; build the data again")
    classes = np.array(detected_classes(scene), np.int64)
    motion = _read_agent_motion(scene)
    poses = compute_planar_lidar_poses(scene)
    frames = [
        _camera_arrays(observation)
        | _ego_arrays(observation, truth, find_followable_positions(excursions, *_seconds(scene, observation.index)))
        | ({} if driven is None else _driven_ego_arrays(driven, observation.index, poses[observation.index]))
        | _agent_arrays(scene, motion, classes, observation)
        | _map_arrays(scene.road_map, poses[observation.index])
        for observation, truth in zip(data.observations(name), truths, strict=True)
    ]
    arrays: Arrays = {}
    for key in frames[0]:
        parts = [frame[key] for frame in frames]
        arrays[key] = np.concatenate(parts) if key in VARIABLE_LENGTH else np.stack(parts)
    arrays["box_starts"] = _start_offsets([len(frame["labels"]) for frame in frames])
    arrays["line_starts"] = _start_offsets([len(frame["line_labels"]) for frame in frames])
    return arrays


VARIABLE_LENGTH: Final = {
    "boxes": "box_starts",
    "labels": "box_starts",
    "instances": "box_starts",
    "futures": "box_starts",
    "futures_valid": "box_starts",
    "lines": "line_starts",
    "line_labels": "line_starts",
}
"""Arrays that differ in length from frame to frame, and where the beginnings of frames are."""


def _start_offsets(counts: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _camera_arrays(observation: Observation) -> Arrays:
    normalised = camera_images(observation, MINIATURE_IMAGE, RGB_MEAN_STD)
    mean, std = (np.array(values, np.float32)[:, None, None] for values in (RGB_MEAN_STD.mean, RGB_MEAN_STD.std))
    pixels = np.rint(normalised * std + mean).clip(0, 255).astype(np.uint8)
    return {"images": pixels, "lidar2img": lidar_to_image_of(observation, MINIATURE_IMAGE)}


def _seconds(scene: Scene, keyframe: int) -> tuple[Floats, Floats]:
    """Seconds from the start of the scene: () of a key frame, (6,) of the steps of a plan that is made there."""
    now = np.array((scene.timestamps_us[scene.keyframes[keyframe]] - scene.timestamps_us[0]) * 1e-6)
    return now, now + PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)


def _ego_arrays(observation: Observation, truth: SampleTruth, shows: Bools) -> Arrays:
    """Arrays of the ego; ``shows`` (6,) says which steps of its future a planner may learn from."""
    return {
        "timestamp_s": np.array(observation.timestamp_us * 1e-6),
        "global_T_lidar": lidar_pose(observation),
        "can_bus": can_bus_vector(observation.ego),
        "command": np.array(observation.command, np.int64),
        "ego_future": truth.ego_future[:, :2].astype(np.float32),
        "ego_future_valid": truth.ego_future_valid & shows,
    }


def _driven_ego_arrays(driven: DrivenEgoTargets, keyframe: int, pose: Floats) -> Arrays:
    """Arrays of the ego where a planner drove: not where it went, but where it should have gone."""
    local = to_local(driven.wanted[keyframe], pose)
    known = driven.known[keyframe]
    future = np.where(known[:, None], np.column_stack([-local[:, 1], local[:, 0]]), 0.0)
    return {
        "command": np.array(driven.commands[keyframe], np.int64),
        "ego_future": future.astype(np.float32),
        "ego_future_valid": known,
    }


def _agent_arrays(scene: Scene, motion: _AgentMotion, classes: NDArray[np.int64], observation: Observation) -> Arrays:
    """Boxes that lidar or radar have hit, as in the training of the full models, and where they go."""
    known, keyframe = scene.annotations, observation.index
    hit = known.num_lidar_pts[:, keyframe] + known.num_radar_pts[:, keyframe] > 0
    rows = np.flatnonzero(known.valid[:, keyframe] & hit & (classes >= 0))
    global_T_lidar = lidar_pose(observation)
    turn, origin = global_T_lidar[:3, :3], global_T_lidar[:3, 3]
    steps = keyframe + 1 + np.arange(FUTURE_STEPS)
    recorded = steps < len(scene.keyframes)
    steps = np.minimum(steps, len(scene.keyframes) - 1)
    centres = (motion.position[rows, keyframe] - origin) @ turn
    velocity = motion.velocity[rows, keyframe] @ turn
    yaw = _yaw(motion.heading[rows, keyframe] @ turn)
    later = (motion.position[rows[:, None], steps] - origin) @ turn
    later_yaw = _yaw(motion.heading[rows[:, None], steps] @ turn)
    boxes = np.column_stack([centres, known.size[rows, keyframe], yaw, velocity[:, :2]])
    return {
        "boxes": boxes.astype(np.float32),
        "labels": classes[rows],
        "instances": rows.astype(np.int64),
        "futures": np.concatenate([later[..., :2], later_yaw[..., None]], -1).astype(np.float32),
        "futures_valid": known.valid[rows[:, None], steps] & recorded,
    }


def _yaw(heading: Floats) -> Floats:
    return np.asarray(np.arctan2(heading[..., 1], heading[..., 0]))


def _read_agent_motion(scene: Scene) -> _AgentMotion:
    known = scene.annotations
    w, x, y, z = np.moveaxis(known.rotation, -1, 0)
    heading = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], -1)
    seconds = scene.timestamps_us[scene.keyframes] * 1e-6
    count = len(seconds)
    indices = np.arange(count)
    before, after = np.maximum(indices - 1, 0), np.minimum(indices + 1, count - 1)
    before = np.where(known.valid[:, before], before, indices)
    after = np.where(known.valid[:, after], after, indices)
    rows = np.arange(len(known.position))[:, None]
    moved_m = known.position[rows, after] - known.position[rows, before]
    took_s = seconds[after] - seconds[before]
    velocity = np.divide(moved_m, took_s[..., None], out=np.zeros_like(moved_m), where=took_s[..., None] > 0)
    return _AgentMotion(known.position, heading, velocity)


def _map_arrays(road_map: RoadMap, pose: Floats) -> Arrays:
    lines, labels = map_lines(road_map, pose, LINE_POINTS)
    is_long = np.linalg.norm(np.diff(lines, axis=1), axis=-1).sum(-1) >= SHORTEST_LINE_M
    return {
        "lines": lines[is_long].astype(np.float32),
        "line_labels": labels[is_long],
        "drivable": drivable_cells(road_map, pose),
    }


def drivable_cells(road_map: RoadMap, pose: Floats) -> Bools:
    """Cells of the drivable area around a planar lidar pose, (3,) global, as `TrainingFrame.drivable` has them."""
    cell_m = 2 * DRIVABLE_HALF_M / DRIVABLE_CELLS
    along = (np.arange(DRIVABLE_CELLS) + 0.5) * cell_m - DRIVABLE_HALF_M
    forward, right = np.meshgrid(along, along, indexing="ij")
    points = to_global(np.stack([forward, -right], axis=-1), pose)
    low, high = points.min((0, 1)), points.max((0, 1))
    clipped = as_multipolygon(shapely.clip_by_rect(road_map.drivable_area, *low, *high))
    shapely.prepare(clipped)
    return RoadMap(road_map.location, clipped).is_drivable(points)
