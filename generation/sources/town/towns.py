"""Whole towns, one per location, kept for the process: from road references to lanes, paint and pavements."""

from functools import lru_cache

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon

from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.geometry import Floats, wrap_angle
from benchmark.machine.storage import content_seed
from benchmark.road_map import Divider, DividerKind, RoadMap, as_multipolygon
from generation.sources.town.curves import (
    compute_headings,
    compute_lengths,
    cut_line,
    interpolate_at_lengths,
    offset_line,
    resample_line,
)
from generation.sources.town.junctions import build_car_park, build_crossing, build_roundabout
from generation.sources.town.mirror import mirror_map
from generation.sources.town.network import (
    CANVAS_M,
    LANE_WIDTH_M,
    PARKING_WIDTH_M,
    PLANS,
    WALKWAY_WIDTH_M,
    JunctionArm,
    LaneRole,
    ParkingPlace,
    Town,
    TownDraft,
    TownLane,
    TownLayout,
    TownNodeKind,
    TownRoad,
    build_map_lanes,
    build_strip,
    find_linked_lanes,
    find_signals,
    make_layout,
)

KERB_RADIUS_M = 8.5
ACCESS_KERB_RADIUS_M = 6.0
ROUNDABOUT_TRIM_M = 31.0
_STATION_M = 2.0
_CROSSING_M = (1.5, 5.0)
_STOP_LINE_M = (7.2, 7.8)
_SOLID_BEFORE_JUNCTION_M = 24.0
_PARKING_CLEAR_M = 16.0
_SLOT_M = 6.2
_DOUBLE_LINE_M = 0.14


def compute_half_width(road: TownRoad) -> float:
    """Half the width of the lanes of a road, metres, without parking strips."""
    return road.lanes * LANE_WIDTH_M


def compute_heading_from(road: TownRoad, node: str) -> float:
    """Heading of a road away from one of its nodes."""
    tangent = compute_headings(road.reference)
    return float(tangent[0]) if road.ends[0] == node else float(tangent[-1] + np.pi)


def compute_trim_lengths(layout: TownLayout) -> dict[tuple[str, str], float]:
    """Metres by (road, node) from a node to the beginning of a road there: enough for kerbs of the usual radius."""
    trims: dict[tuple[str, str], float] = {}
    for node in layout.nodes.values():
        roads = [road for road in layout.roads.values() if node.name in road.ends]
        for road in roads:
            trims[road.name, node.name] = 0.0
            if node.kind is TownNodeKind.ROUNDABOUT:
                trims[road.name, node.name] = ROUNDABOUT_TRIM_M
            elif node.kind is TownNodeKind.CROSSING:
                own = compute_heading_from(road, node.name)
                for other in roads:
                    angle = abs(float(wrap_angle(np.array(compute_heading_from(other, node.name) - own))))
                    if other.name == road.name or angle > np.deg2rad(140.0):
                        continue
                    needed = (compute_half_width(other) + _choose_kerb_radius(road, other)) / np.sin(angle) + 1.0
                    trims[road.name, node.name] = max(trims[road.name, node.name], float(needed))
    return trims


def _choose_kerb_radius(road: TownRoad, other: TownRoad) -> float:
    slow = min(road.speed_mps, other.speed_mps)
    return ACCESS_KERB_RADIUS_M if slow < 8.0 else KERB_RADIUS_M


def build_road(
    draft: TownDraft, layout: TownLayout, road: TownRoad, trims: dict[tuple[str, str], float]
) -> tuple[JunctionArm, JunctionArm]:
    """Add one road to the draft, shortened by `compute_trim_lengths`; gives its arms at its start and at its end."""
    total = float(compute_lengths(road.reference)[-1])
    line = cut_line(road.reference, trims[road.name, road.ends[0]], total - trims[road.name, road.ends[1]], _STATION_M)
    forward, backward = _add_lanes(draft, road, line)
    parking = _compute_parking_width(road, line)
    side = compute_half_width(road) + parking
    draft.surfaces[road.name] = build_strip(offset_line(line, -side), offset_line(line, side))
    _add_dividers(draft, layout, road, line)
    busy = [layout.nodes[end].kind in (TownNodeKind.CROSSING, TownNodeKind.ROUNDABOUT) for end in road.ends]
    for at_end in (False, True):
        if busy[at_end] and road.speed_mps >= 8.0:
            _add_crossing(draft, road, line[::-1] if at_end else line, at_end)
    if road.kerb_parking:
        _add_parking_places(draft, road, line)
    walk = resample_line(line, 1.0)
    middle = (
        compute_half_width(road)
        + np.interp(compute_lengths(walk), compute_lengths(line), parking)
        + 0.5 * WALKWAY_WIDTH_M
    )
    draft.walks += [offset_line(walk, -middle), offset_line(walk, middle)[::-1]]
    start, end = road.ends
    return (
        JunctionArm(road.name, compute_heading_from(road, start), incoming=backward, outgoing=forward),
        JunctionArm(road.name, compute_heading_from(road, end), incoming=forward, outgoing=backward),
    )


