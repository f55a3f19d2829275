"""Agents of one frame as facets: size, heading, paint and lamps."""

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, box_corners
from benchmark.scene import Scene
from generation.render.schematic.atmosphere import Rgb, car_paint, clothes
from generation.render.schematic.drafting import Role, Shape
from generation.render.schematic.facets import Facets, joined, unit_normals
from generation.render.schematic.shapes import shape_name, shape_named

DRAWN_WITHIN_M = 80.0
_TERRAIN_M = 4.0
"""Recordings have hills, the drawn ground is flat: what is annotated less than this above or below it stands on it."""
_BRAKING_M_S2 = -1.0
_MATERIALS: dict[Role, Rgb] = {
    Role.GLASS: (54, 66, 80),
    Role.RUBBER: (30, 30, 32),
    Role.METAL: (150, 152, 156),
    Role.SKIN: (214, 170, 140),
    Role.TROUSERS: (48, 54, 72),
    Role.WHITE: (236, 236, 232),
    Role.ORANGE: (232, 112, 32),
    Role.CARGO: (206, 206, 200),
    Role.HAIR: (52, 40, 34),
    Role.BEACON: (52, 96, 226),
}
_HEAD_LAMP: dict[bool, Rgb] = {False: (226, 230, 236), True: (255, 250, 224)}
_TAIL_LAMP: dict[bool, Rgb] = {False: (122, 20, 22), True: (206, 30, 30)}
_BRAKE_LAMP: Rgb = (255, 48, 40)


@functools.lru_cache(maxsize=4096)
def _colours(instance: str, category: str, salt: tuple[str, ...]) -> Floats:
    """(roles, 3) colours of one agent, lamps off."""
    table = np.zeros((len(Role), 3))
    for role, colour in _MATERIALS.items():
        table[role] = colour
    table[Role.PAINT] = (236, 236, 236) if category.startswith("vehicle.emergency") else car_paint(instance, salt)
    table[Role.CLOTH] = (232, 140, 40) if category.endswith("construction_worker") else clothes(instance, salt)
    return table


@dataclass(frozen=True, slots=True)
class Traffic:
    """The agents of a scene, ready to be placed.

    Attributes:
        bodies: One solid per agent around the origin, heading along +x, lamps off.
        role: (Q,) materials of their facets.
        braking: (N, T) whether a vehicle's brake lamps are on.
    """

    scene: Scene
    bodies: Facets
    role: NDArray[np.int64]
    braking: Bools

    @classmethod
    def of(cls, scene: Scene, salt: tuple[str, ...] = ()) -> "Traffic":
        """Prepare the agents of a scene; the salt of a style goes into their colours."""
        agents = scene.agents
        shapes = [shape_named(shape_name(kind, size)) for kind, size in zip(agents.categories, agents.size)]
        bodies = joined(
            [
                _body(shape, size, _colours(instance, kind, salt))
                for shape, size, instance, kind in zip(shapes, agents.size, agents.ids, agents.categories)
            ]
        )
        role = np.concatenate([np.zeros(0, np.int64), *(shape.role for shape in shapes)])
        return cls(scene, bodies, role, _braking(scene))

    def in_scene(self, scene: Scene) -> "Traffic":
        """The same agents in a scene in which they have other tracks."""
        return replace(self, scene=scene, braking=_braking(scene))

    def near(self, frame: int) -> NDArray[np.int64]:
        """Indices of the agents that exist at a frame and are close enough to be drawn."""
        agents = self.scene.agents
        offset = agents.position[:, frame, :2] - self.scene.ego.position[frame, :2]
        return np.flatnonzero(agents.valid[:, frame] & (np.hypot(offset[:, 0], offset[:, 1]) < DRAWN_WITHIN_M))

    def facets(self, frame: int, *, lamps: bool) -> Facets:
        """Facets of everything near the ego at a frame, one solid per agent; ``lamps`` are head and tail lamps."""
        agents, members = self.scene.agents, self.near(frame)
        bodies, chosen = self.bodies.solids(members)
        role, solid = self.role[chosen], bodies.solid
        yaw, centre = agents.yaw[members, frame], self._standing_centres(members, frame)
        cos, sin = np.cos(yaw), np.sin(yaw)
        heading = np.stack([cos, sin], axis=-1)
        colour = bodies.colour.copy()
        colour[role == Role.HEAD_LAMP] = _HEAD_LAMP[lamps]
        colour[role == Role.TAIL_LAMP] = _TAIL_LAMP[lamps]
        stopping = (role == Role.TAIL_LAMP) & self.braking[members, frame][solid]
        colour[stopping] = _BRAKE_LAMP
        is_lamp = (role == Role.HEAD_LAMP) | (role == Role.TAIL_LAMP) | (role == Role.BEACON)
        return replace(
            bodies,
            quads=_turned(bodies.quads, cos[solid, None], sin[solid, None]) + centre[solid, None],
            normal=_turned(bodies.normal, cos[solid], sin[solid]),
            colour=colour,
            glows=stopping | (is_lamp & lamps),
            footprint=_turned(bodies.footprint, cos[:, None], sin[:, None]) + centre[:, None, :2],
            centre=centre,
            split=np.column_stack([heading, (heading * centre[:, :2]).sum(axis=1) + bodies.split[:, 2]]),
        )

    def _standing_centres(self, members: NDArray[np.int64], frame: int) -> Floats:
        """Box centres with the boxes put down on the ground, (n, 3)."""
        centre: Floats = self.scene.agents.position[members, frame]
        on_ground = self.scene.ego.position[frame, 2] + 0.5 * self.scene.agents.size[members, 2]
        centre[:, 2] = np.where(np.abs(centre[:, 2] - on_ground) < _TERRAIN_M, on_ground, centre[:, 2])
        return centre


