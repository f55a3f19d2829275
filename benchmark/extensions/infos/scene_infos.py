"""Infos of one scene, key by key in the order of each repository's converter, with sensors and objects' futures."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.constants import CAMERA_NAMES, KEYFRAME_HZ, PLAN_STEPS
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.extensions.infos.boxes import NO_BOX, Indices, SceneBoxes, build_annotation_keys
from benchmark.extensions.infos.ego_trajectory import (
    ConverterCanMessages,
    EgoTrajectory,
    compute_ego_status,
    to_single_precision,
)
from benchmark.extensions.infos.frames import SensorFrame, compute_heading, rotate_points
from benchmark.extensions.infos.map_lines import MapLines
from benchmark.extensions.infos.repositories import TEST, Repository, RepositoryName
from benchmark.extensions.infos.scene_rows import SceneTableRows
from benchmark.geometry import Bools, Floats

_MARGIN_S: Final = 0.15
"""By which nuscenes-devkit lets a future reach beyond what was asked for."""
_STANDS_M: Final = 1.0
_GOALS: Final = 8
STATIC_GOAL: Final = 9


def compute_own_frame_futures(boxes: SceneBoxes, here: Indices, seconds: int) -> tuple[Floats, Bools]:
    """Future positions, (N, 2 seconds, 2), as nuscenes-devkit's ``PredictHelper`` gives them, and which there are.

    In the frame of each object now, x to its right and y ahead. Entries are packed: where a track has a hole, later
    positions stand in earlier places; 0 where there are none.
    """
    chain = boxes.following(here, seconds * KEYFRAME_HZ)
    elapsed_s = np.abs(boxes.time_us[chain] - boxes.time_us[here][:, None]) / 1e6
    there = np.logical_and.accumulate((chain != NO_BOX) & (elapsed_s < seconds + _MARGIN_S), axis=1)
    moved = (boxes.position[chain] - boxes.position[here][:, None])[..., :2]
    own = rotate_points(moved, (np.pi / 2 - compute_heading(boxes.rotation[here]))[:, None])
    return np.where(there[..., None], own, 0.0), there


def compute_lidar_offsets(boxes: SceneBoxes, here: Indices, lidar: SensorFrame, seconds: int) -> tuple[Floats, Bools]:
    """Lidar-frame offsets, (N, 2 seconds, 2), of `compute_own_frame_futures` as SparseDrive turns them back.

    It turns by the heading in the global frame and back by that in the lidar frame, which differ for tilted boxes. 0
    where there are none.
    """
    own, there = compute_own_frame_futures(boxes, here, seconds)
    back = compute_heading(lidar.local_rotation(boxes.rotation[here])) - np.pi / 2
    centre = lidar.local(boxes.position[here])[:, None, :2]
    path = np.concatenate([centre, rotate_points(own, back[:, None]) + centre], axis=1)
    return np.where(there[..., None], np.diff(path, axis=1), 0.0), there


def compute_vad_futures(boxes: SceneBoxes, here: Indices, lidar: SensorFrame) -> dict[str, Any]:
    """VAD's futures of N objects: the next annotation is the next step, however long the gap.

    ``gt_agent_fut_trajs`` is (N, 12), ``gt_agent_fut_yaw`` (N, 6), ``gt_agent_fut_goal`` (N,), all in double precision.
    """
    chain = boxes.following(here, PLAN_STEPS)
    there = chain != NO_BOX
    path = np.concatenate([here[:, None], chain], axis=1)
    position = lidar.local(boxes.position[path])[..., :2]
    angle = compute_heading(lidar.local_rotation(boxes.rotation[path]))
    offsets = np.where(there[..., None], np.diff(position, axis=1), 0.0)
    return {
        "gt_agent_fut_trajs": offsets.reshape(len(here), 2 * PLAN_STEPS),
        "gt_agent_fut_masks": there.astype(np.float64),
        # Differences are not wrapped: a heading that crosses 180 degrees jumps by 360.
        "gt_agent_fut_yaw": np.where(there, np.diff(angle, axis=1), 0.0),
        "gt_agent_fut_goal": classify_goals(offsets),
    }


def classify_goals(offsets: Floats) -> Floats:
    """(N,) classes of (N, 6, 2) offsets: eighths of a turn 0 to 8, or 9 for objects that stand.

    An object stands if neither coordinate grows by a metre; growing is meant with its sign, so that one that goes 20 m
    to the left and back stands, too.
    """
    moved = np.cumsum(offsets, axis=1)
    moved = moved[:, -1] - moved[:, 0]
    eighth = np.floor((np.arctan2(moved[:, 1], moved[:, 0]) + np.pi) / (2 * np.pi / _GOALS))
    return np.where(moved.max(axis=1) < _STANDS_M, STATIC_GOAL, eighth)


SWEEPS: Final = 10
"""Lidar measurements before a sample that an info names at most, key frames of earlier samples among them."""

SensorInfo = dict[str, Any]


def has_cameras(rows: SceneTableRows) -> bool:
    """Whether a scene has any image; one that was written with ``--renderer none`` has none."""
    return any(channel in frames for frames in rows.key_frames.values() for channel in CAMERA_NAMES)


def build_camera_infos(rows: SceneTableRows, sample: Row, lidar: SensorFrame, prefix: str) -> dict[str, SensorInfo]:
    """Cameras of a sample by channel, in the networks' order; none of a scene without images.

    `require_cameras` refuses scenes with some images.
    """
    infos: dict[str, SensorInfo] = {}
    for channel in CAMERA_NAMES if has_cameras(rows) else ():
        data = rows.key_frames[sample["token"]][channel]
        intrinsic = rows.mounts[data["calibrated_sensor_token"]]["camera_intrinsic"]
        infos[channel] = build_sensor_info(rows, data, channel, lidar, prefix)
        infos[channel]["cam_intrinsic"] = np.array(intrinsic, np.float64)
    return infos


def build_sweep_infos(rows: SceneTableRows, data: Row, lidar: SensorFrame, prefix: str) -> list[SensorInfo]:
    """Lidar measurements before that of a sample, newest first; arguments as in `build_camera_infos`."""
    sweeps: list[SensorInfo] = []
    while data["prev"] and len(sweeps) < SWEEPS:
        data = rows.data[data["prev"]]
        sweeps.append(build_sensor_info(rows, data, "lidar", lidar, prefix))
    return sweeps


def build_sensor_info(rows: SceneTableRows, data: Row, kind: str, lidar: SensorFrame, prefix: str) -> SensorInfo:
    """One measurement: its file, where the sensor was, and how its points come to the lidar of the sample."""
    mount = rows.mounts[data["calibrated_sensor_token"]]
    pose = rows.poses[data["ego_pose_token"]]
    rotation, translation = rows.frame(data).transform_to(lidar)
    return {
        "data_path": prefix + data["filename"],
        "type": kind,
        "sample_data_token": data["token"],
        "sensor2ego_translation": mount["translation"],
        "sensor2ego_rotation": mount["rotation"],
        "ego2global_translation": pose["translation"],
        "ego2global_rotation": pose["rotation"],
        "timestamp": data["timestamp"],
        "sensor2lidar_rotation": rotation,
        "sensor2lidar_translation": translation,
    }


Info = dict[str, Any]

_UNIAD_SECONDS: Final = 8
_SPARSEDRIVE_SECONDS: Final = 6
_FUTURE_SAMPLES: Final = 6


@dataclass(frozen=True)
class SceneSources:
    """All that the infos of a scene are made of; `map_lines` only where the repository's infos hold a map.

    Unknown visibilities become `default_visibility`; ``None`` refuses them.
    """

    rows: SceneTableRows
    boxes: SceneBoxes
    drive: EgoTrajectory
    can: ConverterCanMessages
    map_lines: MapLines | None
    prefix: str
    category_numbers: Mapping[str, int]
    default_visibility: int | None


@dataclass(frozen=True)
class _InfoSample:
    """A sample: its row, its place in the scene, its lidar's row and frame, its boxes in the order of the file."""

    sample: Row
    at: int
    data: Row
    lidar: SensorFrame
    here: Indices


