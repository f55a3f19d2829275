"""Crossings, roundabouts and car parks: the connectors between roads and the surfaces they need."""

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

from benchmark.geometry import Floats, to_global, wrap_angle
from benchmark.road_map import as_multipolygon
from generation.sources.town.curves import build_turn, compute_headings, join_lines, resample_line, unit_vector
from generation.sources.town.network import (
    LANE_WIDTH_M,
    JunctionArm,
    LaneRole,
    ParkingPlace,
    TownDraft,
    TownLane,
    TownNode,
    build_strip,
)

RING_RADIUS_M = 15.0
RING_WIDTH_M = 5.0
_MERGE_ANGLE_RAD = np.deg2rad(35.0)
_CONNECTOR_STEP_M = 0.5
_TURN_SPEED_MPS = 8.0
_RING_SPEED_MPS = 8.0
_PARK_SPEED_MPS = 5.0
_AISLE_M = 6.0
_BAY_LENGTH_M = 5.2
_BAY_WIDTH_M = 2.7


def build_crossing(draft: TownDraft, node: TownNode, arms: list[JunctionArm], trims: dict[str, float]) -> None:
    """Connect the arms of a crossing or T junction, ``trims`` (by road) from its node on, and add its surface."""
    for arm in arms:
        for other in arms:
            if other.road != arm.road:
                _connect_arms(draft, node, arm, other)
    _require_connected(draft, arms)
    radius = 5.5 if any(draft.lanes[arm.incoming[0]].speed_mps < 8.0 for arm in arms) else 8.0
    beams = [_build_arm_band(draft, node, arm, trims[arm.road] + 4.0 * radius) for arm in arms]
    area = (
        shapely.union_all([*beams, *_build_connector_bands(draft, node)])
        .buffer(radius, quad_segs=16)
        .buffer(-radius, quad_segs=16)
    )
    edges = [_compute_arm_edge(draft, arm) for arm in arms]
    reach = shapely.MultiPoint(np.concatenate([*edges, node.position[None]])).convex_hull.buffer(0.01)
    draft.surfaces[node.name] = max(as_multipolygon(area.intersection(reach)).geoms, key=lambda part: part.area)
    draft.junctions.append(node.name)


def _build_connector_bands(draft: TownDraft, node: TownNode) -> list[Polygon]:
    lanes = (lane for lane in draft.lanes.values() if lane.road == node.name)
    return [LineString(lane.line).buffer(0.5 * LANE_WIDTH_M, cap_style="flat") for lane in lanes]


def _compute_arm_edge(draft: TownDraft, arm: JunctionArm) -> Floats:
    """(4, 2) the two ends of the line where an arm begins, and the same a little way into the road."""
    incoming, outgoing = draft.lanes[arm.incoming[-1]], draft.lanes[arm.outgoing[-1]]
    right = 0.5 * LANE_WIDTH_M * unit_vector(arm.heading - np.pi / 2)
    into = 0.05 * unit_vector(arm.heading)
    ends = np.stack([outgoing.line[0] + right, incoming.line[-1] - right])
    return np.concatenate([ends, ends + into])


def _build_arm_band(draft: TownDraft, node: TownNode, arm: JunctionArm, reach: float) -> Polygon:
    """A straight band as wide as the arm, from the node outwards."""
    width = len(arm.incoming) * LANE_WIDTH_M
    edge = _compute_arm_edge(draft, arm)[:2].mean(axis=0)
    start = edge - unit_vector(arm.heading) * float(np.hypot(*(edge - node.position)))
    return LineString([start, start + reach * unit_vector(arm.heading)]).buffer(width, cap_style="flat")


def _connect_arms(draft: TownDraft, node: TownNode, arm: JunctionArm, other: JunctionArm) -> None:
    """Connectors from one arm into another, lane by lane as people would use them."""
    change = float(wrap_angle(np.array(other.heading - arm.heading - np.pi)))
    count_in, count_out = len(arm.incoming), len(other.outgoing)
    if abs(change) < np.deg2rad(40.0):
        role = LaneRole.STRAIGHT
        pairs = [(index, min(index, count_out - 1)) for index in range(count_in)]
        pairs += [(count_in - 1, index) for index in range(count_in, count_out)]
    elif change > 0:
        role, pairs = LaneRole.LEFT, [(0, 0)]
    else:
        role, pairs = LaneRole.RIGHT, [(count_in - 1, count_out - 1)]
    for index_in, index_out in pairs:
        _add_connector(draft, node, arm.incoming[index_in], other.outgoing[index_out], role)