def _turned(vectors: Floats, cos: Floats, sin: Floats) -> Floats:
    """Vectors (..., 2 or 3) turned about the vertical."""
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([x * cos - y * sin, x * sin + y * cos, *np.moveaxis(vectors[..., 2:], -1, 0)], axis=-1)


def _body(shape: Shape, size: Floats, colours: Floats) -> Facets:
    """One agent around the origin, its box centred there."""
    quads = (shape.quads - np.array([0.0, 0.0, 0.5])) * size
    count = len(quads)
    return Facets(
        quads=quads,
        normal=unit_normals(quads),
        colour=colours[shape.role],
        glows=np.zeros(count, dtype=np.bool_),
        solid=np.zeros(count, dtype=np.int64),
        layer=shape.layer,
        ahead=shape.ahead,
        detail_px=shape.detail_px,
        batch=np.arange(count),
        footprint=box_corners(np.array([[0.0, 0.0, size[0], size[1], 0.0]])),
        centre=np.zeros((1, 3)),
        height=size[2:],
        radius=np.array([0.55 * float(np.linalg.norm(size))]),
        split=np.array([[1.0, 0.0, shape.split * size[0]]]),
    )


def _braking(scene: Scene) -> Bools:
    """(N, T) whether the speed fell by more than 1 m/s^2 over the last quarter of a second or so."""
    position, seconds = scene.agents.position[..., :2], scene.seconds
    count = len(seconds)
    if count < 3 or not len(scene.agents):
        return np.zeros((len(scene.agents), count), dtype=np.bool_)
    speed = np.linalg.norm(np.diff(position, axis=1), axis=-1) / np.maximum(np.diff(seconds), 1e-6)
    speed = np.concatenate([speed[:, :1], speed], axis=1)
    lag = min(3, count - 1)
    falling = np.zeros_like(speed)
    falling[:, lag:] = (speed[:, lag:] - speed[:, :-lag]) / np.maximum(seconds[lag:] - seconds[:-lag], 1e-6)
    was_there = scene.agents.valid.copy()
    was_there[:, lag + 1 :] &= scene.agents.valid[:, : -(lag + 1)]
    is_vehicle = np.array([category.startswith("vehicle") for category in scene.agents.categories])
    return np.asarray((falling < _BRAKING_M_S2) & was_there & is_vehicle[:, None])
