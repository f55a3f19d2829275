"""Agents that keep their distance: nuPlan's reactive parameters, along each one's own road.

Vehicles with four wheels or more that move in their recording drive along their recorded path, and beyond its end along
the lanes of the map, straight on where they fork; speed is that of the intelligent-driver model (10 m/s or what they
drove where that was faster, 1.5 s and 1 m behind a leader, 1 and 2 m/s^2), and any that stands or moves in their way is
the leader: the ego, others, people. All others, parked cars too, do what the tracks say.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmark.closed_loop.agent_policy import AgentMotion, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import INSTANT_US, INSTANTS
from benchmark.closed_loop.track_replay import TrackReplay
from benchmark.constants import FOUR_WHEELED_CATEGORIES
from benchmark.dynamics.lane_path import SPACING_M, LanePath, build_lane_path, build_straight_path
from benchmark.geometry import Bools, Floats
from benchmark.interactions.idm_driver import compute_idm_acceleration
from benchmark.interactions.tracks import Integers
from benchmark.planning import Command
from benchmark.road_map import RoadMap

SIGHT_M: Final = 100.0
SIDE_MARGIN_M: Final = 0.3
"""Room beside a vehicle that counts as its way."""
_BEHIND_M: Final = 20.0
_BLOCK: Final = 16
"""Points of a road in a block."""
_SAFE_M: Final = 1e-6
"""More than rounding can make of any of these distances."""


@dataclass(frozen=True, slots=True)
class VehicleRoads:
    """Lines along which M vehicles drive, one after the other, in whole blocks of points.

    Attributes:
        length: (M,) points of each.
        first: (M,) row at which each begins.
        line: (P, 3) x, y, heading, every half metre; a line's last point fills its last block.
        centre: (P / 16, 2) centres of circles around blocks of 16 points, metres.
        radius: (P / 16,) their radii.
        stray: (2, M) how far a place can be ahead of the point of a road that is nearest to it: so many metres, and so
            many for each metre that it is beside the road.
    """

    paths: tuple[LanePath, ...]
    length: Integers
    first: Integers
    line: Floats
    centre: Floats
    radius: Floats
    stray: Floats

    @classmethod
    def of(cls, paths: Sequence[LanePath]) -> "VehicleRoads":
        """Cut lines into blocks."""
        length = np.array([len(path.points) for path in paths], np.int64)
        padded_length = -(-length // _BLOCK) * _BLOCK
        padded = [
            np.pad(np.column_stack([path.points, path.heading]), ((0, more), (0, 0)), mode="edge")
            for path, more in zip(paths, (padded_length - length).tolist(), strict=True)
        ]
        line = np.concatenate([np.zeros((0, 3)), *padded])
        blocks = line[:, :2].reshape(-1, _BLOCK, 2)
        centre = 0.5 * (blocks.min(axis=1) + blocks.max(axis=1))
        away = np.hypot(blocks[..., 0] - centre[:, :1], blocks[..., 1] - centre[:, 1:])
        return cls(
            paths=tuple(paths),
            length=length,
            first=np.concatenate([np.zeros(1, np.int64), np.cumsum(padded_length)])[:-1],
            line=line,
            centre=centre,
            radius=away.max(axis=1),
            stray=np.array([_measure_stray(path) for path in paths]).reshape(-1, 2).T,
        )


def find_leaders(
    roads: VehicleRoads, driving: Integers, station: Floats, here: Integers, moment: TrafficSnapshot
) -> tuple[Floats, Floats]:
    """(M,) metres to the nearest in each vehicle's way, infinite without one, and (M,) its speed along the road, m/s.

    ``driving`` are the places of the M vehicles among the agents, ``station`` metres along their roads, ``here`` those
    of them that are on the road.
    """
    gaps, speeds = np.full(len(driving), np.inf), np.zeros(len(driving))
    boxes, velocity, vehicles, other = _find_visible_pairs(driving, here, moment)
    if not len(vehicles):
        return gaps, speeds
    # A box reaches no farther to the side than half of its diagonal.
    reach = 0.5 * np.hypot(boxes[other, 2], boxes[other, 3]) + 0.5 * moment.boxes[driving[vehicles], 3]
    reach += SIDE_MARGIN_M + _SAFE_M
    in_reach, point = _find_nearest_points(roads, vehicles, station[vehicles], boxes[other, :2], reach)
    vehicles, other, reach = vehicles[in_reach], other[in_reach], reach[in_reach]
    line = roads.line[roads.first[vehicles] + point]
    offset = boxes[other, :2] - line[:, :2]
    cos, sin = np.cos(line[:, 2]), np.sin(line[:, 2])
    # Points are exactly half metres apart along the line.
    along = point * SPACING_M + (offset[:, 0] * cos + offset[:, 1] * sin)
    left = offset[:, 1] * cos - offset[:, 0] * sin
    near = (along > station[vehicles]) & (along <= station[vehicles] + SIGHT_M) & (np.abs(left) <= reach)
    vehicles, other, along, left = vehicles[near], other[near], along[near], left[near]
    own = moment.boxes[driving[vehicles]]
    heading = np.empty(len(vehicles))
    for vehicle, rows in _group_runs(vehicles):
        path = roads.paths[vehicle]
        heading[rows] = np.interp(along[rows], path.arc_length, path.heading)
    box, motion = boxes[other], velocity[other]
    cos, sin = np.cos(box[:, 4] - heading), np.sin(box[:, 4] - heading)
    half_along = 0.5 * (np.abs(box[:, 2] * cos) + np.abs(box[:, 3] * sin))
    half_across = 0.5 * (np.abs(box[:, 2] * sin) + np.abs(box[:, 3] * cos))
    inside = np.abs(left) <= half_across + 0.5 * own[:, 3] + SIDE_MARGIN_M
    gap = np.maximum(along - half_along - station[vehicles] - 0.5 * own[:, 2], 0.0)
    speed = motion[:, 0] * np.cos(heading) + motion[:, 1] * np.sin(heading)
    vehicles, gap, speed = vehicles[inside], gap[inside], speed[inside]
    for vehicle, rows in _group_runs(vehicles):
        nearest = rows.start + int(np.argmin(gap[rows]))
        gaps[vehicle], speeds[vehicle] = gap[nearest], speed[nearest]
    return gaps, speeds


def _find_visible_pairs(
    driving: Integers, here: Integers, moment: TrafficSnapshot
) -> tuple[Floats, Floats, Integers, Integers]:
    """Boxes (N + 1, 5) and velocities of all, the ego last, and pairs: which vehicle, and whom it sees."""
    yaw = moment.ego[4]
    own_motion = moment.ego_speed * np.array([[np.cos(yaw), np.sin(yaw)]])
    boxes = np.concatenate([moment.boxes, moment.ego[None]])
    velocity = np.concatenate([moment.velocity, own_motion])
    there = np.append(moment.present, True)
    place = boxes[driving[here], :2]
    in_sight = there & (np.hypot(boxes[:, 0] - place[:, :1], boxes[:, 1] - place[:, 1:]) < SIGHT_M)
    in_sight[np.arange(len(here)), driving[here]] = False
    row, other = np.nonzero(in_sight)
    return boxes, velocity, here[row], other


def _find_nearest_points(
    roads: VehicleRoads, who: Integers, station: Floats, places: Floats, reach: Floats
) -> tuple[Integers, Integers]:
    """(R,) which of Q places can be in the way of vehicles, rising, and (R,) points of their roads nearest to them.

    Only the part of a road counts that is from 20 m behind a vehicle to 200 m ahead of it; of equals the first point.
    From Q vehicles at stations and (Q, 2) places of others, which have to be within ``reach`` beside the road to
    matter.
    """
    # Truncation is towards zero, which puts vehicles before the start of their road at its start.
    lowest = np.maximum(((station - _BEHIND_M) / SPACING_M).astype(np.int64), 0)
    beyond = np.minimum(((station + 2 * SIGHT_M) / SPACING_M).astype(np.int64) + 1, roads.length[who])
    farthest = _bound_distances(roads, who, station, reach)
    begin = lowest // _BLOCK
    columns = np.arange(int(((beyond - 1) // _BLOCK - begin).max()) + 1)
    block = (roads.first[who] // _BLOCK + begin)[:, None] + columns
    inside = columns < (-(-beyond // _BLOCK) - begin)[:, None]
    at = np.minimum(block, len(roads.radius) - 1)
    x, y = roads.centre[:, 0][at] - places[:, :1], roads.centre[:, 1][at] - places[:, 1:]
    pair, column = np.nonzero(inside & (x * x + y * y <= (roads.radius[at] + farthest[:, None]) ** 2))
    point = ((begin[pair] + column) * _BLOCK)[:, None] + np.arange(_BLOCK)
    line = roads.line[roads.first[who[pair], None] + point]
    squared = (places[pair, :1] - line[..., 0]) ** 2 + (places[pair, 1:] - line[..., 1]) ** 2
    squared[(point < lowest[pair, None]) | (point >= beyond[pair, None])] = np.inf
    # Where the nearest point of all is not among these, what is found is too far away to matter, as it is itself.
    squared[squared > farthest[pair, None] ** 2] = np.inf
    best = squared.argmin(axis=1)
    row = np.arange(len(best))
    value, point = squared[row, best], point[row, best]
    near = value < np.inf
    pair, value, point = pair[near], value[near], point[near]
    firsts = _find_first_indices(pair)
    least = np.repeat(np.minimum.reduceat(value, firsts), np.diff(np.append(firsts, len(pair)))) if len(pair) else value
    pair, point = pair[value == least], point[value == least]
    firsts = _find_first_indices(pair)
    return pair[firsts], point[firsts]


def _bound_distances(roads: VehicleRoads, who: Integers, station: Floats, reach: Floats) -> Floats:
    """(Q,) how far from the nearest point of a road a place is at most that is within reach of it.

    Such a place is hardly ahead of the point or behind it (`_measure_stray`); but beyond the end of a road it can be
    ahead as far as is looked.
    """
    constant, slope = roads.stray[:, who]
    beyond_end = station + SIGHT_M - SPACING_M * (roads.length[who] - 1)
    return np.asarray(np.hypot(np.maximum(constant + slope * reach, beyond_end), reach) + _SAFE_M)


def _measure_stray(path: LanePath) -> tuple[float, float]:
    """See `VehicleRoads`: infinite of a line that turns back on itself.

    Of a place o from its nearest point, with steps u to the next point and from the one before, o u <= u u / 2 and o u
    >= - u u / 2; along and across the heading there that bounds how far o is along it.
    """
    steps = np.diff(path.points, axis=0)
    ahead = np.column_stack([np.cos(path.heading), np.sin(path.heading)])
    aside = ahead[:, ::-1] * [-1.0, 1.0]
    pairs = [(ahead[:-1], aside[:-1]), (ahead[1:], aside[1:])]
    along = np.concatenate([(steps * axis).sum(axis=1) for axis, _ in pairs])
    across = np.concatenate([np.abs((steps * axis).sum(axis=1)) for _, axis in pairs])
    if along.min() <= 0.0:
        return np.inf, 0.0
    half = 0.5 * (steps**2).sum(axis=1)
    return float((np.concatenate([half, half]) / along).max()) + _SAFE_M, float((across / along).max()) + _SAFE_M


def _group_runs(rising: Integers) -> list[tuple[int, slice]]:
    """Values of a rising list and where each one is."""
    firsts = _find_first_indices(rising)
    ends = np.append(firsts, len(rising))
    return [(int(rising[first]), slice(int(first), int(end))) for first, end in zip(firsts, ends[1:], strict=True)]


def _find_first_indices(rising: Integers) -> Integers:
    """Where each value of a rising list is first."""
    return np.flatnonzero(np.append(True, rising[1:] != rising[:-1])) if len(rising) else rising


FREE_SPEED_M_S: Final = 10.0
MOVING_M: Final = 2.0
"""A vehicle that moves no farther than this in the recording is parked."""
_BEYOND_M: Final = 300.0
"""Of road beyond the end of a recorded path."""


@dataclass(frozen=True, slots=True)
class IdmMemory:
    """State of the M vehicles that drive by themselves; every array (M,).

    ``station`` is of the centre along each one's path, metres; ``here`` are those that have come in and not yet reached
    the end of their road, ``come`` all that have come in.
    """

    station: Floats
    speed: Floats
    here: Bools
    come: Bools


@dataclass(frozen=True, slots=True)
class IdmPolicy:
    """Policy under which M vehicles drive by themselves along roads and all other agents keep their tracks.

    ``driving`` are their indices; ``free_speed`` is m/s on an empty road, ``length`` metres of each one's road.
    """

    replay: TrackReplay
    driving: Integers
    roads: VehicleRoads
    free_speed: Floats
    length: Floats
    name: str = "idm"
    draws: bool = False

    @classmethod
    def of(cls, replay: TrackReplay, categories: Sequence[str], road_map: RoadMap) -> "IdmPolicy":
        """The policy of a scene; the map says where roads go on."""
        driving, paths, fastest = [], [], []
        for agent, category in enumerate(categories):
            rows = np.flatnonzero(replay.present[:, agent])
            places = replay.boxes[rows, agent]
            if category not in FOUR_WHEELED_CATEGORIES or len(rows) < 2 or _measure_reach(places) < MOVING_M:
                continue
            driving.append(agent)
            speed = np.hypot(*replay.velocity[rows, agent].T)
            fastest.append(max(float(speed.max()), FREE_SPEED_M_S))
            paths.append(_build_road_path(places, float(speed[-1]), road_map))
        return cls(
            replay=replay,
            driving=np.array(driving, np.int64),
            roads=VehicleRoads.of(paths),
            free_speed=np.array(fastest),
            length=np.array([path.arc_length[-1] for path in paths]),
        )

    def init(self, time_us: int, key: int) -> tuple[IdmMemory, AgentMotion]:
        """All agents where the tracks begin."""
        count = len(self.driving)
        all_absent = np.zeros(count, np.bool_)
        _, moved = self.replay.init(time_us, key)
        memory = self._add_arrivals(IdmMemory(np.zeros(count), np.zeros(count), all_absent, all_absent), moved)
        return memory, moved

    def act(self, memory: IdmMemory, moment: TrafficSnapshot, key: int) -> tuple[IdmMemory, AgentMotion]:
        """The next 0.1 s: those on the road follow the nearest ahead of them now."""
        _, moved = self.replay.act(None, moment, key)
        boxes, present, velocity = moved.boxes.copy(), moved.present.copy(), moved.velocity.copy()
        here = np.flatnonzero(memory.here)
        gap, leader_speed = find_leaders(self.roads, self.driving, memory.station, here, moment)
        acceleration = compute_idm_acceleration(memory.speed, self.free_speed, gap, leader_speed)
        station, speed = memory.station, memory.speed
        seconds = INSTANT_US / 1e6
        for instant in range(INSTANTS):
            faster = np.maximum(speed + seconds * acceleration, 0.0)
            station, speed = station + 0.5 * seconds * (speed + faster), faster
            self._place(boxes[instant], station, memory.here)
            present[instant, self.driving] = memory.here
        after = IdmMemory(station, speed, memory.here & (station < self.length), memory.come)
        after = self._add_arrivals(after, moved)
        present[-1, self.driving] |= after.here & ~memory.come
        self._set_velocity(velocity, after)
        return after, AgentMotion(boxes, present, velocity)

    def _add_arrivals(self, memory: IdmMemory, moved: AgentMotion) -> IdmMemory:
        """Vehicles that appear for the first time start at their recorded states."""
        new = moved.present[-1, self.driving] & ~memory.come
        if not new.any():
            return memory
        station, speed = memory.station.copy(), memory.speed.copy()
        for index in np.flatnonzero(new):
            agent = self.driving[index]
            station[index] = max(float(self.roads.paths[index].project(moved.boxes[-1, agent, :2])[0]), 0.0)
            speed[index] = np.hypot(*moved.velocity[agent])
        return replace(memory, station=station, speed=speed, here=memory.here | new, come=memory.come | new)

    def _at(self, station: Floats) -> Floats:
        """(M, 3) x, y, heading of each one at its station."""
        place = np.minimum(station, self.length) / SPACING_M
        row = np.minimum(place.astype(np.int64), (self.length / SPACING_M).astype(np.int64) - 1)
        share = (place - row)[:, None]
        at = self.roads.first + row
        return np.asarray((1.0 - share) * self.roads.line[at] + share * self.roads.line[at + 1])

    def _place(self, boxes: Floats, station: Floats, here: Bools) -> None:
        rows = self.driving[here]
        boxes[rows[:, None], [0, 1, 4]] = self._at(station)[here]

    def _set_velocity(self, velocity: Floats, memory: IdmMemory) -> None:
        heading = self._at(memory.station)[:, 2]
        moving = memory.speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        velocity[self.driving[memory.here]] = moving[memory.here]


def _measure_reach(places: Floats) -> float:
    """How far from its first place an agent comes, metres."""
    return float(np.hypot(*(places[:, :2] - places[0, :2]).T).max())


def _build_road_path(places: Floats, speed: float, road_map: RoadMap) -> LanePath:
    """The recorded path, and where the road goes on from its end."""
    spaced_rows = _find_spaced_rows(places[:, :2])
    end = places[-1, [0, 1, 4]]
    beyond = build_lane_path(road_map, end, Command.STRAIGHT, speed, _BEYOND_M) or build_straight_path(end, _BEYOND_M)
    recorded = places[spaced_rows, :2]
    # The last recorded place is where the road beyond begins; points nearer than a step to it would fold the line.
    far = np.hypot(*(recorded - end[:2]).T) >= SPACING_M
    return LanePath.through(np.concatenate([recorded[far], beyond.points]))


def _find_spaced_rows(places: Floats) -> list[int]:
    """Rows of (R, 2) places, each half a metre or more from the one before."""
    spaced_rows, at = [0], places.tolist()
    x, y = at[0]
    for row in range(1, len(at)):
        squared = (at[row][0] - x) ** 2 + (at[row][1] - y) ** 2
        # Plain numbers are fast, and the last bit matters only where they are nearly equal.
        if abs(squared - SPACING_M**2) > 1e-9:
            apart = squared > SPACING_M**2
        else:
            apart = bool(np.hypot(*(places[row] - places[spaced_rows[-1]])) >= SPACING_M)
        if apart:
            spaced_rows.append(row)
            x, y = at[row]
    return spaced_rows
