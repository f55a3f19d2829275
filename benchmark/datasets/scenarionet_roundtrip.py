"""The scene of a ScenarioNet file that was exported here: its own frames, with what others have no place for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_HEIGHT_M
from benchmark.datasets.annotated_objects import find_nearest_valid
from benchmark.datasets.scenario_map import (
    ADVERSARIES,
    FARTHEST_M,
    OWN,
    SCHEMA,
    ExchangedScene,
    compute_ego_center,
    decode_map,
    hash_track,
    to_name,
    to_real_numbers,
)
from benchmark.datasets.scenarionet_tracks import SourceTrack
from benchmark.errors import InputError
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.scene import Agents, Annotations, Camera, EgoTrack, LidarMount, Scene, SweepPoses
from benchmark.untrusted.files import RECORD, to_one_line
from benchmark.untrusted.text_files import parse_json

_SAME_M: Final = 1e-6
"""Largest distance of the ego from its pose in the file's own block before the file counts as edited."""
_LONGEST_TEXT: Final = 10_000
_MOST_PIXELS: Final = 20_000


@dataclass(frozen=True, slots=True)
class RoundtripFile:
    """Checked content of a file that was exported here.

    ``raw_tracks`` are as they stand in it; ``tracks`` are those that are there at some step, but for the ego's.
    """

    path: Path
    own: Mapping[Any, Any]
    metadata: Mapping[Any, Any]
    raw_tracks: Mapping[Any, Any]
    tracks: Mapping[str, SourceTrack]
    ego: SourceTrack
    features: Mapping[Any, Any]


def find_own_block(metadata: Mapping[Any, Any], path: Path) -> Mapping[Any, Any] | None:
    """Own block of a file that was exported here; ``None`` in any other file."""
    additions = metadata.get(OWN)
    if additions is None:
        return None
    if not isinstance(additions, dict) or additions.get("schema") != SCHEMA:
        schema = additions.get("schema") if isinstance(additions, dict) else None
        raise InputError(
            f"{path} was exported by another version (its {OWN} block has schema {schema!r:.40}, this version reads "
            f"{SCHEMA}); upgrade challenger-bench or export it again"
        )
    return additions


def restore_scene(file: RoundtripFile) -> ExchangedScene:
    """The scene as it was exported, with what was edited since.

    A track that is as it was exported keeps its annotations. One that was edited, or is new, is annotated where it is
    at each keyframe. Objects that are at no keyframe are left out, because nothing would annotate them.
    """
    try:
        return _scene(file)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{file.path}: the block added by challenger-bench is damaged ({type(error).__name__}: "
            f"{to_one_line(error, 80)}); export it again"
        ) from error


def _scene(file: RoundtripFile) -> ExchangedScene:
    additions, path = file.own, file.path
    timestamps = _whole_numbers(additions["timestamps_us"])
    keyframes = _whole_numbers(additions["keyframes"])
    frames = len(file.ego.heading)
    if len(timestamps) != frames or (np.diff(timestamps) <= 0).any() or timestamps[0] < 0:
        raise ValueError("times that do not match its steps")
    if not len(keyframes) or (np.diff(keyframes) <= 0).any() or keyframes[0] < 0 or keyframes[-1] >= frames:
        raise ValueError("keyframes that are not steps of the recording")
    agents, annotations = _objects(file, keyframes)
    name = to_name(additions["name"], "the name of the scene", path)
    exchanged = ExchangedScene(
        scene=Scene(
            name=name,
            token=to_name(additions["token"], "the token of the scene", path),
            description=_text(additions["description"]),
            log=to_name(additions["log"], "the log", path),
            vehicle=to_name(additions["vehicle"], "the vehicle", path),
            date=to_name(additions["date"], "the date", path),
            timestamps_us=timestamps,
            keyframes=keyframes,
            ego=_ego(file),
            agents=agents,
            annotations=annotations,
            cameras=tuple(_camera(camera, path) for camera in additions["cameras"]),
            lidar=LidarMount(
                _numbers(additions["lidar"]["translation"], (3,)), _numbers(additions["lidar"]["rotation"], (4,))
            ),
            road_map=decode_map(file.features, additions["map"], path),
            adversaries=read_adversaries(file.metadata, agents.ids, path),
            sweep_poses=_sweeps(additions["sweeps"], frames, len(additions["cameras"])),
        ),
        source_scene=to_name(additions["source_scene"], "the source scene", path) or name,
        report=_report(additions["report"]),
    )
    return exchanged


