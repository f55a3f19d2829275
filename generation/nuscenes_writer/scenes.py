"""Writing one scene: its files first, the fragment with its table rows last."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import LIDAR_NAME
from benchmark.errors import InputError
from benchmark.machine.progress import CountedUnits, track_progress
from benchmark.machine.storage import (
    canonical_json,
    content_key,
    read_cached_json,
    read_json,
    write_bytes,
    write_json,
    writing_to,
)
from benchmark.records.seed_splits import RECORDED_EGO
from benchmark.road_map import RoadMap
from benchmark.scene import Camera, Scene
from generation.nuscenes_writer.can_bus import build_can_bus_files
from generation.nuscenes_writer.numbering import SceneNumber
from generation.nuscenes_writer.plan import DataSetPlan, SceneNames, compute_scene_key, require_own_root
from generation.nuscenes_writer.road_maps import pack_road_map
from generation.nuscenes_writer.rows import SensorChannel, build_channels, build_scene_tables, list_used_labels
from generation.nuscenes_writer.vocabulary import LabelVocabulary
from generation.render.contract import CuttingRenderer, Images, RecordedImages, SweepRenderer

FRAGMENT_SCHEMA = 1
UNDRAWN = "undrawn"
"""Stands in the fragment of a scene whose images between samples are not drawn yet, or `_NOT_ONE`."""
_NOT_ONE = "not one"

NUMBER = "number"
"""In the fragment of a scene whose name and times in the tables are not its recording's (`SceneNumber`)."""


class WrittenScene(NamedTuple):
    """A scene of a data set on disk: its content key for `finish_data_set`, and whether there was something to do."""

    key: str
    made: bool

    @property
    def kept(self) -> bool:
        """Whether nothing had to be done."""
        return not self.made


def write_scene(
    plan: DataSetPlan,
    scene: Scene,
    *,
    name: str,
    source_scene: str,
    report: dict[str, Any],
    variant: int = 0,
) -> str:
    """`write_scene_if_missing`, its content key alone."""
    return write_scene_if_missing(plan, scene, name=name, source_scene=source_scene, report=report, variant=variant).key


def write_scene_if_missing(
    plan: DataSetPlan,
    scene: Scene,
    *,
    name: str,
    source_scene: str,
    report: dict[str, Any],
    variant: int = 0,
    identity: str | None = None,
    number: SceneNumber | None = None,
) -> WrittenScene:
    """Render and write one scene, unless it is complete; gives the content key, and whether there was something to do.

    Safe to call for different scenes in different processes, and to kill at any moment: the same call then goes on and
    ends with the same bytes. A `CuttingRenderer` may leave the scene's end out. ``report`` is plain JSON for
    ``challenger.json``, ``variant`` the number of the root in the ``per-variant`` layout. ``identity`` is the source of
    tokens; the scene's motion by default, whose last bits depend on the processor. ``number`` is its name in the tables
    and the shift of its times; a scene that was written under another one is renamed, not drawn again. An `InputError`
    refuses scenes as `require_valid`, names that are no file names, and targets with another writer's data set.
    """
    require_valid(scene)
    if isinstance(plan.renderer, CuttingRenderer):
        scene = plan.renderer.cut(scene)
    require_own_root(plan, variant)
    names = SceneNames.of(
        plan, scene, name=name, variant=variant, source_scene=source_scene, identity=identity, number=number
    )
    cameras = () if plan.renderer is None else plan.renderer.cameras(scene)
    map_key = _store_map(plan, scene.road_map)
    labels = {"name": name, "variant": variant, "source_scene": source_scene, "report": report}
    called = labels if identity is None else {**labels, "identity": identity}
    key = compute_scene_key(plan, scene, cameras, map_key=map_key, labels=called)
    if is_complete(plan, key, variant=variant, name=name, number=number):
        return WrittenScene(key, made=False)
    shift_us = 0 if number is None else number.shift_us
    timed = replace(scene, timestamps_us=scene.timestamps_us + shift_us)
    frames = range(len(scene.timestamps_us)) if plan.frames == "all" else scene.keyframes.tolist()
    tracks = plan.renderer.camera_tracks(scene) if isinstance(plan.renderer, SweepRenderer) else {}
    recorded = plan.renderer.channels(scene) if isinstance(plan.renderer, RecordedImages) else None
    channels = build_channels(cameras, tracks, recorded)
    vocabulary = LabelVocabulary.of(plan.source)
    tables = build_scene_tables(names, vocabulary, timed, channels, frames)
    # What the recorded car measured is not what a driven ego would have measured.
    measured = plan.source if plan.ego == RECORDED_EGO else None
    messages = build_can_bus_files(timed, name=name, source=measured, source_scene=source_scene, shift_us=shift_us)
    sensor_files = _list_sensor_files(plan, tables["sample_data"])
    existing_pictures = _keep_pictures(plan, key, variant, name, sensor_files)
    placed = (_place(path, name, names.row) for path in messages)
    claim_files(plan, key, variant, name, {*sensor_files, *messages, *placed})
    root = plan.data_root(variant)
    for path, data in messages.items():
        write_bytes(root / path, data, durable=False)
    _write_lidar_files(root, names, timed, channels, frames)
    _write_images(plan, root, names, (scene, timed), channels, frames, existing_pictures)
    if plan.pictures == "keyframes":
        sensor_files = [path for path in sensor_files if not _is_sweep_image(path)]
    if plan.pictures == "none":
        sensor_files = [path for path in sensor_files if not _is_image(path)]
    fragment = {
        "schema": FRAGMENT_SCHEMA,
        "key": key,
        **labels,
        "adversaries": [names.instance(agent) for agent in scene.agents.ids if agent in scene.adversaries],
        "location": scene.road_map.location,
        "map": map_key,
        "log": vocabulary.get_log_row(scene),
        "labels": list_used_labels(vocabulary, scene),
        "instances": [row["token"] for row in tables["instance"]],
        "files": {path: (root / path).stat().st_size for path in sorted([*sensor_files, *messages])},
        "renderer": _build_renderer_row(plan, cameras),
        **({} if plan.pictures == "all" else {UNDRAWN: _NOT_ONE if plan.pictures == "none" else True}),
        **({NUMBER: asdict(number)} if number is not None else {}),
        "tables": {table: ",\n".join(map(canonical_json, rows)) for table, rows in tables.items()},
    }
    plan.fragments.put(key, fragment)
    return WrittenScene(key, made=True)