def _add_connector(draft: TownDraft, node: TownNode, source: str, target: str, role: LaneRole) -> None:
    before, after = draft.lanes[source], draft.lanes[target]
    line = build_turn(
        before.line[-1],
        float(compute_headings(before.line)[-1]),
        after.line[0],
        float(compute_headings(after.line)[0]),
        step_m=_CONNECTOR_STEP_M,
        max_radius_m=22.0,
    )
    name = f"{node.name}/{source.replace('/', '.')}>{target.replace('/', '.')}"
    fast = min(before.speed_mps, after.speed_mps)
    speed = fast if role is LaneRole.STRAIGHT else min(fast, _TURN_SPEED_MPS)
    draft.lanes[name] = TownLane(name, line, role, node.name, 0, (name,), speed, None)
    draft.links += [(source, name), (name, target)]


def _require_connected(draft: TownDraft, arms: list[JunctionArm]) -> None:
    """Every lane of a junction must lead somewhere and be reachable."""
    sources = {first for first, _ in draft.links}
    targets = {second for _, second in draft.links}
    for arm in arms:
        assert all(name in sources for name in arm.incoming), f"{arm.road}: a lane leads nowhere"
        assert all(name in targets for name in arm.outgoing), f"{arm.road}: a lane cannot be reached"


def build_roundabout(draft: TownDraft, node: TownNode, arms: list[JunctionArm]) -> None:
    """A one-lane roundabout, counter-clockwise; its roads have one lane per direction."""
    arms = sorted(arms, key=lambda arm: float(arm.heading % (2 * np.pi)))
    for arm, following in zip(arms, [*arms[1:], arms[0]]):
        span = float((following.heading - arm.heading) % (2 * np.pi))
        begin, end = arm.heading + _MERGE_ANGLE_RAD, arm.heading + span - _MERGE_ANGLE_RAD
        ring, passing = f"{node.name}/ring.{arm.road}", f"{node.name}/pass.{arm.road}"
        _add_arc(draft, node, ring, begin, end, LaneRole.RING)
        _add_arc(draft, node, passing, arm.heading - _MERGE_ANGLE_RAD, begin, LaneRole.STRAIGHT)
        for source, target, role in (
            (arm.incoming[0], ring, LaneRole.RING_ENTRY),
            (ring, following.outgoing[0], LaneRole.RING_EXIT),
        ):
            _add_ring_connector(draft, node, source, target, role)
        draft.links += [(passing, ring), (ring, f"{node.name}/pass.{following.road}")]
    center = Point(*node.position)
    inner, outer = RING_RADIUS_M - 0.5 * RING_WIDTH_M, RING_RADIUS_M + 0.5 * RING_WIDTH_M + 0.5
    island = center.buffer(inner, quad_segs=32)
    beams = [_build_arm_band(draft, node, arm, _compute_reach(draft, node, arm) + 12.0) for arm in arms]
    area = shapely.union_all([center.buffer(outer, quad_segs=32), *beams, *_build_connector_bands(draft, node)])
    area = area.buffer(6.0, quad_segs=16).buffer(-6.0, quad_segs=16)
    edges = [_compute_arm_edge(draft, arm) for arm in arms]
    reach = shapely.MultiPoint(np.concatenate([*edges, np.array(center.buffer(outer).exterior.coords)])).convex_hull
    draft.surfaces[node.name] = max(
        as_multipolygon(area.intersection(reach.buffer(0.01)).difference(island)).geoms, key=lambda part: part.area
    )
    draft.junctions.append(node.name)
    draft.green.append(island)


def _compute_reach(draft: TownDraft, node: TownNode, arm: JunctionArm) -> float:
    return float(np.hypot(*(_compute_arm_edge(draft, arm)[:2].mean(axis=0) - node.position)))


def _compute_ring_points(node: TownNode, begin: float, end: float, radius: float) -> Floats:
    angle = np.linspace(begin, end, max(round(radius * (end - begin) / _CONNECTOR_STEP_M), 2) + 1)
    return np.asarray(node.position + radius * np.column_stack([np.cos(angle), np.sin(angle)]))


def _add_arc(draft: TownDraft, node: TownNode, name: str, begin: float, end: float, role: LaneRole) -> None:
    line = _compute_ring_points(node, begin, end, RING_RADIUS_M)
    half = 0.5 * RING_WIDTH_M
    sides = [_compute_ring_points(node, begin, end, RING_RADIUS_M + side) for side in (half, -half)]
    surface = build_strip(*sides)
    draft.lanes[name] = TownLane(name, line, role, node.name, 0, (name,), _RING_SPEED_MPS, surface)


