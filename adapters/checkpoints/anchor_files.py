"""Anchors of a data set: samples to fit them, what ``weights anchors`` writes, UniAD's published pickle."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
import torch
from numpy.typing import NDArray
from torch import Tensor

from adapters.models import MOTION_ANCHORS, published_models
from adapters.networks.sparse.anchors import BOXES, FORECASTS, LINES, PLANS, AnchorSamples, cluster_anchors
from adapters.networks.sparse.config import SparseConfig
from benchmark.constants import DETECTION_CLASS_OF_CATEGORY, DETECTION_CLASSES, FARTHEST_WAYPOINT_M, PLAN_STEPS
from benchmark.datasets.roots import DataSet
from benchmark.datasets.sample_truth import compute_planar_lidar_poses
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_global, to_local, transform_matrix, yaw_of_quaternion
from benchmark.machine.storage import file_sha256
from benchmark.planning import Command
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from benchmark.truth import SampleTruth
from benchmark.untrusted.children import read_pickle
from benchmark.weights.tensors import read_tensors, write_tensors

FILE: Final = "motion_anchor_infos_mode6.pkl"
"""Its published name."""
_LIST: Final = "anchors_all"
_SHAPE: Final = (4, 6, 12, 2)
_NETWORK: Final = MOTION_ANCHORS.partition(".")[0] + "."


def read_motion_anchors(path: Path) -> Tensor:
    """Read UniAD's anchors without trusting the pickle: arrays and plain containers, no code.

    (4 groups of kinds of agents, 6 modes, 12 steps, 2) float32 metres in the frames of agents.
    """
    held = read_pickle(path)
    groups = held.get(_LIST) if isinstance(held, dict) else None
    if not isinstance(groups, list | tuple | np.ndarray):
        raise InputError(f"{path} has no list {_LIST!r} and so no motion anchors; get {FILE} (weights list)")
    shapes = {_shape(group) for group in groups}
    if len(groups) != _SHAPE[0] or shapes != {_SHAPE[1:]}:
        summary = f"{len(groups)} of {', '.join(map(str, sorted(shapes, key=str))) or 'nothing'}"
        raise InputError(
            f"the motion anchors in {path} are {summary}, but UniAD needs {_SHAPE[0]} arrays of {_SHAPE[1:]}; get "
            f"{FILE} (weights list)"
        )
    anchors = np.stack([np.asarray(group, np.float64) for group in groups])
    if not np.isfinite(anchors).all() or np.abs(anchors).max() > FARTHEST_WAYPOINT_M:
        raise InputError(f"the motion anchors in {path} hold implausible values; get {FILE} (weights list)")
    return torch.from_numpy(anchors).float()


def find_anchors_beside(path: Path, tensors: Mapping[str, Tensor]) -> Path | None:
    """File of the anchors that lie beside a checkpoint of UniAD which has none, under their published name."""
    if MOTION_ANCHORS in tensors or not _is_uniad(tensors):
        return None
    return find_published_beside(path)


def find_published_beside(path: Path) -> Path | None:
    """The file of the published name in the folder of another, if there is one."""
    beside = path.with_name(FILE)
    return beside if beside.is_file() else None


def add_motion_anchors(path: Path, tensors: Mapping[str, Tensor], anchors: Path) -> dict[str, Tensor]:
    """Tensors of UniAD and its anchors; those of another model, or with other anchors, are refused."""
    if not _is_uniad(tensors):
        raise InputError(
            f"{anchors} is not a .safetensors file, so for UniAD, but {path} is not a checkpoint of UniAD; "
            "give the output of weights anchors, or leave --anchors out"
        )
    read = read_motion_anchors(anchors)
    present = tensors.get(MOTION_ANCHORS)
    if present is not None and not (present.shape == read.shape and bool(torch.equal(present.float(), read))):
        raise InputError(f"{path} already has motion anchors, different from {anchors}; leave --anchors out")
    return {**tensors, MOTION_ANCHORS: read}


def _is_uniad(tensors: Mapping[str, Tensor]) -> bool:
    return any(name.startswith(_NETWORK) for name in tensors)


def _shape(group: Any) -> tuple[int, ...] | str:
    """Shape of an array of numbers, or a description of another object."""
    if isinstance(group, np.ndarray) and group.dtype.kind in "fiu":
        return group.shape
    return type(group).__name__


MAP_ASIDE_M: Final = 15.0
MAP_AHEAD_M: Final = 30.0
"""Half the sides of the rectangle around the lidar in which map elements are looked for."""


def collect_anchor_samples(data: DataSet, split: str | None, config: SparseConfig) -> AnchorSamples:
    """Sightings of all key frames of a split by scene and time, without futures that the recording cuts off.

    A network that plans other steps than a data set has is an `InputError`.
    """
    if config.steps != PLAN_STEPS:
        raise InputError(f"a data set has plans of {PLAN_STEPS} steps, but the network needs {config.steps}")
    boxes: list[Floats] = [np.zeros((0, 3))]
    middles: list[Floats] = [np.zeros((0, 2))]
    futures: list[list[Floats]] = [[np.zeros((0, config.agent_steps, 2))] for _ in DETECTION_CLASSES]
    plans: list[list[Floats]] = [[np.zeros((0, PLAN_STEPS, 2))] for _ in Command]
    for name in data.scene_names(split):
        scene = data.scene(name)
        classes = detected_classes(scene)
        boxes.append(box_centres(scene, classes))
        for pose in compute_planar_lidar_poses(scene) if data.has_map(name) else ():
            middles.append(line_centres(scene.road_map, pose, config.points_per_line))
        for row, kind in enumerate(classes):
            if kind >= 0:
                futures[kind].append(agent_futures(scene, row, config.agent_steps))
        for command, plan in _plans(data.truth(name)):
            plans[command].append(plan[None])
    return AnchorSamples(
        box_centres=np.concatenate(boxes),
        line_centres=np.concatenate(middles),
        futures=[np.concatenate(parts) for parts in futures],
        plans=[np.concatenate(parts) for parts in plans],
    )


def box_centres(scene: Scene, classes: Sequence[int]) -> Floats:
    """Centres of annotated boxes in the key frame's lidar frame, (N, 3) metres, without agents of negative class."""
    known, detected = scene.annotations, np.asarray(classes, np.int64) >= 0
    ego_T_lidar = transform_matrix(scene.lidar.rotation, scene.lidar.translation)
    parts = [np.zeros((0, 3))]
    for keyframe, frame in enumerate(scene.keyframes):
        global_T_lidar = transform_matrix(scene.ego.rotation[frame], scene.ego.position[frame]) @ ego_T_lidar
        centres = known.position[known.valid[:, keyframe] & detected, keyframe]
        parts.append((centres - global_T_lidar[:3, 3]) @ global_T_lidar[:3, :3])
    return np.concatenate(parts)


