"""A scene in words as nuScenes describes its own: traffic and road, and where and when it was, as far as that is known.

Nothing is guessed: facts missing in the recording are left out. Words for light and weather are read when a scene is
drawn (`benchmark.scene.Conditions`), so they stand here only where the recording has them.
"""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from benchmark.geometry import Floats, to_local, wrap_angle
from benchmark.scene import Scene

_NEAR_M: Final = 50.0
_MOVED_M: Final = 2.0
_BESIDE_M: Final = 12.0
_LANE_M: Final = 3.0
_CROSSING_RAD: Final = np.radians(50.0)
_ALONG_RAD: Final = np.radians(30.0)
_TURN_RAD: Final = np.radians(45.0)
_EVERY_FRAMES: Final = 6
_DENSE, _MANY = 12, 8
_CITIES: Final = {
    "us-nv-las-vegas-strip": "Las Vegas",
    "us-ma-boston": "Boston",
    "us-pa-pittsburgh-hazelwood": "Pittsburgh",
    "sg-one-north": "Singapore",
    "atx": "Austin",
    "dtw": "Detroit",
    "mia": "Miami",
    "pao": "Palo Alto",
    "pit": "Pittsburgh",
    "wdc": "Washington",
}
"""Cities by what nuPlan and Argoverse 2 call them."""
_LIGHTS: Final = {"day": "daytime", "daytime": "daytime", "night": "night", "dawn/dusk": "dusk", "dusk": "dusk"}
_WEATHERS: Final = {"rain": "rain", "rainy": "rain", "sunny": "sunny"}
_NUSCENES_LOG: Final = re.compile(r"n\d{3}-\d{4}-\d{2}-\d{2}-(\d{2})-\d{2}-\d{2}[+-]\d{4}")
_DAY_HOURS, _NIGHT_HOURS = range(8, 17), (20, 21, 22, 23, 0, 1, 2, 3, 4)


def describe_place_and_light(metadata: Mapping[str, Any]) -> list[str]:
    """City, light and weather of a ScenarioNet recording, in words that are known; nuScenes maps name their places."""
    texts = {name: value.strip() for name, value in metadata.items() if isinstance(value, str)}
    words = [_CITIES.get(texts.get("map", "").lower(), ""), _LIGHTS.get(_one_of(texts, "time_of_day", "timeofday"), "")]
    if not words[1]:
        words[1] = _light_at(_one_of(texts, "log_name", "logfile", "log"))
    words.append(_WEATHERS.get(texts.get("weather", "").lower(), ""))
    return [word for word in words if word]


def describe_traffic_and_road(scene: Scene) -> list[str]:
    """Traffic and road of a scene, a few words each; its description is not looked at."""
    return [*_traffic(scene), *_road(scene)]


def join_words(words: list[str]) -> str:
    """Words as one description."""
    text = ", ".join(words)
    return text[:1].upper() + text[1:]


def _one_of(texts: Mapping[str, str], *names: str) -> str:
    return next((texts[name].lower() for name in names if name in texts), "")


def _light_at(log: str) -> str:
    """Light at the hour that a nuScenes log has in its name, in local time; nothing at hours that may be either."""
    match = _NUSCENES_LOG.match(log)
    hour = int(match.group(1)) if match else -1
    return "daytime" if hour in _DAY_HOURS else "night" if hour in _NIGHT_HOURS else ""


def _traffic(scene: Scene) -> list[str]:
    agents, ego = scene.agents, scene.ego.position[:, :2]
    distances = np.linalg.norm(agents.position[..., :2] - ego, axis=-1)
    near = (np.where(agents.valid, distances, np.inf) <= _NEAR_M).any(axis=1)
    counts: dict[str, int] = {}
    for agent in np.flatnonzero(near):
        positions = agents.position[agent, agents.valid[agent], :2]
        moves = float(np.ptp(positions, axis=0).max()) > _MOVED_M
        kind = _kind(agents.categories[agent], moves)
        counts[kind] = counts.get(kind, 0) + 1
    moving = sum(counts.get(kind, 0) for kind in ("car", "truck", "bus", "motorcycle"))
    words = ["dense traffic" if moving >= _DENSE else "some traffic" if moving else "no moving traffic"]
    named = {"truck": "truck", "bus": "bus", "motorcycle": "motorcycle", "bicycle": "bicycle", "parked": "parked cars"}
    words += [word for kind, word in named.items() if counts.get(kind)]
    people = counts.get("pedestrian", 0)
    words += ["many pedestrians" if people >= _MANY else "pedestrians"] if people else []
    return [*words, *(["cones and barriers"] if counts.get("barrier", 0) >= _MANY else [])]


def _kind(category: str, moves: bool) -> str:
    if category.startswith("human."):
        return "pedestrian"
    if category.startswith("movable_object."):
        return "barrier"
    kind = category.split(".")[1] if category.startswith("vehicle.") else ""
    if kind in ("truck", "construction", "trailer", "car", "emergency") and not moves:
        return "parked"
    return {"construction": "truck", "trailer": "truck", "emergency": "car"}.get(kind, kind)


def _road(scene: Scene) -> list[str]:
    pose = scene.ego.pose
    turned = float(np.unwrap(pose[:, 2])[-1] - pose[0, 2])
    stood = float(np.linalg.norm(np.ptp(pose[:, :2], axis=0))) <= _MOVED_M
    points = [_lane_points(lane.centerline) for lane in scene.road_map.lanes.values()]
    lanes = np.concatenate(points) if points else np.zeros((0, 3))
    lanes_beside = [_find_lanes_beside(now, lanes) for now in pose[::_EVERY_FRAMES]]
    crossing = np.mean([crosses for crosses, _ in lanes_beside]) > 0.1
    wide = np.median([count for _, count in lanes_beside]) >= 3
    words = [("multi-lane road", bool(wide)), ("intersection", bool(crossing))]
    words += [("turn left", turned > _TURN_RAD), ("turn right", turned < -_TURN_RAD), ("waiting", stood)]
    crossings = scene.road_map.ped_crossings.values()
    words.append(("crosswalk", any(_is_near(shape.bounds, pose) for shape in crossings)))
    return [word for word, applies in words if applies]


def _lane_points(line: Floats) -> Floats:
    """(M - 1, 3) middles of a lane's pieces, and where they lead."""
    steps = np.diff(line, axis=0)
    return np.column_stack([0.5 * (line[1:] + line[:-1]), np.arctan2(steps[:, 1], steps[:, 0])])


def _find_lanes_beside(pose: Floats, lanes: Floats) -> tuple[bool, int]:
    """Whether a lane crosses the ego's heading near it, and how many lie side by side there."""
    near = lanes[np.abs(lanes[:, :2] - pose[:2]).max(axis=1) <= _BESIDE_M] if len(lanes) else lanes
    if not len(near):
        return False, 0
    angle = np.abs(wrap_angle(near[:, 2] - pose[2]))
    along = np.minimum(angle, np.pi - angle)
    lateral = to_local(near[along <= _ALONG_RAD, :2], pose)[:, 1]
    return bool((along >= _CROSSING_RAD).any()), len(np.unique(np.round(lateral / _LANE_M)))


def _is_near(bounds: tuple[float, float, float, float], pose: Floats) -> bool:
    x_low, y_low, x_high, y_high = bounds
    x, y = pose[:, 0], pose[:, 1]
    return bool(((x >= x_low) & (x <= x_high) & (y >= y_low) & (y <= y_high)).any())
