"""Export of the scenes of a data set to files, in any format, and as scenarios of ScenarioNet and MetaDrive."""

import io
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import EGO_BODY_WIDTH_M, EGO_HEIGHT_M, EGO_LENGTH_M, FRAME_HZ, VERSION
from benchmark.datasets.roots import DataSet
from benchmark.datasets.scenario_map import (
    ADVERSARIES,
    DATASET,
    IS_ADVERSARY,
    OWN,
    SCHEMA,
    ExchangedScene,
    compute_ego_center,
    encode_map,
    hash_track,
)
from benchmark.datasets.steps import require_two_hz
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.machine.progress import CountedUnits
from benchmark.machine.storage import canonical_json, lock_folder, make_token, write_bytes
from benchmark.machine.workers import map_ordered
from benchmark.scene import Annotations, Scene

Scenario = dict[str, Any]

_TYPES: Final = {
    "vehicle.bicycle": "CYCLIST",
    "vehicle.motorcycle": "CYCLIST",
    "movable_object.trafficcone": "TRAFFIC_CONE",
    "movable_object.barrier": "TRAFFIC_BARRIER",
    "static_object.bicycle_rack": "TRAFFIC_OBJECT",
}
_KINDS: Final = {"vehicle": "VEHICLE", "human": "PEDESTRIAN", "movable_object": "TRAFFIC_OBJECT"}
_LEAST_MOVED_M: Final = 1.0
"""Threshold of movement in ScenarioNet's summaries."""


def build_scenario(made: ExchangedScene) -> Scenario:
    """Scenario of a scene for MetaDrive and ScenarioNet, of plain containers, numbers, texts and arrays.

    Steps are the scene's own frames (12 Hz). Positions are box centres, the ego's too; where an object is not there its
    numbers are zero. ``dynamic_map_states`` are none; ``adversaries`` in the metadata names tracks, and each track's
    own says ``is_adversary``.
    """
    scene = made.scene
    seconds = scene.seconds
    ego = _ego_name(scene)
    tracks = {ego: _ego_track(scene, ego, seconds)}
    for index, name in enumerate(scene.agents.ids):
        tracks[name] = _track(scene, index, seconds)
    features, own_map = encode_map(scene.road_map)
    return {
        "id": scene.name,
        "version": f"{DATASET} {VERSION}",
        "length": len(seconds),
        "tracks": tracks,
        "dynamic_map_states": {},
        "map_features": features,
        "metadata": {
            "id": scene.name,
            "scenario_id": scene.name,
            "dataset": DATASET,
            "metadrive_processed": False,
            "coordinate": "right-handed",
            "map": scene.road_map.location,
            "date": scene.date,
            "scenario_token": scene.token,
            "sample_rate": 1.0 / FRAME_HZ,
            "ts": seconds,
            "sdc_id": ego,
            ADVERSARIES: list(scene.adversaries),
            **_summarise_tracks(tracks, len(features)),
            OWN: _build_extra_metadata(made) | {"map": own_map},
        },
    }


def _ego_name(scene: Scene) -> str:
    name = "ego"
    while name in scene.agents.ids:
        name = f"{name}_"
    return name


def _ego_track(scene: Scene, name: str, seconds: Floats) -> dict[str, Any]:
    size = np.array([EGO_LENGTH_M, EGO_BODY_WIDTH_M, EGO_HEIGHT_M])
    there = np.ones(len(seconds), np.bool_)
    state = _build_state(compute_ego_center(scene.ego), scene.ego.yaw, size, there, seconds)
    return {
        "type": "VEHICLE",
        "state": state,
        "metadata": _build_metadata(name, "vehicle.car", len(seconds), adversary=False),
    }


def _track(scene: Scene, index: int, seconds: Floats) -> dict[str, Any]:
    agents = scene.agents
    name, category = agents.ids[index], agents.categories[index]
    position, yaw, size, valid = (part[index] for part in (agents.position, agents.yaw, agents.size, agents.valid))
    annotated = {field: getattr(scene.annotations, field)[index] for field in Annotations.__dataclass_fields__}
    annotated["attribute"] = [str(text) for text in annotated["attribute"]]
    own = {"annotations": annotated, "digest": hash_track(position, yaw, size, valid), "category": category}
    return {
        "type": _TYPES.get(category) or _KINDS.get(category.partition(".")[0], "OTHER"),
        "state": _build_state(position, yaw, size, valid, seconds),
        "metadata": {**_build_metadata(name, category, len(seconds), adversary=name in scene.adversaries), OWN: own},
    }


