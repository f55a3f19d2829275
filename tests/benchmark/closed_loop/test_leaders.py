"""Leaders of all vehicles at once are those of one vehicle after the other, to the last bit."""

import numpy as np
import pytest

from benchmark.closed_loop.agent_policy import TrafficSnapshot
from benchmark.closed_loop.idm_policy import VehicleRoads, find_leaders
from benchmark.dynamics.lane_path import LanePath
from benchmark.geometry import Floats
from tests.benchmark.closed_loop.slow_leaders import slow_leaders


def road(kind: str, rng: np.random.Generator) -> LanePath:
    length = float(rng.uniform(8.0, 400.0))
    along = np.arange(0.0, length, 1.3)
    if kind == "straight":
        points = np.column_stack([along, np.zeros(len(along))])
    elif kind == "circle":
        points = 25.0 * np.column_stack([np.cos(along / 25.0), np.sin(along / 25.0)])
    elif kind == "wiggles":
        points = np.column_stack([along, 3.0 * np.sin(along / 4.0)])
    else:
        # Turns back on itself again and again, as the track of somebody who stands does.
        points = np.column_stack([along / 6.0 + rng.normal(0.0, 0.6, len(along)), rng.normal(0.0, 0.6, len(along))])
    turn = float(rng.uniform(-np.pi, np.pi))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return LanePath.through(points @ rotation.T + rng.uniform(-40.0, 40.0, 2))


def boxes_around(count: int, paths: list[LanePath], rng: np.random.Generator) -> Floats:
    """Half of them on roads, where they matter."""
    places = rng.uniform(-150.0, 150.0, (count, 2))
    for row in range(0, count, 2):
        path = paths[int(rng.integers(len(paths)))]
        places[row] = path.points[int(rng.integers(len(path.points)))] + rng.normal(0.0, 1.5, 2)
    sizes = np.column_stack([rng.uniform(0.3, 14.0, count), rng.uniform(0.3, 3.0, count)])
    return np.column_stack([places, sizes, rng.uniform(-np.pi, np.pi, count)])


@pytest.mark.parametrize(
    "kinds", [("straight",), ("circle",), ("wiggles",), ("noise",), ("straight", "noise", "circle")]
)
def test_they_are_those_of_one_after_the_other(kinds: tuple[str, ...]) -> None:
    rng = np.random.default_rng(7)
    led = 0
    for _ in range(15):
        paths = tuple(road(kinds[number % len(kinds)], rng) for number in range(6))
        boxes = boxes_around(24, list(paths), rng)
        driving = rng.permutation(24)[:6]
        station = np.array([rng.uniform(0.0, path.arc_length[-1]) for path in paths])
        # At the start of a road and at its very end, too.
        station[0], station[1] = 0.0, paths[1].arc_length[-1]
        for vehicle, path in enumerate(paths):
            boxes[driving[vehicle], :2] = path.at(station[vehicle])
        here = np.flatnonzero(rng.random(6) < 0.8)
        ego = boxes_around(2, list(paths), rng)[0]
        moment = TrafficSnapshot(0, ego, 5.0, boxes, rng.random(24) < 0.9, rng.normal(0.0, 5.0, (24, 2)))
        fast = find_leaders(VehicleRoads.of(paths), driving, station, here, moment)
        slow = slow_leaders(paths, driving, station, here, moment)
        assert [each.tobytes() for each in fast] == [each.tobytes() for each in slow]
        led += int(np.isfinite(slow[0]).sum())
    assert led > 15


def test_nobody_drives_and_nobody_is_seen() -> None:
    ego, nobody = np.array([500.0, 500.0, 4.0, 1.7, 0.0]), np.zeros(0, np.int64)
    empty = TrafficSnapshot(0, ego, 5.0, np.zeros((0, 5)), np.zeros(0, np.bool_), np.zeros((0, 2)))
    assert find_leaders(VehicleRoads.of(()), nobody, np.zeros(0), nobody, empty)[0].shape == (0,)
    paths = (road("straight", np.random.default_rng(1)),)
    own = np.array([[*paths[0].points[3], 4.0, 1.7, 0.0]])
    alone = TrafficSnapshot(0, ego, 5.0, own, np.ones(1, np.bool_), np.zeros((1, 2)))
    gaps, speeds = find_leaders(VehicleRoads.of(paths), np.zeros(1, np.int64), np.ones(1), np.zeros(1, np.int64), alone)
    assert gaps.tolist() == [np.inf] and speeds.tolist() == [0.0]