def read_adversaries(metadata: Mapping[Any, Any], ids: Sequence[str], path: Path) -> tuple[str, ...]:
    """Adversaries that metadata of a ScenarioNet file may name (``adversaries``); refuses names not in ``ids``."""
    listed = metadata.get(ADVERSARIES, [])
    if not isinstance(listed, list | tuple):
        raise InputError(f"{path}: metadata {ADVERSARIES} must be a list of tracks; correct it")
    names = tuple(dict.fromkeys(to_name(adversary, f"one of the {ADVERSARIES}", path) for adversary in listed))
    unknown = [name for name in names if name not in ids]
    if unknown:
        raise InputError(
            f"{path}: metadata {ADVERSARIES} names {unknown[0]}, which is not an object at any keyframe; correct it"
        )
    return names


def _ego(file: RoundtripFile) -> EgoTrack:
    """Recorded poses, unless the ego was moved since."""
    frames = len(file.ego.heading)
    known = EgoTrack(
        _numbers(file.own["ego_position"], (frames, 3)), _unit(_numbers(file.own["ego_rotation"], (frames, 4)))
    )
    away = np.abs(compute_ego_center(known) - file.ego.position).max(axis=1)
    turned = np.abs(np.sin((known.yaw - file.ego.heading) / 2))
    if max(away.max(), turned.max()) < _SAME_M:
        return known
    yaw = file.ego.heading
    ahead = EGO_CENTER_FROM_REAR_AXLE_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
    center = file.ego.position
    position = np.column_stack([center[:, :2] - ahead, center[:, 2] - 0.5 * EGO_HEIGHT_M])
    return EgoTrack(position, quaternion_from_yaw(yaw))


def _objects(file: RoundtripFile, keyframes: NDArray[np.int64]) -> tuple[Agents, Annotations]:
    tracks = {name: track for name, track in file.tracks.items() if track.valid[keyframes].any()}
    nearest = {name: find_nearest_valid(track.valid[None])[0] for name, track in tracks.items()}
    frames, count = len(file.ego.heading), len(tracks)
    # Names may be numbers in the file.
    raw = {str(name): track for name, track in file.raw_tracks.items()}
    additions = {name: _find_track_additions(raw[name]) for name in tracks}
    categories = [_category(additions[name], track, file.path) for name, track in tracks.items()]
    agents = Agents(
        ids=tuple(tracks),
        categories=tuple(categories),
        position=np.array([track.position[nearest[name]] for name, track in tracks.items()]).reshape(count, frames, 3),
        yaw=np.array([track.heading[nearest[name]] for name, track in tracks.items()]).reshape(count, frames),
        size=np.array([track.size for track in tracks.values()]).reshape(count, 3),
        valid=np.array([track.valid for track in tracks.values()], np.bool_).reshape(count, frames),
    )
    rows = [_read_annotations(additions[name], agents, row, keyframes) for row, name in enumerate(tracks)]
    shape = (count, len(keyframes))

    def together(field: str, last: tuple[int, ...], kind: type) -> Any:
        return np.array([row[field] for row in rows], dtype=kind).reshape(*shape, *last)

    return agents, Annotations(
        position=together("position", (3,), np.float64),
        rotation=together("rotation", (4,), np.float64),
        size=together("size", (3,), np.float64),
        valid=together("valid", (), np.bool_),
        attribute=together("attribute", (), np.str_),
        visibility=together("visibility", (), np.int64),
        num_lidar_pts=together("num_lidar_pts", (), np.int64),
        num_radar_pts=together("num_radar_pts", (), np.int64),
    )


def _find_track_additions(track: Mapping[Any, Any]) -> Mapping[Any, Any] | None:
    """Additions of the file to a track; ``None`` for a track that was added since."""
    metadata = track.get("metadata")
    additions = metadata.get(OWN) if isinstance(metadata, dict) else None
    return additions if isinstance(additions, dict) else None


