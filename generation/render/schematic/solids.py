"""Drawing what stands on the ground: shadows, then solids from far to near, as every separating line orders them."""

import functools
import heapq

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, wrap_angle
from generation.render.schematic.atmosphere import Atmosphere
from generation.render.schematic.painting import SHIFT, to_fixed_point
from generation.render.schematic.roadside import Facets
from generation.render.schematic.view import NEAR_M, PlacedCamera, clip_near

_NEXT = (1, 2, 3, 0)
"""Of each corner the one that follows."""


def compute_drawing_order(footprints: Floats, eye: Floats) -> list[int]:
    """Order upright convex solids so that each is drawn after everything that it can hide.

    Of two solids seen in the same direction, the one whose farthest point is nearer than the other's nearest point is
    in front; where their distances overlap, a line along one of their sides that separates them decides: the solid on
    the eye's side is in front. (N, 4, 2) footprints are counter-clockwise, metres.
    """
    behind = _is_behind(np.asarray(footprints, np.float64) - np.asarray(eye, np.float64))
    offset = footprints - eye
    farthest = np.hypot(offset[..., 0], offset[..., 1]).max(axis=1, initial=0.0)
    return _sort_topologically(behind, farthest)


def _is_behind(corners: Floats) -> Bools:
    """(N, N) whether the first solid must be drawn before the second; corners relative to the eye."""
    nearest, farthest = _compute_distances(corners)
    centre = corners.mean(axis=1)
    bearing = np.arctan2(centre[:, 1], centre[:, 0])
    spread = wrap_angle(np.arctan2(corners[..., 1], corners[..., 0]) - bearing[:, None])
    low, high = spread.min(axis=1), spread.max(axis=1)
    # A solid beside or around the eye can fill any direction.
    wide = (high - low > 0.9 * np.pi) | (nearest == 0.0)
    low, high = np.where(wide, -np.pi, low), np.where(wide, np.pi, high)
    turn = wrap_angle(bearing[None, :] - bearing[:, None])
    same_direction = (turn + low[None, :] <= high[:, None]) & (turn + high[None, :] >= low[:, None])
    np.fill_diagonal(same_direction, False)
    behind = same_direction & (nearest[:, None] >= farthest[None, :])
    unclear = np.argwhere(np.triu(same_direction & ~behind & ~behind.T))
    if len(unclear):
        first, second = unclear.T
        first_is_behind = _is_first_behind(corners[first], corners[second])
        behind[first, second] = first_is_behind
        behind[second, first] = ~first_is_behind
    return np.asarray(behind)


def _compute_distances(corners: Floats) -> tuple[Floats, Floats]:
    """Nearest and farthest distance of each footprint from the eye; zero where the eye is inside."""
    side = corners[:, _NEXT] - corners
    length_sq = np.maximum((side**2).sum(axis=-1), 1e-12)
    share = np.clip(-(corners * side).sum(axis=-1) / length_sq, 0.0, 1.0)
    foot = corners + share[..., None] * side
    nearest = np.hypot(foot[..., 0], foot[..., 1]).min(axis=1)
    inside = (side[..., 0] * -corners[..., 1] - side[..., 1] * -corners[..., 0] >= 0.0).all(axis=1)
    return np.where(inside, 0.0, nearest), np.hypot(corners[..., 0], corners[..., 1]).max(axis=1)


def _is_first_behind(first: Floats, second: Floats) -> Bools:
    """(P,) verdicts for pairs whose distances overlap; the eye is the origin."""
    centre_distance = [np.hypot(*shape.mean(axis=1).T) for shape in (first, second)]
    verdict = np.asarray(centre_distance[0] > centre_distance[1])
    best = np.full(len(first), -1e-3)
    for own, other, own_is_first in ((first, second, True), (second, first, False)):
        side = own[:, _NEXT] - own
        normal = np.stack([side[..., 1], -side[..., 0]], axis=-1)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        offset = (normal * own).sum(axis=-1)
        clearance = (np.einsum("pki,pci->pkc", normal, other) - offset[..., None]).min(axis=-1)
        for index in range(4):
            better = clearance[:, index] > best
            # The eye (origin) is beyond this side where the offset is negative: then the other solid is in front.
            own_is_behind = offset[:, index] < 0.0
            verdict = np.where(better, own_is_behind == own_is_first, verdict)
            best = np.where(better, clearance[:, index], best)
    return verdict


