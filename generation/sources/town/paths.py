"""From a chain of lanes to the motion of a car's body: routes, and paths that a wheeled vehicle can follow exactly."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sin

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_HEIGHT_M, EGO_LENGTH_M, EGO_WHEELBASE_M, EGO_WIDTH_M
from benchmark.geometry import Floats
from generation.sources.town.curves import (
    compute_headings,
    compute_lengths,
    interpolate_at_lengths,
    interpolate_grid,
    join_lines,
    offset_line,
    resample_line,
    smooth_line,
)
from generation.sources.town.network import LaneRole, Town, TownLane

STATION_M = 0.5
LEAD_M = 14.0
_SMOOTHING_M = 2.0
_COMFORTABLE_LATERAL_MPS2 = 2.2
_COMFORTABLE_BRAKING_MPS2 = 1.2
_LANE_CHANGE_M = (32.0, 46.0)
_ROOM_FOR_LANE_CHANGE_M = 75.0


@dataclass(frozen=True, slots=True)
class VehicleBody:
    """Size, metres, and wheels of a vehicle; ``center_ahead`` is the box centre ahead of the rear axle."""

    category: str
    length: float
    width: float
    height: float
    wheelbase: float
    center_ahead: float


EGO_BODY = VehicleBody(
    "vehicle.car", EGO_LENGTH_M, EGO_WIDTH_M, EGO_HEIGHT_M, EGO_WHEELBASE_M, EGO_CENTER_FROM_REAR_AXLE_M
)


@dataclass(frozen=True, slots=True)
class RouteLeg:
    """One lane of a route; ``changes_to`` is the sibling lane that it ends in, from ``change_from_m`` along it."""

    lane: str
    changes_to: str | None = None
    change_from_m: float = 0.0
    change_length_m: float = 0.0

    @property
    def leaves_by(self) -> str:
        """The lane at the end of the leg."""
        return self.lane if self.changes_to is None else self.changes_to


@dataclass(frozen=True, slots=True)
class VehiclePath:
    """Way of a vehicle, (M, 3) rear-axle x, y, yaw every `STATION_M`; (M,) limits, m/s, are by sign and curvature.

    ``halts`` are the stations, by lane, at which the front axle is at the end of a lane that ends at traffic lights.
    """

    rear: Floats
    speed_limit: Floats
    body: VehicleBody
    halts: tuple[tuple[int, str], ...] = ()

    def boxes(self, stations: Floats) -> Floats:
        """(K, 5) boxes at fractional stations."""
        return compute_body_boxes(interpolate_grid(self.rear, stations), self.body)


def compute_body_boxes(rear: Floats, body: VehicleBody) -> Floats:
    """Boxes of a vehicle from (..., 3) rear-axle poses."""
    heading = rear[..., 2]
    x = rear[..., 0] + body.center_ahead * np.cos(heading)
    y = rear[..., 1] + body.center_ahead * np.sin(heading)
    size = np.broadcast_to([body.length, body.width], (*heading.shape, 2))
    return np.concatenate([np.stack([x, y], -1), size, heading[..., None]], axis=-1)


def compute_lane_length(lane: TownLane) -> float:
    """Metres along a lane."""
    return float(compute_lengths(lane.line)[-1])


def is_dead_end(town: Town, name: str) -> bool:
    """Whether a lane leads out of the map, itself or after its junction."""
    after = town.successors[name]
    return not after or (
        town.lanes[name].role is not LaneRole.ROAD and all(not town.successors[lane] for lane in after)
    )


def find_route(
    town: Town,
    lane: str,
    start_m: float,
    length_m: float,
    rng: np.random.Generator,
    *,
    likes: Callable[[TownLane], float],
    change_chance: float = 0.0,
) -> tuple[list[RouteLeg], float] | None:
    """A random chain of lanes around a start, and the start's arc length on the first leg, at least `LEAD_M`.

    ``start_m`` is of the front axle along the lane; where negative, the route begins further back. At least
    ``length_m`` lie ahead of it. ``likes`` weighs each next lane, zero forbids it; ``change_chance`` is of a lane
    change on each road that has room for it. ``None`` where there is no such route.
    """
    before: list[str] = []
    first = lane
    while start_m < LEAD_M:
        options = town.predecessors[first]
        if not options:
            return None
        first = options[int(rng.integers(len(options)))]
        before.insert(0, first)
        start_m += compute_lane_length(town.lanes[first])
    legs = [RouteLeg(name) for name in before]
    # A change of lane ahead of the start is possible on the start's own lane too.
    passed = start_m - sum(compute_lane_length(town.lanes[name]) for name in before)
    current: str | None = lane
    ahead = -passed
    while current is not None:
        leg = _draw_leg(town, current, rng, change_chance, max(passed, 0.0))
        passed = 0.0
        legs.append(leg)
        ahead += compute_lane_length(town.lanes[current])
        if ahead > length_m:
            return legs, start_m
        options = tuple(name for name in town.successors[leg.leaves_by] if not is_dead_end(town, name))
        weights = np.array([likes(town.lanes[name]) for name in options])
        if not options or weights.sum() <= 0:
            return None
        current = options[int(rng.choice(len(options), p=weights / weights.sum()))]
    return None


def _draw_leg(town: Town, name: str, rng: np.random.Generator, change_chance: float, passed: float) -> RouteLeg:
    lane = town.lanes[name]
    room = compute_lane_length(lane) - passed
    if len(lane.siblings) < 2 or room < _ROOM_FOR_LANE_CHANGE_M or rng.random() >= change_chance:
        return RouteLeg(name)
    others = [other for other in lane.siblings if abs(town.lanes[other].index - lane.index) == 1]
    length = float(rng.uniform(*_LANE_CHANGE_M))
    begin = passed + float(rng.uniform(6.0, room - length - 20.0))
    return RouteLeg(name, others[int(rng.integers(len(others)))], begin, length)


def build_path(
    town: Town,
    legs: list[RouteLeg],
    start_m: float,
    body: VehicleBody,
    *,
    lateral_m: float = 0.0,
    pull_out_m: float = 0.0,
) -> VehiclePath:
    """The path of a vehicle along a route; its front axle follows the smoothed centrelines exactly.

    The rear axle is towed by the front axle, which is the kinematic bicycle with the front wheels along the path: it
    moves along the heading and never sideways. The front axle is at ``start_m`` of the first leg at station 0;
    ``lateral_m`` is an offset to the left of the centrelines, constant or gone after ``pull_out_m``.
    """
    lines, limits, ends, along = [], [], [], 0.0
    for leg in legs:
        line = _build_leg_line(town, leg)
        limits.append((along, town.lanes[leg.lane].speed_mps))
        along += float(compute_lengths(line)[-1])
        if leg.leaves_by in town.signals:
            ends.append((round((along - start_m) / STATION_M), leg.leaves_by))
        lines.append(line)
    line = resample_line(join_lines(lines), STATION_M)
    spacing = float(np.hypot(*(line[1] - line[0])))
    if pull_out_m:
        # From the strip at the kerb, standing along it, into the lane.
        u = np.clip((np.arange(len(line)) * spacing - start_m - 1.0) / pull_out_m, 0.0, 1.0)
        line = offset_line(line, lateral_m * (1 - u**3 * (10 - 15 * u + 6 * u**2)))
    elif lateral_m:
        line = offset_line(line, lateral_m)
    front = smooth_line(line, spacing_m=spacing, deviation_m=_SMOOTHING_M)
    walked = compute_lengths(front)
    skipped = round((start_m - LEAD_M) / spacing)
    front = interpolate_at_lengths(front, np.arange(walked[max(skipped, 0)], walked[-1], STATION_M))
    rear = _compute_rear_axle_path(front, body.wheelbase)
    curvature = np.gradient(compute_headings(front)) / STATION_M
    stations = np.arange(len(front)) * STATION_M + start_m - LEAD_M
    starts, speeds = np.array(limits).T
    limit = speeds[np.clip(np.searchsorted(starts, stations, side="right") - 1, 0, len(speeds) - 1)]
    bend = np.sqrt(_COMFORTABLE_LATERAL_MPS2 / np.maximum(np.abs(curvature), 1e-3))
    lead = round(LEAD_M / STATION_M)
    return VehiclePath(rear[lead:], np.minimum(limit, bend)[lead:], body, tuple(ends))


def compute_fastest_start(path: VehiclePath) -> float:
    """Speed at the start from which gentle braking meets every speed limit ahead, m/s."""
    stations = np.arange(len(path.speed_limit)) * STATION_M
    return float(np.sqrt(path.speed_limit**2 + 2 * _COMFORTABLE_BRAKING_MPS2 * stations).min())


def _build_leg_line(town: Town, leg: RouteLeg) -> Floats:
    line = town.lanes[leg.lane].line
    if leg.changes_to is None:
        return line
    # Siblings are parallels of one reference: equal stations lie side by side.
    u = np.clip((compute_lengths(line) - leg.change_from_m) / leg.change_length_m, 0.0, 1.0)
    blend = (u**3 * (10 - 15 * u + 6 * u**2))[:, None]
    return np.asarray((1 - blend) * line + blend * town.lanes[leg.changes_to].line)


def _compute_rear_axle_path(front: Floats, wheelbase: float) -> Floats:
    """(M, 3) rear-axle poses behind a (M, 2) front-axle path.

    Kinematic bicycle with the front wheels along the path: d yaw / d s = sin(path heading - yaw) / wheelbase, by the
    midpoint rule.
    """
    tangent = compute_headings(front)
    steps = np.diff(compute_lengths(front)).tolist()
    middle = (0.5 * (tangent[1:] + tangent[:-1])).tolist()
    yaw = float(tangent[0])
    yaws = [yaw]
    for step, before, between in zip(steps, tangent.tolist(), middle):
        halfway = yaw + 0.5 * step * sin(before - yaw) / wheelbase
        yaw += step * sin(between - halfway) / wheelbase
        yaws.append(yaw)
    heading = np.array(yaws)
    rear = front - wheelbase * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.column_stack([rear, heading])
