"""Pictures from above for people: who was where, who drove how."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, VEHICLE_CATEGORIES
from benchmark.errors import InputError
from benchmark.geometry import Floats, box_corners
from benchmark.scene import Scene
from generation.render.contract import Renderer
from generation.render.schematic.painting import Coat, paint, painted_polygons, to_fixed_point
from generation.render.schematic.view import View

Rgb = tuple[int, int, int]

_LAND: Rgb = (236, 235, 228)
_COATS = {
    Coat.CAR_PARK: (208, 208, 208),
    Coat.PAVEMENT: (222, 216, 204),
    Coat.KERB: (170, 170, 166),
    Coat.ROAD: (190, 191, 194),
    Coat.WHITE: (252, 252, 252),
    Coat.YELLOW: (240, 190, 60),
}
_EGO: Rgb = (34, 150, 74)
_ADVERSARY: Rgb = (214, 40, 40)
_VEHICLE: Rgb = (104, 122, 150)
_CYCLE: Rgb = (150, 110, 160)
_PERSON: Rgb = (226, 140, 40)
_THING: Rgb = (140, 136, 128)
_INK: Rgb = (40, 42, 46)
_PLAN: Rgb = (40, 90, 220)
_TRAIL_S = 3.0
_SHIFT = 4


def draw_birdseye(
    scene: Scene,
    frame: int,
    *,
    size_px: int = 480,
    extent_m: float = 40.0,
    trails: bool = True,
    plan: Floats | None = None,
    highlight: bool = True,
) -> NDArray[np.uint8]:
    """Draw the surroundings of the ego from above, its heading upwards.

    Args:
        scene: The scene.
        frame: Frame index.
        size_px: Side of the picture.
        extent_m: Half the side of the square that it shows.
        trails: Whether to draw the ways of ego and adversaries over the 3 s before (thin) and after (thick, a dot
            each half second).
        plan: (M, 2) waypoints in the ego frame (x forward, y left, rear axle), metres, or ``None``.
        highlight: Whether adversaries are red.

    Returns:
        (size_px, size_px, 3) RGB.

    Raises:
        InputError: If the frame is not in the scene, or the size or extent is not positive.
    """
    if not 0 <= frame < len(scene.timestamps_us):
        raise InputError(
            f"{scene.name} has frames 0 to {len(scene.timestamps_us) - 1}, there is no frame {frame} to draw"
        )
    if size_px < 1 or not extent_m > 0.0:
        raise InputError(f"a picture from above needs a positive size and extent, got {size_px} px and {extent_m} m")
    image = np.empty((size_px, size_px, 3), dtype=np.uint8)
    image[:] = _LAND
    pose = scene.ego.pose[frame]
    to_pixel = _heading_up(pose, size_px, extent_m)
    x, y, reach = float(pose[0]), float(pose[1]), extent_m * 1.5
    paint(image, painted_polygons(scene.road_map.near((x - reach, y - reach, x + reach, y + reach))), to_pixel, _COATS)
    shown = _adversaries(scene) if highlight else []
    if trails:
        for index in shown:
            _trail(image, scene.agents.position[index, :, :2], scene.agents.valid[index], frame, to_pixel, _ADVERSARY)
        always = np.ones(len(scene.timestamps_us), dtype=np.bool_)
        _trail(image, scene.ego.boxes[:, :2], always, frame, to_pixel, _EGO)
    present = np.flatnonzero(scene.agents.valid[:, frame])
    boxes = scene.agents.boxes[:, frame]
    for index in sorted(present.tolist(), key=lambda index: (index in shown, index)):
        colour = _ADVERSARY if index in shown else _colour_of(scene.agents.categories[index])
        _box(image, boxes[index], to_pixel, colour)
    _box(image, scene.ego.boxes[frame], to_pixel, _EGO)
    if plan is not None:
        _plan(image, np.asarray(plan, np.float64), size_px, extent_m)
    return image


def birdseye_strip(
    scene: Scene,
    frames: Sequence[int],
    renderer: Renderer | None = None,
    *,
    size_px: int = 320,
    extent_m: float = 30.0,
    plan: Floats | None = None,
) -> NDArray[np.uint8]:
    """Several moments side by side, each from above and, with a renderer, through a camera below.

    Args:
        scene: The scene.
        frames: Frame indices, left to right.
        renderer: Draws the camera that sees the adversary best over these frames (``CAM_FRONT`` without one).
        size_px: Side of a panel.
        extent_m: Half the side of the square that a panel shows.
        plan: Waypoints drawn in the first panel, see `draw_birdseye`.

    Returns:
        (h, w, 3) RGB.

    Raises:
        InputError: If there are no frames, or one is not in the scene.
    """
    if not len(frames):
        raise InputError("a strip needs at least one frame")
    columns = []
    for number, frame in enumerate(frames):
        panel = draw_birdseye(scene, frame, size_px=size_px, extent_m=extent_m, plan=plan if number == 0 else None)
        _label(panel, f"{float(scene.seconds[frame]):.1f} s")
        columns.append(panel)
    if renderer is not None:
        channel = best_camera(scene, frames, renderer)
        for number, images in enumerate(renderer.render(scene, list(frames))):
            picture = images[channel]
            height = max(round(picture.shape[0] * size_px / picture.shape[1]), 1)
            picture = np.asarray(cv2.resize(picture, (size_px, height), interpolation=cv2.INTER_AREA), np.uint8)
            _label(picture, channel)
            gap = np.full((4, size_px, 3), 255, dtype=np.uint8)
            columns[number] = np.vstack([columns[number], gap, picture])
    gap = np.full((columns[0].shape[0], 4, 3), 255, dtype=np.uint8)
    parts = [part for column in columns for part in (column, gap)][:-1]
    return np.hstack(parts)


def best_camera(scene: Scene, frames: Sequence[int], renderer: Renderer) -> str:
    """The camera in which the adversaries appear largest over some frames.

    Args:
        scene: The scene.
        frames: Frame indices.
        renderer: Gives the cameras.

    Returns:
        A camera name; ``CAM_FRONT``, or the first camera there is, where no adversary is in sight.
    """
    cameras = renderer.cameras(scene)
    names = [camera.name for camera in cameras]
    usual = "CAM_FRONT" if "CAM_FRONT" in names else names[0]
    # The usual camera wins unless another one sees clearly more.
    score = {name: 1e-6 if name == usual else 0.0 for name in names}
    for frame in frames:
        for index in _adversaries(scene):
            if not scene.agents.valid[index, frame]:
                continue
            for camera in cameras:
                view = View.of(camera, scene.ego.position[frame], scene.ego.rotation[frame])
                centre = view.to_camera(scene.agents.position[index, frame])
                if centre[2] < 1.0:
                    continue
                column = float(view.to_pixels(centre)[0]) / camera.width
                if 0.0 <= column <= 1.0:
                    score[camera.name] += (2.0 if camera.name == usual else 1.0) / float(centre[2])
    return max(names, key=lambda name: score[name])


def _heading_up(pose: Floats, size_px: int, extent_m: float) -> Floats:
    """(2, 3) affine map from global metres to pixels with the heading of a pose upwards and the pose in the middle."""
    scale = size_px / (2.0 * extent_m)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = scale * np.array([[sin, -cos], [-cos, -sin]])
    return np.column_stack([turn, np.full(2, (size_px - 1) / 2.0) - turn @ pose[:2]])


def _adversaries(scene: Scene) -> list[int]:
    return [index for index, name in enumerate(scene.agents.ids) if name in scene.adversaries]


def _colour_of(category: str) -> Rgb:
    if category in ("vehicle.bicycle", "vehicle.motorcycle"):
        return _CYCLE
    if category in VEHICLE_CATEGORIES:
        return _VEHICLE
    return _PERSON if category.startswith(("human", "animal")) else _THING


def _box(image: NDArray[np.uint8], box: Floats, to_pixel: Floats, colour: Rgb) -> None:
    """A filled box with an outline and a tick from its centre through its front."""
    corners = to_fixed_point(box_corners(box), to_pixel)
    cv2.fillConvexPoly(image, corners, colour, cv2.LINE_AA, _SHIFT)
    cv2.polylines(image, [corners], True, _INK, 1, cv2.LINE_AA, _SHIFT)
    if box[2] > 1.2:
        heading = np.array([np.cos(box[4]), np.sin(box[4])])
        nose = np.stack([box[:2] + 0.18 * box[2] * heading, box[:2] + 0.5 * box[2] * heading])
        cv2.polylines(image, [to_fixed_point(nose, to_pixel)], False, (255, 255, 255), 2, cv2.LINE_AA, _SHIFT)


def _trail(
    image: NDArray[np.uint8], centres: Floats, valid: NDArray[np.bool_], frame: int, to_pixel: Floats, colour: Rgb
) -> None:
    """Way of a box centre: thin where it came from, thick with half-second dots where it goes."""
    reach = round(_TRAIL_S * FRAME_HZ)
    first, last = max(frame - reach, 0), min(frame + reach, len(centres) - 1)
    pale = tuple(round(0.5 * part + 0.5 * 200) for part in colour)
    for start, stop, shade, width in ((first, frame, pale, 1), (frame, last, colour, 2)):
        steps = [step for step in range(start, stop) if valid[step] and valid[step + 1]]
        lines = [to_fixed_point(centres[step : step + 2], to_pixel) for step in steps]
        cv2.polylines(image, lines, False, shade, width, cv2.LINE_AA, _SHIFT)
    for step in range(frame + FRAME_HZ // 2, last + 1, FRAME_HZ // 2):
        if valid[step]:
            _dot(image, to_fixed_point(centres[step : step + 1], to_pixel)[0], colour)


def _dot(image: NDArray[np.uint8], fixed: NDArray[np.int32], colour: Rgb) -> None:
    cv2.circle(image, (int(fixed[0]), int(fixed[1])), 3 << _SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)


def _plan(image: NDArray[np.uint8], waypoints: Floats, size_px: int, extent_m: float) -> None:
    to_pixel = _heading_up(np.zeros(3), size_px, extent_m)
    path = np.concatenate([np.zeros((1, 2)), waypoints])
    cv2.polylines(image, [to_fixed_point(path, to_pixel)], False, _PLAN, 2, cv2.LINE_AA, _SHIFT)
    for point in to_fixed_point(waypoints, to_pixel):
        _dot(image, point, _PLAN)


def _label(image: NDArray[np.uint8], text: str) -> None:
    """Small text in the upper left corner, on a plate so that it can be read on anything."""
    scale, face = 0.45, cv2.FONT_HERSHEY_SIMPLEX
    (width, height), below = cv2.getTextSize(text, face, scale, 1)
    cv2.rectangle(image, (0, 0), (width + 8, height + below + 6), (255, 255, 255), -1)
    cv2.putText(image, text, (4, height + 4), face, scale, _INK, 1, cv2.LINE_AA)