def line_centres(road_map: RoadMap, pose: Floats, points_per_line: int) -> Floats:
    """Means, (L, 2), of the points that `map_lines` gives."""
    return np.asarray(map_lines(road_map, pose, points_per_line)[0].mean(1))


def map_lines(road_map: RoadMap, pose: Floats, points_per_line: int) -> tuple[Floats, NDArray[np.int64]]:
    """Map elements around a planar lidar pose as evenly spaced points: crossings, dividers and the border of the road.

    (L, points_per_line, 2) metres, lidar frame: x right, y forward; (L,) their classes: 0 divider, 1 pedestrian
    crossing, 2 boundary of the road. `pose` is (3,), global.
    """
    corners = np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]) * [MAP_AHEAD_M, MAP_ASIDE_M]
    window = shapely.Polygon(to_global(corners, pose))
    elements: list[shapely.Geometry] = [
        shapely.boundary(shapely.union_all(list(road_map.ped_crossings.values()))),
        *(shapely.LineString(divider.line) for divider in road_map.dividers),
        shapely.boundary(road_map.drivable_area),
    ]
    kinds = [1, *(0 for _ in road_map.dividers), 2]
    shares = np.linspace(0.0, 1.0, points_per_line)
    lines, classes = [np.zeros((0, points_per_line, 2))], []
    for clipped, kind in zip(shapely.intersection(elements, window), kinds, strict=True):
        for line in shapely.get_parts(shapely.line_merge(clipped)):
            # A line that only touches the rectangle leaves a point.
            if isinstance(line, shapely.LineString) and line.length > 0:
                points = shapely.get_coordinates(shapely.line_interpolate_point(line, shares, normalized=True))
                lines.append(points[None])
                classes.append(kind)
    local = to_local(np.concatenate(lines), pose)
    return np.stack([-local[..., 1], local[..., 0]], axis=-1), np.array(classes, np.int64)


