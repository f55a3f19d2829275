"""The main path of the schematic renderer: scene and frame to six pictures, with agents as facets."""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import VEHICLE_CATEGORIES
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.machine.storage import content_seed
from benchmark.road_map import RoadMap
from benchmark.scene import Camera, Scene
from generation.render.contract import Images, require_frames
from generation.render.schematic import roadside
from generation.render.schematic.atmosphere import ATMOSPHERES, Atmosphere, Rgb, choose_car_paint, choose_clothes
from generation.render.schematic.backdrop import Backdrop, Skyline
from generation.render.schematic.ground import PaintedGround
from generation.render.schematic.roadside import Facets, compute_seen_colours, compute_unit_normals, join_facets
from generation.render.schematic.shapes import FacetMaterial, SolidShape, choose_shape_name, get_shape
from generation.render.schematic.solids import draw_shadows, draw_solids
from generation.render.schematic.styles import FIRST, DrawingStyle, develop
from generation.render.schematic.view import PlacedCamera
from generation.sources.rig import build_default_cameras

DRAWN_WITHIN_M = 80.0
_TERRAIN_M = 4.0
"""Recordings have hills, the drawn ground is flat: what is annotated less than this above or below it stands on it."""
_BRAKING_M_S2 = -1.0
_MATERIALS: dict[FacetMaterial, Rgb] = {
    FacetMaterial.GLASS: (54, 66, 80),
    FacetMaterial.RUBBER: (30, 30, 32),
    FacetMaterial.METAL: (150, 152, 156),
    FacetMaterial.SKIN: (214, 170, 140),
    FacetMaterial.TROUSERS: (48, 54, 72),
    FacetMaterial.WHITE: (236, 236, 232),
    FacetMaterial.ORANGE: (232, 112, 32),
    FacetMaterial.CARGO: (206, 206, 200),
    FacetMaterial.HAIR: (52, 40, 34),
    FacetMaterial.BEACON: (52, 96, 226),
}
_HEAD_LAMP: dict[bool, Rgb] = {False: (226, 230, 236), True: (255, 250, 224)}
_TAIL_LAMP: dict[bool, Rgb] = {False: (122, 20, 22), True: (206, 30, 30)}
_BRAKE_LAMP: Rgb = (255, 48, 40)


@functools.lru_cache(maxsize=4096)
def _choose_colours(instance: str, category: str, salt: tuple[str, ...]) -> Floats:
    """(roles, 3) colours of one agent, lamps off."""
    table = np.zeros((len(FacetMaterial), 3))
    for role, colour in _MATERIALS.items():
        table[role] = colour
    table[FacetMaterial.PAINT] = (
        (236, 236, 236) if category.startswith("vehicle.emergency") else choose_car_paint(instance, salt)
    )
    table[FacetMaterial.CLOTH] = (
        (232, 140, 40) if category.endswith("construction_worker") else choose_clothes(instance, salt)
    )
    return table