def _sort_topologically(behind: Bools, farthest: Floats) -> list[int]:
    """Far to near; a cycle (solids that interlock) is opened at its farthest member."""
    waiting = behind.sum(axis=0).tolist()
    in_front: list[list[int]] = [[] for _ in range(len(behind))]
    for first, second in np.argwhere(behind).tolist():
        in_front[first].append(second)
    distance = farthest.tolist()
    ready = [(-distance[index], index) for index, count in enumerate(waiting) if count == 0]
    heapq.heapify(ready)
    order: list[int] = []
    done = [False] * len(behind)
    while len(order) < len(behind):
        if ready:
            index = heapq.heappop(ready)[1]
        else:
            index = max((i for i in range(len(behind)) if not done[i]), key=lambda i: distance[i])
        if done[index]:
            continue
        done[index] = True
        order.append(index)
        for other in in_front[index]:
            waiting[other] -= 1
            if waiting[other] == 0 and not done[other]:
                heapq.heappush(ready, (-distance[other], other))
    return order


_PART_STEP = 64


def draw_solids(image: NDArray[np.uint8], view: PlacedCamera, facets: Facets, colours: NDArray[np.uint8]) -> None:
    """Draw solids with correct occlusion into an (h, w, 3) RGB; (Q, 3) colours are of `compute_seen_colours`."""
    in_view = _find_solids_in_view(view, facets)
    if not len(in_view):
        return
    order = in_view[compute_drawing_order(facets.footprint[in_view], view.eye[:2])]
    rank = np.full(len(facets.footprint), -1)
    rank[order] = np.arange(len(order))
    depth = np.maximum((facets.centre - view.eye) @ view.rotation[2], 1.0)
    apparent_px = view.camera.intrinsic[1, 1] * facets.height / depth
    apparent_px *= 256.0 / max(view.camera.height, 256)
    drawn = np.flatnonzero((rank >= 0)[facets.solid])
    drawn = drawn[apparent_px[facets.solid[drawn]] >= facets.detail_px[drawn]]
    drawn = drawn[((view.eye - facets.quads[drawn, 0]) * facets.normal[drawn]).sum(axis=-1) > 0.0]
    solid = facets.solid[drawn]
    eye_is_ahead = (facets.split[:, :2] @ view.eye[:2]) > facets.split[:, 2]
    in_front = facets.ahead[drawn] == eye_is_ahead[solid]
    key = (rank[solid] * 2 + in_front) * _PART_STEP + facets.layer[drawn]
    drawn = drawn[np.lexsort((facets.batch[drawn], key))]
    _fill(image, view, facets, colours, drawn)


