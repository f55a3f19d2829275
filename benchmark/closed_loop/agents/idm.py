"""Agents that keep their distance: nuPlan's reactive parameters, along each one's own road.

Vehicles with four wheels or more that move in their recording drive along their recorded path, and beyond its end along
the lanes of the map, straight on where they fork; speed is that of the intelligent-driver model (10 m/s or what they
drove where that was faster, 1.5 s and 1 m behind a leader, 1 and 2 m/s^2), and whoever stands or moves in their way is
the leader: the ego, others, people. Everybody else, parked cars too, does what the tracks say.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmark.closed_loop.agents.contract import Moment, Moved
from benchmark.closed_loop.agents.replay import Replay
from benchmark.closed_loop.following import INSTANT_US, INSTANTS
from benchmark.constants import FOUR_WHEELED_CATEGORIES
from benchmark.drivers.keeping_distance import idm_acceleration
from benchmark.dynamics.lane_path import SPACING_M, Path, lane_path, straight_path
from benchmark.encounters.tracks import Integers
from benchmark.geometry import Bools, Floats
from benchmark.planning import Command
from benchmark.road_map import RoadMap

FREE_SPEED_M_S: Final = 10.0
SIGHT_M: Final = 100.0
SIDE_MARGIN_M: Final = 0.3
"""Room beside a vehicle that counts as its way."""
MOVING_M: Final = 2.0
"""Who comes no further than this in the recording is parked."""
_BEHIND_M: Final = 20.0
_BEYOND_M: Final = 300.0
"""Of road beyond the end of a recorded path."""


@dataclass(frozen=True, slots=True)
class IdmMemory:
    """Where the M vehicles are that drive by themselves.

    Attributes:
        station: (M,) of the centre along each one's path, metres.
        speed: (M,) m/s.
        here: (M,) who has come in and not yet reached the end of its road.
        come: (M,) who has come in.
    """

    station: Floats
    speed: Floats
    here: Bools
    come: Bools


@dataclass(frozen=True, slots=True)
class Idm:
    """The policy.

    Attributes:
        replay: Tracks of everybody.
        driving: (M,) agents that drive by themselves.
        paths: M lines along which they do.
        free_speed: (M,) m/s on an empty road.
        road: (P, 3) x, y, heading of all paths, every half metre, one after the other.
        first: (M,) row at which each one's begins.
        length: (M,) of each one's, metres.
        name: Of the policy.
        draws: It draws nothing.
    """

    replay: Replay
    driving: Integers
    paths: tuple[Path, ...]
    free_speed: Floats
    road: Floats
    first: Integers
    length: Floats
    name: str = "idm"
    draws: bool = False

    @classmethod
    def of(cls, replay: Replay, categories: Sequence[str], road_map: RoadMap) -> "Idm":
        """The policy of a scene.

        Args:
            replay: Tracks of everybody.
            categories: N nuScenes categories.
            road_map: Where roads go on.

        Returns:
            It.
        """
        driving, paths, fastest = [], [], []
        for agent, category in enumerate(categories):
            rows = np.flatnonzero(replay.present[:, agent])
            places = replay.boxes[rows, agent]
            if category not in FOUR_WHEELED_CATEGORIES or len(rows) < 2 or _reach(places) < MOVING_M:
                continue
            driving.append(agent)
            speed = np.hypot(*replay.velocity[rows, agent].T)
            fastest.append(max(float(speed.max()), FREE_SPEED_M_S))
            paths.append(_road(places, float(speed[-1]), road_map))
        roads = [np.column_stack([path.points, path.heading]) for path in paths]
        return cls(
            replay=replay,
            driving=np.array(driving, np.int64),
            paths=tuple(paths),
            free_speed=np.array(fastest),
            road=np.concatenate([np.zeros((0, 3)), *roads]),
            first=np.cumsum([0, *(len(each) for each in roads)])[:-1],
            length=np.array([path.arc_length[-1] for path in paths]),
        )

    def init(self, time_us: int, key: int) -> tuple[IdmMemory, Moved]:
        """Everybody where the tracks begin."""
        count = len(self.driving)
        nobody = np.zeros(count, np.bool_)
        _, moved = self.replay.init(time_us, key)
        memory = self._arrivals(IdmMemory(np.zeros(count), np.zeros(count), nobody, nobody), moved)
        return memory, moved

    def act(self, memory: IdmMemory, moment: Moment, key: int) -> tuple[IdmMemory, Moved]:
        """The next 0.1 s: those on the road follow whoever is ahead of them now."""
        _, moved = self.replay.act(None, moment, key)
        boxes, present, velocity = moved.boxes.copy(), moved.present.copy(), moved.velocity.copy()
        gap, leader_speed = self._leaders(memory, moment)
        asked = idm_acceleration(memory.speed, self.free_speed, gap, leader_speed)
        station, speed = memory.station, memory.speed
        seconds = INSTANT_US / 1e6
        for instant in range(INSTANTS):
            faster = np.maximum(speed + seconds * asked, 0.0)
            station, speed = station + 0.5 * seconds * (speed + faster), faster
            self._place(boxes[instant], station, memory.here)
            present[instant, self.driving] = memory.here
        after = IdmMemory(station, speed, memory.here & (station < self.length), memory.come)
        after = self._arrivals(after, moved)
        present[-1, self.driving] |= after.here & ~memory.come
        boxes[-1, self.driving] = np.where(
            (after.here & ~memory.come)[:, None], moved.boxes[-1, self.driving], boxes[-1, self.driving]
        )
        self._set_velocity(velocity, after)
        return after, Moved(boxes, present, velocity)

    def _arrivals(self, memory: IdmMemory, moved: Moved) -> IdmMemory:
        """Who is there for the first time drives on from where the tracks have it."""
        new = moved.present[-1, self.driving] & ~memory.come
        if not new.any():
            return memory
        station, speed = memory.station.copy(), memory.speed.copy()
        for index in np.flatnonzero(new):
            agent = self.driving[index]
            station[index] = max(float(self.paths[index].project(moved.boxes[-1, agent, :2])[0]), 0.0)
            speed[index] = np.hypot(*moved.velocity[agent])
        return replace(memory, station=station, speed=speed, here=memory.here | new, come=memory.come | new)

    def _at(self, station: Floats) -> Floats:
        """(M, 3) x, y, heading of each one at its station."""
        place = np.minimum(station, self.length) / SPACING_M
        row = np.minimum(place.astype(np.int64), (self.length / SPACING_M).astype(np.int64) - 1)
        share = (place - row)[:, None]
        at = self.first + row
        return np.asarray((1.0 - share) * self.road[at] + share * self.road[at + 1])

    def _place(self, boxes: Floats, station: Floats, here: Bools) -> None:
        rows = self.driving[here]
        boxes[rows[:, None], [0, 1, 4]] = self._at(station)[here]

    def _set_velocity(self, velocity: Floats, memory: IdmMemory) -> None:
        heading = self._at(memory.station)[:, 2]
        moving = memory.speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        velocity[self.driving[memory.here]] = moving[memory.here]

    def _leaders(self, memory: IdmMemory, moment: Moment) -> tuple[Floats, Floats]:
        """(M,) metres to the nearest in each one's way, infinite without one, and (M,) its speed along the path."""
        gaps, speeds = np.full(len(self.driving), np.inf), np.zeros(len(self.driving))
        yaw = moment.ego[4]
        own_motion = moment.ego_speed * np.array([[np.cos(yaw), np.sin(yaw)]])
        boxes = np.concatenate([moment.boxes, moment.ego[None]])
        velocity = np.concatenate([moment.velocity, own_motion])
        there = np.append(moment.present, True)
        for index in np.flatnonzero(memory.here):
            agent, path = self.driving[index], self.paths[index]
            own = moment.boxes[agent]
            others = there & (np.hypot(*(boxes[:, :2] - own[:2]).T) < SIGHT_M)
            others[agent] = False
            rows = np.flatnonzero(others)
            if not len(rows):
                continue
            ahead, speed = _in_the_way(path, memory.station[index], own, boxes[rows], velocity[rows])
            if len(ahead):
                nearest = int(np.argmin(ahead))
                gaps[index], speeds[index] = ahead[nearest], speed[nearest]
        return gaps, speeds


