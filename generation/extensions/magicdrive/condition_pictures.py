"""Pictures of what MagicDriveDiT is told: one PNG a condition, for people to look at before hours of rendering."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.box_projection import intersect_near_plane
from benchmark.constants import DETECTION_CLASSES
from benchmark.datasets.roots import DataSet
from benchmark.geometry import Floats
from benchmark.machine.storage import sanitise_file_name, write_bytes
from benchmark.report.canvas import encode_png
from benchmark.report.palette import ADVERSARY
from benchmark.scene import Scene
from generation.extensions.magicdrive.clip import Clip, build_clip, pad_frames
from generation.extensions.magicdrive.condition_plots import (
    CLASS_COLOURS,
    draw_cameras,
    draw_ego_motion,
    draw_map,
    draw_pooling,
    draw_visibility,
    draw_words,
)
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS
from generation.extensions.magicdrive.sensor_frames import CALIBRATION_SIZE
from generation.render.contract import Images, Renderer
from generation.render.pictures import choose_frames

_PANEL: Final = (640, 360)
_NEAR_M: Final = 0.1
# Corner numbers of the model's order: the right face, the left face, and what joins them.
_EDGES: Final = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
_FRONT: Final = ((0, 5), (1, 4))
_RAISED_RGB: Final = (235, 235, 235)


def write_condition_pictures(data: DataSet, names: Sequence[str], folder: Path, renderer: Renderer) -> list[Path]:
    """Write the pictures of some scenes, a folder a scene.

    Args:
        data: The data set.
        names: Scenes.
        folder: Where to.
        renderer: Draws what lies under the boxes where the data set has no images.

    Returns:
        The PNG files.

    Raises:
        InputError: If a scene is unknown, has no map or lacks a camera, or a file cannot be written.
    """
    written = []
    for name in names:
        scene = data.scene(name)
        clip = build_clip(scene, pad_frames(range(len(scene.timestamps_us))))
        shown = choose_shown_frames(scene)
        images = [
            _read_recorded_images(data, name, scene, frame) or next(iter(renderer.render(scene, [frame])))
            for frame in shown
        ]
        for kind, content in draw_condition_pictures(clip, scene, shown, images).items():
            path = folder / sanitise_file_name(name) / f"{kind}.png"
            write_bytes(path, content)
            written.append(path)
    return written


def draw_condition_pictures(
    clip: Clip, scene: Scene, frames: Sequence[int], images: Sequence[Images | None]
) -> dict[str, bytes]:
    """PNG files of one clip at ``frames`` of the scene; ``images`` have any size, ``None`` is a dark ground."""
    places = [int(np.flatnonzero(clip.frames == frame)[0]) for frame in frames]
    adversaries = [slot for slot, name in enumerate(clip.boxes.ids) if name in scene.adversaries]
    pictures: dict[str, Callable[[], bytes]] = {
        "cameras": lambda: draw_cameras(clip),
        "ego-motion": lambda: draw_ego_motion(clip, scene.keyframes),
        "pooling": lambda: draw_pooling(clip, scene.keyframes, adversaries),
        "words": lambda: draw_words(clip, adversaries),
    }
    drawn = {name: draw() for name, draw in pictures.items()}
    for place, frame, frame_images in zip(places, frames, images):
        drawn[f"boxes-{frame:03d}"] = encode_png(draw_boxes(clip, place, frame_images, adversaries))
        drawn[f"visibility-{frame:03d}"] = draw_visibility(clip, place, adversaries)
        drawn[f"map-{frame:03d}"] = draw_map(clip, place, adversaries)
    return drawn


def choose_shown_frames(scene: Scene) -> list[int]:
    """Keyframes worth looking at, one or two: the first, and the one nearest to the decisive moment."""
    middle = choose_frames(scene)[3]
    nearest = scene.keyframes[np.abs(scene.keyframes - middle).argmin()]
    return sorted({int(scene.keyframes[0]), int(nearest)})


def draw_boxes(clip: Clip, place: int, images: Images | None, adversaries: Sequence[int]) -> NDArray[np.uint8]:
    """(720, 1920, 3) RGB: boxes of one frame, with their slots, over six views in the model's order, three in a row.

    A box that a view is told to use is drawn where the object is, in the colour of its class or of adversaries; the
    roof of the raised box that the model is given is drawn above it in pale grey. ``place`` is the frame's position in
    the clip.
    """
    panels = []
    for view, name in enumerate(MODEL_CAMERAS):
        panel = np.full((_PANEL[1], _PANEL[0], 3), 45, dtype=np.uint8)
        if images is not None:
            panel = np.asarray(cv2.resize(images[name], _PANEL, interpolation=cv2.INTER_AREA), np.uint8)
        _draw_view(panel, clip, place, view, adversaries)
        box_count = int(clip.boxes.masks[view, place].sum())
        _write_text(panel, f"{view} {name}: told of {box_count} boxes", (4, 16), (255, 255, 255))
        panels.append(panel)
    return np.vstack([np.hstack(panels[:3]), np.hstack(panels[3:])])


def _draw_view(panel: NDArray[np.uint8], clip: Clip, place: int, view: int, adversaries: Sequence[int]) -> None:
    """Far boxes first; what lies behind the lens is cut off."""
    camera = clip.cams[view, place].astype(np.float64)
    turn, eye = camera[:, 3:6], camera[:, 6]
    scale = np.array([_PANEL[0] / CALIBRATION_SIZE[0], _PANEL[1] / CALIBRATION_SIZE[1], 1.0])
    to_pixels = scale[:, None] * camera[:, :3]
    slots = np.flatnonzero(clip.boxes.masks[view, place])
    corners = (clip.boxes.true_corners[place, slots] - eye) @ turn
    raised = (clip.boxes.corners[place, slots] - eye) @ turn
    for index in np.argsort(-corners[..., 2].mean(axis=-1)).tolist():
        slot = int(slots[index])
        name = DETECTION_CLASSES[int(clip.boxes.classes[place, slot])]
        colour = ADVERSARY if slot in adversaries else CLASS_COLOURS[name]
        for start, end in ((1, 2), (2, 6), (6, 5), (5, 1)):
            _draw_line(panel, raised[index, [start, end]], to_pixels, _RAISED_RGB, 1)
        for edge in (*_EDGES, *_FRONT):
            _draw_line(panel, corners[index, list(edge)], to_pixels, colour, 1 if edge in _FRONT else 2)
        middle = corners[index].mean(axis=0)
        if middle[2] > _NEAR_M:
            at = to_pixels @ middle
            _write_text(panel, str(slot), (int(at[0] / at[2]) - 6, int(at[1] / at[2]) + 4), (255, 255, 255))


def _draw_line(
    panel: NDArray[np.uint8], ends: Floats, to_pixels: Floats, colour: tuple[int, int, int], width: int
) -> None:
    depth = ends[:, 2]
    if depth.max() <= _NEAR_M:
        return
    if depth.min() < _NEAR_M:
        cut = intersect_near_plane(ends[0], ends[1], _NEAR_M)
        ends = np.stack([np.where(depth[0] < _NEAR_M, cut, ends[0]), np.where(depth[1] < _NEAR_M, cut, ends[1])])
    homogeneous = ends @ to_pixels.T
    # Far outside the picture OpenCV's fixed-point numbers would overflow.
    pixels = np.clip(homogeneous[:, :2] / homogeneous[:, 2:], -1e5, 1e5)
    start, end = (tuple(np.rint(pixel).astype(int).tolist()) for pixel in pixels)
    cv2.line(panel, start, end, colour, width, cv2.LINE_AA)


def _write_text(panel: NDArray[np.uint8], text: str, at: tuple[int, int], colour: tuple[int, int, int]) -> None:
    """Small text with a dark rim, so that it can be read on anything."""
    face, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.45
    cv2.putText(panel, text, at, face, scale, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(panel, text, at, face, scale, colour, 1, cv2.LINE_AA)


def _read_recorded_images(data: DataSet, name: str, scene: Scene, frame: int) -> Images | None:
    """The data set's own images at a keyframe, where it has all six."""
    place = int(np.flatnonzero(scene.keyframes == frame)[0])
    videos = data.videos(name, sweeps=False)
    if any(len(videos.get(camera, ())) != len(scene.keyframes) for camera in MODEL_CAMERAS):
        return None
    views = {camera: videos[camera][place] for camera in MODEL_CAMERAS}
    if not all(view.path.is_file() for view in views.values()):
        return None
    return {camera: view.load() for camera, view in views.items()}
