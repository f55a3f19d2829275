"""The check of each official protocol that takes steps out of the evaluation, on cases made by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from benchmark.constants import EGO_LENGTH_M, EGO_WIDTH_M
from benchmark.geometry import Floats
from benchmark.protocols import LEAVING_OUT, NATIVE_PROTOCOLS, PROTOCOLS, find_masking_protocols
from benchmark.protocols.raster import CELL_M, EXTENT_M, RasterProtocol
from benchmark.protocols.stacked_truths import stack
from benchmark.records.row_schema import OutcomeRow
from benchmark.records.run import summarise_rows
from benchmark.records.run_schema import SceneFacts
from benchmark.truth import SampleTruth
from tests.benchmark.protocols.protocol_cases import Traits, made_truth, plan_of, sample_of, traits
from tests.benchmark.records.test_run import row as _record_row

LENGTH_M, WIDTH_M = 4.5, 1.9
ALL, NONE = [True] * 6, [False] * 6


def beside(
    left_m: float = 0.0, ahead_m: float = 0.0, *, category: str = "vehicle.car", turn_rad: float = 0.0, steps: int = 6
) -> SampleTruth:
    """One adversary that keeps its place beside the recorded ego, which drives 4 m a step, turned by ``turn_rad``.

    ``left_m`` and ``ahead_m`` are air between bodies (one of them; negative on the other side).
    """
    ego = np.column_stack([np.full(6, 0.1), 4.0 * np.arange(1, 7) + 0.1, np.full(6, np.pi / 2 + turn_rad)])
    center = ego[:, :2] + 0.5 * np.column_stack([np.cos(ego[:, 2]), np.sin(ego[:, 2])])
    aside = np.sign(left_m) * (abs(left_m) + 0.5 * (EGO_WIDTH_M + WIDTH_M))
    along = np.sign(ahead_m) * (abs(ahead_m) + 0.5 * (EGO_LENGTH_M + LENGTH_M))
    boxes = np.empty((1, 7, 5))
    boxes[0, 1:] = np.column_stack([center + [-aside, along], np.tile([LENGTH_M, WIDTH_M], (6, 1)), ego[:, 2]])
    boxes[0, 0] = boxes[0, 1] - [0.0, 4.0, 0.0, 0.0, turn_rad]
    there = np.arange(7) <= steps
    return made_truth(
        boxes, ego, instances=("adversary",), categories=(category,), annotated=there[None],
        ego_future_valid=there[1:], adversaries=frozenset({"adversary"}),
    )  # fmt: skip


def on_top(**changes: Any) -> SampleTruth:
    """The adversary lies on the recorded ego."""
    found = beside(left_m=-0.1, **changes)
    found.boxes[:, :, 0] -= 1.2
    return found


def touched(truth: SampleTruth, name: str) -> list[bool]:
    stacked = stack([truth])
    found: list[bool] = find_masking_protocols()[name].recorded_contacts(stacked, stacked.adversarial)[0].tolist()
    return found


@pytest.mark.parametrize(
    ("case", "touching"),
    [
        (beside(left_m=0.3), {"uniad", "vad"}),
        (beside(left_m=0.9), set()),
        (beside(left_m=-0.1), set()),
        (beside(left_m=0.3, category="human.pedestrian.adult"), {"vad"}),
        (beside(left_m=0.3, category="movable_object.barrier"), set()),
        (beside(ahead_m=-0.2), {"uniad"}),
        (beside(ahead_m=-0.8), set()),
        (beside(ahead_m=0.3), set()),
    ],
)
def test_the_rasters_touch_what_the_polygons_do_not(case: SampleTruth, touching: set[str]) -> None:
    assert {name for name in NATIVE_PROTOCOLS if any(touched(case, name))} == touching


def test_every_protocol_sees_a_car_on_the_recorded_way() -> None:
    assert all(touched(on_top(), name) == ALL for name in NATIVE_PROTOCOLS)


def test_polygons_see_a_contact_on_the_right_that_rasters_do_not() -> None:
    grazing = beside(left_m=-0.01)
    grazing.boxes[:, :, 0] -= 0.1
    assert {name for name in NATIVE_PROTOCOLS if any(touched(grazing, name))} == {"sparsedrive", "diffusiondrive"}


def test_the_rasters_never_turn_the_ego() -> None:
    """Half a metre of air beside the turned body is inside of what looks straight ahead."""
    turned = beside(left_m=-0.3, turn_rad=np.pi / 2)
    turned.boxes[0, 1:, :2] = turned.ego_future[:, :2] + [0.0, 2.0]
    assert touched(turned, "uniad") == ALL and touched(turned, "vad") == ALL
    for name in ("uniad", "vad", "stp3"):
        assert (PROTOCOLS[name].headings(np.zeros((1, 6, 2))) == np.pi / 2).all()


@pytest.mark.parametrize("name", NATIVE_PROTOCOLS)
def test_there_are_no_contacts_past_the_end_of_the_recording(name: str) -> None:
    assert touched(on_top(steps=2), name) == [True, True, *NONE[2:]]


@pytest.mark.parametrize("name", find_masking_protocols())
def test_only_adversaries_are_in_their_column_and_the_mask_holds_for_all(name: str) -> None:
    plan = on_top().ego_future[None, :, :2]
    for truth, of_adversaries in ((on_top(), ALL), (replace(on_top(), adversaries=frozenset()), NONE)):
        outcomes = PROTOCOLS[name].evaluate([truth], plan)
        assert outcomes.step("recorded")[0].tolist() == outcomes.step("before_mask")[0].tolist() == ALL
        assert outcomes.step("recorded_adversary")[0].tolist() == of_adversaries
        assert outcomes.collision[0].tolist() == NONE


@pytest.mark.parametrize("name", find_masking_protocols())
@settings(max_examples=12, deadline=None)
@given(kind=traits(coarse=True))
def test_the_check_of_all_objects_is_the_mask_and_that_of_parts_adds_up_to_it(name: str, kind: Traits) -> None:
    sample = sample_of(kind)
    stacked, mask = stack([sample]), PROTOCOLS[name].evaluate([sample], plan_of(kind)[None]).step("recorded")
    check, some = find_masking_protocols()[name].recorded_contacts, np.arange(len(sample.instances)) % 2 == 0
    np.testing.assert_array_equal(check(stacked, np.ones_like(some)), mask)
    np.testing.assert_array_equal(check(stacked, some) | check(stacked, ~some), mask)


@pytest.mark.parametrize("name", sorted(LEAVING_OUT))
def test_samples_that_are_left_out_are_told_and_their_colliding_steps_counted(name: str) -> None:
    truths = [on_top(), replace(on_top(), adversaries=frozenset()), beside(left_m=5.0)]
    outcomes = PROTOCOLS[name].evaluate(truths, np.stack([truth.ego_future[:, :2] for truth in truths]))
    assert outcomes.facts["left_out"] == (True, True, False)
    assert outcomes.counted.tolist() == [False, False, True]
    rows = [
        _record_row("s", place).model_copy(update={"outcomes": {name: OutcomeRow.model_validate(one)}})
        for place, one in enumerate(outcomes.as_rows())
    ]
    facts = {"s": SceneFacts(source="s", adversaries=1)}
    summary = summarise_rows(rows, {name: 1}, seed=0, scene_facts=facts).protocols[name]
    assert (summary.mask_removed_steps, summary.mask_removed_for_adversary, summary.counted) == (12, 6, 1)


@pytest.mark.parametrize("name", ["uniad", "vad"])
def test_the_mean_ends_are_those_of_the_drawn_block(name: str) -> None:
    known = PROTOCOLS[name]
    assert isinstance(known, RasterProtocol)
    waypoints = np.random.default_rng(0).uniform(-20.0, 20.0, (20_000, 2))
    cells = known.ego_block(waypoints)
    ahead = EXTENT_M - cells[..., 0] * CELL_M if known.first_row_ahead else cells[..., 0] * CELL_M - EXTENT_M
    left = EXTENT_M - cells[..., 1] * CELL_M
    ends: list[Floats] = []
    for places, waypoint in ((ahead, waypoints[:, 1]), (left, -waypoints[:, 0])):
        ends += [places.min(axis=1) - 0.25 - waypoint, places.max(axis=1) + 0.25 - waypoint]
    np.testing.assert_allclose(np.mean(ends, axis=1), known.mean_ends_m, atol=0.01)
