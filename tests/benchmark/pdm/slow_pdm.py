"""The definition ``nuscenes-pdm`` as obviously as possible: one plan, one state, one object, one polygon at a time.

Written from `docs/pdm.md` alone; nothing is shared with the fast side but the containers that hold a scene. Rectangles
are polygons of shapely, profiles dense least squares, filters those of SciPy, as in the official code.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import savgol_filter
from shapely.geometry import LineString, Point, Polygon

from benchmark.geometry import Floats
from benchmark.pdm.road_polygons import RoadPolygons
from tests.benchmark.pdm.slow_motion import slow_motion, wrap

LENGTH, WIDTH, AHEAD = 4.084, 1.85, 1.39
COMFORT_AHEAD = 1.461
BOUNDS = ((-4.05, 2.40), (-4.89, 4.89), (-8.37, 8.37), (-4.13, 4.13), (-1.93, 1.93), (-0.95, 0.95))


@dataclass(frozen=True)
class SlowObject:
    """One object at the seven key frames; ``None`` where it is not annotated."""

    poses: list[tuple[float, float, float] | None]
    velocities: list[tuple[float, float]]
    length: float
    width: float
    is_agent: bool


@dataclass(frozen=True)
class SlowSample:
    """What one plan is judged by; ``past`` are pose, velocity, acceleration at -1.5, -1, -0.5, 0 s, if they exist."""

    now: Floats
    past: Floats | None
    objects: list[SlowObject]
    road: RoadPolygons
    route: Floats


@dataclass(frozen=True)
class SlowVerdict:
    """Sub-scores of one plan alone, and what they come from; steps are -1 for none.

    ``nc_events``: state, object, kind (0 stopped ego, 1 stopped track, 2 front, 3 rear, 4 lateral), at fault.
    ``ttc_events``: state, projection, object, ahead, behind (-1: not asked), counts.
    """

    states: Floats
    nc: float
    dac: float
    ddc: float
    ttc: float
    lk: float
    hc: float
    progress_m: float
    wrong_way_m: float
    offset_m: list[float]
    extremes: list[tuple[float, float]]
    places: list[dict[str, bool]]
    nc_events: list[tuple[int, ...]]
    ttc_events: list[tuple[int, ...]]

    @property
    def collision_step(self) -> int:
        return min((state for state, *_, at_fault in self.nc_events if at_fault), default=-1)

    @property
    def ttc_step(self) -> int:
        return min((state for state, *_, counts in self.ttc_events if counts), default=-1)

    @property
    def multiplier(self) -> float:
        return self.nc * self.dac * self.ddc


Thing = tuple[int, list[tuple[float, float, float] | None], list[Polygon | None], float, bool]
"""Number, poses and shapes at the 31 states, speed where it is first seen, whether it moves by itself."""


def rectangle(x: float, y: float, heading: float, length: float, width: float) -> Polygon:
    cos, sin, corners = math.cos(heading), math.sin(heading), []
    for ahead, left in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        dx, dy = ahead * length / 2, left * width / 2
        corners.append((x + dx * cos - dy * sin, y + dx * sin + dy * cos))
    return Polygon(corners)


def ego_rectangle(state: Floats, forward: float = 0.0) -> Polygon:
    reach = AHEAD + forward
    heading = state[2]
    return rectangle(state[0] + reach * math.cos(heading), state[1] + reach * math.sin(heading), heading, LENGTH, WIDTH)


def slow_track(thing: SlowObject) -> tuple[list[tuple[float, float, float] | None], list[tuple[float, float]]]:
    """Poses and velocities at the 31 states; things have none."""
    seen = [key for key in range(7) if thing.poses[key] is not None]
    poses: list[tuple[float, float, float] | None] = []
    velocities: list[tuple[float, float]] = []
    for state in range(31):
        time = state / 5.0
        before = seen if len(seen) == 1 else [key for key in seen if key <= time]
        after = seen if len(seen) == 1 else [key for key in seen if key >= time]
        if not before or not after:
            poses.append(None)
            velocities.append((0.0, 0.0))
            continue
        a, b = before[-1], after[0]
        share = 0.0 if a == b else (time - a) / (b - a)
        first, last = thing.poses[a], thing.poses[b]
        assert first is not None and last is not None
        poses.append(
            (
                first[0] + share * (last[0] - first[0]),
                first[1] + share * (last[1] - first[1]),
                first[2] + share * wrap(last[2] - first[2]),
            )
        )
        slow, fast = thing.velocities[a], thing.velocities[b]
        mixed = (slow[0] + share * (fast[0] - slow[0]), slow[1] + share * (fast[1] - slow[1]))
        velocities.append(mixed if thing.is_agent else (0.0, 0.0))
    return poses, velocities


def slow_verdict(plan: Floats, sample: SlowSample) -> SlowVerdict:
    """Everything about one plan but what needs another."""
    return slow_states_verdict(slow_motion(plan, sample.now), sample)


def slow_states_verdict(states: Floats, sample: SlowSample) -> SlowVerdict:
    """The same of a given motion."""
    start = ego_rectangle(states[0])
    things: list[Thing] = []
    for number, thing in enumerate(sample.objects):
        poses, velocities = slow_track(thing)
        shapes = [None if pose is None else rectangle(*pose, thing.length, thing.width) for pose in poses]
        if shapes[0] is None or not shapes[0].intersects(start):
            first = next(velocity for pose, velocity in zip(poses, velocities) if pose is not None)
            things.append((number, poses, shapes, math.hypot(*first), thing.is_agent))
    places = [slow_place(state, sample.road) for state in states]
    nc, nc_events = slow_collisions(states, things, places)
    ttc_events = slow_time_to_collision(states, things, places)
    line = LineString(sample.route)
    centers = [slow_center(state) for state in states]
    progress = max(0.0, line.project(centers[30]) - line.project(centers[0]))
    wrong_way = slow_wrong_way(centers, places)
    offsets = [line.distance(center) for center in centers]
    extremes = [] if sample.past is None else slow_extremes(states, sample.past)
    return SlowVerdict(
        states=states,
        nc=nc,
        dac=0.0 if any(place["non-drivable"] for place in places) else 1.0,
        ddc=1.0 if wrong_way < 2.0 else 0.5 if wrong_way < 6.0 else 0.0,
        ttc=0.0 if any(counts for *_, counts in ttc_events) else 1.0,
        lk=slow_lane_keeping(offsets, places),
        hc=float(all(low < least and most < high for (low, high), (least, most) in zip(BOUNDS, extremes))),
        progress_m=progress,
        wrong_way_m=wrong_way,
        offset_m=offsets,
        extremes=extremes,
        places=places,
        nc_events=nc_events,
        ttc_events=ttc_events,
    )


def slow_center(state: Floats) -> Point:
    return Point(state[0] + AHEAD * math.cos(state[2]), state[1] + AHEAD * math.sin(state[2]))


def slow_place(state: Floats, road: RoadPolygons) -> dict[str, bool]:
    corners = [Point(*corner) for corner in list(ego_rectangle(state).exterior.coords)[:4]]
    center, axle = slow_center(state), Point(state[0], state[1])
    touched = [lane for lane in road.lanes if any(lane.contains(corner) for corner in corners)]
    whole = any(all(lane.contains(corner) for corner in corners) for lane in touched)
    return {
        "multiple lanes": len(touched) > 1 and not whole,
        "non-drivable": not all(any(area.contains(corner) for area in road.drivable) for corner in corners),
        "oncoming": not any(lane.contains(center) for lane, routed in zip(road.lanes, road.on_route) if routed),
        "in intersection": any(area.contains(center) for area in road.intersections),
        "axle in intersection": any(area.contains(axle) for area in road.intersections),
    }


def angle_to(state: Floats, pose: tuple[float, float, float] | None) -> float:
    assert pose is not None
    dx, dy = pose[0] - state[0], pose[1] - state[1]
    cosine = (dx * math.cos(state[2]) + dy * math.sin(state[2])) / math.hypot(dx, dy)
    return math.acos(min(max(cosine, -1.0), 1.0))


def slow_collisions(
    states: Floats, things: list[Thing], places: list[dict[str, bool]]
) -> tuple[float, list[tuple[int, ...]]]:
    score, ignored = 1.0, set[int]()
    events: list[tuple[int, ...]] = []
    for t, state in enumerate(states):
        body = ego_rectangle(state)
        corners = list(body.exterior.coords)
        front = LineString([corners[0], corners[3]])
        for number, poses, shapes, speed, is_agent in things:
            shape = shapes[t]
            if number in ignored or shape is None or not body.intersects(shape):
                continue
            if math.hypot(state[3], state[4]) <= 0.05:
                kind, at_fault = 0, False
            elif not is_agent or speed <= 0.05:
                kind, at_fault = 1, True
            elif angle_to(state, poses[t]) > math.radians(150):
                kind, at_fault = 3, False
            elif front.intersects(shape):
                kind, at_fault = 2, True
            else:
                kind, at_fault = 4, places[t]["multiple lanes"] or places[t]["non-drivable"]
            events.append((t, number, kind, int(at_fault)))
            if at_fault:
                score = min(score, 0.0 if is_agent else 0.5)
            else:
                ignored.add(number)
    return score, events


def slow_time_to_collision(states: Floats, things: list[Thing], places: list[dict[str, bool]]) -> list[tuple[int, ...]]:
    events: list[tuple[int, ...]] = []
    ignored = set[int]()
    for t in range(22):
        state = states[t]
        speed = math.hypot(state[3], state[4])
        for step, later in enumerate((0, 3, 6, 9)):
            body = ego_rectangle(state, speed * later * 0.1)
            for number, poses, shapes, _, _ in things:
                shape = shapes[t + later]
                if number in ignored or shape is None or speed < 0.005 or not body.intersects(shape):
                    continue
                angle, place, behind = angle_to(state, poses[t + later]), places[t], -1
                ahead = angle < math.radians(30)
                if not ahead and (place["multiple lanes"] or place["non-drivable"] or place["axle in intersection"]):
                    behind = int(angle > math.radians(150))
                counts = ahead or behind == 0
                events.append((t, step, number, int(ahead), behind, int(counts)))
                if not counts:
                    ignored.add(number)
    return events


def slow_wrong_way(centers: list[Point], places: list[dict[str, bool]]) -> float:
    moved = [0.0]
    for t in range(1, 31):
        wrong = places[t]["oncoming"] and not places[t]["in intersection"]
        moved.append(centers[t].distance(centers[t - 1]) if wrong else 0.0)
    return max(sum(moved[max(t - 10, 0) : t + 1]) for t in range(31))


def slow_lane_keeping(offsets: list[float], places: list[dict[str, bool]]) -> float:
    beside, longest = 0, 0
    for offset, place in zip(offsets, places):
        if place["in intersection"]:
            continue
        beside = beside + 1 if offset > 0.5 else 0
        longest = max(longest, beside)
    return 0.0 if longest >= 20 else 1.0


def smooth(values: Floats, window: int, order: int, derivative: int) -> Floats:
    return np.asarray(np.round(savgol_filter(values, window, order, deriv=derivative, delta=0.1), 8))


def unwrapped(heading: Floats) -> Floats:
    result, turns = [heading[0]], 0.0
    for before, after in pairwise(heading):
        turns += round((after - before) / (2 * math.pi))
        result.append(after - 2 * math.pi * turns)
    return np.array(result)


def slow_history(past: Floats) -> Floats:
    """The 14 rows before a motion."""
    rows = []
    headings = unwrapped(past[:, 2])
    for row in range(14):
        first = min(row // 5, 2)
        share = (row - 5 * first) / 5.0
        mixed = past[first] + share * (past[first + 1] - past[first])
        mixed[2] = headings[first] + share * (headings[first + 1] - headings[first])
        rows.append([*mixed, 0.0, 0.0, 0.0])
    return np.array(rows)


def slow_extremes(states: Floats, past: Floats) -> list[tuple[float, float]]:
    """Lowest and highest value of the six series of comfort."""
    every = np.concatenate([slow_history(past), states])
    along = smooth(every[:, 5] + COMFORT_AHEAD * (every[:, 9] ** 2 + every[:, 10]), 8, 2, 0)
    magnitude = smooth(np.hypot(every[:, 5], every[:, 6]), 8, 2, 0)
    heading = unwrapped(every[:, 2])
    series = (
        along,
        smooth(every[:, 6], 8, 2, 0),
        smooth(magnitude, 15, 2, 1),
        smooth(along, 15, 2, 1),
        smooth(heading, 5, 3, 2),
        smooth(heading, 5, 2, 1),
    )
    return [(float(values.min()), float(values.max())) for values in series]


def slow_differences(earlier: Floats, later: Floats, apart: int) -> list[float]:
    """Root mean square differences of two motions whose starts are some states apart."""
    squares = []
    for states in (later[: 31 - apart], earlier[apart:]):
        magnitude = smooth(np.hypot(states[:, 5], states[:, 6]), 8, 2, 0)
        heading = unwrapped(states[:, 2])
        squares.append((magnitude, smooth(magnitude, 15, 2, 1), smooth(heading, 5, 2, 1), smooth(heading, 5, 2, 2)))
    return [math.sqrt(float(np.mean((a - b) ** 2))) for a, b in zip(*squares)]


def slow_agreement(differences: list[float]) -> float:
    """EC."""
    return float(all(value <= most for value, most in zip(differences, (0.7, 0.5, 0.1, 0.1))))


def slow_progress(plan: SlowVerdict, reference: SlowVerdict) -> float:
    """EP of a plan beside a reference."""
    best = max(plan.progress_m * plan.multiplier, reference.progress_m * reference.multiplier)
    return min(max(plan.progress_m / best, 0.0), 1.0) if best > 5.0 else 1.0


def slow_score(plan: SlowVerdict, ep: float, ec: float | None) -> float:
    """The total; over 14 without EC, over 16 with it."""
    weighted = 5 * ep + 5 * plan.ttc + 2 * plan.lk + 2 * plan.hc
    return plan.multiplier * (weighted / 14 if ec is None else (weighted + 2 * ec) / 16)
