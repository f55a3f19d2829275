"""Bodies as AlpaSim's evaluation has them, and which of its contacts counts: shrunk, rounded, and the last in order."""

from enum import IntEnum
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats

Shapes = NDArray[Any]
"""Polygons."""
KEPT: Final = 0.98
"""Of length and width."""
ROUNDNESS: Final = 0.5
QUARTER_SEGMENTS: Final = 16
NODE_CAPACITY: Final = 10
"""Of the tree of boxes whose order decides between contacts."""
_SAME_M: Final = 1e-9
_RAD: Final = 0.5 * np.pi / QUARTER_SEGMENTS * np.arange(QUARTER_SEGMENTS + 1)
_CORNERS: Final = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
"""Front right and on to the left, as the vertices of a body go round."""


class ContactSide(IntEnum):
    """Part of the ego's body that another touches."""

    NONE = 0
    FRONT = 1
    REAR = 2
    LATERAL = 3


def build_bodies(boxes: Floats) -> Shapes:
    """(...) rounded bodies of (..., 5) boxes x, y, length, width, yaw: 2 % smaller, corners of radius width / 4.

    Circles have 64 segments whose ends lie on them.
    """
    return _build_polygons(boxes, slice(None))


def build_slabs(boxes: Floats) -> tuple[Shapes, Shapes]:
    """The front and the rear slab of the bodies: two quarter circles each, and what lies between."""
    half = 2 * (QUARTER_SEGMENTS + 1)
    return _build_polygons(boxes, slice(None, half)), _build_polygons(boxes, slice(half, None))


def classify_contacts(ego: Floats, others: Floats, present: Bools, *, cut: bool = False) -> NDArray[np.int64]:
    """(T,) `ContactSide` of the contact that counts at each instant; touching is contact.

    Of several at once it is the last one in the order of the tree (`order_in_tree`), so that the verdict depends on
    where north is.

    Args:
        ego: (T, 5) boxes.
        others: (N, T, 5) boxes.
        present: (N, T) who is there.
        cut: Whether the nearest of the others counts at the last instant although the bodies do not touch there, by the
            part of the ego's body that is nearest to it.
    """
    sides = np.full(len(ego), ContactSide.NONE, np.int64)
    apart = np.hypot(*(others[..., :2] - ego[:, :2]).transpose(2, 0, 1))
    reach = 0.5 * (np.hypot(ego[:, 2], ego[:, 3]) + np.hypot(others[..., 2], others[..., 3]))
    rows, agents = np.nonzero((present & (apart <= reach)).T)
    bodies, near = build_bodies(ego), build_bodies(others[agents, rows])
    hit = np.asarray(shapely.intersects(bodies[rows], near), np.bool_)
    for row in np.unique(rows[hit]).tolist():
        among = np.flatnonzero(hit & (rows == row))
        chosen = (
            among[0] if len(among) == 1 else among[_find_last(ego[row], others[:, row], present[:, row], agents[among])]
        )
        sides[row] = _find_side(ego[row], near[chosen])
    if cut and not sides.any() and present[:, -1].any():
        there = build_bodies(others[present[:, -1], -1])
        sides[-1] = _find_side(ego[-1], there[int(np.argmin(shapely.distance(bodies[-1], there)))])
    return sides


def order_in_tree(bounds: Floats) -> NDArray[np.int64]:
    """Order in which a sort-tile-recursive tree of node capacity 10 lists (n, 4) envelopes: depth first.

    Up to ten come by rising y of their middle.
    """
    items = [np.array([place]) for place in range(len(bounds))]
    while len(items) > 1:
        x, y = (0.5 * (bounds[:, axis] + bounds[:, axis + 2]) for axis in range(2))
        leaves = -(-len(items) // NODE_CAPACITY)
        slices = int(np.ceil(np.sqrt(leaves)))
        width = -(-len(items) // slices)
        by_x = np.argsort(x, kind="stable")
        nodes = [
            in_slice[start : start + NODE_CAPACITY]
            for in_slice in (
                part[np.argsort(y[part], kind="stable")]
                for part in (by_x[first : first + width] for first in range(0, len(items), width))
            )
            for start in range(0, len(in_slice), NODE_CAPACITY)
        ]
        items = [np.concatenate([items[place] for place in node.tolist()]) for node in nodes]
        bounds = np.array([[*bounds[node, :2].min(axis=0), *bounds[node, 2:].max(axis=0)] for node in nodes])
    return items[0] if items else np.zeros(0, np.int64)


def _find_last(ego: Floats, others: Floats, present: Bools, touching: NDArray[np.int64]) -> int:
    """Place among the touching of the one that comes last in the tree of all who are there, the ego included."""
    there = np.flatnonzero(present)
    order = order_in_tree(shapely.bounds(build_bodies(np.concatenate([ego[None], others[there]]))))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return int(np.argmax(rank[1 + np.searchsorted(there, touching)]))


def _find_side(ego: Floats, other: Any) -> ContactSide:
    """Side of the ego that is nearest to another; front before rear before the rest where it is the same distance."""
    apart = float(shapely.distance(build_bodies(ego), other))
    slabs = zip((ContactSide.FRONT, ContactSide.REAR), build_slabs(ego), strict=True)
    return next((side for side, slab in slabs if shapely.distance(slab, other) <= apart + _SAME_M), ContactSide.LATERAL)


def _build_polygons(boxes: Floats, vertices: slice) -> Shapes:
    size = KEPT * boxes[..., 2:4]
    radius = 0.5 * ROUNDNESS * size.min(axis=-1)
    inner = _CORNERS * (0.5 * size - radius[..., None])[..., None, :]
    turn = np.add.outer(np.arange(-1, 3) * 0.5 * np.pi, _RAD)
    arcs = radius[..., None, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    points = (inner[..., None, :] + arcs).reshape(*boxes.shape[:-1], 4 * len(_RAD), 2)[..., vertices, :]
    cos, sin = np.cos(boxes[..., 4])[..., None], np.sin(boxes[..., 4])[..., None]
    x = boxes[..., :1] + points[..., 0] * cos - points[..., 1] * sin
    y = boxes[..., 1:2] + points[..., 0] * sin + points[..., 1] * cos
    return np.asarray(shapely.polygons(np.stack([x, y], axis=-1)))
