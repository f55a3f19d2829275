"""`Scene` objects from ScenarioNet files: recordings of nuScenes, Waymo, nuPlan and Argoverse 2 in one format.

Such files have no images, point counts (each annotation claims one lidar point), attributes and visibility, and no
clock (see `_timestamps`).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import (
    EGO_CENTER_FROM_REAR_AXLE_M,
    FRAME_HZ,
    FRAMES_PER_KEYFRAME,
    OFFICIAL_LOCATIONS,
)
from benchmark.datasets.scenario_map import ExchangedScene, to_name, to_real_numbers
from benchmark.datasets.scenarionet_map import build_road_map
from benchmark.datasets.scenarionet_roundtrip import RoundtripFile, find_own_block, read_adversaries, restore_scene
from benchmark.datasets.scenarionet_tracks import SourceTrack, read_track, resample_tracks
from benchmark.datasets.scene_descriptions import describe_place_and_light, describe_traffic_and_road, join_words
from benchmark.datasets.sensors import make_standard_lidar
from benchmark.datasets.tables import parse_scene_number
from benchmark.errors import InputError
from benchmark.geometry import Floats, poses_between, quaternion_from_yaw
from benchmark.machine.storage import content_seed, make_token
from benchmark.scene import EgoTrack, Scene
from benchmark.untrusted.children import read_pickle
from benchmark.untrusted.files import RECORDED_OBJECTS, RECORDED_POSES, RECORDING_S, to_one_line

_FALLBACK_LOCATION: Final = OFFICIAL_LOCATIONS[0]
_UNOFFICIAL_NUMBERS: Final = range(2000, 10000)
"""Above all numbers of real nuScenes scenes, some of which the devkit's CAN bus reader refuses."""
_CLOCK_START_US: Final = 1_500_000_000_000_000
_CLOCK_APART_US: Final = 600_000_000
_FASTEST_EGO_MPS: Final = 200.0
"""Beyond this a position is broken; spliced recordings jump by a metre between two steps."""


@dataclass(frozen=True, slots=True)
class _ScenarioNetFile:
    """Facts that a file states about itself: scenario name in its source, (L,) times of steps, its whole ``value``."""

    path: Path
    identifier: str
    dataset: str
    seconds: Floats
    metadata: Mapping[str, Any]
    value: Mapping[str, Any]

    @property
    def is_nuscenes(self) -> bool:
        return self.dataset.lower() == "nuscenes"


def find_scenarionet(folder: Path) -> tuple[Path, ...]:
    """``sd_*.pkl`` files in a folder and below it, sorted, or a single file.

    Where there are none, all ``*.pkl`` but the database's ``dataset_summary.pkl`` and ``dataset_mapping.pkl``.
    """
    if folder.is_file():
        return (folder,)
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; give a folder with ScenarioNet files (sd_*.pkl)")
    pickles = sorted(path for path in folder.rglob("*.pkl") if path.is_file())
    named = [path for path in pickles if path.name.startswith("sd_")]
    paths = named or [path for path in pickles if path.name not in ("dataset_summary.pkl", "dataset_mapping.pkl")]
    if not paths:
        raise InputError(f"{folder} has no ScenarioNet files (sd_*.pkl); give the folder that contains them")
    return tuple(paths)


def read_scenarionet(path: Path) -> Scene:
    """Read one ScenarioNet file.

    A file that `benchmark.extensions.exchange` wrote is the scene that it was made of, but for what was edited since
    (`benchmark.datasets.scenarionet_roundtrip`). Of any other file:

    Steps (usually 10 Hz) are resampled to 12 Hz; each sixth frame is a keyframe, and the scene ends with the last
    keyframe. The name is the scenario's if that is like ``scene-0061``, else ``scene-2000`` to ``scene-9999`` by hash
    of the scenario's id. The location is the file's own if it is an official nuScenes one, else ``boston-seaport``,
    because the devkit accepts no other; coordinates are shifted where they would be negative.

    In nuScenes files the ego's position is ``ego_pose`` (the rear axle), agents' positions are box centres, and the
    last half second is left out: there ScenarioNet joins two sources of ego poses, which jump by up to a metre. In
    other files the ego's position is its box centre; heights are made relative to the ground under the ego. Tracks that
    the metadata's ``adversaries`` names are the adversaries.

    The scene has no cameras, a map cropped to 200 m around the ego's path, and a description in words
    (`benchmark.datasets.scene_descriptions`).
    """
    return read_exchanged_scene(path).scene


