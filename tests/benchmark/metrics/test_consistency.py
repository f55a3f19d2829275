"""Plan consistency: zero for one fixed path, and the distance that a planner changed its mind by otherwise."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats, to_global, to_local
from benchmark.metrics.consistency import INSTANTS, MEAN, measure_consistency, measure_plan_distance
from benchmark.records.row_schema import PlanRow, SampleRow
from benchmark.records.run import RunRecord
from benchmark.waypoints import waypoints_in_lidar
from tests.benchmark.records.hand_made_records import CLEAN, hand_made
from tests.benchmark.records.test_run import row


def driven(rng: np.random.Generator, samples: int) -> Floats:
    """(K, 3) recorded poses of the lidar, global: a car that drives and turns at will."""
    yaw = rng.uniform(-3, 3) + np.cumsum(rng.normal(0.0, 0.15, samples))
    steps = rng.uniform(0.0, 8.0, samples)[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.concatenate([rng.uniform(-2000, 2000, 2) + np.cumsum(steps, axis=0), yaw[:, None]], axis=1)


def in_lidar(points: Floats, pose: Floats) -> Floats:
    """Global points x right, y forward of a pose."""
    local = to_local(points, pose)
    return np.stack([-local[:, 1], local[:, 0]], axis=-1)


def rows_of(poses: Floats, planned: Callable[[int], Floats], scene: str = "a") -> list[SampleRow]:
    """Rows of a scene; ``planned`` gives the global waypoints of each sample."""
    found = []
    for index, pose in enumerate(poses):
        future: list[list[float] | None] = [None] * 6
        for step in range(6):
            if index + step + 1 < len(poses):
                then = poses[index + step + 1]
                yaw = then[2] - pose[2] + np.pi / 2
                future[step] = [*in_lidar(then[None, :2], pose)[0].tolist(), float(yaw)]
        plan = PlanRow(frame="lidar", waypoints=in_lidar(planned(index), pose).tolist())
        changed = {"plan": plan, "recorded_future": future}
        found.append(row(scene, index).model_copy(update=changed))
    return found


def record_of(rows: list[SampleRow]) -> RunRecord:
    scenes = {name: [CLEAN] for name in dict.fromkeys(one.scene for one in rows)}
    made = hand_made("p", scenes)
    return RunRecord(made.directory, made.run, tuple(rows), made.summary)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 12))
def test_a_planner_that_follows_one_fixed_path_is_consistent(seed: int, samples: int) -> None:
    rng = np.random.default_rng(seed)
    poses = driven(rng, samples)
    path = poses[0, :2] + np.cumsum(rng.normal(0.0, 4.0, (samples + 6, 2)), axis=0)
    found = measure_consistency(record_of(rows_of(poses, lambda index: path[index + 1 : index + 7])))
    assert found.pairs == samples - 1 and found.without == 0
    for rate in found.distances.values():
        assert rate.value == pytest.approx(0.0, abs=1e-8)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.1, 5.0))
def test_a_shift_of_every_other_plan_is_the_distance(seed: int, shift_m: float) -> None:
    rng = np.random.default_rng(seed)
    poses = driven(rng, 8)
    path = poses[0, :2] + np.cumsum(rng.normal(0.0, 4.0, (14, 2)), axis=0)
    aside = shift_m * np.array([0.6, 0.8])
    rows = rows_of(poses, lambda index: path[index + 1 : index + 7] + (index % 2) * aside)
    found = measure_consistency(record_of(rows))
    assert [rate.value for rate in found.distances.values()] == pytest.approx([shift_m] * 6, abs=1e-8)
    # Where and which way the scene lies changes nothing.
    turned = np.concatenate([to_global(poses[:, :2], np.array([9.0, 4.0, 1.0])), poses[:, 2:] + 1.0], axis=1)
    again = rows_of(turned, lambda index: to_global(path[index + 1 : index + 7], np.array([9.0, 4.0, 1.0])))
    assert measure_plan_distance(again[0], again[1]) == pytest.approx(np.zeros(5), abs=1e-8)


def test_a_car_that_stands_still_while_the_planner_drives_off_each_time() -> None:
    poses = np.zeros((4, 3))
    rows = rows_of(poses, lambda index: 2.0 * np.arange(1, 7)[:, None] * np.array([1.0, 0.0]))
    found = measure_consistency(record_of(rows))
    # The later plan begins half a second later at the same place: it is one step of 2 m behind.
    assert [found.distances[name].value for name in (*INSTANTS, MEAN)] == pytest.approx([2.0] * 6)


def test_missing_plans_ends_of_scenes_and_gaps_are_in_no_pair() -> None:
    poses, path = np.zeros((5, 3)), np.zeros((12, 2))
    rows = rows_of(poses, lambda index: path[index + 1 : index + 7])
    rows[2] = rows[2].model_copy(update={"plan": None, "status": "failed"})
    other = rows_of(poses[:2], lambda index: path[index + 1 : index + 7], scene="b")
    found = measure_consistency(record_of([*rows, *other]))
    assert (found.pairs, found.without) == (3, 2)
    nothing = measure_consistency(record_of(rows[:1]))
    assert nothing.pairs == 0 and nothing.distances[MEAN].value is None


def test_intervals_are_over_recorded_scenes() -> None:
    rng, rows = np.random.default_rng(1), []
    for number in range(6):
        poses, path = driven(rng, 6), np.cumsum(rng.normal(0.0, 4.0, (12, 2)), axis=0)
        plans = [path[index + 1 : index + 7] + (index % 2) * np.array([0.5 * number, 0.0]) for index in range(6)]
        rows += rows_of(poses, plans.__getitem__, scene=f"s{number}")
    rate = measure_consistency(record_of(rows)).distances[MEAN]
    assert rate.value == pytest.approx(1.25) and rate.low is not None and rate.high is not None
    assert rate.low < 1.25 < rate.high


def test_plans_of_the_rear_axle_are_moved_to_the_lidar_first() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    rows = rows_of(poses, lambda index: np.zeros((6, 2)))
    straight = [[2.0 * step, 0.0] for step in range(1, 7)]
    rows = [one.model_copy(update={"plan": PlanRow(frame="ego", waypoints=straight)}) for one in rows]
    assert measure_plan_distance(*rows) == pytest.approx(np.zeros(5), abs=1e-9)
    assert waypoints_in_lidar(np.array(straight), "ego", 0.94)[0] == pytest.approx([0.0, 2.0])


def test_samples_that_are_not_half_a_second_apart_are_not_compared() -> None:
    rows = rows_of(driven(np.random.default_rng(1), 6), lambda _: np.zeros((6, 2)))
    late = [one.model_copy(update={"timestamp_us": one.timestamp_us + 500_000 * (one.index > 2)}) for one in rows]
    assert [measure_consistency(record_of(some)).pairs for some in (rows, late)] == [5, 4]
