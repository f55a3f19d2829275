"""Vehicles' 3-D boxes as polygons in a camera image, and what of each nearer ones leave visible."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from shapely.errors import GEOSException
from shapely.geometry import MultiPoint, Polygon
from shapely.geometry import box as rectangle

from benchmark.box_projection import BOX_EDGES, agents_at, at_near_plane, corners_of_box, to_camera
from benchmark.geometry import Bools, Floats
from benchmark.planning import CameraView
from benchmark.scene import Camera, Scene

_SUBPIXEL_BITS: Final = 6


@dataclass(frozen=True, slots=True)
class ProjectedBox:
    """One vehicle in one image.

    Attributes:
        polygon: (P, 2) convex outline inside the image, pixels.
        distance_m: From the camera to the box centre.
    """

    instance: str
    category: str
    polygon: Floats
    distance_m: float

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom, pixels."""
        low, high = self.polygon.min(axis=0), self.polygon.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def filled(self, height: int, width: int) -> Bools:
        """(height, width) which pixels lie inside."""
        canvas = np.zeros((height, width), np.uint8)
        # A pixel's middle is at its index plus one half.
        points = np.rint((self.polygon - 0.5) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
        cv2.fillConvexPoly(canvas, points, (1.0,), lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)
        return canvas.astype(bool)


def boxes_in_view(
    scene: Scene, view: CameraView, size: tuple[int, int], categories: Sequence[str], near_m: float
) -> tuple[ProjectedBox, ...]:
    """Project every vehicle that is there when an image was taken, in the order of the scene's agents.

    Positions are interpolated between the scene's frames; boxes without a point in the image are left out.

    Args:
        size: Width and height of the pixels that are wanted.
        near_m: Boxes are cut off so far in front of the camera.
    """
    camera = view.camera.resized(*size)
    poses = agents_at(scene, view.timestamp_us)
    found = []
    for agent, (position, yaw, there) in enumerate(zip(*poses)):
        if not there or scene.agents.categories[agent] not in categories:
            continue
        corners = corners_of_box(position, float(yaw), scene.agents.size[agent])
        in_camera = to_camera(np.vstack([corners, position]), view.global_T_ego, camera)
        polygon = _outline(in_camera[:8], camera, near_m)
        if polygon is None:
            continue
        distance_m = float(np.linalg.norm(in_camera[8]))
        found.append(ProjectedBox(scene.agents.ids[agent], scene.agents.categories[agent], polygon, distance_m))
    return tuple(found)


def visible_parts(boxes: Sequence[ProjectedBox], height: int, width: int) -> dict[str, Bools]:
    """Pixels that nearer boxes leave of each box in one image, (height, width) by instance.

    Equally near boxes hide in the order of their identifiers.
    """
    hidden = np.zeros((height, width), bool)
    parts = {}
    for box in sorted(boxes, key=lambda box: (box.distance_m, box.instance)):
        filled = box.filled(height, width)
        parts[box.instance] = filled & ~hidden
        hidden |= filled
    return parts


def _outline(corners: Floats, camera: Camera, near_m: float) -> Floats | None:
    """(P, 2) convex outline of what lies in front of the camera and in the image; ``None`` if nothing does."""
    ahead = corners[:, 2] >= near_m
    if not ahead.any():
        return None
    points = [corners[ahead]]
    for first, second in BOX_EDGES:
        if ahead[first] != ahead[second]:
            points.append(at_near_plane(corners[first], corners[second], near_m)[None])
    projected = np.vstack(points) @ camera.intrinsic.T
    pixels = projected[:, :2] / projected[:, 2:]
    try:
        hull = MultiPoint(pixels).convex_hull
        inside = hull.intersection(rectangle(0, 0, camera.width, camera.height))
    except GEOSException:
        return None
    if not isinstance(inside, Polygon) or inside.area <= 0:
        return None
    return np.asarray(inside.exterior.coords[:-1], np.float64)


def scaled_size(width: int, height: int, longer_side_px: int) -> tuple[int, int]:
    """Width and height of a picture after its longer side was brought down to a limit; never enlarged."""
    longer = max(width, height)
    if longer <= longer_side_px:
        return width, height
    return max(round(width * longer_side_px / longer), 1), max(round(height * longer_side_px / longer), 1)


def reduced(image: NDArray[np.uint8], longer_side_px: int) -> NDArray[np.uint8]:
    """A (height, width, 3) picture brought down to a longer side by averaging areas.

    Smaller ones are left as they are.
    """
    height, width = image.shape[:2]
    size = scaled_size(width, height, longer_side_px)
    return image if size == (width, height) else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