def _build_metadata(name: str, category: str, length: int, *, adversary: bool) -> dict[str, Any]:
    return {
        "track_length": length,
        "type": category,
        "object_id": name,
        "original_id": name,
        IS_ADVERSARY: adversary,
    }


def _build_state(position: Floats, yaw: Floats, size: Floats, valid: Bools, seconds: Floats) -> dict[str, Any]:
    there = np.asarray(valid, np.bool_)
    sides = {name: np.where(there, side, 0.0) for name, side in zip(("length", "width", "height"), size, strict=True)}
    return {
        "position": np.where(there[:, None], position, 0.0),
        "heading": np.where(there, yaw, 0.0),
        "velocity": _velocity(position, there, seconds),
        "valid": there.astype(np.float64),
        **sides,
    }


def _velocity(position: Floats, there: Bools, seconds: Floats) -> Floats:
    """(T, 2) m/s to the next step, at the last one of each stretch from the one before; zero where nothing is known."""
    steps = np.diff(position[:, :2], axis=0) / np.diff(seconds)[:, None]
    known = there[:-1] & there[1:]
    velocity = np.zeros((len(there), 2))
    velocity[1:][known] = steps[known]
    velocity[:-1][known] = steps[known]
    return velocity


def _build_extra_metadata(exchanged: ExchangedScene) -> dict[str, Any]:
    """Facts that ScenarioNet has no place for; `benchmark.datasets.scenarionet_roundtrip` reads them."""
    scene = exchanged.scene
    sweeps = scene.sweep_poses
    return {
        "schema": SCHEMA,
        "name": scene.name,
        "source_scene": exchanged.source_scene,
        "report": canonical_json(dict(exchanged.report)),
        "token": scene.token,
        "description": scene.description,
        "log": scene.log,
        "vehicle": scene.vehicle,
        "date": scene.date,
        "timestamps_us": scene.timestamps_us,
        "keyframes": scene.keyframes,
        "ego_position": scene.ego.position,
        "ego_rotation": scene.ego.rotation,
        "cameras": [
            {
                "name": camera.name,
                "translation": camera.translation,
                "rotation": camera.rotation,
                "intrinsic": camera.intrinsic,
                "size": [camera.width, camera.height],
            }
            for camera in scene.cameras
        ],
        "lidar": {"translation": scene.lidar.translation, "rotation": scene.lidar.rotation},
        "sweeps": None if sweeps is None else {"lidar": sweeps.lidar, "cameras": sweeps.cameras},
    }


def _summarise_tracks(tracks: dict[str, dict[str, Any]], features: int) -> dict[str, Any]:
    """Summaries that ScenarioNet's filters look at."""
    objects = {name: _summarise_track(name, track) for name, track in tracks.items()}
    types = sorted({summary["type"] for summary in objects.values()})
    moving = [summary for summary in objects.values() if summary["moving_distance"] > _LEAST_MOVED_M]

    def each(summaries: Any) -> dict[str, int]:
        present_types = [summary["type"] for summary in summaries]
        return {kind: present_types.count(kind) for kind in types if kind in present_types}

    return {
        "object_summary": objects,
        "number_summary": {
            "num_objects": len(objects),
            # ScenarioNet has a set here; the order of a pickled set changes from run to run.
            "object_types": types,
            "num_objects_each_type": each(objects.values()),
            "num_moving_objects": len(moving),
            "num_moving_objects_each_type": each(moving),
            "num_traffic_lights": 0,
            "num_traffic_light_types": [],
            "num_traffic_light_each_step": {},
            "num_map_features": features,
            "map_height_diff": 0.0,
        },
    }


def _summarise_track(name: str, track: dict[str, Any]) -> dict[str, Any]:
    there = track["state"]["valid"] > 0
    path = track["state"]["position"][there, :2]
    first = int(there.argmax())
    absent = np.flatnonzero(~there[first:])
    return {
        "type": track["type"],
        "object_id": name,
        "track_length": len(there),
        "moving_distance": float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()),
        "valid_length": int(there.sum()),
        "continuous_valid_length": int(absent[0]) if len(absent) else len(there) - first,
    }


SUMMARY: Final = "dataset_summary.pkl"
MAPPING: Final = "dataset_mapping.pkl"
"""Index files that ScenarioNet and MetaDrive read in a folder: metadata by file, and the folder of each file."""
_PROTOCOL: Final = 4
"""Of pickles, as ScenarioNet writes them; Python 3.4 reads it."""