def draw_shadows(image: NDArray[np.uint8], view: PlacedCamera, footprints: Floats, air: Atmosphere) -> None:
    """Darken the ground in an (h, w, 3) RGB image, softly, in place, around (N, 4, 2) footprints, before the solids."""
    if not len(footprints) or air.shadow == 0.0:
        return
    centre = footprints.mean(axis=1, keepdims=True)
    lean = -0.35 * np.array(air.sun[:2]) / max(air.sun[2], 0.3)
    # Wide and light ones first, narrow and dark ones over them.
    parts = [centre + (footprints - centre) * grow + lean * offset for grow, offset in ((1.10, 1.0), (1.0, 0.4))]
    outline = np.concatenate(parts)
    ground = np.concatenate([outline, np.full((*outline.shape[:2], 1), view.ground_z)], axis=-1)
    visible, polygons = _project_to_image(view, view.to_camera(ground))
    if not len(visible):
        return
    mask = np.full(image.shape[:2], 255, dtype=np.uint8)
    for index, pixels in zip(visible.tolist(), polygons):
        share = 0.45 if index < len(footprints) else 1.0
        cv2.fillConvexPoly(mask, pixels, (255 * (1 - share * air.shadow),), cv2.LINE_AA, SHIFT)
    size = max(3, image.shape[0] // 64 | 1)
    part = _compute_image_window(polygons, size + 2, image.shape)
    if not image[part].size:
        return
    soft = cv2.blur(mask[part], (size, size))
    image[part] = cv2.multiply(image[part], cv2.merge([soft, soft, soft]), scale=1.0 / 255.0)


def _compute_image_window(
    polygons: list[NDArray[np.int32]], margin: int, shape: tuple[int, ...]
) -> tuple[slice, slice]:
    """Rows and columns of an image that polygons in fixed point lie in, with a margin in pixels."""
    points = np.concatenate(polygons) >> SHIFT
    (left, top), (right, bottom) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    rows = slice(max(top - margin, 0), max(min(bottom + margin + 1, shape[0]), 0))
    columns = slice(max(left - margin, 0), max(min(right + margin + 1, shape[1]), 0))
    return rows, columns


def _find_solids_in_view(view: PlacedCamera, facets: Facets) -> NDArray[np.int64]:
    """Indices of solids whose sphere touches the view's pyramid."""
    if not len(facets.footprint):
        return np.zeros(0, dtype=np.int64)
    in_camera = view.to_camera(facets.centre)
    sides = _compute_view_pyramid(view.camera.width, view.camera.height, view.camera.intrinsic.tobytes())
    inside = (in_camera @ sides.T > -facets.radius[:, None]).all(axis=1) & (in_camera[:, 2] > NEAR_M - facets.radius)
    return np.flatnonzero(inside)


@functools.lru_cache(maxsize=64)
def _compute_view_pyramid(width: int, height: int, intrinsic: bytes) -> Floats:
    """(4, 3) inward normals of the sides of what a camera sees, in camera axes."""
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], dtype=np.float64)
    rays = corners @ np.linalg.inv(np.frombuffer(intrinsic, np.float64).reshape(3, 3)).T
    sides = np.cross(rays, np.roll(rays, -1, axis=0))
    return np.asarray(sides / np.linalg.norm(sides, axis=1, keepdims=True))


def _project_to_image(view: PlacedCamera, in_camera: Floats) -> tuple[NDArray[np.int64], list[NDArray[np.int32]]]:
    """Which quadrilaterals (Q, 4, 3) can touch the image, and their pixels, clipped at the near plane."""
    depth = in_camera[..., 2]
    ahead = depth > NEAR_M
    corners_ahead = ahead.sum(axis=1)
    cut = (corners_ahead > 0) & (corners_ahead < 4)
    homogeneous = (in_camera.reshape(-1, 3) @ view.camera.intrinsic.T).reshape(in_camera.shape)
    pixels = homogeneous[..., :2] / np.where(ahead, depth, 1.0)[..., None]
    x, y = pixels[..., 0], pixels[..., 1]
    outside = (x < -1).all(axis=1) | (y < -1).all(axis=1)
    outside |= (x > view.camera.width).all(axis=1) | (y > view.camera.height).all(axis=1)
    visible = np.flatnonzero(cut | ((corners_ahead == 4) & ~outside))
    polygons = list(to_fixed_point(pixels[visible]))
    for index in np.flatnonzero(cut[visible]).tolist():
        polygons[index] = to_fixed_point(view.to_pixels(clip_near(in_camera[visible[index]])))
    return visible, polygons


def _fill(
    image: NDArray[np.uint8], view: PlacedCamera, facets: Facets, colours: NDArray[np.uint8], drawn: NDArray[np.int64]
) -> None:
    visible, polygons = _project_to_image(view, view.to_camera(facets.quads[drawn]))
    drawn = drawn[visible]
    batch = facets.batch[drawn]
    starts = np.flatnonzero(np.diff(batch, prepend=-1)).tolist()
    shades = colours[drawn[starts]].tolist() if starts else []
    for start, stop, shade in zip(starts, [*starts[1:], len(polygons)], shades):
        if stop - start == 1:
            cv2.fillConvexPoly(image, polygons[start], shade, cv2.LINE_AA, SHIFT)
        else:
            cv2.fillPoly(image, polygons[start:stop], shade, cv2.LINE_AA, SHIFT)
