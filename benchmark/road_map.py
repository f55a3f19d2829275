"""The static map: vector layers in the global frame, and the drivable area as a raster or a point test."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final, Self

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, MultiPolygon, Polygon

from benchmark.geometry import Bools, Floats, to_global, to_local

BLOCK: Final = 8
"""Nodes along the side of a block of a raster: where no border passes, all are what one of them is."""
BORDER_STEP_M: Final = 1.0
"""Farthest apart that points stand for the border."""
SLACK: Final = 1e-3
"""Nodes; far above rounding."""


class Handedness(StrEnum):
    """Side of the road that traffic keeps to."""

    RIGHT = "right"
    LEFT = "left"

    @property
    def far_turn(self) -> int:
        """Sign of a turn across oncoming traffic, left positive."""
        return 1 if self is Handedness.RIGHT else -1

    @classmethod
    def of_location(cls, location: str) -> Self | None:
        """By the names of nuScenes, nuPlan and Argoverse 2; ``None`` of any other place."""
        if location.startswith(_LEFT_HAND_TRAFFIC):
            return cls("left")
        return cls("right") if location.startswith(_RIGHT_HAND_TRAFFIC) else None


_LEFT_HAND_TRAFFIC: Final = ("singapore", "sg-")
_RIGHT_HAND_TRAFFIC: Final = ("boston", "us-", "las-vegas", "pittsburgh")


class DividerKind(StrEnum):
    """How a divider is painted."""

    SOLID_WHITE = "solid-white"
    DASHED_WHITE = "dashed-white"
    SOLID_YELLOW = "solid-yellow"
    DASHED_YELLOW = "dashed-yellow"
    UNPAINTED = "unpainted"


@dataclass(frozen=True, slots=True)
class Divider:
    """A painted or unpainted line between lanes or directions: (M, 2) metres, M >= 2.

    ``between_directions`` is True for a nuScenes ``road_divider``, False for a ``lane_divider``.
    """

    identifier: str
    line: Floats
    kind: DividerKind
    between_directions: bool


@dataclass(frozen=True, slots=True)
class Lane:
    """One lane or lane connector: its centre line is (M, 2) metres in driving direction, M >= 2.

    ``polygon`` is ``None`` where the source has none (nuScenes lane connectors). Successors continue the lane,
    predecessors lead into it, by identifier. ``is_connector`` is True inside junctions (nuScenes ``lane_connector``).
    """

    identifier: str
    centerline: Floats
    polygon: Polygon | None
    successors: tuple[str, ...]
    predecessors: tuple[str, ...]
    is_connector: bool


@dataclass(frozen=True, slots=True)
class RoadMap:
    """Vector layers of one place, planar, global frame, metres; surfaces are by identifier.

    Attributes:
        location: nuScenes location name.
        drivable_area: Everything a car may drive on, one geometry with holes.
        walkways: Pavements.
        road_segments: ``intersections`` names those that are junctions.
        road_blocks: Road surfaces of one driving direction (nuScenes ``road_block``).
        canvas_m: Width and height of the whole map.
        stop_line_types: nuScenes' ``stop_line_type`` of stop lines that have one, by identifier.
    """

    location: str
    drivable_area: MultiPolygon
    lanes: dict[str, Lane] = field(default_factory=dict)
    dividers: tuple[Divider, ...] = ()
    ped_crossings: dict[str, Polygon] = field(default_factory=dict)
    walkways: dict[str, Polygon] = field(default_factory=dict)
    road_segments: dict[str, Polygon] = field(default_factory=dict)
    intersections: frozenset[str] = frozenset()
    stop_lines: dict[str, Polygon] = field(default_factory=dict)
    carparks: dict[str, Polygon] = field(default_factory=dict)
    road_blocks: dict[str, Polygon] = field(default_factory=dict)
    canvas_m: tuple[float, float] = (0.0, 0.0)
    stop_line_types: dict[str, str] = field(default_factory=dict)
    _lane_bounds: list[Floats] = field(default_factory=list, init=False, repr=False, compare=False)

    def lane_bounds(self) -> Floats:
        """(L, 4) smallest x and y, then largest, of the centre line of each lane, in the order of the lanes."""
        if not self._lane_bounds:
            lines = [lane.centerline for lane in self.lanes.values()]
            bounds = [np.concatenate([line.min(axis=0), line.max(axis=0)]) for line in lines]
            self._lane_bounds.append(np.array(bounds).reshape(-1, 4))
        return self._lane_bounds[0]

    def is_drivable(self, points: Floats) -> Bools:
        """(...) exact tests of (..., 2) global metres against the drivable polygons; the border counts as drivable."""
        points = np.asarray(points, np.float64)
        return np.asarray(shapely.intersects_xy(self.drivable_area, points[..., 0], points[..., 1]), dtype=np.bool_)

    def near(self, bounds: tuple[float, float, float, float]) -> Self:
        """The part of the map that touches a rectangle; geometries are kept whole, the drivable area is clipped.

        ``bounds`` are x_min, y_min, x_max, y_max in metres; identifiers stay.
        """
        window = shapely.box(*bounds)

        def keep(layer: dict[str, Polygon]) -> dict[str, Polygon]:
            return {name: shape for name, shape in layer.items() if shape.intersects(window)}

        road_segments = keep(self.road_segments)
        lanes = {
            name: lane
            for name, lane in self.lanes.items()
            if LineString(lane.centerline).intersects(window)
            or (lane.polygon is not None and lane.polygon.intersects(window))
        }
        return replace(
            self,
            drivable_area=as_multipolygon(self.drivable_area.intersection(window)),
            lanes=lanes,
            dividers=tuple(line for line in self.dividers if LineString(line.line).intersects(window)),
            ped_crossings=keep(self.ped_crossings),
            walkways=keep(self.walkways),
            road_segments=road_segments,
            intersections=self.intersections & frozenset(road_segments),
            stop_lines=keep(self.stop_lines),
            carparks=keep(self.carparks),
            road_blocks=keep(self.road_blocks),
        )


def as_multipolygon(shape: shapely.Geometry) -> MultiPolygon:
    """The polygons of any geometry; lines and points are dropped."""
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon) and not part.is_empty]
    return MultiPolygon(parts)


def mend_polygon(shape: Polygon) -> Polygon:
    """A polygon as it is where it is valid, else its largest valid part; empty if it has none."""
    if shape.is_valid:
        return shape
    parts = as_multipolygon(shapely.make_valid(shape))
    return max(parts.geoms, key=lambda part: part.area, default=Polygon())


@dataclass(frozen=True, slots=True)
class DrivableRaster:
    """The drivable area around a pose as a grid of booleans.

    A point looks up the cell ``rint((local + half_extent) / resolution)``, half to even, as the reference
    code does; outside the grid is not drivable.

    Attributes:
        cells: (n, n) first index along the pose's right, second along its heading.
        pose: (3,) x, y, yaw at the centre.
        resolution_m: Cell size.
    """

    cells: NDArray[np.bool_]
    pose: Floats
    resolution_m: float
    _framed: NDArray[np.bool_] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_framed", np.pad(self.cells, 1).ravel())

    @classmethod
    def around(
        cls, road_map: RoadMap, pose: Floats, *, half_extent_m: float = 50.0, resolution_m: float = 0.5
    ) -> "DrivableRaster":
        """Rasterise a square of the map around a (3,) global pose; a cell is drivable when its centre node is."""
        count = round(2 * half_extent_m / resolution_m)
        steps = (np.arange(count) * resolution_m) - half_extent_m
        pose = np.asarray(pose, np.float64)
        reach = half_extent_m * np.sqrt(2.0) + resolution_m
        x, y = float(pose[0]), float(pose[1])
        window = shapely.box(x - reach, y - reach, x + reach, y + reach)
        local = RoadMap(road_map.location, as_multipolygon(road_map.drivable_area.intersection(window)))
        shapely.prepare(local.drivable_area)
        return cls(_find_drivable_nodes(local, steps, pose, resolution_m), pose, resolution_m)

    def look_up(self, points: Floats) -> Bools:
        """Whether (..., 2) global points in metres are drivable."""
        cos, sin = np.cos(self.pose[2]), np.sin(self.pose[2])
        dx, dy = points[..., 0] - self.pose[0], points[..., 1] - self.pose[1]
        count = len(self.cells)
        # A point too far away for a float is outside like any other.
        with np.errstate(over="ignore", invalid="ignore"):
            cell = self._nearest(dx * sin - dy * cos)
            cell *= count + 2
            cell += self._nearest(dx * cos + dy * sin)
        return np.asarray(self._framed[cell])

    def _nearest(self, along_m: Floats) -> NDArray[np.int64]:
        """Index along one axis, counted from a frame of one cell around the grid that stands for all outside."""
        count = len(self.cells)
        place: Floats = along_m / self.resolution_m
        place += count / 2
        # Before the conversion: an integer cannot hold every float.
        place = np.fmin(np.fmax(np.rint(place), -1.0), float(count))
        place += 1.0
        return place.astype(np.int64)


def _find_drivable_nodes(area: RoadMap, steps: Floats, pose: Floats, spacing_m: float) -> NDArray[np.bool_]:
    """`RoadMap.is_drivable` of a grid, (n, n) nodes at some metres to the right of a pose and ahead of it.

    One node speaks for its block where the border is elsewhere; in the other blocks each is asked.
    """
    firsts = np.arange(0, len(steps), BLOCK)
    right, forward = np.meshgrid(firsts, firsts, indexing="ij")
    verdicts = area.is_drivable(_compute_nodes(steps, pose, right, forward))
    drivable, undecided = (
        blocks.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)[: len(steps), : len(steps)]
        for blocks in (verdicts, _find_border_blocks(area, steps, pose, spacing_m))
    )
    right, forward = np.nonzero(undecided)
    drivable[right, forward] = area.is_drivable(_compute_nodes(steps, pose, right, forward))
    return drivable


def _compute_nodes(steps: Floats, pose: Floats, right: NDArray[np.int64], forward: NDArray[np.int64]) -> Floats:
    """(..., 2) nodes of a grid by their indices, global."""
    return to_global(np.stack([steps[forward], -steps[right]], axis=-1), pose)


def _find_border_blocks(area: RoadMap, steps: Floats, pose: Floats, spacing_m: float) -> NDArray[np.bool_]:
    """Which blocks of a grid have the border between their nodes; a few more, and none less."""
    count = -(-len(steps) // BLOCK)
    has_border = np.zeros((count, count), np.bool_)
    border = shapely.get_coordinates(shapely.segmentize(area.drivable_area.boundary, BORDER_STEP_M))
    local = to_local(border, pose)
    places = (np.stack([-local[:, 1], local[:, 0]]) - steps[0]) / spacing_m
    reach = 0.5 * BORDER_STEP_M / spacing_m + SLACK
    first, last = np.ceil((places - (BLOCK - 1) - reach) / BLOCK), np.floor((places + reach) / BLOCK)
    for right in _fill_ranges(first[0], last[0]):
        for forward in _fill_ranges(first[1], last[1]):
            inside = (right >= 0) & (right < count) & (forward >= 0) & (forward < count)
            has_border[right[inside], forward[inside]] = True
    return has_border


def _fill_ranges(first: Floats, last: Floats) -> list[NDArray[np.int64]]:
    """Whole numbers from first to last of each row, one after the other; the last again where there are less."""
    most = int((last - first).max(initial=0.0))
    return [np.minimum(first + number, last).astype(np.int64) for number in range(most + 1)]