def build_scene_infos(repository: Repository, version: str, sources: SceneSources) -> Iterator[Info]:
    """Infos of a scene in the order of the sample table; ``frame_idx`` stays 0 until scenes are put together.

    Those of v1.0-test have no annotations. Fails where the converter itself would.
    """
    rows = sources.rows
    index = {row["token"]: number for number, row in enumerate(sources.boxes.rows)}
    for sample in rows.samples:
        at = sources.drive.place[sample["token"]]
        here = np.array([index[row["token"]] for row in rows.annotations_of.get(sample["token"], ())], np.int64)
        moment = _InfoSample(sample, at, rows.lidar(sample), sources.drive.frames[at], here)
        yield {
            **_build_shared_keys(repository, sources, moment),
            **_BEFORE_BOXES[repository.name](sources, moment),
            **({} if version == TEST else _build_annotations(repository, sources, moment)),
        }


def _build_shared_keys(repository: Repository, sources: SceneSources, moment: _InfoSample) -> Info:
    rows, sample = sources.rows, moment.sample
    mount = rows.mounts[moment.data["calibrated_sensor_token"]]
    pose = rows.poses[moment.data["ego_pose_token"]]
    in_scene = {"prev": sample["prev"], "next": sample["next"], "can_bus": sources.can.vector(sample["timestamp"])}
    return {
        "lidar_path": sources.prefix + moment.data["filename"],
        "token": sample["token"],
        **({**in_scene, "frame_idx": 0} if repository.has_can_bus else {}),
        "sweeps": build_sweep_infos(rows, moment.data, moment.lidar, sources.prefix),
        "cams": build_camera_infos(rows, sample, moment.lidar, sources.prefix),
        "scene_token": sample["scene_token"],
        "lidar2ego_translation": mount["translation"],
        "lidar2ego_rotation": mount["rotation"],
        "ego2global_translation": pose["translation"],
        "ego2global_rotation": pose["rotation"],
        "timestamp": sample["timestamp"],
    }


