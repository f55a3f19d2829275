"""Paths that a vehicle may take from a moment on: its recorded one, and ones that join a lane and follow it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, Self

import numpy as np
import shapely
from shapely.ops import substring

from benchmark.dynamics.bicycle import compute_rear_axle
from benchmark.geometry import Floats, to_local, wrap_angle
from benchmark.road_map import RoadMap
from benchmark.scene import Scene

SPACING_M: Final = 0.5
EXTENSION_M: Final = 80.0
"""How far a path goes on along lanes after its recording has ended, or from where it joins a lane."""
LANE_REACH_M: Final = 3.0
LANE_TURN_RAD: Final = np.deg2rad(45.0)
"""A vehicle this near a centre line, and turned from it by less, is on that lane."""
JOIN_M: Final = (9.0, 14.0, 22.0, 35.0)
"""How far ahead, along a lane, it is joined; the first two of them that take at least `JOIN_S` at its speed."""
JOIN_S: Final = 1.2
JOIN_ASIDE_M: Final = 8.0
JOIN_TURN_RAD: Final = np.deg2rad(100.0)
"""Largest angle between a vehicle and the lane that it joins; a right turn out of a driveway."""
U_TURN_M: Final = (9.0, 18.0)
"""How far aside, at least and at most, lanes of the other way lie that a U-turn ends in."""
U_TURN_M_S: Final = 5.0
"""Faster ones make no U-turn."""
TIGHTEST_1_M: Final = 1 / 4.3
"""Curvature that a car manages at walking pace; the tightest of the simulator is 1/4.0."""
MOST_LANES, MOST_U_TURNS = 4, 2
MOST_ROUTES: Final = 4
ALIKE_M: Final = 1.0
"""Ways on from one place, of those that branch."""
LEAST_STEP_M: Final = 0.3

PathKind = Literal["recorded", "lane", "joins", "turns"]


@dataclass(frozen=True, slots=True)
class VehiclePath:
    """Path of a vehicle's rear axle: (V, 2) points every half metre, (V,) headings (unwrapped) and curvatures, 1/m."""

    kind: PathKind
    points: Floats
    headings: Floats
    curvature: Floats

    @classmethod
    def of(cls, kind: PathKind, line: Floats) -> Self | None:
        """Through (M, 2) points, smoothed over 2 m; ``None`` where it is too short or too tight for a car."""
        keep = np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > 1e-6])
        line = line[keep]
        if len(line) < 2:
            return None
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        stations = np.arange(0.0, way[-1], SPACING_M)
        if len(stations) < 8:
            return None
        points = np.column_stack([np.interp(stations, way, line[:, axis]) for axis in range(2)])
        points[2:-2] = sum(points[shift : len(points) - 4 + shift] for shift in range(5)) / 5.0
        return cls._through(kind, points)

    @classmethod
    def _through(cls, kind: PathKind, points: Floats) -> Self | None:
        headings = np.unwrap(np.arctan2(*np.gradient(points, axis=0).T[::-1]))
        curvature = np.gradient(headings, SPACING_M)
        if np.abs(curvature[2:-2]).max(initial=0.0) > TIGHTEST_1_M:
            return None
        return cls(kind, points, headings, curvature)

    def swerved(self, at_m: float, reach_m: float, aside_m: float) -> Self | None:
        """The same, so many metres farther left at a station, from ``reach_m`` before it to as much behind it."""
        along = SPACING_M * np.arange(len(self.points)) - at_m
        away = aside_m * np.where(np.abs(along) < reach_m, 0.5 + 0.5 * np.cos(np.pi * along / reach_m), 0.0)
        left = np.column_stack([-np.sin(self.headings), np.cos(self.headings)])
        return self._through(self.kind, self.points + away[:, None] * left)

    def at(self, station: Floats) -> Floats:
        """(..., 3) poses at stations in metres; past the end it goes straight on."""
        along = np.clip(station / SPACING_M, 0.0, len(self.points) - 1.0)
        index = np.minimum(along.astype(np.int64), len(self.points) - 2)
        share = (along - index)[..., None]
        place = self.points[index] + share * (self.points[index + 1] - self.points[index])
        yaw = self.headings[index] + share[..., 0] * (self.headings[index + 1] - self.headings[index])
        past = np.maximum(station - SPACING_M * (len(self.points) - 1), 0.0)[..., None]
        place = place + past * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        return np.concatenate([place, yaw[..., None]], axis=-1)


