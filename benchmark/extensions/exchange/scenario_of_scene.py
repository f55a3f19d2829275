"""A scene as a ScenarioNet scenario: the dictionary that MetaDrive and ScenarioNet read."""

from typing import Any, Final

import numpy as np

from benchmark.constants import EGO_BODY_WIDTH_M, EGO_HEIGHT_M, EGO_LENGTH_M, FRAME_HZ, VERSION
from benchmark.datasets.own_words import (
    ADVERSARIES,
    DATASET,
    IS_ADVERSARY,
    OWN,
    SCHEMA,
    Exchanged,
    ego_center,
    track_digest,
)
from benchmark.datasets.scenario_map import features_of_map
from benchmark.geometry import Bools, Floats
from benchmark.machine.storage import canonical_json
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
"""What counts as moving in ScenarioNet's summaries."""


def scenario_of(made: Exchanged) -> Scenario:
    """A scene for MetaDrive and ScenarioNet.

    Steps are the scene's own frames (12 Hz). Positions are box centres, the ego's too; where an object is not there its
    numbers are zero. All values are plain containers, numbers, texts and arrays.

    Returns:
        The scenario: ``id``, ``version``, ``length``, ``tracks``, ``dynamic_map_states`` (none), ``map_features`` and
        ``metadata``. The metadata's ``adversaries`` names tracks, and each track's own says ``is_adversary``.
    """
    scene = made.scene
    seconds = scene.seconds
    ego = _ego_name(scene)
    tracks = {ego: _ego_track(scene, ego, seconds)}
    for index, name in enumerate(scene.agents.ids):
        tracks[name] = _track(scene, index, seconds)
    features, own_map = features_of_map(scene.road_map)
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
            **_summaries(tracks, len(features)),
            OWN: _own(made) | {"map": own_map},
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
    state = _state(ego_center(scene.ego), scene.ego.yaw, size, there, seconds)
    return {"type": "VEHICLE", "state": state, "metadata": _about(name, "vehicle.car", len(seconds), adversary=False)}


def _track(scene: Scene, index: int, seconds: Floats) -> dict[str, Any]:
    agents = scene.agents
    name, category = agents.ids[index], agents.categories[index]
    position, yaw, size, valid = (part[index] for part in (agents.position, agents.yaw, agents.size, agents.valid))
    annotated = {field: getattr(scene.annotations, field)[index] for field in Annotations.__dataclass_fields__}
    annotated["attribute"] = [str(text) for text in annotated["attribute"]]
    own = {"annotations": annotated, "digest": track_digest(position, yaw, size, valid), "category": category}
    return {
        "type": _TYPES.get(category) or _KINDS.get(category.partition(".")[0], "OTHER"),
        "state": _state(position, yaw, size, valid, seconds),
        "metadata": {**_about(name, category, len(seconds), adversary=name in scene.adversaries), OWN: own},
    }


def _about(name: str, category: str, length: int, *, adversary: bool) -> dict[str, Any]:
    return {
        "track_length": length,
        "type": category,
        "object_id": name,
        "original_id": name,
        IS_ADVERSARY: adversary,
    }


def _state(position: Floats, yaw: Floats, size: Floats, valid: Bools, seconds: Floats) -> dict[str, Any]:
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


def _own(made: Exchanged) -> dict[str, Any]:
    """Facts that ScenarioNet has no place for; `benchmark.datasets.scene_of_own` reads them."""
    scene = made.scene
    sweeps = scene.sweep_poses
    return {
        "schema": SCHEMA,
        "name": scene.name,
        "source_scene": made.source_scene,
        "report": canonical_json(dict(made.report)),
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


def _summaries(tracks: dict[str, dict[str, Any]], features: int) -> dict[str, Any]:
    """Summaries that ScenarioNet's filters look at."""
    objects = {name: _summary(name, track) for name, track in tracks.items()}
    types = sorted({summary["type"] for summary in objects.values()})
    moving = [summary for summary in objects.values() if summary["moving_distance"] > _LEAST_MOVED_M]

    def each(summaries: Any) -> dict[str, int]:
        found = [summary["type"] for summary in summaries]
        return {kind: found.count(kind) for kind in types if kind in found}

    return {
        "object_summary": objects,
        "number_summary": {
            "num_objects": len(objects),
            # ScenarioNet has a set here, whose order in a pickle changes from run to run.
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


def _summary(name: str, track: dict[str, Any]) -> dict[str, Any]:
    there = track["state"]["valid"] > 0
    path = track["state"]["position"][there, :2]
    first = int(there.argmax())
    gone = np.flatnonzero(~there[first:])
    return {
        "type": track["type"],
        "object_id": name,
        "track_length": len(there),
        "moving_distance": float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()),
        "valid_length": int(there.sum()),
        "continuous_valid_length": int(gone[0]) if len(gone) else len(there) - first,
    }