def is_complete(plan: DataSetPlan, key: str, *, variant: int, name: str, number: SceneNumber | None = None) -> bool:
    """Whether a scene's fragment, claim and files are all there, the files in the size they were written."""
    fragment = _read_claimed_fragment(plan, key, variant=variant, name=name)
    if fragment is None or (UNDRAWN in fragment and plan.pictures == "all"):
        return False
    if fragment.get(UNDRAWN) == _NOT_ONE and plan.pictures != "none":
        return False
    if fragment.get(NUMBER) != (None if number is None else asdict(number)):
        return False
    return len(_find_whole_files(plan.data_root(variant), fragment)) == len(fragment["files"])


def _read_claimed_fragment(plan: DataSetPlan, key: str, *, variant: int, name: str) -> dict[str, Any] | None:
    claim = read_state(plan.claim_path(variant, name))
    return None if claim is None or claim["key"] != key else read_stored_fragment(plan, key)


def _find_whole_files(root: Path, fragment: dict[str, Any]) -> frozenset[str]:
    """Which files of a fragment are there, in the size they were written."""
    whole = set()
    for path, size in fragment["files"].items():
        places = (root / path, root / place_file(fragment, path))
        if any(place.is_file() and place.stat().st_size == size for place in places):
            whole.add(path)
    return frozenset(whole)


def place_file(fragment: dict[str, Any], path: str) -> str:
    """Where a file of a written scene is in the finished root: the CAN bus under the scene's name in the tables.

    Numbers change hands between scenes; until a root is finished, all files have names that are of one scene alone.
    """
    return _place(path, fragment["name"], fragment.get(NUMBER, fragment)["name"])


def _place(path: str, name: str, row: str) -> str:
    own = f"can_bus/{name}_"
    return f"can_bus/{row}_{path.removeprefix(own)}" if path.startswith(own) else path