def _category(own: Mapping[Any, Any] | None, track: SourceTrack, path: Path) -> str:
    return track.category if own is None else to_name(own["category"], "a category", path)


def _read_annotations(
    own: Mapping[Any, Any] | None, agents: Agents, row: int, keyframes: NDArray[np.int64]
) -> dict[str, Any]:
    """Fields of `Annotations` of one object."""
    position, yaw, size, valid = (part[row] for part in (agents.position, agents.yaw, agents.size, agents.valid))
    if own is not None:
        known = _read_recorded_annotations(own["annotations"], len(keyframes))
        if own["digest"] == hash_track(position, yaw, size, valid):
            return known
    else:
        nothing = np.zeros(len(keyframes), np.int64)
        known = {"attribute": [""] * len(keyframes), "visibility": nothing, "num_lidar_pts": nothing}
        known["num_radar_pts"] = nothing
    is_there = valid[keyframes]
    at = keyframes[find_nearest_valid(is_there[None])[0]]
    return {
        **known,
        "position": position[at],
        "rotation": quaternion_from_yaw(yaw[at]),
        "size": np.repeat(size[None], len(keyframes), axis=0),
        "valid": is_there,
        # Metrics drop boxes without points.
        "num_lidar_pts": np.where(is_there, np.maximum(known["num_lidar_pts"], 1), 0),
    }


def _read_recorded_annotations(stored: Mapping[str, Any], count: int) -> dict[str, Any]:
    attributes = [_text(text) for text in stored["attribute"]]
    if len(attributes) != count:
        raise ValueError(f"{len(attributes)} attributes at {count} keyframes")
    counts = {
        name: _whole_numbers(stored[name]).reshape(count) for name in ("visibility", "num_lidar_pts", "num_radar_pts")
    }
    size = _numbers(stored["size"], (count, 3))
    if (size <= 0).any():
        raise ValueError("sizes that are not positive")
    return {
        "position": _numbers(stored["position"], (count, 3)),
        "rotation": _unit(_numbers(stored["rotation"], (count, 4))),
        "size": size,
        "valid": _numbers(stored["valid"], (count,)) > 0,
        "attribute": attributes,
        **counts,
    }


def _camera(stored: Mapping[Any, Any], path: Path) -> Camera:
    width, height = _whole_numbers(stored["size"]).tolist()
    if not (0 < width <= _MOST_PIXELS and 0 < height <= _MOST_PIXELS):
        raise ValueError(f"a camera of {width} x {height} pixels")
    return Camera(
        name=to_name(stored["name"], "the name of a camera", path),
        translation=_numbers(stored["translation"], (3,)),
        rotation=_unit(_numbers(stored["rotation"], (4,))),
        intrinsic=_numbers(stored["intrinsic"], (3, 3)),
        width=width,
        height=height,
    )


def _sweeps(stored: Any, frames: int, cameras: int) -> SweepPoses | None:
    if stored is None:
        return None
    return SweepPoses(_numbers(stored["lidar"], (frames, 4, 4)), _numbers(stored["cameras"], (cameras, frames, 4, 4)))


def _report(text: Any) -> dict[str, Any]:
    value = parse_json(_text(text, RECORD.line_bytes).encode(), RECORD)
    if not isinstance(value, dict):
        raise ValueError("a report that is not an object")
    return value


def _text(value: Any, longest: int = _LONGEST_TEXT) -> str:
    if not isinstance(value, str) or len(value) > longest:
        raise ValueError("a value that is not text, or text that is too long")
    value.encode()
    return value


def _numbers(value: Any, shape: tuple[int, ...]) -> Floats:
    numbers = to_real_numbers(value).reshape(shape)
    if not np.isfinite(numbers).all() or np.abs(numbers).max(initial=0.0) > FARTHEST_M:
        raise ValueError("numbers that are not finite or too large")
    return numbers


def _unit(quaternions: Floats) -> Floats:
    if (np.abs(np.linalg.norm(quaternions, axis=-1) - 1.0) > 1e-3).any():
        raise ValueError("rotations that are not unit quaternions")
    return quaternions


def _whole_numbers(value: Any) -> NDArray[np.int64]:
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "iu" or numbers.ndim != 1:
        raise ValueError(f"{numbers.dtype} instead of whole numbers")
    return numbers.astype(np.int64)
