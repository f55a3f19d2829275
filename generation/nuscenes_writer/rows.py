"""Table rows of one scene."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from benchmark.constants import LIDAR_NAME
from benchmark.scene import Camera, EgoTrack, Scene
from generation.nuscenes_writer.plan import SceneNames
from generation.nuscenes_writer.vocabulary import LabelVocabulary, Row, build_sensor_row
from generation.render.contract import RecordedChannel

SceneTables = dict[str, list[Row]]


@dataclass(frozen=True, slots=True)
class SensorChannel:
    """One sensor, the lidar without ``camera``; ``ego`` is the ego's track as it measures, ``None`` for the scene's.

    ``offsets_us`` is by how much it measures later than a frame, by frame; ``None`` where it has every frame's time.
    """

    name: str
    camera: Camera | None
    extension: str
    ego: EgoTrack | None = None
    offsets_us: Mapping[int, int] | None = None

    def list_frames(self, frames: Iterable[int]) -> list[int]:
        """Which of some frames it has."""
        return [frame for frame in frames if self.offsets_us is None or frame in self.offsets_us]

    def time_us(self, scene: Scene, frame: int) -> int:
        """When it measured a frame."""
        return int(scene.timestamps_us[frame]) + (0 if self.offsets_us is None else self.offsets_us[frame])


def build_channels(
    cameras: Sequence[Camera], tracks: Mapping[str, EgoTrack], recorded: Mapping[str, RecordedChannel] | None = None
) -> tuple[SensorChannel, ...]:
    """The lidar and the cameras of a scene, and the ego motion of cameras with clocks of their own."""
    channels = [SensorChannel(LIDAR_NAME, None, "pcd.bin")]
    for camera in cameras:
        own = None if recorded is None else recorded[camera.name]
        if own is None:
            channels.append(SensorChannel(camera.name, camera, "jpg", tracks.get(camera.name)))
            continue
        places = np.searchsorted(own.frames, np.arange(own.frames.max(initial=-1) + 1)).clip(max=len(own.frames) - 1)
        ego = EgoTrack(own.ego.position[places], own.ego.rotation[places])
        offsets = dict(zip(own.frames.tolist(), own.offsets_us.tolist(), strict=True))
        channels.append(SensorChannel(camera.name, camera, own.extension, ego, offsets))
    return tuple(channels)


def build_scene_tables(
    names: SceneNames,
    vocabulary: LabelVocabulary,
    scene: Scene,
    channels: Sequence[SensorChannel],
    frames: Sequence[int],
) -> SceneTables:
    """All rows of one scene, linked, by table; ``frames``, ascending with the keyframes among them, get sensor rows."""
    tables: SceneTables = {"sample": _build_samples(names, scene), "calibrated_sensor": []}
    tables["scene"] = [_build_scene_row(names, vocabulary, scene)]
    tables["sample_data"], tables["ego_pose"] = [], []
    for channel in channels:
        tables["calibrated_sensor"].append(_build_calibration(names, scene, channel))
        data, poses = _build_sensor_rows(names, scene, channel, frames)
        tables["sample_data"] += data
        tables["ego_pose"] += poses
    tables["instance"], tables["sample_annotation"] = _build_object_rows(names, vocabulary, scene)
    return tables


def list_used_labels(vocabulary: LabelVocabulary, scene: Scene) -> dict[str, list[Row]]:
    """Category and attribute rows that a scene uses, by table."""
    attributes = {word for words in scene.annotations.attribute.ravel().tolist() for word in words.split(";") if word}
    return {
        "category": [vocabulary.get_category_row(name) for name in sorted(set(scene.agents.categories))],
        "attribute": [vocabulary.get_attribute_row(name) for name in sorted(attributes)],
    }


def _link_rows(rows: list[Row]) -> list[Row]:
    for earlier, later in pairwise(rows):
        earlier["next"], later["prev"] = later["token"], earlier["token"]
    return rows


def _build_samples(names: SceneNames, scene: Scene) -> list[Row]:
    rows = [
        {
            "token": names.token("sample", index),
            "timestamp": int(scene.timestamps_us[frame]),
            "scene_token": names.token("scene"),
            "prev": "",
            "next": "",
        }
        for index, frame in enumerate(scene.keyframes)
    ]
    return _link_rows(rows)


def _build_scene_row(names: SceneNames, vocabulary: LabelVocabulary, scene: Scene) -> Row:
    count = len(scene.keyframes)
    return {
        "token": names.token("scene"),
        "name": names.row,
        "description": scene.description,
        "log_token": vocabulary.get_log_row(scene)["token"],
        "nbr_samples": count,
        "first_sample_token": names.token("sample", 0),
        "last_sample_token": names.token("sample", count - 1),
    }


def _build_calibration(names: SceneNames, scene: Scene, channel: SensorChannel) -> Row:
    mount = channel.camera or scene.lidar
    return {
        "token": names.token("calibrated_sensor", channel.name),
        "sensor_token": build_sensor_row(channel.name)["token"],
        "translation": mount.translation.tolist(),
        "rotation": mount.rotation.tolist(),
        "camera_intrinsic": [] if channel.camera is None else channel.camera.intrinsic.tolist(),
    }


def _build_sensor_rows(
    names: SceneNames, scene: Scene, channel: SensorChannel, frames: Sequence[int]
) -> tuple[list[Row], list[Row]]:
    """Rows of ``sample_data`` and ``ego_pose``, one pair a frame with equal tokens."""
    keyframes, ego = set(scene.keyframes.tolist()), channel.ego or scene.ego
    # A sweep belongs to the sample before it, as in the reference code; in nuScenes, to the one after.
    frames = channel.list_frames(frames)
    owner = np.maximum(np.searchsorted(scene.keyframes, frames, side="right") - 1, 0)
    data, poses = [], []
    for frame, sample in zip(frames, owner.tolist()):
        own_token = names.token("sample_data", channel.name, int(frame))
        timestamp = channel.time_us(scene, frame)
        is_keyframe = frame in keyframes
        data.append(
            {
                "token": own_token,
                "sample_token": names.token("sample", sample),
                "ego_pose_token": own_token,
                "calibrated_sensor_token": names.token("calibrated_sensor", channel.name),
                "timestamp": timestamp,
                "fileformat": "pcd" if channel.camera is None else channel.extension,
                "is_key_frame": is_keyframe,
                "height": 0 if channel.camera is None else channel.camera.height,
                "width": 0 if channel.camera is None else channel.camera.width,
                "filename": names.file(channel.name, timestamp, is_keyframe=is_keyframe, extension=channel.extension),
                "prev": "",
                "next": "",
            }
        )
        poses.append(
            {
                "token": own_token,
                "timestamp": timestamp,
                "translation": ego.position[frame].tolist(),
                "rotation": ego.rotation[frame].tolist(),
            }
        )
    return _link_rows(data), poses


def _build_object_rows(names: SceneNames, vocabulary: LabelVocabulary, scene: Scene) -> tuple[list[Row], list[Row]]:
    """Rows of ``instance`` and ``sample_annotation``; an object without annotations has neither."""
    instances: list[Row] = []
    annotations: list[Row] = []
    for agent, agent_id in enumerate(scene.agents.ids):
        at = np.flatnonzero(scene.annotations.valid[agent])
        if not len(at):
            continue
        rows = _link_rows([_build_annotation(names, vocabulary, scene, agent, int(keyframe)) for keyframe in at])
        annotations += rows
        instances.append(
            {
                "token": names.instance(agent_id),
                "category_token": vocabulary.get_category_row(scene.agents.categories[agent])["token"],
                "nbr_annotations": len(rows),
                "first_annotation_token": rows[0]["token"],
                "last_annotation_token": rows[-1]["token"],
            }
        )
    return instances, annotations


def _build_annotation(names: SceneNames, vocabulary: LabelVocabulary, scene: Scene, agent: int, keyframe: int) -> Row:
    source, at = scene.annotations, (agent, keyframe)
    agent_id = scene.agents.ids[agent]
    length, width, height = source.size[at].tolist()
    lidar_points, radar_points = int(source.num_lidar_pts[at]), int(source.num_radar_pts[at])
    # Evaluators drop boxes without points. Counts of the source are kept; where the source has no
    # visibility it has no counts either, and the adversary must stay visible.
    if agent_id in scene.adversaries or source.visibility[at] == 0:
        lidar_points = max(lidar_points, 1)
    attributes = [word for word in str(source.attribute[at]).split(";") if word]
    return {
        "token": names.token("sample_annotation", agent_id, keyframe),
        "sample_token": names.token("sample", keyframe),
        "instance_token": names.instance(agent_id),
        "visibility_token": vocabulary.get_visibility_token(int(source.visibility[at])),
        "attribute_tokens": [vocabulary.get_attribute_row(word)["token"] for word in attributes],
        "translation": source.position[at].tolist(),
        "size": [width, length, height],
        "rotation": source.rotation[at].tolist(),
        "num_lidar_pts": lidar_points,
        "num_radar_pts": radar_points,
        "prev": "",
        "next": "",
    }