def _build_vad_ego_keys(sources: SceneSources, moment: _InfoSample) -> Info:
    ahead = len(sources.rows.samples) - 1 - moment.at
    return {"fut_valid_flag": ahead >= _FUTURE_SAMPLES, "map_location": sources.rows.location}


def _build_sparsedrive_ego_keys(sources: SceneSources, moment: _InfoSample) -> Info:
    assert sources.map_lines is not None
    return {"map_location": sources.rows.location, "map_annos": sources.map_lines.around(moment.lidar)}


_BEFORE_BOXES: Final[Mapping[RepositoryName, Callable[[SceneSources, _InfoSample], Info]]] = {
    "uniad": lambda sources, moment: {},
    "vad": _build_vad_ego_keys,
    "sparsedrive": _build_sparsedrive_ego_keys,
}


def _build_annotations(repository: Repository, sources: SceneSources, moment: _InfoSample) -> Info:
    keys = build_annotation_keys(sources.rows, sources.boxes, moment.here, moment.lidar)
    further = _OF_BOXES[repository.name](sources, moment, keys)
    keys["gt_boxes"] = _convert_boxes(repository.name, keys["gt_boxes"])
    return {**keys, **further}


def _convert_boxes(name: RepositoryName, boxes: Any) -> Any:
    """(N, 7) boxes as a repository's version of mmdet3d wants them, or as it believes that it does."""
    if name == "sparsedrive":
        return boxes[:, [0, 1, 2, 4, 3, 5, 6]]
    if name == "vad":
        return np.concatenate([boxes[:, :6], -boxes[:, 6:] - np.pi / 2], axis=1)
    return boxes


