"""Flat facets in the world: what agents, buildings and trees become before any camera looks at them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from generation.render.schematic.atmosphere import Atmosphere


@dataclass(frozen=True, slots=True)
class Facets:
    """Q quadrilaterals that belong to N upright solids.

    Attributes:
        quads: (Q, 4, 3) corners, metres, global, counter-clockwise seen from outside.
        normal: (Q, 3) outward unit normals.
        colour: (Q, 3) RGB under white light.
        glows: (Q,) whether the facet is a light source.
        solid: (Q,) which solid it belongs to.
        layer: (Q,) drawing order within the part.
        ahead: (Q,) whether it belongs to the part ahead of the solid's split plane.
        detail_px: (Q,) the facet is left out where its solid appears lower than this.
        batch: (Q,) facets of one batch have one colour and layer and are filled together.
        footprint: (N, 4, 2) outlines on the ground.
        centre: (N, 3) metres.
        height: (N,) metres.
        radius: (N,) of the circumscribed sphere, metres.
        split: (N, 3) split plane a x + b y = c, with (a, b) pointing ahead.
    """

    quads: Floats
    normal: Floats
    colour: Floats
    glows: Bools
    solid: NDArray[np.int64]
    layer: NDArray[np.int64]
    ahead: Bools
    detail_px: Floats
    batch: NDArray[np.int64]
    footprint: Floats
    centre: Floats
    height: Floats
    radius: Floats
    split: Floats

    @classmethod
    def none(cls) -> "Facets":
        """No facets."""
        return cls(
            np.zeros((0, 4, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.bool_), np.zeros(0, np.int64),
            np.zeros(0, np.int64), np.zeros(0, np.bool_), np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 4, 2)),
            np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 3)),
        )  # fmt: skip

    def solids(self, chosen: NDArray[np.int64]) -> tuple["Facets", NDArray[np.int64]]:
        """Some of the solids, renumbered, and the indices of their facets; ``chosen`` are rising."""
        renumbered = np.full(len(self.footprint), -1)
        renumbered[chosen] = np.arange(len(chosen))
        solid = renumbered[self.solid]
        kept = np.flatnonzero(solid >= 0)
        by_solid = {name: getattr(self, name)[chosen] for name in _BY_SOLID}
        by_facet = {name: getattr(self, name)[kept] for name in _BY_FACET if name != "solid"}
        return Facets(**by_facet, **by_solid, solid=solid[kept]), kept


_BY_SOLID = ("footprint", "centre", "height", "radius", "split")
_BY_FACET = ("quads", "normal", "colour", "glows", "solid", "layer", "ahead", "detail_px", "batch")


def joined(parts: list[Facets]) -> Facets:
    """Several sets of facets as one; solids and batches are renumbered."""
    if not parts:
        return Facets.none()
    fields = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _BY_SOLID + _BY_FACET}
    solid_starts = np.cumsum([0] + [len(part.footprint) for part in parts])
    batch_starts = np.cumsum([0] + [int(part.batch.max(initial=-1)) + 1 for part in parts])
    fields["solid"] = np.concatenate([part.solid + start for part, start in zip(parts, solid_starts)])
    fields["batch"] = np.concatenate([part.batch + start for part, start in zip(parts, batch_starts)])
    return Facets(**fields)


def unit_normals(quads: Floats) -> Floats:
    """Outward unit normals, (..., 3), of (..., 4, 3) corners from the diagonals; zero where degenerate."""
    normal = np.cross(quads[..., 2, :] - quads[..., 0, :], quads[..., 3, :] - quads[..., 1, :])
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12))


def seen_colours(facets: Facets, air: Atmosphere, ego_pose: Floats) -> NDArray[np.uint8]:
    """Colours, (Q, 3) RGB, after light, head lamps and haze.

    Head lamps and distance refer to the (3,) planar pose.
    """
    sun = np.array(air.sun) / np.linalg.norm(air.sun)
    # Half the light wraps around to the side away from the sun, as it does under an open sky.
    facing = np.maximum(0.4 + 0.6 * (facets.normal @ sun), 0.0)
    ambient = 0.86 + 0.14 * facets.normal[:, 2]
    light = (1.0 - air.sun_share) * ambient + air.sun_share * 1.15 * facing
    offset = facets.centre[:, :2] - ego_pose[:2]
    cos, sin = np.cos(ego_pose[2]), np.sin(ego_pose[2])
    ahead, left = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
    beam = air.beam_at(ahead, left)[facets.solid]
    # The lamps light what faces the ego.
    towards = -(facets.normal[:, 0] * offset[facets.solid, 0] + facets.normal[:, 1] * offset[facets.solid, 1])
    beam = beam * np.clip(towards / np.maximum(np.hypot(*offset[facets.solid].T), 1e-6), 0.15, 1.0)
    lit = facets.colour * (light[:, None] * np.array(air.tint) + beam[:, None])
    lit = np.where(facets.glows[:, None], facets.colour, lit)
    fade = air.fade(np.hypot(ahead, left))[facets.solid][:, None] * np.where(facets.glows, 0.5, 1.0)[:, None]
    return np.asarray(np.clip(lit * (1.0 - fade) + np.array(air.haze) * fade, 0, 255), dtype=np.uint8)
