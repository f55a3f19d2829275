"""A scene of two seconds on a straight road, drawn from nothing: where everything is can be counted on fingers."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmark.machine.storage import file_sha256, write_bytes, write_json
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import DataFacts
from benchmark.records.scene_pages import (
    CAMERA_GRID,
    SCHEMA,
    ScenePage,
    StoredScenePage,
    picture_name,
    read_scene_page,
    scene_folder,
)
from tests.benchmark.records.hand_made_records import CLEAN, hand_made

FRAMES, EVERY = 25, 6
CELL_PX = (40, 24)
SCENE = "scene-1"
ROAD = ((-60.0, -6.0), (60.0, -6.0), (60.0, 6.0), (-60.0, 6.0))


def agent(name: str, x_m: float, y_m: float, **changes: Any) -> dict[str, Any]:
    """A car that stands there all the time, its front towards +x."""
    whole = {"id": name, "category": "vehicle.car", "size_m": (4.0, 2.0, 1.5), "adversary": False, "first": 0}
    there = {"x_m": [x_m] * FRAMES, "y_m": [y_m] * FRAMES, "yaw_rad": [0.0] * FRAMES}
    return {**whole, **there, **changes}


def sheet(**changes: Any) -> ScenePage:
    """The ego stands at the origin and looks along +x; a car 10 m ahead, the adversary 5 m to the left."""
    keyframes = list(range(0, FRAMES, EVERY))
    scene = changes.get("scene", SCENE)
    content: dict[str, Any] = {
        "schema": SCHEMA, "data": DataFacts(name="d", version="v", fingerprint="d adv"), "split": "adv",
        "scene": scene, "source": "scene", "description": "A straight road", "labels": [{"manoeuvre": "cut-in-left"}],
        "origin_m": (600.0, 1600.0), "timestamps_us": [1_000_000 + round(1e6 * frame / 12) for frame in range(FRAMES)],
        "keyframes": keyframes, "sample_tokens": [f"{scene}-{place}" for place in range(len(keyframes))],
        "ego": {
            "x_m": [0.0] * FRAMES, "y_m": [0.0] * FRAMES, "yaw_rad": [0.0] * FRAMES,
            "length_m": 4.084, "width_m": 1.85, "centre_ahead_m": 1.44,
        },
        "agents": [agent("car", 10.0, 0.0), agent("bad", 0.0, 5.0, adversary=True)],
        "road": {"drivable": [[ROAD]], "dividers": [{"points": [(-60, 0), (60, 0)], "paint": "dashed-white"}]},
        "cameras": [], "pictures": [], "adversary_edges": {}, "files": {}, **changes,
    }  # fmt: skip
    return ScenePage.model_validate(content)


def written(root: Path, *, pictures: bool = True, **changes: Any) -> StoredScenePage:
    """The same on disk, its cameras grey with one edge of the adversary's box in the front one."""
    plain = sheet(**changes)
    folder = scene_folder(root, plain.data.name, plain.split, plain.scene)
    width, height = CELL_PX
    content = plain.model_dump(mode="json", by_alias=True)
    if pictures:
        cells = [(name, column, row) for row, names in enumerate(CAMERA_GRID) for column, name in enumerate(names)]
        content["cameras"] = [
            {"name": name, "left": width * column, "top": height * row, "width": width, "height": height}
            for name, column, row in cells
        ]
        content["pictures"] = [6, 12]
        content["adversary_edges"] = {"6": {"CAM_FRONT": [[60.0, 0.0, 60.0, 24.0]]}}
        for frame in content["pictures"]:
            path = folder / picture_name(frame)
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.full((2 * height, 3 * width, 3), 128, np.uint8)).save(path, lossless=True)
            content["files"][picture_name(frame)] = file_sha256(path)
    write_json(folder / "sheet.json", content)
    return read_scene_page(folder)


def broken_picture(stored: StoredScenePage, data: bytes) -> None:
    """Put something else in place of the first picture after the sheet was read."""
    write_bytes(stored.picture_path(6), data)


def record(name: str, samples: Sequence[str | None] = (CLEAN,) * 5, *, scene: str = SCENE, **facts: Any) -> RunRecord:
    """A planner's run on the scene; see `hand_made` for what samples are."""
    return hand_made(name, {scene: samples}, **facts)


def with_plan(run: RunRecord, plan: dict[str, Any]) -> RunRecord:
    """The same run with another plan at every sample that has one."""
    rows = [
        row if row.plan is None else type(row).model_validate({**row.model_dump(), "plan": plan}) for row in run.rows
    ]
    return RunRecord(run.directory, run.run, tuple(rows), run.summary)