def _list_instances(sources: SceneSources, moment: _InfoSample) -> Sequence[str]:
    return [str(sources.boxes.rows[number]["instance_token"]) for number in moment.here]


def _build_uniad_keys(sources: SceneSources, moment: _InfoSample, _: Info) -> Info:
    tokens = _list_instances(sources, moment)
    future, there = compute_own_frame_futures(sources.boxes, moment.here, _UNIAD_SECONDS)
    levels = [sources.boxes.rows[number]["visibility_token"] for number in moment.here]
    return {
        "gt_inds": np.array([sources.rows.instance_numbers[token] for token in tokens]),
        "gt_ins_tokens": np.array(tokens),
        "fut_traj": future,
        "fut_traj_valid_mask": np.repeat(there[..., None], 2, axis=-1).astype(np.float64),
        "visibility_tokens": np.array([_find_visibility(sources, moment, level) for level in levels]),
    }


def is_level(visibility: str) -> bool:
    """Whether a visibility is a number, as UniAD's converter assumes."""
    return visibility.isascii() and visibility.isdigit()


def _find_visibility(sources: SceneSources, moment: _InfoSample, level: str) -> int:
    if is_level(level):
        return int(level)
    if sources.default_visibility is not None:
        return sources.default_visibility
    raise InputError(
        f"{sources.rows.name}, sample {moment.sample['token']}: the visibility {level!r} of a box is not a number; "
        "UniAD's converter fails on it, leave out --as-converted"
    )


def _build_vad_keys(sources: SceneSources, moment: _InfoSample, box_keys: Info) -> Info:
    path = sources.drive.path(moment.at)
    boxes, names = box_keys["gt_boxes"], [sources.rows.categories[token] for token in _list_instances(sources, moment)]
    categories = np.array([sources.category_numbers[name] for name in names], np.float64)
    features = [boxes[:, :2], boxes[:, 6:], box_keys["gt_velocity"], boxes[:, 3:6], categories[:, None]]
    futures = compute_vad_futures(sources.boxes, moment.here, moment.lidar)
    ego = sources.drive.features(moment.at, path, sources.can, sources.rows.location)
    return to_single_precision(
        {
            "gt_agent_fut_trajs": futures["gt_agent_fut_trajs"],
            "gt_agent_fut_masks": futures["gt_agent_fut_masks"],
            "gt_agent_lcf_feat": np.concatenate(features, axis=1),
            "gt_agent_fut_yaw": futures["gt_agent_fut_yaw"],
            "gt_agent_fut_goal": futures["gt_agent_fut_goal"],
            **path,
            "gt_ego_lcf_feat": ego,
        }
    )


def _build_sparsedrive_keys(sources: SceneSources, moment: _InfoSample, _: Info) -> Info:
    offsets, there = compute_lidar_offsets(sources.boxes, moment.here, moment.lidar, _SPARSEDRIVE_SECONDS)
    path = sources.drive.path(moment.at)
    return {
        "instance_inds": [sources.rows.instance_numbers[token] for token in _list_instances(sources, moment)],
        **to_single_precision(
            {
                "gt_agent_fut_trajs": offsets,
                "gt_agent_fut_masks": there,
                "gt_ego_fut_trajs": path["gt_ego_fut_trajs"],
                "gt_ego_fut_masks": path["gt_ego_fut_masks"],
                "gt_ego_fut_cmd": path["gt_ego_fut_cmd"],
                "ego_status": compute_ego_status(sources.can, moment.sample["timestamp"]),
            }
        ),
    }


_OF_BOXES: Final[Mapping[RepositoryName, Callable[[SceneSources, _InfoSample, Info], Info]]] = {
    "uniad": _build_uniad_keys,
    "vad": _build_vad_keys,
    "sparsedrive": _build_sparsedrive_keys,
}
