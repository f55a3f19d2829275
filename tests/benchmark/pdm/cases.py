"""Made-up samples for the PDM sub-scores, as the fast and as the slow side take them: nothing in them was recorded."""

from dataclasses import dataclass

import numpy as np
from shapely.geometry import Polygon

from benchmark.geometry import Floats
from benchmark.pdm.plan_motion import build_history_rows
from benchmark.pdm.road_polygons import RoadPolygons, SurfaceKind
from benchmark.pdm.scoring import ScoringContext, remove_touching_objects
from benchmark.pdm.traffic import KeyFrameObjects, interpolate_traffic
from tests.benchmark.pdm.slow_pdm import SlowObject, SlowSample

LANE_M = 3.5


@dataclass(frozen=True)
class Case:
    """S samples at one crossing with P plans each."""

    now: Floats
    past: Floats
    key_frames: KeyFrameObjects
    surfaces: list[tuple[SurfaceKind, Polygon, bool]]
    route: Floats
    plans: Floats

    @property
    def road(self) -> RoadPolygons:
        return RoadPolygons.of(self.surfaces)

    @property
    def build_context(self) -> ScoringContext:
        return ScoringContext(
            now=self.now,
            history=build_history_rows(self.past),
            has_history=np.ones(len(self.now), np.bool_),
            traffic=remove_touching_objects(interpolate_traffic(self.key_frames), self.now),
            road=self.road,
            route=self.route,
        )

    def slow(self, sample: int) -> SlowSample:
        objects = slow_objects(self.key_frames, sample)
        return SlowSample(self.now[sample], self.past[sample], objects, self.road, self.route)


def slow_objects(frames: KeyFrameObjects, sample: int) -> list[SlowObject]:
    """Objects of one sample as the slow side takes them."""
    return [
        SlowObject(
            [
                (float(x), float(y), float(yaw)) if there else None
                for (x, y, yaw), there in zip(frames.box[number], frames.annotated[number])
            ],
            [(float(x), float(y)) for x, y in frames.velocity[number]],
            float(frames.size[number, 0]),
            float(frames.size[number, 1]),
            bool(frames.is_agent[number]),
        )
        for number in range(int(frames.offsets[sample]), int(frames.offsets[sample + 1]))
    ]


def crossing(seed: int, *, samples: int = 4, objects: int = 14) -> Case:
    """A crossing of two two-way roads; the route goes straight on or turns left, cars and things are all around."""
    rng = np.random.default_rng(seed)
    now, past = np.zeros((samples, 11)), np.zeros((samples, 4, 8))
    for sample in range(samples):
        speed = rng.choice([0.0, 3.0, 8.0, 12.0])
        x, heading = rng.uniform(-45.0, -5.0), rng.normal(0.0, 0.05)
        now[sample, :7] = x, -LANE_M / 2 + rng.normal(0, 0.2), heading, speed, 0.0, rng.normal(0.0, 0.5), 0.0
        for step, back in enumerate((1.5, 1.0, 0.5, 0.0)):
            past[sample, step, :7] = now[sample, :7]
            past[sample, step, 0] -= speed * back
            past[sample, step, 2] += rng.normal(0, 0.01)
    plans = np.stack([_plans(rng, state) for state in now])
    return Case(now, past, _objects(rng, now, objects), _surfaces(), _route(turning=seed % 2 == 1), plans)


def _plans(rng: np.random.Generator, now: Floats) -> Floats:
    """(P, 6, 3) straight on, standing, braking, faster, to either side, back, at random."""
    time = 0.5 * np.arange(1, 7)
    speed = now[3]
    plans = []
    for acceleration, across in ((0.0, 0.0), (0.0, 2.5), (0.0, -2.5), (2.5, 0.0), (-4.0, 0.0), (0.0, 6.0)):
        along = np.maximum(speed * time + acceleration * time**2 / 2, 0.0)
        left = across * (time / 3.0) ** 2
        plans.append(np.column_stack([along, left, np.gradient(left) / np.maximum(np.gradient(along), 0.3)]))
    plans.append(np.zeros((6, 3)))
    plans.append(np.column_stack([-1.5 * time, np.zeros(6), np.zeros(6)]))
    wander = np.cumsum(rng.normal([max(speed, 2.0) / 2, 0.0], [0.5, 0.4], (6, 2)), axis=0)
    plans.append(np.column_stack([wander, rng.normal(0, 0.2, 6)]))
    plans.append(np.column_stack([8 * np.sin(time / 2), 8 - 8 * np.cos(time / 2), time / 2]))
    return np.array(plans)