def read_exchanged_scene(path: Path) -> ExchangedScene:
    """The same with how the scene was made, which files say that were exported here; as `read_scenarionet`."""
    recording = _read_recording(path)
    tracks = _tracks_of(recording)
    ego = _ego_of(recording, tracks)
    others = {name: track for name, track in tracks.items() if track is not ego}
    additions = find_own_block(recording.metadata, path)
    if additions is not None:
        _require_steady(recording, ego)
        value = recording.value
        return restore_scene(
            RoundtripFile(path, additions, recording.metadata, value["tracks"], others, ego, value["map_features"])
        )
    scene = _build_external_scene(recording, ego, others)
    return ExchangedScene(scene, scene.name)


def _build_external_scene(recording: _ScenarioNetFile, ego: SourceTrack, others: Mapping[str, SourceTrack]) -> Scene:
    frame_seconds = _frame_seconds(recording, ego)
    position = _ego_position(recording, ego)
    ground_z = None if recording.is_nuscenes else position[:, 2].copy()
    if ground_z is not None:
        position[:, 2] = 0.0
    road_map, shift = build_road_map(
        recording.value["map_features"],
        path=recording.path,
        location=_location(recording),
        official=_is_official(recording.metadata.get("map")),
        ego_path=position[:, :2],
    )
    keyframes = np.arange(0, len(frame_seconds), FRAMES_PER_KEYFRAME)
    agents, annotations = resample_tracks(
        others, recording.seconds, frame_seconds, keyframes, shift=shift, ground_z=ground_z
    )
    name = _scene_name(recording)
    scene = Scene(
        name=name,
        token=_scene_token(recording),
        # Words of a description set the appearance, and an identifier may contain any word.
        description="",
        log=f"scenarionet-{recording.dataset}-{recording.identifier}",
        vehicle="scenarionet",
        date=_date(recording),
        timestamps_us=_timestamps(name, frame_seconds),
        keyframes=keyframes,
        ego=_ego_track(recording.seconds, position, ego.heading, frame_seconds, shift),
        agents=agents,
        annotations=annotations,
        cameras=(),
        lidar=make_standard_lidar(),
        road_map=road_map,
        adversaries=read_adversaries(recording.metadata, agents.ids, recording.path),
    )
    return replace(
        scene,
        description=join_words([*describe_place_and_light(recording.metadata), *describe_traffic_and_road(scene)]),
    )


def _read_recording(path: Path) -> _ScenarioNetFile:
    value = read_pickle(path)
    needed = ("id", "length", "metadata", "tracks", "map_features")
    if not isinstance(value, dict) or any(key not in value for key in needed):
        raise InputError(f"{path} is not a ScenarioNet scenario: it needs the keys {', '.join(needed)}")
    metadata = value["metadata"]
    if not all(isinstance(value[key], dict) for key in ("metadata", "tracks", "map_features")):
        raise InputError(f"{path}: metadata, tracks and map_features must be dictionaries; fetch the file again")
    try:
        seconds = to_real_numbers(metadata["ts"]).reshape(-1)
    except (KeyError, ValueError):
        raise InputError(f"{path}: metadata has no usable list of times 'ts'; fetch the file again") from None
    steps, length = np.diff(seconds), value["length"]
    is_complete = isinstance(length, int | np.integer) and len(seconds) == length >= 2
    if not is_complete or not np.isfinite(seconds).all() or not (steps > 0).all():
        raise InputError(
            f"{path}: metadata 'ts' must be {to_one_line(length, 40)} increasing finite times, one a step; fetch the "
            "file again"
        )
    if not 0.01 <= float(np.median(steps)) <= 1.0:
        raise InputError(f"{path}: 'ts' steps by {np.median(steps):g}; it must be in seconds, at 1 to 100 Hz")
    if seconds[-1] - seconds[0] > RECORDING_S:
        raise InputError(
            f"{path} lasts {seconds[-1] - seconds[0]:g} s; one recording has at most {RECORDING_S:g} s; cut it"
        )
    dataset = to_name(metadata.get("dataset", "unknown"), "metadata dataset", path)
    return _ScenarioNetFile(path, to_name(value["id"], "id", path), dataset, seconds - seconds[0], metadata, value)


def _tracks_of(recording: _ScenarioNetFile) -> dict[str, SourceTrack]:
    path, given = recording.path, recording.value["tracks"]
    named = {to_name(name, "the name of a track", path): track for name, track in given.items()}
    if len(named) != len(given):
        raise InputError(f"{path} has two tracks with the same name; fetch the file again")
    frames = max(len(recording.seconds), (recording.seconds[-1] + 1.0) * FRAME_HZ)
    if len(named) > RECORDED_OBJECTS or len(named) * frames > RECORDED_POSES:
        raise InputError(f"{path} has {len(named)} tracks at {frames:.0f} frames, which is too many; cut it")
    read = {name: read_track(track, name, len(recording.seconds), path) for name, track in named.items()}
    return {name: track for name, track in read.items() if track is not None}


