"""Scenes as MCAP files, one each, and a layout in which Foxglove and Lichtblick show them."""

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from benchmark.constants import VERSION
from benchmark.datasets.roots import DataSet
from benchmark.datasets.scene_facts import find_frozen_split
from benchmark.errors import InputError
from benchmark.extensions.mcap.camera_images import ImageChoice, find_images
from benchmark.extensions.mcap.planner_messages import JUDGE, add_drive, add_plans
from benchmark.extensions.mcap.scene_messages import ADVERSARY_TOPIC, AdversaryFacts, add_scene
from benchmark.extensions.mcap.timeline import MAP, Primitives, Timeline, load_messages
from benchmark.fairness.data_set_assessment import find_recording, read_adversarial_scene, read_launches
from benchmark.machine.progress import CountedUnits
from benchmark.machine.storage import lock_folder, sanitise_file_name, write_bytes
from benchmark.machine.workers import map_ordered
from benchmark.records.drives import DriveRecord
from benchmark.records.run import RunRecord
from benchmark.scene import Scene

LAYOUT_FILE: Final = "layout.json"
_BYTES_OF_A_BOX: Final = 14
_BYTES_OF_A_PLAN: Final = 450
_BYTES_OF_A_FRAME: Final = 260
"""Compressed, measured on nuScenes and the town; what `estimate_bytes` multiplies."""


@dataclass(frozen=True, slots=True)
class McapContents:
    """What goes into the files beside the scenes.

    Attributes:
        records: Of planning, each of another planner.
        drives: Of driving.
        images: Those of key frames, all, or none.
        split: Of the data set, for the metadata.
        recordings: What its scenes were made from, for where adversaries went there.
        image_quality: 1 to 100, of images that are encoded anew; ``None`` for the files as they are.
    """

    records: tuple[RunRecord, ...] = ()
    drives: tuple[DriveRecord, ...] = ()
    images: ImageChoice = "keyframes"
    split: str | None = None
    recordings: DataSet | None = None
    image_quality: int | None = None


@dataclass(frozen=True, slots=True)
class WrittenLog:
    """One file: its scene, size and number of messages."""

    path: Path
    scene: str
    size: int
    messages: int


def export_mcap(
    dataset: DataSet, names: Sequence[str], to: Path, contents: McapContents | None = None, *, workers: int = 1
) -> tuple[WrittenLog, ...]:
    """Write scenes as MCAP files with Foxglove's schemas.

    Args:
        dataset: The data set.
        names: Its scenes.
        to: Folder; gets a file a scene, ``SCENE.mcap``, and ``layout.json``.
        contents: What goes along.
        workers: Number of processes.

    Returns:
        The written files.

    Raises:
        InputError: If the package ``foxglove-sdk`` is absent, a scene or one of its images is broken, a record is of
            another data set, or the folder cannot be written.
    """
    load_messages()
    if not names:
        raise InputError("there is no scene to export; name one with --scenes, or leave --scenes and --limit out")
    contents = contents or McapContents()
    for recorded in ([each.planner for each in contents.records], [each.planner for each in contents.drives]):
        if twice := next((planner for planner in recorded if recorded.count(planner) > 1), None):
            raise InputError(f"there are two records of {twice!r}, which would share topics; name the folder of one")
    with lock_folder(to):
        write = partial(_write, dataset, to, contents)
        written = list(
            map_ordered(write, names, workers=workers, label="exporting scenes", count=CountedUnits("scene"))
        )
        write_bytes(to / LAYOUT_FILE, encode_layout(dataset.scene(names[0]), contents))
    return tuple(written)


def _write(dataset: DataSet, to: Path, contents: McapContents, name: str) -> WrittenLog:
    data, messages = encode_mcap(dataset, name, contents)
    variant, slash, inner = name.partition("/")
    path = to / f"{sanitise_file_name(f'{inner}-{variant}' if slash else name)}.mcap"
    write_bytes(path, data)
    return WrittenLog(path, name, len(data), messages)