@dataclass(frozen=True, slots=True)
class AgentFacets:
    """Agents of a scene, one solid each around the origin, heading along +x, lamps off; ready to be placed.

    ``role`` (Q,) are materials of facets; ``braking`` (N, T) says where brake lamps are on.
    """

    scene: Scene
    bodies: Facets
    role: NDArray[np.int64]
    braking: Bools

    @classmethod
    def of(cls, scene: Scene, salt: tuple[str, ...] = ()) -> "AgentFacets":
        """Prepare the agents of a scene; the salt of a style goes into their colours."""
        agents = scene.agents
        shapes = [get_shape(choose_shape_name(kind, size)) for kind, size in zip(agents.categories, agents.size)]
        bodies = join_facets(
            [
                _build_body(shape, size, _choose_colours(instance, kind, salt))
                for shape, size, instance, kind in zip(shapes, agents.size, agents.ids, agents.categories)
            ]
        )
        role = np.concatenate([np.zeros(0, np.int64), *(shape.role for shape in shapes)])
        return cls(scene, bodies, role, _find_braking(scene))

    def in_scene(self, scene: Scene) -> "AgentFacets":
        """The same agents in a scene in which they have other tracks."""
        return replace(self, scene=scene, braking=_find_braking(scene))

    def near(self, frame: int) -> NDArray[np.int64]:
        """Indices of the agents that exist at a frame and are close enough to be drawn."""
        agents = self.scene.agents
        offset = agents.position[:, frame, :2] - self.scene.ego.position[frame, :2]
        return np.flatnonzero(agents.valid[:, frame] & (np.hypot(offset[:, 0], offset[:, 1]) < DRAWN_WITHIN_M))

    def facets(self, frame: int, *, lamps: bool) -> Facets:
        """Facets of everything near the ego at a frame, one solid per agent; ``lamps`` are head and tail lamps."""
        agents, members = self.scene.agents, self.near(frame)
        bodies, chosen = self.bodies.select_solids(members)
        role, solid = self.role[chosen], bodies.solid
        yaw, centre = agents.yaw[members, frame], self._compute_standing_centres(members, frame)
        cos, sin = np.cos(yaw), np.sin(yaw)
        heading = np.stack([cos, sin], axis=-1)
        colour = bodies.colour.copy()
        colour[role == FacetMaterial.HEAD_LAMP] = _HEAD_LAMP[lamps]
        colour[role == FacetMaterial.TAIL_LAMP] = _TAIL_LAMP[lamps]
        stopping = (role == FacetMaterial.TAIL_LAMP) & self.braking[members, frame][solid]
        colour[stopping] = _BRAKE_LAMP
        is_lamp = (role == FacetMaterial.HEAD_LAMP) | (role == FacetMaterial.TAIL_LAMP) | (role == FacetMaterial.BEACON)
        return replace(
            bodies,
            quads=_rotate_vectors(bodies.quads, cos[solid, None], sin[solid, None]) + centre[solid, None],
            normal=_rotate_vectors(bodies.normal, cos[solid], sin[solid]),
            colour=colour,
            glows=stopping | (is_lamp & lamps),
            footprint=_rotate_vectors(bodies.footprint, cos[:, None], sin[:, None]) + centre[:, None, :2],
            centre=centre,
            split=np.column_stack([heading, (heading * centre[:, :2]).sum(axis=1) + bodies.split[:, 2]]),
        )

    def _compute_standing_centres(self, members: NDArray[np.int64], frame: int) -> Floats:
        """Box centres with the boxes put down on the ground, (n, 3)."""
        centre: Floats = self.scene.agents.position[members, frame]
        on_ground = self.scene.ego.position[frame, 2] + 0.5 * self.scene.agents.size[members, 2]
        centre[:, 2] = np.where(np.abs(centre[:, 2] - on_ground) < _TERRAIN_M, on_ground, centre[:, 2])
        return centre


def _rotate_vectors(vectors: Floats, cos: Floats, sin: Floats) -> Floats:
    """Vectors (..., 2 or 3) turned about the vertical."""
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([x * cos - y * sin, x * sin + y * cos, *np.moveaxis(vectors[..., 2:], -1, 0)], axis=-1)


