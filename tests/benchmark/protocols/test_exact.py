"""The exact protocol and what objects count, on cases made by hand; `test_slow` and the golden sets have the rest."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.sample_truth import compute_truth
from benchmark.geometry import Floats
from benchmark.protocols import PROTOCOLS, ProtocolOutcomes, find_category_protocols, find_protocol, register
from benchmark.protocols.exact import ExactProtocol
from benchmark.protocols.stacked_truths import stack
from benchmark.truth import SampleTruth
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.protocols.protocol_cases import Traits, made_truth, plan_of, sample_of
from tests.hand_made import Car, scene_on_straight_road

STRAIGHT = np.column_stack([np.zeros(6), np.arange(1, 7) * 4.0])
CAR = (4.6, 1.9, np.pi / 2)


def truth(boxes: Floats, **changes: Any) -> SampleTruth:
    """The recorded ego drives straight at 8 m/s."""
    return made_truth(boxes, STRAIGHT, **changes)


def parked(x: float, y: float) -> Floats:
    return np.tile([x, y, *CAR], (7, 1))


def test_contact_between_waypoints_counts_and_is_not_undone() -> None:
    # A pedestrian-sized box stands where the ego passes between 0.5 s (y = 8) and 1.0 s (y = 16).
    post = np.tile([0.0, 12.2, 0.4, 0.4, 0.0], (7, 1))
    plan = np.column_stack([np.zeros(6), 8.0 * np.arange(1, 7)])
    outcomes = ExactProtocol().evaluate([truth(post)], plan[None])
    assert not outcomes.steps["waypoint_collision"].any()
    assert outcomes.collision[0].tolist() == [False, True, False, False, False, False]
    assert ExactProtocol().sample_values(outcomes)["collision"].tolist() == [[1.0, 1.0, 1.0]]
    assert outcomes.facts["first_contact_s"] == (0.6,) and outcomes.facts["hit"] == ("s-0",)


@pytest.mark.parametrize(("ahead_m", "counts"), [(29.0, True), (31.0, False)])
def test_vad_counts_who_is_within_thirty_metres_ahead_now(ahead_m: float, counts: bool) -> None:
    comes = parked(8.0, 8.0)
    comes[0, 1] = ahead_m
    found = PROTOCOLS["vad"].evaluate([truth(comes)], np.full((1, 6, 2), 8.0))
    assert bool(found.collision.any()) == counts


@pytest.mark.parametrize("now", [True, False])
def test_safemvdrive_leaves_out_samples_whose_ego_touches_a_box_that_is_there_now(now: bool) -> None:
    there = np.full((1, 7), not now)
    there[0, 0] = now
    found = PROTOCOLS["safemvdrive-box"].evaluate([truth(parked(0.0, 1.0), annotated=there)], STRAIGHT[None])
    assert bool(found.counted[0]) != now


def test_contact_now_does_not_count() -> None:
    stays = np.zeros((1, 6, 2))
    away = np.concatenate([[[0.0, 1.0, *CAR]], np.tile([50.0, 50.0, *CAR], (6, 1))])
    annotated = np.array([[True, False, True, True, True, True, True]])
    assert not ExactProtocol().evaluate([truth(away, annotated=annotated)], stays).collision.any()


def test_an_object_is_between_keyframes_only_if_annotated_at_both() -> None:
    crossing = np.array([[-20.0 + 10.0 * step, 10.0, *CAR] for step in range(7)])
    waits = np.column_stack([np.zeros(6), np.full(6, 10.0)])[None]
    both = np.ones((1, 7), dtype=np.bool_)
    seen = ExactProtocol().evaluate([truth(crossing, annotated=both)], waits)
    assert seen.collision[0].tolist() == [False, True, False, False, False, False]
    gone = both.copy()
    gone[0, 2] = False
    assert not ExactProtocol().evaluate([truth(crossing, annotated=gone)], waits).collision.any()


def test_the_box_turns_with_the_plan() -> None:
    # A wall that a box with a frozen heading would reach into, and a car that has turned left drives along.
    turning = np.array([[0.0, 2.0], [-1.0, 3.6], [-2.6, 4.6], [-4.6, 4.8], [-6.6, 4.8], [-8.6, 4.8]])
    wall = np.tile([-5.0, 6.6, 10.0, 1.0, 0.0], (7, 1))
    outcomes = ExactProtocol().evaluate([truth(wall)], turning[None])
    assert not outcomes.collision[0, 4:].any()


def test_l2_is_at_the_step_and_ade_is_the_mean() -> None:
    plan = STRAIGHT + np.array([0.0, 1.0]) * np.arange(1, 7)[:, None]
    values = ExactProtocol().sample_values(ExactProtocol().evaluate([truth(np.empty((0, 7, 5)))], plan[None]))
    assert values["l2"].tolist() == [[2.0, 4.0, 6.0]]
    assert values["ade"].tolist() == [[1.5, 2.5, 3.5]]


def test_samples_without_a_complete_future_are_not_counted() -> None:
    short = truth(parked(0, 8), ego_future_valid=np.arange(6) < 5)
    outcomes = ExactProtocol().evaluate([short, truth(parked(0, 8))], np.stack([STRAIGHT, STRAIGHT]))
    assert outcomes.counted.tolist() == [False, True]
    assert outcomes.as_rows()[0]["l2"][5] is None


@pytest.mark.parametrize("name", PROTOCOLS)
def test_rows_and_arrays_are_the_same(name: str) -> None:
    kinds = [Traits(seed, seed, 9.0, 6 - seed % 2, "drive", False) for seed in range(5)]
    truths, plans = [sample_of(kind) for kind in kinds], np.array([plan_of(kind) for kind in kinds])
    outcomes = PROTOCOLS[name].evaluate(truths, plans)
    back = ProtocolOutcomes.from_rows(outcomes.as_rows())
    assert back.as_rows() == outcomes.as_rows()
    before, after = (PROTOCOLS[name].sample_values(one) for one in (outcomes, back))
    assert all(np.array_equal(before[column], after[column], equal_nan=True) for column in before)
    assert len(ProtocolOutcomes.from_rows([])) == 0


def test_a_name_is_registered_once() -> None:
    assert find_protocol("exact") is PROTOCOLS["exact"]
    with pytest.raises(ValueError, match="already"):
        register(ExactProtocol())


@pytest.mark.parametrize("name", PROTOCOLS)
def test_another_name_hides_an_object_from_those_that_go_by_names_and_from_no_other(name: str) -> None:
    truths = town_of_two(slow_leader=True).truth("scene-9902")
    definition = PROTOCOLS[name]
    named = definition.counted_objects(stack(truths))
    foreign = definition.counted_objects(
        stack([replace(truth, categories=("car",) * len(truth.categories)) for truth in truths])
    )
    assert named.any()
    assert np.array_equal(named, foreign) != definition.uses_categories
    assert (name in find_category_protocols([name])) == definition.uses_categories
    assert not (definition.uses_categories and foreign.any())


def parked_ahead(lidar_points: int, radar_points: int) -> SampleTruth:
    """A car parked on the recorded path, with so many points on it at every keyframe."""
    scene = scene_on_straight_road((Car(x=75.0, y=200.0, speed=0.0),), seconds=5.0)
    known = scene.annotations
    lidar, radar = (np.full_like(known.num_lidar_pts, count) for count in (lidar_points, radar_points))
    annotations = replace(known, num_lidar_pts=lidar, num_radar_pts=radar)
    tokens = [str(index) for index in range(len(scene.keyframes))]
    return compute_truth(replace(scene, annotations=annotations), tokens)[0]


def straight_into(sample: SampleTruth) -> Floats:
    """A plan that reaches the car at its second step and stands in it."""
    place = sample.boxes[0, 0, :2]
    return np.array([0.5 * place, *[place] * 5])


@pytest.mark.parametrize("name", ["vad", "vad-23"])
@pytest.mark.parametrize(("lidar_points", "radar_points", "seen"), [(1, 0, True), (3, 9, True), (0, 9, False)])
def test_a_box_with_radar_points_alone_cannot_be_hit(
    name: str, lidar_points: int, radar_points: int, seen: bool
) -> None:
    sample = parked_ahead(lidar_points, radar_points)
    assert sample.has_points[0].all(), "the box has points of some sensor"
    outcomes = PROTOCOLS[name].evaluate([sample], straight_into(sample)[None])
    assert bool(outcomes.step("before_mask")[0, 1:].all()) == seen
    assert bool(outcomes.step("before_mask").any()) == seen
    assert PROTOCOLS[name].version == 2


def test_the_others_are_as_before() -> None:
    sample = parked_ahead(0, 9)
    plan = straight_into(sample)[None]
    assert PROTOCOLS["uniad"].evaluate([sample], plan).step("before_mask")[0, 1:].all()
    assert not PROTOCOLS["sparsedrive"].evaluate([sample], plan).step("before_mask").any()
