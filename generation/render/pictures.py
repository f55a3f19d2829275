"""Pictures of whole scenes for people: what to look at before a generated scene is trusted."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ
from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.storage import sanitise_file_name, write_bytes
from benchmark.report.birdseye import BirdseyeScene
from benchmark.report.canvas import Picture, encode_png, write_text
from benchmark.report.captions import draw_captions, draw_time
from benchmark.report.palette import PAPER
from benchmark.scene import Scene
from benchmark.scene_pages.page_building import build_page_to_draw
from generation.labels.labelling import find_closest_approach
from generation.render.contract import Renderer
from generation.render.schematic.view import PlacedCamera

PANELS = 6
"""Moments in a strip."""
_PANEL_PX: Final = 360
_EXTENT_M: Final = 30.0
_GAP_PX: Final = 4


def choose_frames(scene: Scene, *, count: int = PANELS, step_s: float = 1.0) -> list[int]:
    """Frames in order around the first adversary's closest approach, a little behind the middle, or spread evenly."""
    last = len(scene.timestamps_us) - 1
    if not scene.adversaries:
        return [round(frame) for frame in np.linspace(0, last, count)]
    agent = scene.agents.ids.index(scene.adversaries[0])
    start = int(np.flatnonzero(scene.agents.valid[agent])[0])
    middle = find_closest_approach(scene, agent, start).frame
    step = round(step_s * FRAME_HZ)
    # As many panels before it as planned, more near the end of the scene, fewer near its start.
    before = max(count // 2 + 1, count - 1 - (last - middle) // step)
    first = middle - step * min(before, middle // step)
    return [min(first + index * step, last) for index in range(count)]


def draw_scene_strip(
    scene: Scene, frames: Sequence[int], renderer: Renderer, *, panel_px: int = _PANEL_PX
) -> NDArray[np.uint8]:
    """Several moments side by side, each from above and through the camera that sees the adversary best.

    (height, width, 3) RGB; frames go from left to right, ``panel_px`` is the side of a panel.
    """
    if not len(frames):
        raise InputError("a strip needs at least one frame")
    sheet = build_page_to_draw(scene)
    above = BirdseyeScene(sheet)
    panels = [above.draw(frame, width_px=panel_px, height_px=panel_px, extent_m=_EXTENT_M) for frame in frames]
    draw_captions(*panels[0], sheet, float(above.seconds[frames[0]]), ())
    for frame, (panel, _) in zip(frames[1:], panels[1:]):
        draw_time(panel, float(above.seconds[frame]))
    channel = find_best_camera(scene, frames, renderer)
    camera_panels = [_draw_label(images[channel], channel, panel_px) for images in renderer.render(scene, list(frames))]
    return np.vstack([_join_pictures([panel for panel, _ in panels]), _join_pictures(camera_panels)])[
        _GAP_PX:, _GAP_PX:
    ]


def find_best_camera(scene: Scene, frames: Sequence[int], renderer: Renderer) -> str:
    """The camera in which the adversaries appear largest over some frames; where none is in sight, the front one."""
    cameras = renderer.cameras(scene)
    names = [camera.name for camera in cameras]
    usual = "CAM_FRONT" if "CAM_FRONT" in names else names[0]
    # The usual camera is chosen unless another one sees clearly more.
    score = {name: 1e-6 if name == usual else 0.0 for name in names}
    adversaries = [scene.agents.ids.index(name) for name in scene.adversaries]
    for frame in frames:
        for index in adversaries:
            if not scene.agents.valid[index, frame]:
                continue
            for camera in cameras:
                view = PlacedCamera.of(camera, scene.ego.position[frame], scene.ego.rotation[frame])
                centre = view.to_camera(scene.agents.position[index, frame])
                if centre[2] < 1.0:
                    continue
                column = float(view.to_pixels(centre)[0]) / camera.width
                if 0.0 <= column <= 1.0:
                    score[camera.name] += (2.0 if camera.name == usual else 1.0) / float(centre[2])
    return max(names, key=lambda name: score[name])


def write_pictures(data: DataSet, names: Sequence[str], folder: Path, renderer: Renderer) -> list[Path]:
    """Write one picture a scene.

    Args:
        data: The data set.
        names: Scenes.
        folder: Where to.
        renderer: Draws the camera pictures.

    Returns:
        The PNG files.

    Raises:
        InputError: If a scene is unknown or the files cannot be written.
    """
    written = []
    for name in names:
        scene = data.scene(name)
        path = folder / f"{sanitise_file_name(name)}.png"
        write_bytes(path, encode_png(draw_scene_strip(scene, choose_frames(scene), renderer)))
        written.append(path)
    return written


def _draw_label(picture: Picture, channel: str, width_px: int) -> Picture:
    height_px = max(round(picture.shape[0] * width_px / picture.shape[1]), 1)
    small = np.asarray(cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA), np.uint8)
    write_text(small, channel, (10.0, 14.0), size_px=13, plate=PAPER)
    return small


def _join_pictures(pictures: Sequence[Picture]) -> Picture:
    """Pictures in a row, a white gap above and to the left of each."""
    gap = ((_GAP_PX, 0), (_GAP_PX, 0), (0, 0))
    return np.hstack([np.pad(picture, gap, constant_values=255) for picture in pictures])
