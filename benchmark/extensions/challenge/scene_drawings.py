"""Pictures for the organiser: each scene from above when a changed vehicle is nearest to the ego."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.machine.progress import track_progress
from benchmark.records.challenge import EntryVerdict, SceneVerdict
from benchmark.report.birdseye import BirdseyeScene
from benchmark.report.canvas import encode_png
from benchmark.report.overlays import PathOverlay
from benchmark.scene_pages.page_building import build_page_to_draw

SIDE_PX: Final = 360
_EXTENT_M: Final = 28.0


def draw_scenes(entry: DataSet, base: DataSet, verdict: EntryVerdict) -> dict[str, bytes]:
    """Pictures of all scenes of an entry from above: PNG files by name of the scene."""
    scenes = track_progress(verdict.scenes, total=len(verdict.scenes), label="drawing scenes")
    return {scene.scene: _draw_scene(entry, base, scene) for scene in scenes}


def _draw_scene(entry: DataSet, base: DataSet, verdict: SceneVerdict) -> bytes:
    """The scene, its changed vehicles as adversaries, and dashed where they were recorded."""
    changed = tuple(vehicle.instance for vehicle in verdict.changed)
    scene, recorded = replace(entry.scene(verdict.scene), adversaries=changed), base.scene(verdict.recording)
    drawn = BirdseyeScene(build_page_to_draw(scene))
    ways = []
    rows: Mapping[str, int] = {name: row for row, name in enumerate(recorded.agents.ids)}
    for vehicle in verdict.changed:
        row = rows[vehicle.recorded]
        ways.append(PathOverlay(recorded.agents.position[row, recorded.agents.valid[row], :2] - drawn.sheet.origin_m))
    at = verdict.changed[0].nearest_ego_s if verdict.changed else None
    frame = len(scene.seconds) // 2 if at is None else int(np.argmin(np.abs(scene.seconds - at)))
    picture, _ = drawn.draw(frame, ways, width_px=SIDE_PX, height_px=SIDE_PX, extent_m=_EXTENT_M)
    return encode_png(picture)
