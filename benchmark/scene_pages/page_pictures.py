"""Pictures of all cameras in one, and the edges of adversaries' boxes in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.box_projection import BOX_EDGES, compute_box_corners, interpolate_agents, intersect_near_plane, to_camera
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.planning import CameraView
from benchmark.records.scene_pages import CAMERA_GRID, PageCamera, Segment
from benchmark.report.words import pluralise
from benchmark.scene import Camera, Scene

Videos = Mapping[str, Sequence[CameraView]]
WEBP_QUALITY: Final = 80
NEAR_PLANE_M: Final = 0.1
FARTHEST_IN_TIME_S: Final = 0.06
"""A frame between samples has a picture if each camera has an image so near in time; images are 0.083 s apart."""
_LEAST_EDGE_PX: Final = 0.1


@dataclass(frozen=True, slots=True)
class PicturedFrame:
    """Images in the picture of one frame, by camera name; a camera without one at this sample is missing."""

    frame: int
    views: Mapping[str, CameraView]


def keep_existing_images(scene: str, videos: Videos) -> Videos:
    """Images that are there: all, or none where all files are missing; a scene with some of its images is refused."""
    paths = [view.path for views in videos.values() for view in views]
    missing = [path for path in paths if not path.is_file()]
    if missing and len(missing) < len(paths):
        raise InputError(
            f"image {missing[0]} is missing, {len(missing)} of {pluralise(len(paths), 'image')} of scene {scene} are; "
            "complete the data set, or make sheets with --pictures none"
        )
    return {} if missing else {name: views for name, views in videos.items() if views}


def select_sweeps(keyframes: Videos, every: Videos) -> Videos:
    """The images of all that are not those of a sample."""
    own = {(name, view.path) for name, views in keyframes.items() for view in views}
    return {name: tuple(view for view in views if (name, view.path) not in own) for name, views in every.items()}


def select_pictured_frames(scene: Scene, keyframes: Videos, sweeps: Videos) -> tuple[PicturedFrame, ...]:
    """Which frames get a picture, of which images: one a sample, and ``sweeps`` between them where they are wanted.

    Every sample of which there is an image, each image at the sample that is nearest in time, and every other frame at
    which each camera has an image within `FARTHEST_IN_TIME_S`, less what it is late at samples.
    """
    times_us, samples_us = scene.timestamps_us, scene.timestamps_us[scene.keyframes]
    views_of_frame: dict[int, dict[str, CameraView]] = {}
    late_us: dict[str, list[int]] = {name: [] for name in keyframes}
    for name, views in keyframes.items():
        for view in views:
            sample = int(np.abs(samples_us - view.timestamp_us).argmin())
            late_us[name].append(view.timestamp_us - int(samples_us[sample]))
            views_of_frame.setdefault(int(scene.keyframes[sample]), {})[name] = view
    of_samples = set(views_of_frame)
    for name, views in sweeps.items():
        if not views:
            continue
        # Cameras fire one after the other, the first of them half a frame before the sample: a camera's images are
        # counted from its own images of the samples, or some would be left out and others shown twice.
        taken_us = np.array([view.timestamp_us for view in views], np.int64) - int(np.median(late_us[name]))
        for frame, time_us in enumerate(times_us.tolist()):
            away_us = np.abs(taken_us - time_us)
            nearest = int(away_us.argmin())
            if frame not in of_samples and away_us[nearest] <= 1e6 * FARTHEST_IN_TIME_S:
                views_of_frame.setdefault(frame, {})[name] = views[nearest]
    complete_frames = {
        frame for frame, views in views_of_frame.items() if frame in of_samples or set(views) == set(keyframes)
    }
    return tuple(PicturedFrame(frame, views_of_frame[frame]) for frame in sorted(complete_frames))


def lay_out_cameras(cameras: Mapping[str, Camera], cell_width_px: int) -> tuple[PageCamera, ...]:
    """Cells of the cameras: the rows of `CAMERA_GRID`, then rows of three of the others, without gaps in a row.

    ``cell_width_px`` is that of the widest cell; narrower images are not enlarged.
    """
    usual = {name for row in CAMERA_GRID for name in row}
    others = sorted(set(cameras) - usual)
    rows = [*CAMERA_GRID, *(others[first : first + 3] for first in range(0, len(others), 3))]
    cells: list[PageCamera] = []
    top = 0
    for row in rows:
        left = height = 0
        for name in (name for name in row if name in cameras):
            cell = _build_cell(cameras[name], left, top, cell_width_px)
            cells.append(cell)
            left, height = left + cell.width, max(height, cell.height)
        top += height
    return tuple(cells)


def _build_cell(camera: Camera, left: int, top: int, cell_width_px: int) -> PageCamera:
    width = min(camera.width, cell_width_px)
    height = max(round(camera.height * width / camera.width), 1)
    return PageCamera(name=camera.name, left=left, top=top, width=width, height=height)


def draw_mosaic(cells: Sequence[PageCamera], views: Mapping[str, CameraView]) -> bytes:
    """One picture of all cameras, as a WebP file; the cell of a camera without an image stays black."""
    width = max(cell.left + cell.width for cell in cells)
    height = max(cell.top + cell.height for cell in cells)
    canvas: NDArray[np.uint8] = np.zeros((height, width, 3), np.uint8)
    for cell in cells:
        if cell.name in views:
            image = views[cell.name].load()
            smaller = cv2.resize(image, (cell.width, cell.height), interpolation=cv2.INTER_AREA)
            turned = cv2.cvtColor(smaller, cv2.COLOR_RGB2BGR)
            canvas[cell.top : cell.top + cell.height, cell.left : cell.left + cell.width] = turned
    try:
        done, data = cv2.imencode(".webp", canvas, [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
    except cv2.error:
        done = False
    if not done:
        raise InputError(f"a picture of {width} x {height} pixels is too large for WebP; choose a smaller --cell-width")
    return data.tobytes()


def project_adversary_edges(
    scene: Scene, cells: Sequence[PageCamera], views: Mapping[str, CameraView]
) -> dict[str, tuple[Segment, ...]]:
    """Edges of the adversaries' 3-D boxes in a picture, each camera by its own exposure and pose.

    For each camera that sees an adversary: segments in pixels of the picture, cut at the near plane and the cell's
    borders.
    """
    edges_of_camera = {}
    adversaries = [scene.agents.ids.index(name) for name in scene.adversaries]
    for cell in cells if adversaries else ():
        if cell.name not in views:
            continue
        view = views[cell.name]
        camera = view.camera.resized(cell.width, cell.height)
        position, yaw, there = interpolate_agents(scene, view.timestamp_us)
        segments: list[Segment] = []
        for agent in adversaries:
            if there[agent]:
                corners = compute_box_corners(position[agent], float(yaw[agent]), scene.agents.size[agent])
                segments += _project_edges(to_camera(corners, view.global_T_ego, camera), camera, cell)
        if segments:
            edges_of_camera[cell.name] = tuple(segments)
    return edges_of_camera


def _project_edges(corners: Floats, camera: Camera, cell: PageCamera) -> list[Segment]:
    """Edges of one box, (8, 3) corners in camera axes."""
    segments = []
    in_front = corners[:, 2] >= NEAR_PLANE_M
    for one, other in BOX_EDGES:
        if not (in_front[one] or in_front[other]):
            continue
        ends, ahead = corners[[one, other]], in_front[[one, other]]
        if not ahead.all():
            ends[~ahead] = intersect_near_plane(ends[0], ends[1], NEAR_PLANE_M)
        projected = ends @ camera.intrinsic.T
        # An invalid matrix gives points that are not finite, and those are not drawn.
        with np.errstate(all="ignore"):
            inside = clip_segment(projected[:, :2] / projected[:, 2:], cell.width, cell.height)
        if inside is not None:
            (x1, y1), (x2, y2) = (np.round(inside + [cell.left, cell.top], 1) + 0.0).tolist()
            segments.append((x1, y1, x2, y2))
    return segments


def clip_segment(segment: Floats, width: int, height: int) -> Floats | None:
    """Part of a (2, 2) segment inside a rectangle with a corner at the origin (Liang and Barsky), pixels.

    ``None`` where nothing that could be seen is inside.
    """
    start, along = segment[0], segment[1] - segment[0]
    first, last = 0.0, 1.0
    for axis, limit in ((0, width), (1, height)):
        if along[axis] == 0:
            if not 0 <= start[axis] <= limit:
                return None
            continue
        with np.errstate(over="ignore"):  # A segment that hardly moves along an axis meets its border at infinity.
            low, high = sorted((-start[axis] / along[axis], (limit - start[axis]) / along[axis]))
        first, last = max(first, float(low)), min(last, float(high))
    if first > last:
        return None
    inside = np.stack([start + first * along, start + last * along])
    # A small distance beyond the border is rounding error.
    inside = np.clip(inside, 0.0, [width, height])
    return inside if np.abs(inside[1] - inside[0]).max() >= _LEAST_EDGE_PX else None