def _keep_pictures(plan: DataSetPlan, key: str, variant: int, name: str, files: Sequence[str]) -> frozenset[str]:
    """Images among ``files`` that are not drawn again, in the order of `_list_sensor_files`.

    Those of a scene whose other images are drawn later, and those that it had under another number, which are renamed.
    """
    fragment = _read_claimed_fragment(plan, key, variant=variant, name=name)
    if fragment is None:
        return frozenset()
    root, rows = plan.data_root(variant), json.loads(f"[{fragment['tables']['sample_data']}]")
    before = _list_sensor_files(plan, rows)
    if before == list(files):
        here = _find_whole_files(root, fragment) if UNDRAWN in fragment else frozenset()
        return frozenset(path for path in here if _is_image(path))
    # Where times overlap, a new name may be the old one of another frame.
    if set(before) & set(files):
        return frozenset()
    path = plan.claim_path(variant, name)
    claim = read_json(path)
    write_json(path, {**claim, "files": sorted({*claim["files"], *files})}, indent=None)
    kept = set()
    for old, new in zip(before, files, strict=True):
        size = fragment["files"].get(old)
        places = (path for path in (root / old, root / new) if path.is_file() and path.stat().st_size == size)
        if _is_image(new) and (place := next(places, None)) is not None:
            with writing_to(place):
                place.replace(root / new)
            kept.add(new)
    return frozenset(kept)


def _list_sensor_files(plan: DataSetPlan, rows: Sequence[dict[str, Any]]) -> list[str]:
    """Files of rows of ``sample_data``, those without loss last."""
    files = [row["filename"] for row in rows]
    return files + [_lossless_name(path) for path in files if plan.lossless and path.endswith(".jpg")]


def _is_image(path: str) -> bool:
    return path.endswith((".jpg", ".png"))


def _is_sweep_image(path: str) -> bool:
    return path.startswith("sweeps/") and _is_image(path)


def read_stored_fragment(plan: DataSetPlan, key: str) -> dict[str, Any] | None:
    """The fragment of a scene, or ``None`` where there is none or it is damaged: the scene is written again."""
    return _check_state(plan.fragments.get(key))


def read_state(path: Path) -> dict[str, Any] | None:
    """A claim, or ``None`` where there is none or it is damaged: what it stood for is written again."""
    return _check_state(read_cached_json(path))


def _check_state(value: Any) -> dict[str, Any] | None:
    if not isinstance(value, dict) or not {"key", "name", "variant", "files"} <= value.keys():
        return None
    typed = isinstance(value["key"], str) and isinstance(value["name"], str) and type(value["variant"]) is int
    listed = isinstance(value["files"], list | dict) and all(map(_is_inside_root, value["files"]))
    return value if typed and listed else None


def _is_inside_root(path: Any) -> bool:
    """Whether a stored path names something below the data root: files that claims name are removed."""
    return isinstance(path, str) and not Path(path).is_absolute() and ".." not in Path(path).parts


def claim_files(plan: DataSetPlan, key: str, variant: int, name: str, files: Iterable[str]) -> None:
    """Say which files, paths below the data root, are about to be written, after removing those of the same name."""
    path = plan.claim_path(variant, name)
    claim: dict[str, Any] = {"key": key, "variant": variant, "name": name, "files": sorted(files)}
    earlier = read_state(path)
    if earlier == claim:
        return
    if earlier is not None:
        release_claim(plan, earlier, frozenset(claim["files"]))
    write_json(path, claim, indent=None)


def release_claim(plan: DataSetPlan, claim: dict[str, Any], keep: frozenset[str]) -> None:
    """Remove the fragment and files that a claim stands for. Those of ``keep`` stay."""
    root = plan.data_root(claim["variant"])
    with writing_to(root):
        # The fragment goes first: without it the scene is unfinished and the rest is written again.
        plan.fragments.path(claim["key"]).unlink(missing_ok=True)
        for path in claim["files"]:
            if path not in keep:
                (root / path).unlink(missing_ok=True)


def require_valid(scene: Scene) -> None:
    """Refuse a scene whose rows would be wrong: it needs keyframes, rising times, finite poses and positive sizes."""
    if not len(scene.keyframes):
        raise InputError(f"{scene.name} has no keyframes to write; leave it out")
    if not (np.diff(scene.timestamps_us) > 0).all() or not (np.diff(scene.keyframes) > 0).all():
        raise InputError(f"{scene.name}: the frame times do not increase; repair the recording or leave it out")
    known = scene.annotations.valid
    checked = {
        "ego positions": scene.ego.position,
        "ego rotations": scene.ego.rotation,
        "annotated positions": scene.annotations.position[known],
        "annotated rotations": scene.annotations.rotation[known],
        "annotated sizes": scene.annotations.size[known],
    }
    for quantity, values in checked.items():
        if not np.isfinite(values).all():
            raise InputError(f"{scene.name}: the {quantity} hold NaN or infinity; repair the recording or leave it out")
    if (checked["annotated sizes"] <= 0).any():
        raise InputError(f"{scene.name}: an annotated size is not positive; repair the recording or leave it out")


