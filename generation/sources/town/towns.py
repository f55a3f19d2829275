"""Whole towns: layout, roads, junctions and surfaces put together; one per location, kept for the process."""

from functools import lru_cache

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon

from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.machine.storage import content_seed
from benchmark.road_map import RoadMap, as_multipolygon
from generation.sources.town.junctions import build_car_park, build_crossing, build_roundabout
from generation.sources.town.layout import CANVAS_M, PLANS, Layout, NodeKind, make_layout
from generation.sources.town.network import (
    LANE_WIDTH_M,
    PARKING_WIDTH_M,
    WALKWAY_WIDTH_M,
    Arm,
    Draft,
    Town,
    linked_lanes,
    map_lanes,
)
from generation.sources.town.roads import build_road, half_width, trim_lengths

TOWN_VERSION = "1"

_SMALLEST_WALKWAY_M2 = 1.5
_ISLAND_KERB_M = 0.5


@lru_cache(maxsize=8)
def build_town(location: str, seed: int) -> Town:
    """The town at a location of `OFFICIAL_LOCATIONS`; the same object on every call of this process.

    Every second one has an avenue, the others a ring road; different seeds give different towns.
    """
    rng = np.random.default_rng(content_seed("town", TOWN_VERSION, location, seed))
    layout = make_layout(PLANS[OFFICIAL_LOCATIONS.index(location) % len(PLANS)], rng)
    draft = Draft(prefix=f"town{seed}/")
    trims = trim_lengths(layout)
    arms: dict[str, list[Arm]] = {name: [] for name in layout.nodes}
    for road in layout.roads.values():
        for node_name, arm in zip(road.ends, build_road(draft, layout, road, trims)):
            arms[node_name].append(arm)
    for node in layout.nodes.values():
        if node.kind is NodeKind.CROSSING:
            build_crossing(
                draft, node, arms[node.name], {arm.road: trims[arm.road, node.name] for arm in arms[node.name]}
            )
        elif node.kind is NodeKind.ROUNDABOUT:
            build_roundabout(draft, node, arms[node.name])
        elif node.kind is NodeKind.CAR_PARK:
            build_car_park(draft, node, arms[node.name][0], width_m=float(rng.uniform(50.0, 58.0)))
    road_map = _road_map(draft, layout, location)
    shapely.prepare(road_map.drivable_area)
    return Town(
        layout=layout,
        road_map=road_map,
        lanes=draft.lanes,
        successors=linked_lanes(draft, 0),
        predecessors=linked_lanes(draft, 1),
        crossing_walks=tuple(draft.crossing_walks),
        walks=tuple(draft.walks),
        standing=tuple(draft.standing),
    )


def _road_map(draft: Draft, layout: Layout, location: str) -> RoadMap:
    roads = shapely.union_all(list(draft.surfaces.values()))
    # Parts that meet along a line differ in the last bit; growing and shrinking closes the slits between them.
    drivable = shapely.union_all([roads, *draft.car_parks.values()]).buffer(0.05, join_style="mitre")
    drivable = as_multipolygon(drivable.buffer(-0.05, join_style="mitre").simplify(0.01))
    return RoadMap(
        location=location,
        drivable_area=drivable,
        lanes=map_lanes(draft),
        dividers=tuple(draft.dividers),
        ped_crossings=draft.crossings,
        walkways=_walkways(draft, layout, drivable),
        road_segments={draft.prefix + name: shape for name, shape in draft.surfaces.items()},
        intersections=frozenset(draft.prefix + name for name in draft.junctions),
        stop_lines=draft.stop_lines,
        carparks=draft.car_parks,
        canvas_m=(CANVAS_M, CANVAS_M),
    )


def _walkways(draft: Draft, layout: Layout, drivable: shapely.Geometry) -> dict[str, Polygon]:
    """Pavements on both sides of the roads and round the corners of junctions, in pieces."""
    everywhere = drivable.buffer(WALKWAY_WIDTH_M, quad_segs=8).difference(drivable)
    islands = [island.buffer(_ISLAND_KERB_M) for island in draft.green]
    rest = everywhere.difference(shapely.union_all(islands)) if islands else everywhere
    walkways: dict[str, Polygon] = {}
    for road in layout.roads.values():
        line = LineString(draft.lanes[f"{road.name}/f0"].line).offset_curve(0.5 * LANE_WIDTH_M)
        reach = half_width(road) + PARKING_WIDTH_M + WALKWAY_WIDTH_M + 0.3
        corridor = line.buffer(reach, cap_style="flat")
        walkways |= _pieces(f"{draft.prefix}{road.name}", rest.intersection(corridor))
        rest = rest.difference(corridor)
    for node in layout.nodes.values():
        if node.kind is not NodeKind.EXIT:
            near = shapely.Point(*node.position).buffer(75.0 if node.kind is NodeKind.CAR_PARK else 45.0)
            walkways |= _pieces(f"{draft.prefix}{node.name}", rest.intersection(near))
            rest = rest.difference(near)
    return walkways


def _pieces(name: str, shape: shapely.Geometry) -> dict[str, Polygon]:
    parts = [part for part in as_multipolygon(shape).geoms if part.area > _SMALLEST_WALKWAY_M2]
    parts.sort(key=lambda part: (round(part.centroid.x, 3), round(part.centroid.y, 3)))
    return {f"{name}/walkway{index}": part for index, part in enumerate(parts)}
