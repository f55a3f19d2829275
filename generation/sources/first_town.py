"""Version 1 of the embedded town: ten recordings as packed tracks and maps, since the code that made them has changed.

The file holds what commit 3657e693 made with seed 0: whole micrometres and microradians as second differences, and
road maps as `pack_road_map` writes them. All else is computed as it was then.
"""

import json
import lzma
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.machine.storage import content_key, lock_folder, read_cached_json, write_json
from benchmark.machine.workers import LocalProcesses
from benchmark.machine.workspace import EMBEDDED, is_finished
from benchmark.road_map import RoadMap
from benchmark.runs.units import run_units
from benchmark.scene import Agents, Annotations, EgoTrack, Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.plan import SHARED_TABLES_VERSION, STATE_FOLDER
from generation.nuscenes_writer.road_maps import unpack_road_map
from generation.nuscenes_writer.scenes import WrittenScene, write_scene_if_missing
from generation.render.schematic import SchematicRenderer
from generation.sources.rig import build_default_cameras, build_default_lidar

_FILE: Final = Path(__file__).parent / "assets" / "town-1.json.xz"
_STEPS_PER_UNIT: Final = 1_000_000
_SCENES: Final = 10
_WIDTH, _HEIGHT = 448, 256


def read_first_scene(index: int) -> Scene:
    """Recording ``index`` of ten, 20 s at 12 Hz, to the bit as the town's code made it."""
    packed = _read_file()["scenes"][index]
    valid = _read_digits(packed["valid"]).astype(np.bool_)
    frames = valid.shape[1]
    keyframes = np.arange(0, frames, FRAMES_PER_KEYFRAME, dtype=np.int64)
    ego_x, ego_y, ego_yaw = _add_up(packed["ego"])
    ego = EgoTrack(np.column_stack([ego_x, ego_y, np.zeros(frames)]), quaternion_from_yaw(ego_yaw))
    size = np.array(packed["size"], np.float64)
    x, y, yaw = np.moveaxis(_add_up(packed["tracks"]), 1, 0)
    height = np.broadcast_to(np.round(size[:, 2:] / 2, 6), yaw.shape)
    agents = Agents(
        ids=tuple(packed["ids"]),
        categories=tuple(packed["categories"]),
        position=np.stack([x, y, height], axis=-1),
        yaw=np.ascontiguousarray(yaw),
        size=size,
        valid=valid,
    )
    return Scene(
        name=packed["name"],
        token=packed["token"],
        description=packed["description"],
        log=packed["log"],
        vehicle="n000",
        date=packed["date"],
        timestamps_us=packed["first_us"] + np.round(np.arange(frames) * 1e6 / FRAME_HZ).astype(np.int64),
        keyframes=keyframes,
        ego=ego,
        agents=agents,
        annotations=Annotations(
            position=agents.position[:, keyframes],
            rotation=quaternion_from_yaw(agents.yaw[:, keyframes]),
            size=np.repeat(size[:, None], len(keyframes), axis=1),
            valid=valid[:, keyframes],
            attribute=np.array(packed["attributes"], np.str_)[_read_digits(packed["attribute"])],
            visibility=_read_digits(packed["visibility"]),
            num_lidar_pts=np.array(packed["lidar"], np.int64),
            num_radar_pts=np.array(packed["radar"], np.int64),
        ),
        cameras=build_default_cameras(),
        lidar=build_default_lidar(),
        road_map=_read_map(packed["location"]),
    )


def format_first_folder() -> str:
    """Folder in the cache, called as when the town was made: what an earlier version built there is taken."""
    return f"{EMBEDDED}-{content_key(*_list_drawn(), SHARED_TABLES_VERSION)[:12]}"


def format_first_drawn() -> str:
    """A name for all that a measured number depends on, as `generation.sources.mini.TownSettings.drawn_name`."""
    return f"{EMBEDDED}-{content_key(*_list_drawn())[:12]}"


def _list_drawn() -> tuple[object, ...]:
    settings = {"val_scenes": _SCENES, "train_scenes": 0, "seed": 0, "width": _WIDTH, "height": _HEIGHT}
    return settings | {"frames": "all", "images": True}, "1", SchematicRenderer(_WIDTH, _HEIGHT).version


def build_first_town(root: Path, pictures: Literal["all", "keyframes"], *, workers: int) -> Path:
    """Write the town as `generation.sources.mini.build_town_data_set` does the current one; gives ``root``."""
    note, whole = root / STATE_FOLDER / "town.json", {"key": f"{root.name}-{format_first_folder()[-12:]}"}
    made_of = whole if pictures == "all" else {**whole, "pictures": pictures}
    if is_finished(root) and read_cached_json(note) in (made_of, whole):
        return root
    renderer = SchematicRenderer(_WIDTH, _HEIGHT)
    plan = DataSetPlan(
        root=root, version="v1.0-mini", split="val", renderer=renderer, frames="all", pictures=pictures, source=None
    )
    with lock_folder(root):
        job, where = partial(_write_one, plan), LocalProcesses(workers)
        written = list(run_units(job, list(range(_SCENES)), where, total=_SCENES, label="building the town"))
        finish_data_set(plan, [scene.key for scene in written])
        write_json(note, made_of)
    return root


def _write_one(plan: DataSetPlan, index: int) -> WrittenScene:
    scene = read_first_scene(index)
    return write_scene_if_missing(plan, scene, name=scene.name, source_scene=scene.name, report={})


@lru_cache(maxsize=1)
def _read_file() -> dict[str, Any]:
    packed: dict[str, Any] = json.loads(lzma.decompress(_FILE.read_bytes()))
    return packed


@lru_cache(maxsize=2)
def _read_map(location: str) -> RoadMap:
    return unpack_road_map(_read_file()["maps"][location])


def _add_up(second_differences: list[Any]) -> Floats:
    """Metres or radians along the last axis."""
    steps = np.array(second_differences, np.int64)
    return np.asarray(steps.cumsum(axis=-1).cumsum(axis=-1) / _STEPS_PER_UNIT)


def _read_digits(rows: list[str]) -> NDArray[np.int64]:
    return np.array([[int(digit) for digit in row] for row in rows], np.int64)