class LaneGraph:
    """Lanes of a map as centre lines that lead on to one another."""

    def __init__(self, road_map: RoadMap) -> None:
        self._lanes = road_map.lanes
        self._names = sorted(road_map.lanes)
        self._lines = [shapely.LineString(road_map.lanes[name].centerline) for name in self._names]
        self._near = shapely.STRtree(self._lines)

    def find_places(self, pose: Floats, reach_m: float, turn_rad: float) -> list[tuple[str, float, float]]:
        """Lanes near a (3,) pose that run its way: name, station and distance, the nearest first."""
        point = shapely.Point(*pose[:2])
        found = []
        for index in self._near.query(point, "dwithin", reach_m).tolist():
            line = self._lines[index]
            station = line.project(point)
            if np.abs(wrap_angle(self._heading(index, station) - pose[2])) <= turn_rad:
                found.append((self._names[index], station, line.distance(point)))
        return sorted(found, key=lambda place: (place[2], place[0]))

    def list_routes(self, name: str, station: float, length_m: float) -> list[Floats]:
        """(M, 2) centre lines from a station of a lane on, over so many metres, of at most three ways on."""
        routes: list[Floats] = []
        waiting = [(self._cut(name, station), name, {name})]
        while waiting and len(routes) < MOST_ROUTES:
            line, last, used = waiting.pop(0)
            length = float(np.hypot(*np.diff(line, axis=0).T).sum())
            further = [
                lane for lane in sorted(self._lanes[last].successors) if lane in self._lanes and lane not in used
            ]
            if length >= length_m or not further:
                routes.append(line)
            waiting += [
                (np.concatenate([line, self._lanes[lane].centerline]), lane, used | {lane})
                for lane in (further if length < length_m else ())
            ]
        return routes

    def _heading(self, index: int, station: float) -> float:
        line = self._lines[index]
        first, second = (line.interpolate(max(station + reach, 0.0)) for reach in (-0.5, 0.5))
        return float(np.arctan2(second.y - first.y, second.x - first.x))

    def _cut(self, name: str, station: float) -> Floats:
        line = self._lines[self._names.index(name)]
        rest = substring(line, min(station, line.length - 1e-3), line.length)
        return np.asarray(rest.coords, np.float64)[:, :2]


def list_recorded_paths(scene: Scene, agent: int, frame: int, graph: LaneGraph) -> Iterator[VehiclePath]:
    """The recorded path from a frame on, and on along lanes (straight where there is none) after its end."""
    agents = scene.agents
    length = float(agents.size[agent, 0])
    there = scene.keyframes[(scene.keyframes > frame) & agents.valid[agent, scene.keyframes]]
    frames = np.concatenate([[frame], there])
    poses = np.column_stack([agents.position[agent, frames, :2], np.unwrap(agents.yaw[agent, frames])])
    axle = compute_rear_axle(poses, length)
    kept = [0]
    for index in range(1, len(axle)):
        ahead = to_local(axle[index, :2], axle[kept[-1]])[0]
        if ahead >= LEAST_STEP_M:
            kept.append(index)
    line = _smooth(axle[kept])
    end = np.array([*line[-1], axle[kept[-1], 2]])
    straight = end[:2] + np.arange(2.0, EXTENSION_M, 2.0)[:, None] * np.array([np.cos(end[2]), np.sin(end[2])])
    for place in graph.find_places(end, LANE_REACH_M, LANE_TURN_RAD)[:1]:
        for route in graph.list_routes(place[0], place[1], EXTENSION_M):
            path = VehiclePath.of("recorded", np.concatenate([line, _skip(route, 6.0)]))
            if path is not None:
                yield path
        return
    path = VehiclePath.of("recorded", np.concatenate([line, straight]))
    if path is not None:
        yield path