def _add_lanes(draft: TownDraft, road: TownRoad, line: Floats) -> tuple[tuple[str, ...], tuple[str, ...]]:
    names = []
    for direction, side in (("f", -1.0), ("b", 1.0)):
        siblings = tuple(f"{road.name}/{direction}{index}" for index in range(road.lanes))
        for index, name in enumerate(siblings):
            edges = [offset_line(line, side * (index + edge) * LANE_WIDTH_M) for edge in (0.0, 0.5, 1.0)]
            center = edges[1] if direction == "f" else edges[1][::-1]
            surface = build_strip(edges[0], edges[2])
            draft.lanes[name] = TownLane(
                name, center, LaneRole.ROAD, road.name, index, siblings, road.speed_mps, surface
            )
        names.append(siblings)
    return names[0], names[1]


def _compute_parking_width(road: TownRoad, line: Floats) -> Floats:
    """(M,) width of the parking strip at each station: zero near the ends, with tapers."""
    along = compute_lengths(line)
    if not road.kerb_parking:
        return np.zeros(len(line))
    inside = np.minimum(along, along[-1] - along) - _PARKING_CLEAR_M
    return np.asarray(PARKING_WIDTH_M * np.clip(inside / 3.0, 0.0, 1.0))


def _add_parking_places(draft: TownDraft, road: TownRoad, line: Floats) -> None:
    along = compute_lengths(line)
    first = _PARKING_CLEAR_M + 3.5
    count = int((along[-1] - 2 * first) // _SLOT_M)
    where = first + (np.arange(count) + 0.5) * _SLOT_M
    for side in (-1.0, 1.0):
        row = offset_line(line, side * (compute_half_width(road) + 0.5 * PARKING_WIDTH_M))
        yaw = np.interp(where, along, compute_headings(line)) + (0.0 if side < 0 else np.pi)
        for point, heading in zip(interpolate_at_lengths(row, where * compute_lengths(row)[-1] / along[-1]), yaw):
            draft.standing.append(ParkingPlace(np.array([point[0], point[1], heading]), in_car_park=False))


def _add_dividers(draft: TownDraft, layout: TownLayout, road: TownRoad, line: Floats) -> None:
    """Between directions a yellow line, doubled on four-lane roads; between lanes dashes, solid before junctions."""
    along = compute_lengths(line)
    paint = [
        5.6 if layout.nodes[end].kind in (TownNodeKind.CROSSING, TownNodeKind.ROUNDABOUT) else 0.0 for end in road.ends
    ]
    if road.speed_mps < 8.0:
        paint = [0.0, 0.0]
    begin, end = paint[0], float(along[-1]) - paint[1]

    def add(tag: str, lateral: float, start: float, stop: float, kind: DividerKind, between_directions: bool) -> None:
        if stop - start > 2.0:
            part = cut_line(offset_line(line, lateral), start, stop, _STATION_M)
            draft.dividers.append(Divider(f"{draft.prefix}{road.name}/{tag}", part, kind, between_directions))

    if road.lanes > 1:
        add("middle-r", -_DOUBLE_LINE_M, begin, end, DividerKind.SOLID_YELLOW, True)
        add("middle-l", _DOUBLE_LINE_M, begin, end, DividerKind.SOLID_YELLOW, True)
    else:
        kind = DividerKind.DASHED_YELLOW if road.kerb_parking else DividerKind.SOLID_YELLOW
        add("middle", 0.0, begin, end, kind, True)
    for index in range(1, road.lanes):
        for tag, lateral in (("f", -index * LANE_WIDTH_M), ("b", index * LANE_WIDTH_M)):
            solid_from = end - _SOLID_BEFORE_JUNCTION_M if tag == "f" else begin + _SOLID_BEFORE_JUNCTION_M
            solid, dashed = (solid_from, end), (begin, solid_from)
            if tag == "b":
                solid, dashed = (begin, solid_from), (solid_from, end)
            add(f"lane-{tag}{index}-dashed", lateral, *dashed, DividerKind.DASHED_WHITE, False)
            add(f"lane-{tag}{index}-solid", lateral, *solid, DividerKind.SOLID_WHITE, False)


def _add_crossing(draft: TownDraft, road: TownRoad, line: Floats, at_end: bool) -> None:
    """A crossing and a stop line; ``line`` leads away from the junction."""
    side = compute_half_width(road)
    name = f"{draft.prefix}{road.name}/{'end' if at_end else 'start'}"
    near = cut_line(line, *_CROSSING_M, 1.75)
    draft.crossings[name] = build_strip(offset_line(near, -side), offset_line(near, side))
    middle = near[len(near) // 2]
    heading = compute_headings(near)[len(near) // 2]
    across = np.array([-np.sin(heading), np.cos(heading)]) * (side + 0.6 * WALKWAY_WIDTH_M)
    draft.crossing_walks.append(np.stack([middle - across, middle + across]))
    stop = cut_line(line, *_STOP_LINE_M, 0.3)
    draft.stop_lines[name] = Polygon(np.concatenate([stop, offset_line(stop, side)[::-1]]))


TOWN_VERSION = "2"

_SMALLEST_WALKWAY_M2 = 1.5
_ISLAND_KERB_M = 0.5


@lru_cache(maxsize=8)
def build_town(location: str, seed: int) -> Town:
    """The town at a location of `OFFICIAL_LOCATIONS` and of a seed; the same object on every call of this process.

    The first and third have an avenue and drive on the right; the others have a ring road and drive on the left.
    """
    rng = np.random.default_rng(content_seed("town", TOWN_VERSION, location, seed))
    plan = PLANS[OFFICIAL_LOCATIONS.index(location) % len(PLANS)]
    layout = make_layout(plan, rng)
    draft = TownDraft(prefix=f"town{seed}/")
    trims = compute_trim_lengths(layout)
    arms: dict[str, list[JunctionArm]] = {name: [] for name in layout.nodes}
    for road in layout.roads.values():
        for node_name, arm in zip(road.ends, build_road(draft, layout, road, trims)):
            arms[node_name].append(arm)
    for node in layout.nodes.values():
        if node.kind is TownNodeKind.CROSSING:
            build_crossing(
                draft, node, arms[node.name], {arm.road: trims[arm.road, node.name] for arm in arms[node.name]}
            )
        elif node.kind is TownNodeKind.ROUNDABOUT:
            build_roundabout(draft, node, arms[node.name])
        elif node.kind is TownNodeKind.CAR_PARK:
            build_car_park(draft, node, arms[node.name][0], width_m=float(rng.uniform(50.0, 58.0)))
    road_map = _build_road_map(draft, layout, location)
    shapely.prepare(road_map.drivable_area)
    return Town(
        layout=layout,
        road_map=road_map,
        shown_map=mirror_map(road_map) if plan == "ring" else road_map,
        signals=find_signals(layout, arms),
        lanes=draft.lanes,
        successors=find_linked_lanes(draft, 0),
        predecessors=find_linked_lanes(draft, 1),
        crossing_walks=tuple(draft.crossing_walks),
        walks=tuple(draft.walks),
        standing=tuple(draft.standing),
    )


def _build_road_map(draft: TownDraft, layout: TownLayout, location: str) -> RoadMap:
    roads = shapely.union_all(list(draft.surfaces.values()))
    # Parts that meet along a line differ in the last bit; growing and shrinking closes the slits between them.
    drivable = shapely.union_all([roads, *draft.car_parks.values()]).buffer(0.05, join_style="mitre")
    drivable = as_multipolygon(drivable.buffer(-0.05, join_style="mitre").simplify(0.01))
    return RoadMap(
        location=location,
        drivable_area=drivable,
        lanes=build_map_lanes(draft),
        dividers=tuple(draft.dividers),
        ped_crossings=draft.crossings,
        walkways=_build_walkways(draft, layout, drivable),
        road_segments={draft.prefix + name: shape for name, shape in draft.surfaces.items()},
        intersections=frozenset(draft.prefix + name for name in draft.junctions),
        stop_lines=draft.stop_lines,
        carparks=draft.car_parks,
        canvas_m=(CANVAS_M, CANVAS_M),
    )


def _build_walkways(draft: TownDraft, layout: TownLayout, drivable: shapely.Geometry) -> dict[str, Polygon]:
    """Pavements on both sides of the roads and round the corners of junctions, in pieces."""
    everywhere = drivable.buffer(WALKWAY_WIDTH_M, quad_segs=8).difference(drivable)
    islands = [island.buffer(_ISLAND_KERB_M) for island in draft.green]
    rest = everywhere.difference(shapely.union_all(islands)) if islands else everywhere
    walkways: dict[str, Polygon] = {}
    for road in layout.roads.values():
        line = LineString(draft.lanes[f"{road.name}/f0"].line).offset_curve(0.5 * LANE_WIDTH_M)
        reach = compute_half_width(road) + PARKING_WIDTH_M + WALKWAY_WIDTH_M + 0.3
        corridor = line.buffer(reach, cap_style="flat")
        walkways |= _split_pieces(f"{draft.prefix}{road.name}", rest.intersection(corridor))
        rest = rest.difference(corridor)
    for node in layout.nodes.values():
        if node.kind is not TownNodeKind.EXIT:
            near = shapely.Point(*node.position).buffer(75.0 if node.kind is TownNodeKind.CAR_PARK else 45.0)
            walkways |= _split_pieces(f"{draft.prefix}{node.name}", rest.intersection(near))
            rest = rest.difference(near)
    return walkways


def _split_pieces(name: str, shape: shapely.Geometry) -> dict[str, Polygon]:
    parts = [part for part in as_multipolygon(shape).geoms if part.area > _SMALLEST_WALKWAY_M2]
    parts.sort(key=lambda part: (round(part.centroid.x, 3), round(part.centroid.y, 3)))
    return {f"{name}/walkway{index}": part for index, part in enumerate(parts)}
