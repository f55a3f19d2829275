"""Shapes of road users, by category and size, as solids of flat facets in a unit box, and the pen that draws them."""

import functools
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats


class FacetMaterial(IntEnum):
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
class SolidShape:
    """A solid of F flat facets, (4, 3) counter-clockwise from outside, in a unit box.

    ``role`` are materials, ``layer`` the drawing order, lower first; ``ahead`` marks the part ahead of x = ``split``. A
    facet is left out where the solid appears lower than ``detail_px`` pixels.
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
    facets: list[tuple[Quad, FacetMaterial, int, bool, float]] = field(default_factory=list)

    def box(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        z: tuple[float, float],
        role: FacetMaterial,
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

    def add_decal(
        self,
        face: Quad,
        u: tuple[float, float],
        v: tuple[float, float],
        role: FacetMaterial,
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

    def add_wheels(
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
                    self.facets.append((quad, FacetMaterial.RUBBER, layer, ahead, 7.0))
                self.facets.append(
                    ([(px, y, pz) for px, pz in hub][::turn], FacetMaterial.METAL, layer + 1, ahead, 20.0)
                )

    def shape(self) -> SolidShape:
        """The finished solid."""
        quads, role, layer, ahead, detail = zip(*self.facets)
        return SolidShape(
            np.array(quads, dtype=np.float64), np.array(role), np.array(layer), np.array(ahead, dtype=np.bool_),
            np.array(detail, dtype=np.float64), self.split,
        )  # fmt: skip


def _add_lamps(
    draft: SolidDraft, faces: dict[str, Quad], *, layer: int, heights: tuple[float, float, float, float]
) -> None:
    """Head lamps on the front, tail lamps on the rear; heights are v ranges on the two faces."""
    for u in ((0.03, 0.26), (0.74, 0.97)):
        draft.add_decal(faces["front"], u, heights[:2], FacetMaterial.HEAD_LAMP, layer=layer, detail_px=4.0)
        draft.add_decal(faces["rear"], u, heights[2:], FacetMaterial.TAIL_LAMP, layer=layer, detail_px=4.0)
    draft.add_decal(faces["front"], (0.28, 0.72), (0.32, 0.72), FacetMaterial.RUBBER, layer=layer)
    draft.add_decal(faces["rear"], (0.36, 0.64), (0.30, 0.52), FacetMaterial.WHITE, layer=layer)
    for end in ("front", "rear"):
        draft.add_decal(faces[end], (0.0, 1.0), (0.0, 0.16), FacetMaterial.RUBBER, layer=layer)


def _build_car(
    cabin: tuple[float, float], inset: tuple[float, float, float], *, bonnet_drop: float, belt: float
) -> SolidShape:
    draft = SolidDraft()
    draft.box((-0.45, 0.45), (-0.42, 0.42), (0.04, 0.22), FacetMaterial.RUBBER, layer=0)
    body = draft.box(
        (-0.5, 0.5),
        (-0.5, 0.5),
        (0.14, belt),
        FacetMaterial.PAINT,
        layer=1,
        inset=(0.015, 0.03, 0.03),
        drop=bonnet_drop,
    )
    _add_lamps(draft, body, layer=2, heights=(0.58, 0.88, 0.60, 0.90))
    for side in ("left", "right"):
        draft.add_decal(body[side], (0.02, 0.98), (0.0, 0.13), FacetMaterial.RUBBER, layer=2)
    draft.add_wheels((-0.30, 0.31), 0.074, 0.20, layer=3)
    top = draft.box(cabin, (-0.46, 0.46), (belt - 0.03, 1.0), FacetMaterial.PAINT, layer=5, inset=inset)
    draft.add_decal(top["front"], (0.06, 0.94), (0.10, 0.90), FacetMaterial.GLASS, layer=6, detail_px=5.0)
    draft.add_decal(top["rear"], (0.08, 0.92), (0.18, 0.88), FacetMaterial.GLASS, layer=6, detail_px=5.0)
    for side, front_first in (("right", False), ("left", True)):
        doors = ((0.07, 0.48), (0.53, 0.95))
        for u in doors:
            low, high = (1 - u[1], 1 - u[0]) if front_first else u
            draft.add_decal(top[side], (low, high), (0.12, 0.86), FacetMaterial.GLASS, layer=6, detail_px=6.0)
    return draft.shape()


def _build_bus() -> SolidShape:
    draft = SolidDraft()
    draft.box((-0.48, 0.48), (-0.42, 0.42), (0.02, 0.12), FacetMaterial.RUBBER, layer=0)
    body = draft.box((-0.5, 0.5), (-0.5, 0.5), (0.09, 1.0), FacetMaterial.PAINT, layer=1, inset=(0.004, 0.01, 0.03))
    draft.add_decal(body["front"], (0.05, 0.95), (0.34, 0.86), FacetMaterial.GLASS, layer=2, detail_px=5.0)
    draft.add_decal(body["front"], (0.2, 0.8), (0.89, 0.97), FacetMaterial.ORANGE, layer=2)
    draft.add_decal(body["rear"], (0.12, 0.88), (0.50, 0.84), FacetMaterial.GLASS, layer=2, detail_px=5.0)
    for u in ((0.03, 0.2), (0.8, 0.97)):
        draft.add_decal(body["front"], u, (0.08, 0.18), FacetMaterial.HEAD_LAMP, layer=2, detail_px=4.0)
        draft.add_decal(body["rear"], u, (0.12, 0.26), FacetMaterial.TAIL_LAMP, layer=2, detail_px=4.0)
    for side in ("left", "right"):
        for pane in range(7):
            draft.add_decal(
                body[side], (0.03 + 0.135 * pane, 0.15 + 0.135 * pane), (0.42, 0.84), FacetMaterial.GLASS, layer=2
            )
        draft.add_decal(body[side], (0.0, 1.0), (0.14, 0.24), FacetMaterial.CARGO, layer=2, detail_px=20.0)
    draft.add_wheels((-0.28, 0.33), 0.046, 0.16, layer=3)
    return draft.shape()


def _build_truck() -> SolidShape:
    draft = SolidDraft(split=0.24)
    draft.box((-0.49, 0.49), (-0.38, 0.38), (0.08, 0.20), FacetMaterial.RUBBER, layer=0)
    cargo = draft.box((-0.5, 0.22), (-0.5, 0.5), (0.19, 1.0), FacetMaterial.CARGO, layer=1)
    draft.add_decal(cargo["rear"], (0.47, 0.53), (0.04, 0.96), FacetMaterial.METAL, layer=2)
    for u in ((0.02, 0.16), (0.84, 0.98)):
        draft.add_decal(cargo["rear"], u, (0.02, 0.12), FacetMaterial.TAIL_LAMP, layer=2, detail_px=4.0)
    for side in ("left", "right"):
        draft.add_decal(cargo[side], (0.0, 1.0), (0.0, 0.07), FacetMaterial.METAL, layer=2)
    draft.add_wheels((-0.34, -0.22), 0.055, 0.16, layer=3)
    cab = draft.box(
        (0.26, 0.5), (-0.47, 0.47), (0.10, 0.82), FacetMaterial.PAINT, layer=1, inset=(0.0, 0.035, 0.03), ahead=True
    )
    draft.add_decal(cab["front"], (0.06, 0.94), (0.52, 0.92), FacetMaterial.GLASS, layer=2, ahead=True, detail_px=5.0)
    draft.add_decal(cab["front"], (0.25, 0.75), (0.16, 0.42), FacetMaterial.RUBBER, layer=2, ahead=True)
    for u in ((0.03, 0.2), (0.8, 0.97)):
        draft.add_decal(cab["front"], u, (0.12, 0.26), FacetMaterial.HEAD_LAMP, layer=2, ahead=True, detail_px=4.0)
    for side, u in (("right", (0.35, 0.9)), ("left", (0.1, 0.65))):
        draft.add_decal(cab[side], u, (0.55, 0.9), FacetMaterial.GLASS, layer=2, ahead=True)
    draft.add_wheels((0.36,), 0.055, 0.16, layer=3, ahead=True)
    return draft.shape()


def _build_trailer() -> SolidShape:
    draft = SolidDraft()
    draft.box((-0.48, 0.48), (-0.38, 0.38), (0.08, 0.28), FacetMaterial.RUBBER, layer=0)
    body = draft.box((-0.5, 0.5), (-0.5, 0.5), (0.26, 1.0), FacetMaterial.CARGO, layer=1)
    draft.add_decal(body["rear"], (0.47, 0.53), (0.04, 0.96), FacetMaterial.METAL, layer=2)
    for u in ((0.02, 0.16), (0.84, 0.98)):
        draft.add_decal(body["rear"], u, (0.02, 0.12), FacetMaterial.TAIL_LAMP, layer=2, detail_px=4.0)
    draft.add_wheels((-0.36, -0.25), 0.05, 0.14, layer=3)
    return draft.shape()


def _build_construction_vehicle() -> SolidShape:
    draft = SolidDraft(split=0.1)
    draft.box((-0.5, 0.1), (-0.5, 0.5), (0.0, 0.28), FacetMaterial.RUBBER, layer=0)
    draft.box((-0.5, 0.08), (-0.44, 0.44), (0.28, 0.62), FacetMaterial.ORANGE, layer=1)
    cabin = draft.box((-0.3, 0.05), (-0.34, 0.34), (0.62, 1.0), FacetMaterial.ORANGE, layer=2, inset=(0.02, 0.02, 0.02))
    for side in ("front", "rear", "left", "right"):
        draft.add_decal(cabin[side], (0.1, 0.9), (0.15, 0.85), FacetMaterial.GLASS, layer=3)
    draft.box(
        (0.12, 0.5),
        (-0.2, 0.2),
        (0.2, 0.6),
        FacetMaterial.ORANGE,
        layer=1,
        inset=(0.0, 0.1, 0.05),
        drop=0.2,
        ahead=True,
    )
    draft.add_wheels((-0.36, -0.06), 0.1, 0.18, layer=4)
    return draft.shape()


def _build_cycle(*, motor: bool) -> SolidShape:
    """Two wheels, a frame and a rider, who leans a little forward."""
    draft = SolidDraft()
    thick = 0.10 if motor else 0.06
    for x in (-0.33, 0.33):
        draft.box(
            (x - 0.13, x + 0.13), (-thick, thick), (0.02, 0.34), FacetMaterial.RUBBER, layer=0, inset=(0.03, 0.03, 0.0)
        )
    draft.add_wheels((-0.33, 0.33), 0.17, 0.18, layer=0, side=thick + 0.005)
    frame = draft.box((-0.36, 0.36), (-1.8 * thick, 1.8 * thick), (0.26, 0.52), FacetMaterial.PAINT, layer=1)
    draft.box((0.22, 0.30), (-0.45, 0.45), (0.56, 0.62), FacetMaterial.METAL, layer=2, detail_px=12.0)
    draft.add_decal(frame["front"], (0.1, 0.9), (0.5, 0.95), FacetMaterial.HEAD_LAMP, layer=2, detail_px=8.0)
    draft.add_decal(frame["rear"], (0.1, 0.9), (0.4, 0.8), FacetMaterial.TAIL_LAMP, layer=2, detail_px=8.0)
    draft.box((-0.16, 0.10), (-0.26, 0.26), (0.22, 0.52), FacetMaterial.TROUSERS, layer=2)
    draft.box((-0.18, 0.14), (-0.40, 0.40), (0.50, 0.84), FacetMaterial.CLOTH, layer=3, inset=(0.06, -0.02, 0.06))
    head = draft.box((-0.03, 0.14), (-0.17, 0.17), (0.85, 1.0), FacetMaterial.HAIR, layer=4, inset=(0.02, 0.02, 0.04))
    draft.add_decal(head["front"], (0.1, 0.9), (0.1, 0.7), FacetMaterial.SKIN, layer=5)
    return draft.shape()


def _build_pedestrian() -> SolidShape:
    draft = SolidDraft()
    for y in (-0.17, 0.17):
        draft.box((-0.18, 0.18), (y - 0.13, y + 0.13), (0.0, 0.48), FacetMaterial.TROUSERS, layer=0)
    draft.box((-0.24, 0.24), (-0.38, 0.38), (0.45, 0.83), FacetMaterial.CLOTH, layer=1, inset=(0.03, 0.03, 0.05))
    for y in (-0.43, 0.43):
        draft.box((-0.12, 0.12), (y - 0.07, y + 0.07), (0.42, 0.81), FacetMaterial.CLOTH, layer=1, detail_px=16.0)
    head = draft.box((-0.19, 0.19), (-0.17, 0.17), (0.86, 1.0), FacetMaterial.HAIR, layer=2, inset=(0.04, 0.04, 0.03))
    draft.add_decal(head["front"], (0.0, 1.0), (0.0, 0.75), FacetMaterial.SKIN, layer=3, detail_px=8.0)
    for side, u in (("left", (0.0, 0.6)), ("right", (0.4, 1.0))):
        draft.add_decal(head[side], u, (0.0, 0.6), FacetMaterial.SKIN, layer=3, detail_px=16.0)
    return draft.shape()


def _build_cone() -> SolidShape:
    draft = SolidDraft()
    draft.box((-0.5, 0.5), (-0.5, 0.5), (0.0, 0.07), FacetMaterial.RUBBER, layer=0)
    inset = 0.15
    lower = draft.box(
        (-0.36, 0.36), (-0.36, 0.36), (0.07, 1.0), FacetMaterial.ORANGE, layer=1, inset=(0.27, 0.27, 0.27)
    )
    for side in ("front", "rear", "left", "right"):
        draft.add_decal(lower[side], (0.0, 1.0), (0.45, 0.45 + inset), FacetMaterial.WHITE, layer=2, detail_px=6.0)
    return draft.shape()


def _build_barrier() -> SolidShape:
    draft = SolidDraft()
    body = draft.box((-0.5, 0.5), (-0.5, 0.5), (0.0, 1.0), FacetMaterial.WHITE, layer=0, inset=(0.1, 0.1, 0.05))
    for side in ("front", "rear", "left", "right"):
        for stripe in range(3):
            u = (0.04 + 0.34 * stripe, 0.20 + 0.34 * stripe)
            draft.add_decal(body[side], u, (0.3, 0.9), FacetMaterial.ORANGE, layer=1, detail_px=6.0)
    return draft.shape()


def _build_crate(role: FacetMaterial) -> SolidShape:
    draft = SolidDraft()
    draft.box((-0.5, 0.5), (-0.5, 0.5), (0.0, 1.0), role, layer=0, inset=(0.08, 0.08, 0.08))
    return draft.shape()


def _add_emergency_lights(base: SolidShape) -> SolidShape:
    draft = SolidDraft()
    draft.box((-0.14, -0.04), (-0.34, 0.34), (1.0, 1.08), FacetMaterial.BEACON, layer=8)
    bar = draft.shape()
    joined = {name: np.concatenate([getattr(base, name), getattr(bar, name)]) for name in SolidShape.__slots__[:-1]}
    return SolidShape(**joined, split=base.split)


@functools.cache
def _build_shapes() -> dict[str, SolidShape]:
    sedan = _build_car((-0.38, 0.24), (0.13, 0.17, 0.09), bonnet_drop=0.05, belt=0.60)
    return {
        "sedan": sedan,
        "suv": _build_car((-0.48, 0.22), (0.05, 0.14, 0.08), bonnet_drop=0.03, belt=0.60),
        "van": _build_car((-0.49, 0.36), (0.01, 0.12, 0.05), bonnet_drop=0.06, belt=0.50),
        "truck": _build_truck(),
        "bus": _build_bus(),
        "trailer": _build_trailer(),
        "construction": _build_construction_vehicle(),
        "emergency": _add_emergency_lights(sedan),
        "motorcycle": _build_cycle(motor=True),
        "bicycle": _build_cycle(motor=False),
        "pedestrian": _build_pedestrian(),
        "cone": _build_cone(),
        "barrier": _build_barrier(),
        "crate": _build_crate(FacetMaterial.CARGO),
        "rack": _build_crate(FacetMaterial.METAL),
        "animal": _build_crate(FacetMaterial.HAIR),
    }


def get_shape(name: str) -> SolidShape:
    """A shape by the name that `choose_shape_name` gives."""
    return _build_shapes()[name]


def choose_shape_name(category: str, size: Floats) -> str:
    """Name of an object's shape, for `get_shape`, by (length, width, height); an unknown category is a crate."""
    if category == "vehicle.car":
        return "van" if size[2] > 2.0 else ("suv" if size[2] > 1.66 else "sedan")
    if category == "vehicle.emergency.ambulance":
        return "van"
    by_prefix = {
        "vehicle.emergency": "emergency",
        "vehicle.truck": "truck",
        "vehicle.bus": "bus",
        "vehicle.trailer": "trailer",
        "vehicle.construction": "construction",
        "vehicle.motorcycle": "motorcycle",
        "vehicle.bicycle": "bicycle",
        "human": "pedestrian",
        "movable_object.trafficcone": "cone",
        "movable_object.barrier": "barrier",
        "static_object.bicycle_rack": "rack",
        "animal": "animal",
    }
    return next((name for prefix, name in by_prefix.items() if category.startswith(prefix)), "crate")
