"""Flat facets of solids, and buildings and trees beside the road, the same for the same place of a map."""

import itertools
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon

from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap
from benchmark.machine.storage import content_seed
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from generation.render.schematic.atmosphere import Atmosphere, choose_facade


@dataclass(frozen=True, slots=True)
class Facets:
    """Q quadrilaterals, (4, 3) global metres, counter-clockwise from outside, that belong to N upright solids.

    Attributes:
        normal: (Q, 3) outward unit normals.
        colour: (Q, 3) RGB under white light.
        glows: (Q,) whether the facet is a light source.
        solid: (Q,) which solid it belongs to.
        layer: (Q,) drawing order within the part.
        ahead: (Q,) whether it belongs to the part ahead of the solid's split plane.
        detail_px: (Q,) the facet is left out where its solid appears lower than this.
        batch: (Q,) facets of one batch have one colour and layer and are filled together.
        footprint: (N, 4, 2) outlines on the ground.
        centre: (N, 3) metres, of the circumscribed sphere with (N,) ``radius``.
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
    def empty(cls) -> "Facets":
        """No facets."""
        return cls(
            np.zeros((0, 4, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.bool_), np.zeros(0, np.int64),
            np.zeros(0, np.int64), np.zeros(0, np.bool_), np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 4, 2)),
            np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 3)),
        )  # fmt: skip

    def select_solids(self, chosen: NDArray[np.int64]) -> tuple["Facets", NDArray[np.int64]]:
        """Some of the solids, renumbered, and the indices of their facets; ``chosen`` are rising."""
        renumbered = np.full(len(self.footprint), -1)
        renumbered[chosen] = np.arange(len(chosen))
        solid = renumbered[self.solid]
        facet_indices = np.flatnonzero(solid >= 0)
        by_solid = {name: getattr(self, name)[chosen] for name in _BY_SOLID}
        by_facet = {name: getattr(self, name)[facet_indices] for name in _BY_FACET if name != "solid"}
        return Facets(**by_facet, **by_solid, solid=solid[facet_indices]), facet_indices


_BY_SOLID = ("footprint", "centre", "height", "radius", "split")
_BY_FACET = ("quads", "normal", "colour", "glows", "solid", "layer", "ahead", "detail_px", "batch")


def join_facets(parts: list[Facets]) -> Facets:
    """Several sets of facets as one; solids and batches are renumbered."""
    if not parts:
        return Facets.empty()
    fields = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _BY_SOLID + _BY_FACET}
    solid_starts = np.cumsum([0] + [len(part.footprint) for part in parts])
    batch_starts = np.cumsum([0] + [int(part.batch.max(initial=-1)) + 1 for part in parts])
    fields["solid"] = np.concatenate([part.solid + start for part, start in zip(parts, solid_starts)])
    fields["batch"] = np.concatenate([part.batch + start for part, start in zip(parts, batch_starts)])
    return Facets(**fields)


def compute_unit_normals(quads: Floats) -> Floats:
    """Outward unit normals, (..., 3), of (..., 4, 3) corners from the diagonals; zero where degenerate."""
    normal = np.cross(quads[..., 2, :] - quads[..., 0, :], quads[..., 3, :] - quads[..., 1, :])
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12))


def compute_seen_colours(facets: Facets, air: Atmosphere, ego_pose: Floats) -> NDArray[np.uint8]:
    """Colours, (Q, 3) RGB, after light, head lamps and haze, seen from the (3,) planar pose."""
    sun = np.array(air.sun) / np.linalg.norm(air.sun)
    # Half the light wraps around to the side away from the sun, as it does under an open sky.
    facing = np.maximum(0.4 + 0.6 * (facets.normal @ sun), 0.0)
    ambient = 0.86 + 0.14 * facets.normal[:, 2]
    light = (1.0 - air.sun_share) * ambient + air.sun_share * 1.15 * facing
    offset = facets.centre[:, :2] - ego_pose[:2]
    cos, sin = np.cos(ego_pose[2]), np.sin(ego_pose[2])
    ahead, left = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
    beam = air.compute_beam(ahead, left)[facets.solid]
    # The lamps light faces towards the ego.
    towards = -(facets.normal[:, 0] * offset[facets.solid, 0] + facets.normal[:, 1] * offset[facets.solid, 1])
    beam = beam * np.clip(towards / np.maximum(np.hypot(*offset[facets.solid].T), 1e-6), 0.15, 1.0)
    lit = facets.colour * (light[:, None] * np.array(air.tint) + beam[:, None])
    lit = np.where(facets.glows[:, None], facets.colour, lit)
    fade = air.fade(np.hypot(ahead, left))[facets.solid][:, None] * np.where(facets.glows, 0.5, 1.0)[:, None]
    return np.asarray(np.clip(lit * (1.0 - fade) + np.array(air.haze) * fade, 0, 255), dtype=np.uint8)


DRAWN_WITHIN_M = 110.0
_BUILDING_CELL_M = 17.0
_TREE_CELL_M = 9.0
_STOREY_M = 3.3
_GLASS = (70, 84, 100)
_LIT_GLASS = (250, 214, 140)
_ROOF = (110, 106, 104)
_TRUNK = (92, 72, 54)
_FOLIAGE = ((74, 112, 58), (88, 122, 60), (62, 100, 62), (108, 128, 66))


@dataclass(frozen=True, slots=True)
class BuildingPlots:
    """Places where something may stand: (P, 5) global footprints, and P seeds, made of the place."""

    boxes: Floats
    seeds: list[int]

    def where(self, kept: Bools) -> "BuildingPlots":
        """Only some places."""
        return BuildingPlots(self.boxes[kept], [seed for seed, keep in zip(self.seeds, kept) if keep])


def build_roadside(scene: Scene, *, lamps: bool, salt: tuple[str, ...] = ()) -> Facets:
    """One solid per building or tree beside the ego's road, if the map has one; a style's ``salt`` colours facades."""
    road_map = scene.road_map
    if road_map.drivable_area.is_empty:
        return Facets.empty()
    path = shapely.LineString(scene.ego.position[:, :2]) if len(scene.ego.position) > 1 else None
    if path is None or path.length == 0.0:
        path = shapely.Point(scene.ego.position[0, :2])
    region = path.buffer(DRAWN_WITHIN_M)
    bounds = region.bounds
    nearby = road_map.near((bounds[0] - 40, bounds[1] - 40, bounds[2] + 40, bounds[3] + 40))
    if nearby.drivable_area.is_empty:
        return Facets.empty()
    paved = shapely.union_all(
        [nearby.drivable_area, *nearby.walkways.values(), *nearby.ped_crossings.values(), *nearby.carparks.values()]
    )
    occupied = _find_occupied_points(scene, bounds)
    buildings = _find_building_plots(nearby, region, paved)
    buildings = buildings.where(~_is_occupied(buildings.boxes, occupied, 1.0))
    trees = _find_tree_plots(nearby, region, paved, buildings.boxes)
    trees = trees.where(~_is_occupied(trees.boxes, occupied, 0.8))
    parts = [_build_building(box, seed, lamps=lamps, salt=salt) for box, seed in zip(buildings.boxes, buildings.seeds)]
    return join_facets(parts + [_build_tree(box, seed) for box, seed in zip(trees.boxes, trees.seeds)])


def _find_occupied_points(scene: Scene, bounds: tuple[float, float, float, float]) -> shapely.MultiPoint:
    """Every place where an agent or the ego ever is: sources also annotate what is beside their maps."""
    agents = scene.agents.position[..., :2][scene.agents.valid]
    points = np.unique(np.round(np.concatenate([agents, scene.ego.position[:, :2]]) * 2) / 2, axis=0)
    inside = ((points >= np.array(bounds[:2])) & (points <= np.array(bounds[2:]))).all(axis=1)
    return shapely.MultiPoint(points[inside])


def _is_occupied(boxes: Floats, occupied: shapely.MultiPoint, margin_m: float) -> Bools:
    """(P,) whether an occupied point is within a margin of a box."""
    if not len(boxes):
        return np.zeros(0, dtype=np.bool_)
    tree = shapely.STRtree(shapely.get_parts(occupied))
    hits = tree.query(shapely.polygons(box_corners(boxes)), predicate="dwithin", distance=margin_m)[0]
    return np.isin(np.arange(len(boxes)), hits)


def _build_cells(region: shapely.Geometry, size_m: float, kind: str, location: str) -> tuple[Floats, Floats, list[int]]:
    """Cell centres in a region, four random numbers and a seed for each, all made of the place alone."""
    x_min, y_min, x_max, y_max = region.bounds
    columns = np.arange(np.floor(x_min / size_m), np.ceil(x_max / size_m)).astype(np.int64)
    rows = np.arange(np.floor(y_min / size_m), np.ceil(y_max / size_m)).astype(np.int64)
    cells = np.stack(np.meshgrid(columns, rows, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = (cells + 0.5) * size_m
    inside = shapely.intersects_xy(region, centres[:, 0], centres[:, 1])
    seeds = [content_seed(kind, location, *cell) for cell in cells[inside].tolist()]
    draws = np.array([np.random.default_rng(seed).random(4) for seed in seeds]).reshape(-1, 4)
    return centres[inside], draws, seeds


def _compute_road_direction(points: Floats, road: MultiPolygon) -> tuple[Floats, Floats]:
    """Distance to the road and direction towards it, (P,) and (P,) radians."""
    lines = shapely.shortest_line(shapely.points(points), road)
    ends = shapely.get_point(lines, -1)
    offset = np.column_stack([shapely.get_x(ends), shapely.get_y(ends)]) - points
    return np.asarray(np.hypot(offset[:, 0], offset[:, 1])), np.asarray(np.arctan2(offset[:, 1], offset[:, 0]))


def _find_building_plots(road_map: RoadMap, region: shapely.Geometry, paved: shapely.Geometry) -> BuildingPlots:
    centres, draws, seeds = _build_cells(region, _BUILDING_CELL_M, "building", road_map.location)
    shapely.prepare(road_map.drivable_area)
    shapely.prepare(paved)
    points = centres + (draws[:, :2] - 0.5) * 0.5 * _BUILDING_CELL_M
    distance, direction = _compute_road_direction(points, road_map.drivable_area)
    depth, width = 9.0 + 6.0 * draws[:, 2], 10.0 + 9.0 * draws[:, 3]
    boxes = np.column_stack([points, depth, width, direction])
    plot = BuildingPlots(boxes, seeds).where((distance > 9.0) & (distance < 60.0))
    footprints = shapely.polygons(box_corners(plot.boxes))
    if len(plot.boxes):
        too_close = shapely.dwithin(footprints, paved, 2.5) | shapely.dwithin(footprints, road_map.drivable_area, 6.0)
        plot = plot.where(~too_close)
    # Of two that overlap, the one with the smaller seed stays: no third one can change this.
    first, second = np.triu_indices(len(plot.boxes), 1)
    near = np.hypot(*(plot.boxes[first, :2] - plot.boxes[second, :2]).T) < 30.0
    first, second = first[near], second[near]
    grown = plot.boxes + np.array([0.0, 0.0, 1.0, 1.0, 0.0])
    overlap = boxes_overlap(grown[first], grown[second])
    seeds_of = np.array(plot.seeds, dtype=np.int64)
    loser = np.where(seeds_of[first] > seeds_of[second], first, second)[overlap]
    return plot.where(~np.isin(np.arange(len(plot.boxes)), loser))


def _find_tree_plots(
    road_map: RoadMap, region: shapely.Geometry, paved: shapely.Geometry, buildings: Floats
) -> BuildingPlots:
    centres, draws, seeds = _build_cells(region, _TREE_CELL_M, "tree", road_map.location)
    points = centres + (draws[:, :2] - 0.5) * 0.7 * _TREE_CELL_M
    boxes = np.column_stack([points, np.full((len(points), 2), 0.6), np.zeros(len(points))])
    plot = BuildingPlots(boxes, seeds).where(draws[:, 2] < 0.42)
    geometry = shapely.points(plot.boxes[:, :2])
    plot = plot.where(~shapely.dwithin(geometry, paved, 2.6) & shapely.dwithin(geometry, road_map.drivable_area, 45.0))
    if not len(plot.boxes) or not len(buildings):
        return plot
    crowns = plot.boxes * np.array([1, 1, 0, 0, 1]) + np.array([0, 0, 4.0, 4.0, 0])
    return plot.where(~boxes_overlap(crowns[:, None], buildings[None]).any(axis=1))


def _build_building(box: Floats, seed: int, *, lamps: bool, salt: tuple[str, ...]) -> Facets:
    random = np.random.default_rng(seed)
    draw = random.random(8)
    storeys = 2 + int(draw[4] ** 2 * 7)
    height = storeys * _STOREY_M + 0.8
    corners = box_corners(box)
    walls, windows, side_of = [], [], []
    for side in range(4):
        a, b = corners[side], corners[(side + 1) % 4]
        walls.append(_build_upright_rectangles(a[None], b[None], np.zeros(1), np.full(1, height)))
        windows.append(_build_windows(a, b, storeys))
        side_of.append(np.full(len(windows[-1]), side))
    roof = np.column_stack([corners, np.full(4, height)])[None]
    panes = sum(map(len, windows))
    lit = random.random(panes) < 0.3 if lamps else np.zeros(panes, dtype=np.bool_)
    wall_colour = np.array(choose_facade(seed, salt), dtype=np.float64) * (0.9 + 0.2 * draw[5])
    glass = np.where(lit[:, None], np.array(_LIT_GLASS), np.array(_GLASS))
    return _build_solid(
        np.concatenate([*walls, roof, *windows]),
        np.concatenate([np.tile(wall_colour, (4, 1)), [_ROOF], glass]),
        glows=np.concatenate([np.zeros(5, np.bool_), lit]),
        layer=np.repeat([0, 1], [5, panes]),
        # The panes of one wall that look alike are filled together.
        batch=np.concatenate([np.arange(5), 5 + 2 * np.concatenate(side_of) + lit]),
        detail=np.repeat([0.0, 14.0], [5, panes]),
        footprint=corners,
        height=height,
    )


def _build_windows(a: Floats, b: Floats, storeys: int) -> Floats:
    """(W, 4, 3) panes of the wall from a to b."""
    columns = max(int(np.linalg.norm(b - a) // 3.2), 1)
    column, row = (part.ravel() for part in np.meshgrid(np.arange(columns), np.arange(storeys)))
    start, end = (column + 0.24) / columns, (column + 0.76) / columns
    low = row * _STOREY_M + 1.0
    return _build_upright_rectangles(a + start[:, None] * (b - a), a + end[:, None] * (b - a), low, low + 1.7)


def _build_upright_rectangles(start: Floats, end: Floats, low: Floats, high: Floats) -> Floats:
    """(W, 4, 3) upright rectangles over ground segments (W, 2) to (W, 2)."""
    rows = [(start, low), (end, low), (end, high), (start, high)]
    return np.stack([np.column_stack(corner) for corner in rows], axis=1)


def _build_tree(box: Floats, seed: int) -> Facets:
    draw = np.random.default_rng(seed).random(8)
    height, crown = 5.0 + 5.0 * draw[4], 1.7 + 0.8 * draw[5]
    angle = 2 * np.pi * draw[6] + np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    conifer = draw[7] < 0.25
    levels = [(0.22, 0.9), (0.99, 0.06)] if conifer else [(0.30, 0.55), (0.52, 1.0), (0.80, 0.78), (1.0, 0.25)]
    after = np.roll(ring, -1, axis=0)
    level = np.zeros(len(ring))
    trunk = _build_upright_rectangles(0.16 * ring, 0.16 * after, level, level + 0.34 * height)
    bands = [trunk]
    for (z0, r0), (z1, r1) in itertools.pairwise(levels):
        rows = [(ring * r0, z0), (after * r0, z0), (after * r1, z1), (ring * r1, z1)]
        bands.append(np.stack([np.column_stack([crown * at, level + z * height]) for at, z in rows], axis=1))
    solid = np.concatenate(bands)
    solid[..., :2] += box[:2]
    green = np.array(_FOLIAGE[seed % len(_FOLIAGE)], dtype=np.float64)
    bark, leaves = len(trunk), len(solid) - len(trunk)
    colour = np.concatenate([np.tile(_TRUNK, (bark, 1)), np.tile(green * (0.8 if conifer else 1.0), (leaves, 1))])
    return _build_solid(
        solid, colour, glows=np.zeros(len(solid), np.bool_), layer=np.repeat([0, 1], [bark, leaves]),
        batch=np.arange(len(solid)), detail=np.zeros(len(solid)), footprint=box_corners(box), height=height,
    )  # fmt: skip


def _build_solid(
    quads: Floats, colour: Floats, *, glows: Bools, layer: NDArray[np.int64], batch: NDArray[np.int64],
    detail: Floats, footprint: Floats,
    height: float,
) -> Facets:  # fmt: skip
    middle = footprint.mean(axis=0)
    reach = np.linalg.norm(quads - np.array([*middle, height / 2]), axis=-1).max()
    return Facets(
        quads, compute_unit_normals(quads), colour, glows, np.zeros(len(quads), np.int64), layer,
        np.zeros(len(quads), np.bool_), detail, batch, footprint[None],
        np.array([[*middle, height / 2]]), np.array([height]), np.array([reach]), np.array([[1.0, 0.0, 1e9]]),
    )  # fmt: skip
