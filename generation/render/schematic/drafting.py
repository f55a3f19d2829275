"""Solids of flat facets in a unit box, and the pen that draws them.

Unit coordinates: x from -0.5 (rear) to 0.5 (front), y from -0.5 (right) to 0.5 (left), z from 0 (ground) to 1 (top).
Parts that lie above each other have rising layers; parts that lie behind each other are told apart by ``split``.
"""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats


class Role(IntEnum):
    """Material of a facet; decides its colour."""

    PAINT = 0
    GLASS = 1
    RUBBER = 2
    METAL = 3
    HEAD_LAMP = 4
    TAIL_LAMP = 5
    SKIN = 6
    CLOTH = 7
    TROUSERS = 8
    WHITE = 9
    ORANGE = 10
    CARGO = 11
    HAIR = 12
    BEACON = 13


@dataclass(frozen=True, slots=True)
class Shape:
    """A solid of flat facets in a unit box.

    Attributes:
        quads: (F, 4, 3) corners, counter-clockwise seen from outside.
        role: (F,) materials.
        layer: (F,) drawing order, lower first.
        ahead: (F,) whether the facet belongs to the part ahead of ``split``.
        detail_px: (F,) the facet is left out where the solid appears lower than this many pixels.
        split: x of the plane between the front and the rear part.
    """

    quads: Floats
    role: NDArray[np.int64]
    layer: NDArray[np.int64]
    ahead: Bools
    detail_px: Floats
    split: float


Quad = list[tuple[float, float, float]]


@dataclass
class SolidDraft:
    """Facets being collected."""

    split: float = 0.0
    facets: list[tuple[Quad, Role, int, bool, float]] = field(default_factory=list)

    def box(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        z: tuple[float, float],
        role: Role,
        *,
        layer: int,
        inset: tuple[float, float, float] = (0.0, 0.0, 0.0),
        drop: float = 0.0,
        ahead: bool = False,
        detail_px: float = 0.0,
    ) -> dict[str, Quad]:
        """Add a box whose top is drawn in by ``inset`` (rear, front, sides) and lower in front by ``drop``."""
        (x0, x1), (y0, y1), (z0, z1) = x, y, z
        rear, front, side = inset
        low = [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)]
        top = [
            (x0 + rear, y0 + side, z1),
            (x1 - front, y0 + side, z1 - drop),
            (x1 - front, y1 - side, z1 - drop),
            (x0 + rear, y1 - side, z1),
        ]
        faces = {
            "front": [low[1], low[2], top[2], top[1]],
            "rear": [low[3], low[0], top[0], top[3]],
            "right": [low[0], low[1], top[1], top[0]],
            "left": [low[2], low[3], top[3], top[2]],
            "top": top,
        }
        for face in faces.values():
            self.facets.append((face, role, layer, ahead, detail_px))
        return faces

    def decal(
        self,
        face: Quad,
        u: tuple[float, float],
        v: tuple[float, float],
        role: Role,
        *,
        layer: int,
        ahead: bool = False,
        detail_px: float = 12.0,
    ) -> None:
        """Paint part of a face: ``u`` from its right to its left edge seen along its lower side, ``v`` upwards."""
        a, b, c, d = (np.array(corner) for corner in face)

        def at(s: float, t: float) -> tuple[float, float, float]:
            point = (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * d + s * c)
            return float(point[0]), float(point[1]), float(point[2])

        quad = [at(u[0], v[0]), at(u[1], v[0]), at(u[1], v[1]), at(u[0], v[1])]
        self.facets.append((quad, role, layer, ahead, detail_px))

    def wheels(
        self,
        at_x: tuple[float, ...],
        radius_x: float,
        radius_z: float,
        *,
        layer: int,
        ahead: bool = False,
        side: float = 0.505,
    ) -> None:
        """Round wheels at y = +-``side``, each an octagon of three facets and a rim."""
        angle = np.pi / 8 + np.arange(8) * np.pi / 4
        for x in at_x:
            rim = [(x + radius_x * np.cos(a), radius_z * (1 + np.sin(a))) for a in angle]
            hub = [(x + 0.5 * radius_x * np.cos(a), radius_z * (1 + 0.5 * np.sin(a))) for a in angle[::2]]
            pieces = [
                (rim[5], rim[6], rim[7], rim[4]),
                (rim[4], rim[7], rim[0], rim[3]),
                (rim[3], rim[0], rim[1], rim[2]),
            ]
            for y, turn in ((-side, 1), (side, -1)):
                for piece in pieces:
                    quad = [(px, y, pz) for px, pz in piece][::turn]
                    self.facets.append((quad, Role.RUBBER, layer, ahead, 7.0))
                self.facets.append(([(px, y, pz) for px, pz in hub][::turn], Role.METAL, layer + 1, ahead, 20.0))

    def shape(self) -> Shape:
        """The finished solid."""
        quads, role, layer, ahead, detail = zip(*self.facets)
        return Shape(
            np.array(quads, dtype=np.float64), np.array(role), np.array(layer), np.array(ahead, dtype=np.bool_),
            np.array(detail, dtype=np.float64), self.split,
        )  # fmt: skip