def agent_futures(scene: Scene, agent: int, steps: int) -> Floats:
    """Recorded futures without gaps, (N, steps, 2) metres in the agent's frame at their start, x forward."""
    known = scene.annotations
    yaw = yaw_of_quaternion(known.rotation[agent])
    futures = [np.zeros((0, steps, 2))]
    for start in range(len(yaw) - steps):
        if known.valid[agent, start : start + steps + 1].all():
            path = known.position[agent, start : start + steps + 1, :2]
            futures.append(to_local(path[1:], np.array([*path[0], yaw[start]]))[None])
    return np.concatenate(futures)


def detected_classes(scene: Scene) -> list[int]:
    """Index into `DETECTION_CLASSES` of each agent, -1 where it is not detected."""
    known = (DETECTION_CLASS_OF_CATEGORY.get(category) for category in scene.agents.categories)
    return [-1 if name is None else DETECTION_CLASSES.index(name) for name in known]


def _plans(truths: Sequence[SampleTruth]) -> Iterator[tuple[Command, Floats]]:
    """Command and (6, 2) recorded positions of the lidar, of the samples that have all of them."""
    return ((truth.command, truth.ego_future[:, :2]) for truth in truths if truth.complete)


_ENTRY: Final = "challenger-bench-anchors"
_NAMES: Final = {BOXES, LINES, FORECASTS, PLANS}


@dataclass(frozen=True, slots=True)
class AnchorFile:
    """Anchors that were written; `sightings` counts boxes, map elements, futures and plans that they are centres of."""

    path: Path
    sha256: str
    model: str
    data: dict[str, str]
    split: str | None
    sightings: dict[str, int]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"path": str(self.path), "sha256": self.sha256, **_metadata(self)}


def write_anchors(model: str, data: DataSet, split: str | None, path: Path) -> AnchorFile:
    """Cluster what a data set holds, and keep the centres.

    Args:
        model: ``sparsedrive`` or ``diffusiondrive``.
        data: Any data set.
        split: Of the data set; ``None`` is all of it.
        path: A .safetensors file to write.

    Returns:
        Facts of the written file; the same data give the same bytes.

    Raises:
        InputError: If the model has no anchors, the data set is too small, or the file cannot be written.
    """
    known = {name: entry for name, entry in published_models().items() if entry.net.clustered}
    if model not in known:
        raise InputError(f"{model!r} is not a model with anchors; use one of {', '.join(known)}")
    config = known[model].configuration()
    samples = collect_anchor_samples(data, split, config)
    counts = {
        "boxes": len(np.asarray(samples.box_centres)),
        "map elements": len(np.asarray(samples.line_centres)),
        "futures": sum(len(np.asarray(futures)) for futures in samples.futures),
        "plans": sum(len(np.asarray(plans)) for plans in samples.plans),
    }
    anchors = cluster_anchors(samples, config)
    source = {"name": data.name, "fingerprint": data.fingerprint()}
    anchor_file = AnchorFile(path, "", model, source, split, counts)
    write_tensors(path, anchors, _metadata(anchor_file), entry=_ENTRY)
    return AnchorFile(path, file_sha256(path), model, source, split, counts)


def read_anchors(path: Path) -> dict[str, Tensor]:
    """Anchors from a file of `write_anchors`."""
    anchors, facts = read_tensors(path, entry=_ENTRY, what="anchors from ", instead="make them again")
    if not facts or set(anchors) != _NAMES:
        raise InputError(f"{path} holds no anchors; make them with: challenger-bench weights anchors --out {path.name}")
    return anchors


def _metadata(anchor_file: AnchorFile) -> dict[str, Any]:
    return {
        "model": anchor_file.model,
        "data": anchor_file.data,
        "split": anchor_file.split,
        "sightings": anchor_file.sightings,
    }