@dataclass(frozen=True, slots=True)
class ExportedScene:
    """One file: its path, the scene's name in it, and who is adversarial."""

    path: Path
    scene: str
    adversaries: tuple[str, ...]


def read_exchange_scene(dataset: DataSet, name: str) -> ExchangedScene:
    """A scene with its recorded scene and the report of its making, where the data set has them.

    In variant roots (``v0/scene-0061``) the name becomes one for a file (``scene-0061-v0``), and identifiers of objects
    become other ones, since variants share theirs.
    """
    scene = dataset.scene(name)
    require_two_hz(scene, "an exchanged file")
    origin = ((dataset.provenance() or {}).get("scenes") or {}).get(name, {})
    report = origin.get("report") if isinstance(origin, dict) else None
    facts = dataset.scene_facts([name])[name]
    if "/" in name:
        variant, _, inner = name.partition("/")
        scene = _rename_as_variant(scene, f"{inner}-{variant}")
    return ExchangedScene(scene, facts.source or scene.name, report if isinstance(report, dict) else {})


def _rename_as_variant(scene: Scene, name: str) -> Scene:
    """The scene of a variant root as it would be called in one root of all variants."""
    called = {identifier: make_token("instance", name, identifier) for identifier in scene.agents.ids}
    return replace(
        scene,
        name=name,
        agents=replace(scene.agents, ids=tuple(called.values())),
        adversaries=tuple(called[identifier] for identifier in scene.adversaries),
    )


def export_scenarionet(dataset: DataSet, names: Sequence[str], to: Path, *, workers: int) -> tuple[ExportedScene, ...]:
    """Write scenes as ScenarioNet files, which MetaDrive and ScenarioNet open.

    Args:
        dataset: The data set.
        names: Its scenes.
        to: Folder; gets a file a scene, ``dataset_summary.pkl`` and ``dataset_mapping.pkl``.
        workers: Number of processes; the bytes are the same with any.

    Returns:
        The written files.

    Raises:
        InputError: If a scene is broken, or the folder holds other scenarios or cannot be written.
    """
    with lock_folder(to):
        files = export_scenes(names, to, "pkl", partial(_write_scenario, dataset, to), workers=workers)
        summary = {written.path.name: metadata for written, metadata in files}
        write_bytes(to / SUMMARY, pickle_plain(summary))
        write_bytes(to / MAPPING, pickle_plain(dict.fromkeys(summary, "")))
    return tuple(written for written, _ in files)


def export_scenes(
    names: Sequence[str], to: Path, ending: str, write: Callable[[str], Any], *, workers: int
) -> list[Any]:
    """Results of ``write``, in the order of the names, of a file a scene in a folder that holds no others."""
    if not names:
        raise InputError("there is no scene to export; name one with --scenes, or leave --scenes and --limit out")
    own = {scene_file(to, name, ending).name for name in names}
    others = sorted(path.name for path in to.glob(f"*.{ending}") if path.name not in {*own, SUMMARY, MAPPING})
    if others:
        raise InputError(f"{to} holds {others[0]}, which is not part of this export; choose an empty folder with --to")
    return list(map_ordered(write, names, workers=workers, label="exporting scenes", count=CountedUnits("scene")))


def scene_file(to: Path, name: str, ending: str) -> Path:
    """The file of a scene in an export."""
    variant, slash, inner = name.partition("/")
    called = f"{inner}-{variant}" if slash else name
    return to / (f"sd_{DATASET}_{VERSION}_{called}.pkl" if ending == "pkl" else f"{called}.{ending}")


def _write_scenario(dataset: DataSet, to: Path, name: str) -> tuple[ExportedScene, dict[str, Any]]:
    exchanged = read_exchange_scene(dataset, name)
    scenario = build_scenario(exchanged)
    path = scene_file(to, name, "pkl")
    write_bytes(path, pickle_plain(scenario))
    metadata = {key: value for key, value in scenario["metadata"].items() if key != OWN}
    return ExportedScene(path, exchanged.scene.name, exchanged.scene.adversaries), metadata


def pickle_plain(value: Any) -> bytes:
    """Pickle plain containers, texts, numbers and arrays: the same bytes for the same values, importing numpy alone."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, _PROTOCOL)
    # Without references: whether two equal strings are one object depends on how they were created.
    pickler.fast = True
    pickler.dump(_to_plain(value))
    return stream.getvalue()


def _to_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _to_plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_to_plain(item) for item in value]
    if isinstance(value, tuple):
        return tuple(_to_plain(item) for item in value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return np.ascontiguousarray(value)
    return value
