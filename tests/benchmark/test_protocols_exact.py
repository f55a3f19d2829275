"""The exact protocol against golden numbers, against shapely, and on cases made by hand."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, box_corners, wrap_angle
from benchmark.planning import Command, chord_headings
from benchmark.protocols import PROTOCOLS, Outcomes, protocol, register
from benchmark.protocols.exact import Exact
from benchmark.truth import SampleTruth

GOLDEN = Path(__file__).resolve().parents[3] / "shared" / "golden" / "protocols"
STRAIGHT = np.column_stack([np.zeros(6), np.arange(1, 7) * 4.0])
CAR = (4.6, 1.9, np.pi / 2)


def truth(
    boxes: Floats, annotated: Bools | None = None, *, future: Floats | None = None, valid: int = 6, name: str = "s"
) -> SampleTruth:
    """Boxes (M, 7, 5); the recorded ego drives straight at 8 m/s."""
    boxes = np.asarray(boxes, np.float64).reshape(-1, 7, 5)
    there = np.ones(boxes.shape[:2], dtype=np.bool_) if annotated is None else annotated
    path = STRAIGHT if future is None else future
    return SampleTruth(
        scene="scene-0001",
        sample_token=name,
        index=0,
        timestamp_us=0,
        lidar_pose=np.zeros(3),
        lidar_ahead_m=0.94,
        ego_future=np.column_stack([path, np.full(6, np.pi / 2)]),
        ego_future_valid=np.arange(6) < valid,
        command=Command.STRAIGHT,
        instances=tuple(f"{name}-{row}" for row in range(len(boxes))),
        categories=("vehicle.car",) * len(boxes),
        boxes=boxes,
        annotated=there,
        has_points=there,
        has_lidar_points=there,
    )


def parked(x: float, y: float) -> Floats:
    return np.tile([x, y, *CAR], (7, 1))


def golden_truths(data: dict[str, NDArray[Any]]) -> list[SampleTruth]:
    truths = []
    for row in range(len(data["keyframe"])):
        rows = slice(data["obj_offset"][row], data["obj_offset"][row + 1])
        box, annotated = data["obj_box"][rows].astype(np.float64), data["obj_annotated"][rows]
        size = np.broadcast_to(data["obj_size"][rows, None].astype(np.float64), (len(box), 7, 2))
        boxes = np.concatenate([box[..., :2], size, box[..., 2:]], axis=-1)
        future = data["ego_fut"][row].astype(np.float64)
        sample = truth(boxes, annotated, future=future[:, :2], valid=int(data["ego_fut_valid"][row].sum()))
        truths.append(sample)
    return truths


@pytest.mark.skipif(not GOLDEN.is_dir(), reason="the golden sets are not beside this checkout")
def test_golden_verdicts_agree_at_every_waypoint_and_every_step() -> None:
    files = sorted(GOLDEN.glob("*_exact.npz"))
    assert files
    for file in files:
        exact = dict(np.load(file))
        inputs = dict(np.load(file.with_name(file.name.replace("_exact", ""))))
        truths = golden_truths(inputs)
        for plan in range(inputs["plans"].shape[1]):
            plans = inputs["plans"][:, plan].astype(np.float64)
            outcomes = Exact().evaluate(truths, plans)
            touching = exact["clear_all"][:, plan] < 1e-6
            decided = ~(touching & ~exact["way_all"][:, plan])
            expected_steps = exact["cont_all"][:, plan].reshape(-1, 6, 5).any(axis=-1)
            assert (outcomes.steps["waypoint_collision"] == exact["way_all"][:, plan])[decided].all(), file.name
            assert (outcomes.collision == expected_steps)[decided].all(), file.name
            heading = chord_headings(plans, start_heading_rad=np.pi / 2)
            assert np.abs(wrap_angle(heading - exact["heading"][:, plan, 1:])).max() < 1e-5
            assert (outcomes.counted == inputs["ego_fut_valid"].all(axis=1)).all()


def oracle(sample: SampleTruth, plan: Floats) -> tuple[list[bool], bool]:
    """Slow and obvious: shapely polygons at each tenth of a second; also whether any verdict is within a hair."""
    headings = [np.pi / 2, *chord_headings(plan, start_heading_rad=np.pi / 2)]
    points = [np.zeros(2), *plan]
    verdicts, close = [], False
    for step in range(6):
        hit = False
        for part in range(1, 6):
            share = part / 5
            turn = wrap_angle(np.asarray(headings[step + 1] - headings[step]))
            yaw = headings[step] + share * float(turn)
            place = (1 - share) * points[step] + share * points[step + 1]
            centre = place + 0.5 * np.array([np.cos(yaw), np.sin(yaw)])
            ego = shapely.Polygon(box_corners(np.array([*centre, 4.084, 1.85, yaw])))
            for boxes, there in zip(sample.boxes, sample.annotated):
                if not there[step + 1] or (part < 5 and not there[step]):
                    continue
                between = (1 - share) * boxes[step] + share * boxes[step + 1]
                swing = wrap_angle(np.asarray(boxes[step + 1, 4] - boxes[step, 4]))
                between[4] = boxes[step, 4] + share * float(swing)
                other = shapely.Polygon(box_corners(between))
                hit |= ego.intersects(other)
                close |= abs(ego.distance(other)) < 1e-6 and ego.intersection(other).area < 1e-6
                close |= 0 < ego.intersection(other).area < 1e-6
        verdicts.append(hit)
    return verdicts, close


def random_case(seed: int, objects: int) -> tuple[SampleTruth, Floats]:
    rng = np.random.default_rng(seed)
    start = rng.uniform([-8, -8], [8, 25], (objects, 2))
    step = rng.normal(0, 2.0, (objects, 2))
    boxes = np.empty((objects, 7, 5))
    boxes[..., :2] = start[:, None] + step[:, None] * np.arange(7)[:, None]
    boxes[..., 2:4] = rng.uniform(0.3, 9.0, (objects, 1, 2))
    boxes[..., 4] = rng.uniform(-np.pi, np.pi, (objects, 1)) + 0.3 * np.arange(7)
    plan = np.cumsum(rng.normal([0.0, 2.0], [0.7, 1.5], (6, 2)), axis=0)
    return truth(boxes, rng.random((objects, 7)) < 0.8), plan


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 5))
def test_verdicts_equal_those_of_polygons(seed: int, objects: int) -> None:
    sample, plan = random_case(seed, objects)
    expected, close = oracle(sample, plan)
    if not close:
        assert Exact().evaluate([sample], plan[None]).collision[0].tolist() == expected


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.permutations(range(7)))
def test_the_order_of_samples_and_objects_changes_nothing(seed: int, order: list[int]) -> None:
    cases = [random_case(seed + row, row) for row in range(7)]
    together = Exact().evaluate([sample for sample, _ in cases], np.array([plan for _, plan in cases])).as_rows()
    shuffled = Exact().evaluate([cases[row][0] for row in order], np.array([cases[row][1] for row in order])).as_rows()
    assert [together[row] for row in order] == shuffled
    assert [Exact().evaluate([sample], plan[None]).as_rows()[0] for sample, plan in cases] == together


def test_contact_between_waypoints_counts_and_is_not_undone() -> None:
    # A pedestrian-sized box stands where the ego passes between 0.5 s (y = 8) and 1.0 s (y = 16).
    post = np.tile([0.0, 12.2, 0.4, 0.4, 0.0], (7, 1))
    plan = np.column_stack([np.zeros(6), 8.0 * np.arange(1, 7)])
    outcomes = Exact().evaluate([truth(post)], plan[None])
    assert not outcomes.steps["waypoint_collision"].any()
    assert outcomes.collision[0].tolist() == [False, True, False, False, False, False]
    assert Exact().sample_values(outcomes)["collision"].tolist() == [[1.0, 1.0, 1.0]]
    assert outcomes.facts["first_contact_s"] == (0.6,) and outcomes.facts["hit"] == ("s-0",)


def test_contact_now_does_not_count() -> None:
    stays = np.zeros((1, 6, 2))
    away = np.concatenate([[[0.0, 1.0, *CAR]], np.tile([50.0, 50.0, *CAR], (6, 1))])
    annotated = np.array([[True, False, True, True, True, True, True]])
    assert not Exact().evaluate([truth(away, annotated)], stays).collision.any()


def test_an_object_is_between_keyframes_only_if_annotated_at_both() -> None:
    crossing = np.array([[-20.0 + 10.0 * step, 10.0, *CAR] for step in range(7)])
    waits = np.column_stack([np.zeros(6), np.full(6, 10.0)])[None]
    both = np.ones((1, 7), dtype=np.bool_)
    seen = Exact().evaluate([truth(crossing, both)], waits)
    assert seen.collision[0].tolist() == [False, True, False, False, False, False]
    gone = both.copy()
    gone[0, 2] = False
    assert not Exact().evaluate([truth(crossing, gone)], waits).collision.any()


def test_the_box_turns_with_the_plan() -> None:
    # A wall that a box with a frozen heading would reach into, and a car that has turned left drives along.
    turning = np.array([[0.0, 2.0], [-1.0, 3.6], [-2.6, 4.6], [-4.6, 4.8], [-6.6, 4.8], [-8.6, 4.8]])
    wall = np.tile([-5.0, 6.6, 10.0, 1.0, 0.0], (7, 1))
    outcomes = Exact().evaluate([truth(wall)], turning[None])
    assert not outcomes.collision[0, 4:].any()


def test_l2_is_at_the_step_and_ade_is_the_mean() -> None:
    plan = STRAIGHT + np.array([0.0, 1.0]) * np.arange(1, 7)[:, None]
    values = Exact().sample_values(Exact().evaluate([truth(np.empty((0, 7, 5)))], plan[None]))
    assert values["l2"].tolist() == [[2.0, 4.0, 6.0]]
    assert values["ade"].tolist() == [[1.5, 2.5, 3.5]]


def test_samples_without_a_complete_future_are_not_counted() -> None:
    outcomes = Exact().evaluate([truth(parked(0, 8), valid=5), truth(parked(0, 8))], np.stack([STRAIGHT, STRAIGHT]))
    assert outcomes.counted.tolist() == [False, True]
    assert outcomes.as_rows()[0]["l2"][5] is None


def test_rows_and_arrays_are_the_same() -> None:
    cases = [random_case(row, row) for row in range(5)]
    outcomes = Exact().evaluate([sample for sample, _ in cases], np.array([plan for _, plan in cases]))
    back = Outcomes.from_rows(outcomes.as_rows())
    assert back.as_rows() == outcomes.as_rows()
    assert len(Outcomes.from_rows([])) == 0


def test_no_samples_give_no_verdicts() -> None:
    outcomes = Exact().evaluate([], np.empty((0, 6, 2)))
    assert len(outcomes) == 0 and outcomes.collision.shape == (0, 6)


def test_a_name_is_registered_once() -> None:
    assert protocol("exact") is PROTOCOLS["exact"]
    with pytest.raises(ValueError, match="already"):
        register(Exact())