def list_lane_paths(scene: Scene, agent: int, frame: int, speed: float, graph: LaneGraph) -> Iterator[VehiclePath]:
    """Paths from a frame on along lanes: the own one, its branches, those joined from beside, and those turned into.

    ``speed`` is that at the frame, m/s.
    """
    agents = scene.agents
    pose = np.array([*agents.position[agent, frame, :2], agents.yaw[agent, frame]])
    axle = compute_rear_axle(pose, float(agents.size[agent, 0]))
    seen: set[bytes] = set()
    for kind, start, route in _list_joined(pose, speed, graph):
        rest = _skip(route, start)
        if len(rest) < 2:
            continue
        # Half a circle is a cubic with derivatives of twice its diameter at both ends.
        joined = _join(axle, rest, 2.0 if kind == "turns" else 1.0)
        path = VehiclePath.of(kind, np.concatenate([joined, rest[1:]]))
        key = b"" if path is None else np.rint(path.points[::10] / ALIKE_M).tobytes()
        if path is not None and key not in seen:
            seen.add(key)
            yield path


def _list_joined(pose: Floats, speed: float, graph: LaneGraph) -> Iterator[tuple[PathKind, float, Floats]]:
    """Kind, metres of it that are cut off, and line of each lane that a vehicle at a (3,) pose may join."""
    joins = [ahead for ahead in JOIN_M if ahead >= JOIN_S * speed][:2] or [JOIN_M[-1]]
    for name, station, distance in graph.find_places(pose, JOIN_ASIDE_M, JOIN_TURN_RAD)[:MOST_LANES]:
        for route in graph.list_routes(name, station, EXTENSION_M + joins[-1]):
            for ahead in joins[:1] if distance <= 1.0 else joins:
                yield "lane" if distance <= 1.0 else "joins", ahead, route
    back = pose + [0.0, 0.0, np.pi]
    other_way = [
        (name, station)
        for name, station, distance in graph.find_places(back, U_TURN_M[1], LANE_TURN_RAD)
        if distance >= U_TURN_M[0]
    ]
    for name, station in other_way[:MOST_U_TURNS] if speed < U_TURN_M_S else ():
        for route in graph.list_routes(name, station, EXTENSION_M)[:1]:
            yield "turns", 2.0, route


def _join(start: Floats, rest: Floats, stretched: float) -> Floats:
    """(M, 2) cubic from a (3,) pose to the beginning of a line, along both directions."""
    step = rest[1] - rest[0]
    chord = float(np.hypot(*(rest[0] - start[:2])))
    leave = stretched * chord * np.array([np.cos(start[2]), np.sin(start[2])])
    arrive = stretched * chord * step / max(float(np.hypot(*step)), 1e-9)
    t = np.linspace(0.0, 1.0, max(round(1.6 * chord), 4))[:, None]
    basis = (2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, -2 * t**3 + 3 * t**2, t**3 - t**2)
    return np.asarray(basis[0] * start[:2] + basis[1] * leave + basis[2] * rest[0] + basis[3] * arrive)


def _skip(line: Floats, metres: float) -> Floats:
    """A line without its first metres."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    if metres >= way[-1]:
        return line[:0]
    first = np.array([np.interp(metres, way, line[:, axis]) for axis in range(2)])
    return np.concatenate([first[None], line[way > metres]])


def _smooth(axle: Floats) -> Floats:
    """(M, 2) points of a spline through rear axles, (K, 3), every metre; the first one stays."""
    if len(axle) < 4:
        return axle[:, :2]
    from scipy.interpolate import CubicSpline

    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(axle[:, :2], axis=0).T))])
    inner = axle[:, :2].copy()
    inner[1:-1] = 0.25 * axle[:-2, :2] + 0.5 * axle[1:-1, :2] + 0.25 * axle[2:, :2]
    return np.asarray(CubicSpline(way, inner)(np.arange(0.0, way[-1], 1.0)))
