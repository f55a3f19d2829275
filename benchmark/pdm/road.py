"""The road as polygons, used one by one, and where on it a car is at each state."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from benchmark.geometry import Bools, Floats, box_corners
from benchmark.pdm.definition import CENTER_AHEAD_M, HEADING, LENGTH_M, WIDTH_M


class Layer(StrEnum):
    """Kinds of surface."""

    LANE = "lane"
    CONNECTOR = "lane_connector"
    ROAD_BLOCK = "roadblock"
    INTERSECTION = "intersection"
    DRIVABLE_AREA = "drivable_area"
    CAR_PARK = "carpark_area"


@dataclass(frozen=True, slots=True)
class Road:
    """Surfaces around a scene; ``lanes`` are lanes and connectors, ``on_route`` says which of them are on the route.

    ``drivable`` are road blocks, intersections, drivable areas and car parks.
    """

    lanes: tuple[Polygon, ...]
    on_route: tuple[bool, ...]
    drivable: tuple[Polygon, ...]
    intersections: tuple[Polygon, ...]

    @classmethod
    def of(cls, surfaces: "list[tuple[Layer, Polygon, bool]]") -> Self:
        """Sort surfaces by what they decide.

        Each is a layer, a shape and whether it is on the route (of lanes and connectors).
        """
        lanes = [(shape, routed) for layer, shape, routed in surfaces if layer in (Layer.LANE, Layer.CONNECTOR)]
        drivable = [shape for layer, shape, _ in surfaces if layer not in (Layer.LANE, Layer.CONNECTOR)]
        crossings = [shape for layer, shape, _ in surfaces if layer is Layer.INTERSECTION]
        for shape in (*(shape for shape, _ in lanes), *drivable):
            shapely.prepare(shape)
        return cls(
            tuple(shape for shape, _ in lanes),
            tuple(routed for _, routed in lanes),
            tuple(drivable),
            tuple(crossings),
        )

    def unsure(self, boxes: Floats) -> Bools:
        """Cars, (Q, 5), that have no lane of their own, so that they are to blame for contacts at their sides.

        They are in several lanes or off the drivable surfaces.
        """
        corners = _Points(box_corners(boxes))
        return self.straddled(corners, (len(boxes),)) | self.left(corners, (len(boxes),))

    def straddled(self, corners: "_Points", shape: tuple[int, ...]) -> Bools:
        """Whether cars (four corners each) are on more than one lane or connector and none holds them whole."""
        touched, whole = np.zeros(shape, np.int64), np.zeros(shape, np.bool_)
        for surface in self.lanes:
            which, inside = corners.inside(surface)
            if which.size:
                held = np.zeros((*shape, 4), np.bool_)
                held.reshape(-1)[which[inside]] = True
                touched += held.any(axis=-1)
                whole |= held.all(axis=-1)
        return np.asarray((touched > 1) & ~whole)

    def left(self, corners: "_Points", shape: tuple[int, ...]) -> Bools:
        """Whether a corner of cars is on no drivable surface."""
        drivable = np.zeros((*shape, 4), np.bool_)
        for surface in self.drivable:
            corners.mark(drivable, surface)
        return np.asarray(~drivable.all(axis=-1))


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """Places of B cars on the road at T states.

    Attributes:
        multiple_lanes: (B, T) some corner is on more than one lane or connector and none holds the whole car.
        non_drivable: (B, T) some corner is on no drivable surface.
        oncoming: (B, T) the centre is on no lane or connector of the route.
        center_in_intersection: (B, T) the centre is in an intersection.
        axle_in_intersection: (B, T) the rear axle is.
    """

    multiple_lanes: Bools
    non_drivable: Bools
    oncoming: Bools
    center_in_intersection: Bools
    axle_in_intersection: Bools


def footprints(states: Floats) -> Floats:
    """(..., 5) boxes of the car at (..., 11) states."""
    heading = states[..., HEADING]
    center = states[..., :2] + CENTER_AHEAD_M * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    size = np.broadcast_to([LENGTH_M, WIDTH_M], center.shape)
    return np.concatenate([center, size, heading[..., None]], axis=-1)


def whereabouts(road: Road, states: Floats) -> Whereabouts:
    """Where cars are on the road at (B, T, 11) states; a point on the border of a surface is outside it."""
    boxes = footprints(states)
    shape = states.shape[:-1]
    corners = _Points(box_corners(boxes))
    center, axle = _Points(boxes[..., :2]), _Points(states[..., :2])
    routed = np.zeros(shape, np.bool_)
    for surface, on_route in zip(road.lanes, road.on_route, strict=True):
        if on_route:
            center.mark(routed, surface)
    crossing, axle_crossing = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    for surface in road.intersections:
        center.mark(crossing, surface)
        axle.mark(axle_crossing, surface)
    straddled, left = road.straddled(corners, shape), road.left(corners, shape)
    return Whereabouts(straddled, left, ~routed, crossing, axle_crossing)


class _Points:
    """Points that are asked for many surfaces."""

    def __init__(self, points: Floats) -> None:
        flat = points.reshape(-1, 2)
        self.x, self.y = np.ascontiguousarray(flat[:, 0]), np.ascontiguousarray(flat[:, 1])
        self.bounds = (*flat.min(axis=0), *flat.max(axis=0)) if len(flat) else (np.inf, np.inf, -np.inf, -np.inf)

    def near(self, surface: Polygon) -> NDArray[np.int64]:
        """Points inside the bounding box of a surface."""
        low_x, low_y, high_x, high_y = surface.bounds
        if low_x > self.bounds[2] or low_y > self.bounds[3] or high_x < self.bounds[0] or high_y < self.bounds[1]:
            return np.zeros(0, np.int64)
        return np.flatnonzero((self.x > low_x) & (self.x < high_x) & (self.y > low_y) & (self.y < high_y))

    def inside(self, surface: Polygon) -> tuple[NDArray[np.int64], Bools]:
        """Points near a surface, and which of them are strictly inside."""
        which = self.near(surface)
        return which, np.asarray(shapely.contains_xy(surface, self.x[which], self.y[which]), np.bool_)

    def mark(self, verdicts: Bools, surface: Polygon) -> None:
        """Set the verdicts of the points inside; those that are set already are not asked again."""
        flat = verdicts.reshape(-1)
        which = self.near(surface)
        which = which[~flat[which]]
        if which.size:
            flat[which] = shapely.contains_xy(surface, self.x[which], self.y[which])