def _store_map(plan: DataSetPlan, road_map: RoadMap) -> str:
    """Keep a road map for `finish_data_set`; scenes with the same map share the file."""
    # Maps of a source are copied whole.
    packed = pack_road_map(road_map if plan.source is None else replace(road_map, stop_line_types={}))
    key = content_key(packed)
    if read_cached_json(plan.map_path(key)) != packed:
        write_json(plan.map_path(key), packed, indent=None)
    return key


def _build_file_path(names: SceneNames, scene: Scene, channel: SensorChannel, frame: int) -> str:
    timestamp, is_keyframe = channel.time_us(scene, frame), bool((scene.keyframes == frame).any())
    return names.file(channel.name, timestamp, is_keyframe=is_keyframe, extension=channel.extension)


def _write_lidar_files(
    root: Path, names: SceneNames, scene: Scene, channels: Sequence[SensorChannel], frames: Sequence[int]
) -> None:
    lidar = next(channel for channel in channels if channel.name == LIDAR_NAME)
    for frame in frames:
        write_bytes(root / _build_file_path(names, scene, lidar, frame), b"", durable=False)


def _write_images(
    plan: DataSetPlan,
    root: Path,
    names: SceneNames,
    scenes: tuple[Scene, Scene],
    channels: Sequence[SensorChannel],
    frames: Sequence[int],
    existing_pictures: frozenset[str],
) -> None:
    """Draw and write the images that a plan wants of a scene, as recorded and as timed, and that are not there."""
    scene, timed = scenes
    cameras = [channel for channel in channels if channel.camera is not None]
    if plan.renderer is None or not cameras or plan.pictures == "none":
        return
    wanted = frames if plan.pictures == "all" else scene.keyframes.tolist()
    if isinstance(plan.renderer, RecordedImages):
        by_name = {channel.name: channel for channel in cameras}
        for name, frame, data in plan.renderer.files(scene, wanted):
            write_bytes(root / _build_file_path(names, timed, by_name[name], frame), data, durable=False)
        return
    open_frames = [
        frame
        for frame in wanted
        if any(_build_file_path(names, timed, one, frame) not in existing_pictures for one in cameras)
    ]
    drawn = plan.renderer.render(scene, open_frames)
    rendered = track_progress(drawn, total=len(open_frames), label=scene.name, count=CountedUnits("frame"))
    for frame, images in zip(open_frames, rendered, strict=True):
        for channel in cameras:
            path, image = root / _build_file_path(names, timed, channel, frame), _check_image(channel, images)
            if plan.lossless:
                write_bytes(path.with_name(_lossless_name(path.name)), _encode_image(image, ".png", []), durable=False)
            write_bytes(path, encode_jpeg(image, plan.jpeg_quality), durable=False)


def _lossless_name(jpeg: str) -> str:
    return jpeg.removesuffix(".jpg") + ".png"


def _check_image(channel: SensorChannel, images: Images) -> NDArray[np.uint8]:
    camera, image = channel.camera, images[channel.name]
    assert camera is not None
    if image.shape != (camera.height, camera.width, 3) or image.dtype != np.uint8:
        raise ValueError(f"the renderer gave {image.dtype} {image.shape} for {camera.width} x {camera.height} pixels")
    return image


def encode_jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    """A picture as it is written: (height, width, 3) RGB, quality 1 to 100."""
    return _encode_image(image, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality])


def _encode_image(image: NDArray[np.uint8], extension: str, options: Sequence[int]) -> bytes:
    done, data = cv2.imencode(extension, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    assert done, "OpenCV refused to encode an image that it accepts by type"
    return bytes(data.tobytes())


def _build_renderer_row(plan: DataSetPlan, cameras: Sequence[Camera]) -> dict[str, Any] | None:
    if plan.renderer is None:
        return None
    width, height = (cameras[0].width, cameras[0].height) if cameras else (0, 0)
    return {"name": plan.renderer.name, "version": plan.renderer.version, "width": width, "height": height}
