"""Inspection of scenes: the pictures shown of each, and the inspector's verdicts."""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from benchmark.datasets.roots import DataSet
from benchmark.datasets.split_reviews import record_verdicts, scene_tokens
from benchmark.errors import InputError
from benchmark.machine.storage import content_seed
from benchmark.records.review import check_verdict, read_review
from benchmark.records.scene_pages import PageCamera
from benchmark.report.birdseye import BirdseyeScene
from benchmark.report.canvas import encode_png
from benchmark.scene import Scene
from benchmark.scene_pages.page_building import build_page_to_draw
from benchmark.scene_pages.page_pictures import (
    PicturedFrame,
    draw_mosaic,
    keep_existing_images,
    lay_out_cameras,
    project_adversary_edges,
    select_pictured_frames,
)

_ABOVE_PX: Final = 460
_EXTENT_M: Final = 30.0
_CELL_WIDTH_PX: Final = 480
_KEPT: Final = 3
"""Scenes that are held: the one that is looked at, the one before, and the next."""


@dataclass(frozen=True, slots=True)
class _PreparedScene:
    """One scene made ready to be drawn."""

    scene: Scene
    above: BirdseyeScene
    frames: tuple[PicturedFrame, ...]
    cells: tuple[PageCamera, ...]


def draw_scenes_to_inspect(names: Sequence[str], count: int | None, seed: int) -> tuple[str, ...]:
    """Some of the scenes, drawn by seed as the paper's random subset, in their order; all where no count is given."""
    if count is None or count >= len(names):
        return tuple(names)
    drawn = set(sorted(names, key=lambda name: content_seed("inspection", name, seed))[:count])
    return tuple(name for name in names if name in drawn)


class Inspection:
    """The scenes of one sitting, their pictures and their verdicts; may be asked from several threads."""

    def __init__(self, data: DataSet, names: Sequence[str], inspector: str = "") -> None:
        """Look up earlier verdicts, which lie beside the root of the data set."""
        self.data, self.names, self.inspector = data, tuple(names), inspector
        self._tokens = scene_tokens(data.root, data.version)
        self._shown: OrderedDict[str, _PreparedScene] = OrderedDict()
        self._lock = threading.Lock()
        self._facts = data.scene_facts(self.names)
        read_review(data.root)

    def state(self) -> dict[str, Any]:
        """All scenes with the verdicts that stand, as JSON values."""
        verdicts = read_review(self.data.root)
        rows = []
        for name in self.names:
            verdict = verdicts.get(name)
            stands = verdict is not None and verdict.token == self._tokens[name]
            rows.append(
                {
                    "name": name,
                    "verdict": verdict.verdict if verdict is not None and stands else None,
                    "reason": verdict.reason if verdict is not None and stands else "",
                    "source": self._facts[name].source,
                    "manoeuvre": self._facts[name].manoeuvre,
                }
            )
        return {"data": self.data.name, "root": str(self.data.root), "inspector": self.inspector, "scenes": rows}

    def describe(self, index: int) -> dict[str, Any]:
        """One scene: times of its pictures, and places of adversaries in them."""
        with self._lock:
            prepared = self._ready(index)
            start_us = int(prepared.scene.timestamps_us[0])
            times = [(int(prepared.scene.timestamps_us[frame.frame]) - start_us) / 1e6 for frame in prepared.frames]
            edges = [project_adversary_edges(prepared.scene, prepared.cells, frame.views) for frame in prepared.frames]
        return {
            "name": self.names[index],
            "description": prepared.scene.description,
            "seconds": times,
            "width": max((cell.left + cell.width for cell in prepared.cells), default=0),
            "height": max((cell.top + cell.height for cell in prepared.cells), default=0),
            "cameras": [cell.model_dump(mode="json") for cell in prepared.cells],
            "edges": [[segment for of_camera in frame.values() for segment in of_camera] for frame in edges],
            "adversaries": len(prepared.scene.adversaries),
        }

    def cameras(self, index: int, place: int) -> bytes:
        """All cameras at one sample, as WebP."""
        with self._lock:
            prepared = self._ready(index)
            if not prepared.cells:
                raise InputError(f"scene {self.names[index]} has no images")
            return draw_mosaic(prepared.cells, self._frame(prepared, place).views)

    def above(self, index: int, place: int) -> bytes:
        """The scene from above at one sample, as PNG."""
        with self._lock:
            prepared = self._ready(index)
            frame = self._frame(prepared, place).frame
            picture, _ = prepared.above.draw(frame, width_px=_ABOVE_PX, height_px=_ABOVE_PX, extent_m=_EXTENT_M)
            return encode_png(picture)

    def record(self, index: int, verdict: Any, reason: Any) -> None:
        """Record a verdict on a scene: ``accepted``, ``rejected`` (with a reason), or ``None`` to take it back."""
        name = self._name(index)
        checked = None
        if verdict is not None:
            stored = {"verdict": verdict, "reason": reason, "inspector": self.inspector, "token": self._tokens[name]}
            checked = check_verdict(stored, f"the verdict on {name}")
        with self._lock:
            record_verdicts(self.data.root, {name: checked})

    def _name(self, index: int) -> str:
        if not 0 <= index < len(self.names):
            raise InputError(f"there is no scene number {index}; there are {len(self.names)}")
        return self.names[index]

    def _frame(self, prepared: _PreparedScene, place: int) -> PicturedFrame:
        if not 0 <= place < len(prepared.frames):
            raise InputError(f"scene {prepared.scene.name} has no picture number {place}")
        return prepared.frames[place]

    def _ready(self, index: int) -> _PreparedScene:
        name = self._name(index)
        if name in self._shown:
            self._shown.move_to_end(name)
            return self._shown[name]
        scene = self.data.scene(name)
        videos = keep_existing_images(name, self.data.videos(name, sweeps=False))
        frames = select_pictured_frames(scene, videos, {}) if videos else ()
        cells = lay_out_cameras({camera: views[0].camera for camera, views in videos.items()}, _CELL_WIDTH_PX)
        unseen = tuple(PicturedFrame(int(frame), {}) for frame in scene.keyframes)
        self._shown[name] = _PreparedScene(scene, BirdseyeScene(build_page_to_draw(scene)), frames or unseen, cells)
        if len(self._shown) > _KEPT:
            self._shown.popitem(last=False)
        return self._shown[name]