def _in_the_way(path: Path, station: float, own: Floats, boxes: Floats, velocity: Floats) -> tuple[Floats, Floats]:
    """Gaps to those of some boxes that lie ahead on a path, and their speeds along it."""
    path = _window(path, station)
    along, left = path.project(boxes[:, :2])
    heading = np.interp(along, path.arc_length, path.heading)
    cos, sin = np.cos(boxes[:, 4] - heading), np.sin(boxes[:, 4] - heading)
    half_along = 0.5 * (np.abs(boxes[:, 2] * cos) + np.abs(boxes[:, 3] * sin))
    half_across = 0.5 * (np.abs(boxes[:, 2] * sin) + np.abs(boxes[:, 3] * cos))
    inside = np.abs(left) <= half_across + 0.5 * own[3] + SIDE_MARGIN_M
    ahead = inside & (along > station) & (along <= station + SIGHT_M)
    gap = along - half_along - station - 0.5 * own[2]
    speed = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
    return np.asarray(np.maximum(gap, 0.0)[ahead]), np.asarray(speed[ahead])


def _window(path: Path, station: float) -> Path:
    """The part of a path that can matter from a station on."""
    first = max(int((station - _BEHIND_M) / SPACING_M), 0)
    rows = slice(first, int((station + 2 * SIGHT_M) / SPACING_M) + 1)
    return Path(path.points[rows], path.heading[rows], path.arc_length[rows], path.curvature[rows])


def _reach(places: Floats) -> float:
    """How far from its first place somebody comes, metres."""
    return float(np.hypot(*(places[:, :2] - places[0, :2]).T).max())


def _road(places: Floats, speed: float, road_map: RoadMap) -> Path:
    """The recorded path, and where the road goes on from its end."""
    kept = [0]
    for row in range(1, len(places)):
        if np.hypot(*(places[row, :2] - places[kept[-1], :2])) >= SPACING_M:
            kept.append(row)
    end = places[-1, [0, 1, 4]]
    beyond = lane_path(road_map, end, Command.STRAIGHT, speed, _BEYOND_M) or straight_path(end, _BEYOND_M)
    recorded = places[kept, :2]
    # The last recorded place is where the road beyond begins; what is nearer than a step to it would fold the line.
    far = np.hypot(*(recorded - end[:2]).T) >= SPACING_M
    return Path.through(np.concatenate([recorded[far], beyond.points]))
