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

from benchmark.closed_loop.contract import Moment, Moved
from benchmark.closed_loop.following import INSTANT_US, INSTANTS
from benchmark.closed_loop.leaders import Roads, leaders
from benchmark.closed_loop.replay import Replay
from benchmark.constants import FOUR_WHEELED_CATEGORIES
from benchmark.dynamics.lane_path import SPACING_M, Path, lane_path, straight_path
from benchmark.geometry import Bools, Floats
from benchmark.interactions.keeping_distance import idm_acceleration
from benchmark.interactions.tracks import Integers
from benchmark.planning import Command
from benchmark.road_map import RoadMap

FREE_SPEED_M_S: Final = 10.0
MOVING_M: Final = 2.0
"""Who comes no further than this in the recording is parked."""
_BEYOND_M: Final = 300.0
"""Of road beyond the end of a recorded path."""


@dataclass(frozen=True, slots=True)
class IdmMemory:
    """State of the M vehicles that drive by themselves; every array (M,).

    ``station`` is of the centre along each one's path, metres; ``here`` are those that have come in and not yet
    reached the end of their road, ``come`` all that have come in.
    """

    station: Floats
    speed: Floats
    here: Bools
    come: Bools


@dataclass(frozen=True, slots=True)
class Idm:
    """Policy under which M vehicles drive by themselves along roads and all other agents keep their tracks.

    ``driving`` are their indices; ``free_speed`` is m/s on an empty road, ``length`` metres of each one's road.
    """

    replay: Replay
    driving: Integers
    roads: Roads
    free_speed: Floats
    length: Floats
    name: str = "idm"
    draws: bool = False

    @classmethod
    def of(cls, replay: Replay, categories: Sequence[str], road_map: RoadMap) -> "Idm":
        """The policy of a scene; the map says where roads go on."""
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
        return cls(
            replay=replay,
            driving=np.array(driving, np.int64),
            roads=Roads.of(paths),
            free_speed=np.array(fastest),
            length=np.array([path.arc_length[-1] for path in paths]),
        )

    def init(self, time_us: int, key: int) -> tuple[IdmMemory, Moved]:
        """All agents where the tracks begin."""
        count = len(self.driving)
        nobody = np.zeros(count, np.bool_)
        _, moved = self.replay.init(time_us, key)
        memory = self._arrivals(IdmMemory(np.zeros(count), np.zeros(count), nobody, nobody), moved)
        return memory, moved

    def act(self, memory: IdmMemory, moment: Moment, key: int) -> tuple[IdmMemory, Moved]:
        """The next 0.1 s: those on the road follow the nearest ahead of them now."""
        _, moved = self.replay.act(None, moment, key)
        boxes, present, velocity = moved.boxes.copy(), moved.present.copy(), moved.velocity.copy()
        here = np.flatnonzero(memory.here)
        gap, leader_speed = leaders(self.roads, self.driving, memory.station, here, moment)
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


def _reach(places: Floats) -> float:
    """How far from its first place an agent comes, metres."""
    return float(np.hypot(*(places[:, :2] - places[0, :2]).T).max())


def _road(places: Floats, speed: float, road_map: RoadMap) -> Path:
    """The recorded path, and where the road goes on from its end."""
    kept = _a_step_apart(places[:, :2])
    end = places[-1, [0, 1, 4]]
    beyond = lane_path(road_map, end, Command.STRAIGHT, speed, _BEYOND_M) or straight_path(end, _BEYOND_M)
    recorded = places[kept, :2]
    # The last recorded place is where the road beyond begins; what is nearer than a step to it would fold the line.
    far = np.hypot(*(recorded - end[:2]).T) >= SPACING_M
    return Path.through(np.concatenate([recorded[far], beyond.points]))


def _a_step_apart(places: Floats) -> list[int]:
    """Rows of (R, 2) places, each half a metre or more from the one before."""
    kept, at = [0], places.tolist()
    x, y = at[0]
    for row in range(1, len(at)):
        squared = (at[row][0] - x) ** 2 + (at[row][1] - y) ** 2
        # Plain numbers are fast, and the last bit decides only where they are as good as equal.
        if abs(squared - SPACING_M**2) > 1e-9:
            apart = squared > SPACING_M**2
        else:
            apart = bool(np.hypot(*(places[row] - places[kept[-1]])) >= SPACING_M)
        if apart:
            kept.append(row)
            x, y = at[row]
    return kept