def _ego_of(recording: _ScenarioNetFile, tracks: Mapping[str, SourceTrack]) -> SourceTrack:
    name = to_name(recording.metadata.get("sdc_id"), "metadata sdc_id", recording.path)
    if name not in tracks:
        raise InputError(
            f"{recording.path}: metadata sdc_id {name!r} names no track, so there is no ego; fetch the file again"
        )
    return tracks[name]


def _require_steady(recording: _ScenarioNetFile, ego: SourceTrack) -> None:
    """Refuse an ego that is not always there, or jumps."""
    if not ego.valid.all():
        raise InputError(
            f"{recording.path}: the ego is absent at step {int(np.argmin(ego.valid))}; a recording needs its ego "
            "at every step"
        )
    moved = np.linalg.norm(np.diff(ego.position[:, :2], axis=0), axis=1) / np.diff(recording.seconds)
    if moved.max() > _FASTEST_EGO_MPS:
        raise InputError(
            f"{recording.path}: the ego moves at {moved.max():.3g} m/s after step {int(np.argmax(moved))}; positions "
            "must be in metres and without jumps; fetch the file again"
        )


def _frame_seconds(recording: _ScenarioNetFile, ego: SourceTrack) -> Floats:
    """12 Hz times from the first step to the last whole keyframe."""
    _require_steady(recording, ego)
    half_second = FRAMES_PER_KEYFRAME / FRAME_HZ
    count = int(np.floor(recording.seconds[-1] / half_second + 1e-6)) + 1
    if recording.is_nuscenes:
        count -= 1
    if count < 2:
        raise InputError(
            f"{recording.path} lasts {recording.seconds[-1]:g} s; a scene needs two keyframes, half a second apart"
        )
    return np.arange((count - 1) * FRAMES_PER_KEYFRAME + 1) / FRAME_HZ


def _ego_position(recording: _ScenarioNetFile, ego: SourceTrack) -> Floats:
    """(L, 3) rear axle on the ground."""
    if recording.is_nuscenes:
        return ego.position.copy()
    back = EGO_CENTER_FROM_REAR_AXLE_M * np.column_stack([np.cos(ego.heading), np.sin(ego.heading)])
    z = ego.position[:, 2]
    ground_z = np.zeros_like(z) if not z.any() else z - 0.5 * ego.size[2]
    return np.column_stack([ego.position[:, :2] - back, ground_z])


def _ego_track(seconds: Floats, position: Floats, heading: Floats, wanted: Floats, shift: Floats) -> EgoTrack:
    right = np.clip(np.searchsorted(seconds, wanted - 1e-9), 1, len(seconds) - 1)
    fraction = np.clip((wanted - seconds[right - 1]) / (seconds[right] - seconds[right - 1]), 0.0, 1.0)
    poses = np.column_stack([position[:, :2] + shift, heading])
    between = poses_between(poses[right - 1], poses[right], fraction)
    z = np.interp(wanted, seconds, position[:, 2])
    return EgoTrack(np.column_stack([between[:, :2], z]), quaternion_from_yaw(between[:, 2]))


def _location(recording: _ScenarioNetFile) -> str:
    location = recording.metadata.get("map")
    return str(location) if _is_official(location) else _FALLBACK_LOCATION


def _is_official(location: Any) -> bool:
    return isinstance(location, str) and location in OFFICIAL_LOCATIONS


def _scene_name(recording: _ScenarioNetFile) -> str:
    if parse_scene_number(recording.identifier) is not None:
        return recording.identifier
    span = len(_UNOFFICIAL_NUMBERS)
    number = _UNOFFICIAL_NUMBERS[content_seed("scene name", recording.dataset, recording.identifier) % span]
    return f"scene-{number:04d}"


def _scene_token(recording: _ScenarioNetFile) -> str:
    given = recording.metadata.get("scenario_token")
    if isinstance(given, str) and re.fullmatch(r"[0-9a-f]{32}", given):
        return given
    return make_token("scene", recording.dataset, recording.identifier)


def _date(recording: _ScenarioNetFile) -> str:
    date = recording.metadata.get("date")
    return date if isinstance(date, str) and re.fullmatch(r"\d{4}-\d{2}-\d{2}", date) else "1970-01-01"


def _timestamps(name: str, frame_seconds: Floats) -> NDArray[np.int64]:
    """Scenes ten minutes apart on one clock: official code sorts samples by time and must not mix two scenes."""
    number = parse_scene_number(name)
    assert number is not None
    start_us = _CLOCK_START_US + number * _CLOCK_APART_US
    return np.asarray(start_us + np.rint(frame_seconds * 1e6), dtype=np.int64)