def _add_ring_connector(draft: TownDraft, node: TownNode, source: str, target: str, role: LaneRole) -> None:
    before, after = draft.lanes[source], draft.lanes[target]
    start_heading, end_heading = float(compute_headings(before.line)[-1]), float(compute_headings(after.line)[0])
    entering = role is LaneRole.RING_ENTRY
    ring_point = after.line[0] if entering else before.line[-1]
    tangent = float(np.arctan2(*(ring_point - node.position)[::-1])) + np.pi / 2
    start_heading, end_heading = (start_heading, tangent) if entering else (tangent, end_heading)
    line = build_turn(
        before.line[-1], start_heading, after.line[0], end_heading, step_m=_CONNECTOR_STEP_M, max_radius_m=20.0
    )
    tag = source if entering else target
    name = f"{node.name}/{role.value}.{tag.replace('/', '.')}"
    draft.lanes[name] = TownLane(name, line, role, node.name, 0, (name,), _RING_SPEED_MPS, None)
    draft.links += [(source, name), (name, target)]


def build_car_park(draft: TownDraft, node: TownNode, arm: JunctionArm, *, width_m: float) -> None:
    """A car park, ``width_m`` across its access road: a one-way loop between four rows of bays."""
    # Frame of the car park: x into it, y to the left of that.
    pose = np.array([*node.position, float(wrap_angle(np.array(arm.heading + np.pi)))])
    half, rows = 0.5 * width_m, (_BAY_LENGTH_M, _BAY_LENGTH_M + _AISLE_M + 2 * _BAY_LENGTH_M)
    depth = rows[1] + _AISLE_M + _BAY_LENGTH_M
    near, far = rows[0] + 0.5 * _AISLE_M, rows[1] + 0.5 * _AISLE_M
    lane, side = 0.5 * LANE_WIDTH_M, half - 0.5 * _AISLE_M
    corners = [
        (0, -lane),
        (near, -lane),
        (near, -side),
        (far, -side),
        (far, side),
        (near, side),
        (near, lane),
        (0, lane),
    ]
    line = resample_line(to_global(_round_corners(np.array(corners, np.float64), 5.5), pose), 1.0)
    name = f"{node.name}/loop"
    surface = LineString(line).buffer(0.5 * LANE_WIDTH_M, cap_style="flat")
    draft.lanes[name] = TownLane(name, line, LaneRole.CAR_PARK, node.name, 0, (name,), _PARK_SPEED_MPS, surface)
    draft.links += [(arm.incoming[0], name), (name, arm.outgoing[0])]
    outline = np.array(
        [(-0.3, -LANE_WIDTH_M), (-0.3, LANE_WIDTH_M), (0.0, half), (depth, half), (depth, -half), (0.0, -half)]
    )
    draft.car_parks[draft.prefix + node.name] = Polygon(to_global(outline, pose))
    inner = side - _AISLE_M
    bays = [
        *((0.5 * _BAY_LENGTH_M, y, 0.0) for y in _compute_bay_centers(half - 0.3) if abs(y) > 9.0),
        *((rows[0] + _AISLE_M + 0.5 * _BAY_LENGTH_M, y, np.pi) for y in _compute_bay_centers(inner)),
        *((rows[1] - 0.5 * _BAY_LENGTH_M, y, 0.0) for y in _compute_bay_centers(inner)),
        *((depth - 0.5 * _BAY_LENGTH_M, y, np.pi) for y in _compute_bay_centers(half - 0.3)),
    ]
    for x, y, yaw in bays:
        center = to_global(np.array([x, y]), pose)
        draft.standing.append(ParkingPlace(np.array([center[0], center[1], pose[2] + yaw]), in_car_park=True))


def _compute_bay_centers(half: float) -> list[float]:
    count = int(2 * half // _BAY_WIDTH_M)
    return [(index - 0.5 * (count - 1)) * _BAY_WIDTH_M for index in range(count)]


def _round_corners(corners: Floats, radius: float) -> Floats:
    """A path through right-angled corners with every inner corner replaced by an arc."""
    pieces, start = [], corners[0]
    for before, corner, after in zip(corners[:-2], corners[1:-1], corners[2:]):
        back, ahead = before - corner, after - corner
        first, second = float(np.arctan2(-back[1], -back[0])), float(np.arctan2(ahead[1], ahead[0]))
        entry, exit_ = corner - radius * unit_vector(first), corner + radius * unit_vector(second)
        pieces += [resample_line(np.stack([start, entry]), 0.25), build_turn(entry, first, exit_, second, step_m=0.25)]
        start = exit_
    pieces.append(resample_line(np.stack([start, corners[-1]]), 0.25))
    return join_lines(pieces)