def _build_body(shape: SolidShape, size: Floats, colours: Floats) -> Facets:
    """One agent around the origin, its box centred there."""
    quads = (shape.quads - np.array([0.0, 0.0, 0.5])) * size
    count = len(quads)
    return Facets(
        quads=quads,
        normal=compute_unit_normals(quads),
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


def _find_braking(scene: Scene) -> Bools:
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


_SIGHT_M = 250.0
"""Farther than the corner of any plan view of the ground."""


class SchematicRenderer:
    """Draws a scene on the CPU with flat shaded solids on a painted ground; see `generation.render.contract.Renderer`.

    Args:
        width: Image width, pixels.
        height: Image height, pixels.
        style: Which of the two ways to draw a scene (`generation.render.schematic.styles`).

    Raises:
        InputError: If a size is not positive.
    """

    version = "1"

    def __init__(self, width: int = 448, height: int = 256, style: DrawingStyle = FIRST) -> None:
        if width < 1 or height < 1:
            raise InputError(f"images need a positive size, got {width} x {height}; choose for example 448 x 256")
        self.width, self.height, self.style = width, height, style
        self.name = f"schematic-{style.name}" if style.name else "schematic"

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        """The scene's cameras, or the default rig where it has none, at the size that is rendered."""
        return tuple(camera.resized(self.width, self.height) for camera in scene.cameras or build_default_cameras())

    def render(self, scene: Scene, frames: Sequence[int]) -> Iterator[Images]:
        """Render frames of one scene.

        Args:
            scene: The scene.
            frames: Frame indices in ``scene.timestamps_us``.

        Yields:
            (height, width, 3) RGB by camera name, for each frame in order.

        Raises:
            InputError: If a frame is not in the scene.
        """
        require_frames(scene, frames)
        if not len(frames):
            return
        stage = self.stage(scene)
        for frame in frames:
            yield stage.pictures(int(frame))

    def stage(self, scene: Scene) -> "PreparedScene":
        """A scene made ready for drawing."""
        cv2.setNumThreads(1)
        return PreparedScene.of(scene, self.cameras(scene), self.style)


@dataclass(slots=True)
class PreparedScene:
    """A scene made ready for drawing: what does not change from frame to frame."""

    scene: Scene
    cameras: tuple[Camera, ...]
    air: Atmosphere
    ground: PaintedGround
    skyline: Skyline
    standing: Facets
    traffic: AgentFacets
    casts_shadow: Bools
    style: DrawingStyle
    beside: tuple[tuple[float, float], Facets] | None = None
    backdrops: dict[str, tuple[bytes, Backdrop]] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene, cameras: tuple[Camera, ...], style: DrawingStyle) -> "PreparedScene":
        """Make a scene ready."""
        air = style.apply_light(ATMOSPHERES[scene.look])
        return cls(
            scene=scene,
            cameras=cameras,
            air=air,
            ground=PaintedGround.of(_clip_map_to_sight(scene), air, style),
            skyline=Skyline.of(scene.road_map.location, air),
            standing=roadside.build_roadside(scene, lamps=air.lamps, salt=style.salt),
            traffic=AgentFacets.of(scene, style.salt),
            casts_shadow=np.array(
                [kind in VEHICLE_CATEGORIES or kind.startswith("human") for kind in scene.agents.categories], np.bool_
            ),
            style=style,
        )

    def go_on(self, scene: Scene) -> None:
        """Draw from now on frames of another scene of the same road and agents, such as the world as driven so far."""
        self.scene, self.traffic = scene, self.traffic.in_scene(scene)

    def pictures(self, frame: int) -> Images:
        """Pictures of the cameras at a frame."""
        ego = self.scene.ego
        position, rotation = ego.position[frame], ego.rotation[frame]
        pose = ego.pose[frame]
        plans = self.ground.around(position[:2])
        facets, colours = self._build_solids(frame, pose, float(position[2]))
        shadows = self._find_shadow_casters(frame)
        images: Images = {}
        for number, camera in enumerate(self.cameras):
            view = PlacedCamera.of(camera, position, rotation)
            image = self._get_backdrop(view, pose).draw(view, plans, self.skyline)
            draw_shadows(image, view, shadows, self.air)
            draw_solids(image, view, facets, colours)
            if self.air.rain:
                _draw_rain(image, content_seed("rain", number, frame))
            if self.style.pipeline is not None:
                image = develop(image, self.style.pipeline, content_seed("sensor", number, frame))
            images[camera.name] = image
        return images

    def _build_solids(self, frame: int, pose: Floats, ground_z: float) -> tuple[Facets, NDArray[np.uint8]]:
        around = self.ground.find_centre(pose[:2])
        if self.beside is None or self.beside[0] != around:
            offset = self.standing.centre[:, :2] - np.array(around)
            near = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) < roadside.DRAWN_WITHIN_M)
            self.beside = (around, self.standing.select_solids(near)[0])
        beside, lift = self.beside[1], np.array([0.0, 0.0, ground_z])
        if ground_z != 0.0:
            beside = replace(beside, quads=beside.quads + lift, centre=beside.centre + lift)
        facets = join_facets([beside, self.traffic.facets(frame, lamps=self.air.lamps)])
        return facets, compute_seen_colours(facets, self.air, pose)

    def _find_shadow_casters(self, frame: int) -> Floats:
        """(N, 4, 2) outlines of the vehicles and people near the ego."""
        members = self.traffic.near(frame)
        members = members[self.casts_shadow[members]]
        agents = self.scene.agents
        return box_corners(
            np.column_stack([agents.position[members, frame, :2], agents.size[members, :2], agents.yaw[members, frame]])
        )

    def _get_backdrop(self, view: PlacedCamera, pose: Floats) -> Backdrop:
        """The camera's backdrop, made anew only when the camera stands differently above the ground."""
        stance = np.concatenate([view.rotation[:, 2], [view.eye[2] - view.ground_z]]).tobytes()
        known = self.backdrops.get(view.camera.name)
        if known is None or known[0] != stance:
            known = (stance, Backdrop.of(view, self.air, float(pose[2]), pose[:2]))
            self.backdrops[view.camera.name] = known
        return known[1]


def _clip_map_to_sight(scene: Scene) -> RoadMap:
    """The part of a map that can come into sight; whole cities are painted too slowly."""
    low, high = scene.ego.position[:, :2].min(axis=0) - _SIGHT_M, scene.ego.position[:, :2].max(axis=0) + _SIGHT_M
    return scene.road_map.near((float(low[0]), float(low[1]), float(high[0]), float(high[1])))


def _draw_rain(image: NDArray[np.uint8], seed: int) -> None:
    height, width = image.shape[:2]
    random = np.random.default_rng(seed)
    starts = random.random((90, 2)) * [width, height]
    ends = starts + np.array([0.012, 0.055]) * height * (0.5 + random.random((90, 1)))
    layer = image.copy()
    lines = np.rint(np.stack([starts, ends], axis=1) * 16).astype(np.int32)
    cv2.polylines(layer, list(lines), False, (214, 220, 226), 1, cv2.LINE_AA, 4)
    cv2.addWeighted(layer, 0.35, image, 0.65, 0.0, dst=image)