def encode_mcap(dataset: DataSet, name: str, contents: McapContents) -> tuple[bytes, int]:
    """The bytes of a scene's file, and the number of its messages; decoded they are the same on every run."""
    scene = read_adversarial_scene(dataset, name, contents.recordings)
    timeline, make = Timeline(), Primitives()
    facts = dataset.scene_facts([name])[name]
    recorded = find_recording(dataset, name, contents.recordings) if scene.adversaries else None
    adversaries = AdversaryFacts(read_launches(dataset, scene), facts.manoeuvre, recorded)
    images = find_images(dataset, name, contents.images, contents.image_quality)
    add_scene(timeline, make, scene, images, adversaries)
    for record in contents.records:
        version = record.run.protocols.get(JUDGE, 0)
        add_plans(timeline, make, scene, record.planner, record.rows_of(name), version)
    for drive in contents.drives:
        for row in drive.rows:
            if row.scene == name:
                add_drive(timeline, make, scene, drive.planner, row, drive.facts.measured.world)
    stream = io.BytesIO()
    timeline.write(stream, {"scene-info": _describe(dataset, scene, contents, facts.source, facts.manoeuvre)})
    return stream.getvalue(), len(timeline.entries)


def estimate_bytes(dataset: DataSet, name: str, contents: McapContents) -> int:
    """About how large a scene's file will be: images as they are exactly, all else by what it had elsewhere."""
    scene = dataset.scene(name)
    pictures = find_images(dataset, name, contents.images, contents.image_quality).count_bytes()
    drives = [row for drive in contents.drives for row in drive.rows if row.scene == name]
    plans = sum(len(record.rows_of(name)) for record in contents.records) + sum(len(row.plans) for row in drives)
    steps = sum(len(row.ticks.time_us) for row in drives)
    boxes = int(scene.agents.valid.sum())
    frames = len(scene.timestamps_us) + steps
    return pictures + _BYTES_OF_A_BOX * boxes + _BYTES_OF_A_PLAN * plans + _BYTES_OF_A_FRAME * frames


def _describe(
    dataset: DataSet, scene: Scene, contents: McapContents, source: str, manoeuvre: str | None
) -> dict[str, str]:
    """The metadata record of a file; nothing of the machine."""
    quality = contents.image_quality
    stated = {
        "name": scene.name,
        "description": scene.description,
        "location": scene.road_map.location,
        "vehicle": scene.vehicle,
        "date_captured": scene.date,
        "split": contents.split,
        "source_scene": source,
        "frozen_split": find_frozen_split(dataset.provenance()),
        "adversaries": " ".join(scene.adversaries),
        "manoeuvre": manoeuvre,
        "images": None if quality is None else f"encoded anew as WebP of quality {quality}",
        "content": dataset.fingerprint(),
        "generator": f"challenger-bench {VERSION}",
        "coordinate_frame": f"{MAP}: metres, x forward and y left of the map's south-west corner",
        "licence": "that of what the scene was made from; nuScenes' recordings are CC BY-NC-SA 4.0",
    }
    return {name: value for name, value in stated.items() if value}


def encode_layout(scene: Scene, contents: McapContents) -> bytes:
    """A layout for Foxglove and Lichtblick: the scene from above, its front cameras, distances over time, events."""
    planners = [sanitise_file_name(record.planner) for record in contents.records]
    drives = [sanitise_file_name(drive.planner) for drive in contents.drives]
    shown = ["/annotations", "/ego", "/map", ADVERSARY_TOPIC]
    shown += [f"/plan/{name}{part}" for name in planners for part in ("", "/marks")]
    shown += [f"/drive/{name}{part}" for name in drives for part in ("", "/body", "/plan")]
    panels: dict[str, Any] = {
        "3D!scene": {
            "followTf": "base_link",
            "followMode": "follow-pose",
            "topics": {topic: {"visible": True} for topic in shown},
            "cameraState": {"distance": 60, "phi": 45, "thetaOffset": 90, "perspective": True},
        },
        "Plot!gap": {
            "title": "distance of the plan to the adversary (m)",
            "paths": [{"value": f"/verdict/{name}.gap_m", "enabled": True} for name in planners],
        },
        "RosOut!log": {"topicToRender": "/log"},
    }
    below: Any = {"direction": "row", "first": "Plot!gap", "second": "RosOut!log"}
    cameras = [camera.name for camera in scene.cameras if "FRONT" in camera.name] if contents.images != "none" else []
    pictures: Any = None
    for camera in cameras[:3]:
        topic = f"/{camera.lower()}"
        mode = {"imageTopic": f"{topic}/image_rect_compressed", "calibrationTopic": f"{topic}/camera_info"}
        panel = f"Image!{camera.lower()}"
        panels[panel] = {"imageMode": mode}
        pictures = panel if pictures is None else {"direction": "row", "first": pictures, "second": panel}
    if pictures is not None:
        below = {"direction": "column", "first": pictures, "second": below}
    layout = {"direction": "column", "first": "3D!scene", "second": below, "splitPercentage": 60}
    stored = {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return (json.dumps({**stored, "layout": layout}, indent=1) + "\n").encode()