def _objects(rng: np.random.Generator, now: Floats, count: int) -> KeyFrameObjects:
    """Around each car: standing, moving along or across, seen once, with gaps, and one on the car itself."""
    total = len(now) * count
    box, annotated = np.zeros((total, 7, 3)), np.ones((total, 7), np.bool_)
    velocity, size = np.zeros((total, 7, 2)), np.zeros((total, 2))
    agents = rng.random(total) < 0.7
    for number in range(total):
        state = now[number // count]
        ahead, left = rng.uniform(-12.0, 35.0), rng.choice([0.0, 3.5, -3.0]) + rng.normal(0, 0.6)
        speed = 0.0 if not agents[number] else rng.choice([0.0, 2.0, 7.0, 14.0])
        yaw = state[2] + rng.choice([0.0, 0.0, np.pi / 2, np.pi]) + rng.normal(0, 0.1)
        if number % count == 0:
            ahead, left = 1.0, 0.3
        cos, sin = np.cos(state[2]), np.sin(state[2])
        start = state[:2] + ahead * np.array([cos, sin]) + left * np.array([-sin, cos])
        direction = np.array([np.cos(yaw), np.sin(yaw)])
        box[number, :, :2] = start + 0.5 * speed * np.arange(7)[:, None] * direction
        box[number, :, 2] = yaw + rng.normal(0, 0.05, 7)
        velocity[number] = speed * direction
        size[number] = rng.uniform([0.5, 0.5], [9.0, 2.6])
        if rng.random() < 0.2:
            annotated[number] = np.arange(7) == rng.integers(7)
        elif rng.random() < 0.4:
            annotated[number] = rng.random(7) < 0.6
            annotated[number, rng.integers(7)] = True
    offsets = np.arange(len(now) + 1) * count
    return KeyFrameObjects(offsets, box, size, annotated, velocity, agents, np.arange(total))


def _surfaces() -> list[tuple[SurfaceKind, Polygon, bool]]:
    """Lanes along x and y, a crossing in the middle with connectors, a car park beside; slits where they meet."""
    surfaces: list[tuple[SurfaceKind, Polygon, bool]] = []
    for low, high in ((-100.0, -10.0), (10.0, 100.0)):
        for left in (-LANE_M, 0.0):
            surfaces.append((SurfaceKind.LANE, _box(low, left, high, left + LANE_M), left < 0))
            surfaces.append((SurfaceKind.LANE, _box(left, low, left + LANE_M, high), False))
        surfaces.append((SurfaceKind.ROAD_BLOCK, _box(low, -LANE_M, high, LANE_M), False))
        surfaces.append((SurfaceKind.ROAD_BLOCK, _box(-LANE_M, low, LANE_M, high), False))
    corner = Polygon([(-10, -LANE_M), (LANE_M, -LANE_M), (LANE_M, 10), (0, 10), (0, 0), (-10, 0)])
    # With an island in it.
    walled = Polygon(_box(20.0, -9.0, 60.0, -LANE_M).exterior.coords, [_box(30.0, -8.0, 34.0, -5.0).exterior.coords])
    return [
        *surfaces,
        (SurfaceKind.CONNECTOR, _box(-10.0, -LANE_M, 10.0, 0.0), True),
        (SurfaceKind.CONNECTOR, _box(-10.0, 0.0, 10.0, LANE_M), False),
        (SurfaceKind.CONNECTOR, corner, True),
        (SurfaceKind.INTERSECTION, _box(-10.0, -LANE_M - 1, 10.0, LANE_M + 1), False),
        (SurfaceKind.CAR_PARK, _box(-60.0, LANE_M, -40.0, 15.0), False),
        (SurfaceKind.DRIVABLE_AREA, walled, False),
    ]


def _box(low_x: float, low_y: float, high_x: float, high_y: float) -> Polygon:
    return Polygon([(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)])


def _route(*, turning: bool) -> Floats:
    before = np.column_stack([np.arange(-80.0, -2.0, 0.5), np.full(156, -LANE_M / 2)])
    if not turning:
        return np.concatenate([before, np.column_stack([np.arange(-2.0, 90.0), np.full(92, -LANE_M / 2)])])
    angle = np.linspace(0.0, np.pi / 2, 8)
    bend = np.column_stack([-2.0 + 3.75 * np.sin(angle), 3.75 - LANE_M / 2 - 3.75 * np.cos(angle)])
    return np.concatenate([before, bend, np.column_stack([np.full(80, 1.75), np.arange(3.0, 83.0)])])
