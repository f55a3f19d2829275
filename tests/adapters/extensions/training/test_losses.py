"""Matching, losses and the room that plans leave, against slow obvious versions of them."""

import math
from dataclasses import replace
from itertools import permutations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from adapters.extensions.training.losses import (
    assign,
    box_loss,
    class_cost,
    dice_loss,
    direction_loss,
    find_winning_modes,
    focal_loss,
    line_loss,
    match_boxes,
    match_lines,
    normalise_boxes,
    plan_loss,
    query_class_loss,
    trajectory_losses,
)
from adapters.extensions.training.plan_room import AHEAD_M, ASIDE_M, NearbyBodies, missing_room, room_loss
from benchmark.constants import (
    EGO_BODY_WIDTH_M,
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_LENGTH_M,
    LIDAR_FROM_REAR_AXLE_M,
)
from benchmark.errors import InputError
from benchmark.geometry import boxes_overlap
from tests.adapters.extensions.training.road_frames import empty
from tests.adapters.extensions.training.uniad.learner import a_frame

SEEDS = st.integers(0, 10_000)


def noise(seed: int, *shape: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@given(SEEDS, st.integers(1, 5), st.lists(st.integers(0, 5), min_size=1, max_size=3))
@settings(max_examples=40, deadline=None)
def test_the_assignment_is_the_cheapest_in_each_key_frame(seed: int, queries: int, counts: list[int]) -> None:
    cost = noise(seed, len(counts) * queries, sum(counts))
    found = assign(cost, queries, counts) if len(counts) > 1 else assign(cost)
    owners = torch.repeat_interleave(torch.arange(len(counts)), torch.tensor(counts))
    assert torch.equal(found.queries // queries, owners[found.wanted])
    assert len(set(found.queries.tolist())) == len(set(found.wanted.tolist())) == len(found.queries)
    cheapest, start = 0.0, 0
    for number, count in enumerate(counts):
        block = cost[number * queries : (number + 1) * queries, start : start + count]
        block, start = block if queries <= count else block.T, start + count
        ways = permutations(range(block.shape[1]), block.shape[0])
        cheapest += min((sum(float(block[row, place]) for row, place in enumerate(way)) for way in ways), default=0.0)
    assert len(found.queries) == sum(min(queries, count) for count in counts)
    assert float(cost[found.queries, found.wanted].sum()) == pytest.approx(cheapest, abs=1e-4)


def test_predictions_that_are_not_finite_are_a_sentence() -> None:
    with pytest.raises(InputError, match="no longer finite"):
        assign(torch.tensor([[math.nan, 1.0]]))


@given(SEEDS)
def test_the_cost_of_a_class_is_what_the_focal_loss_changes_by(seed: int) -> None:
    logits = noise(seed, 3, 4)
    cost = class_cost(logits, torch.tensor([2]))[:, 0]
    for query in range(3):
        without, with_it = torch.zeros(4), torch.tensor([0.0, 0.0, 1.0, 0.0])
        changed = focal_loss(logits[query], with_it, count=1) - focal_loss(logits[query], without, count=1)
        assert float(cost[query]) == pytest.approx(float(changed), abs=1e-5)


def test_boxes_are_matched_by_place_and_kind() -> None:
    wanted = normalise_boxes(torch.tensor([[0.0, 10, -1, 4, 2, 1.5, 0, 1, 0], [5.0, 0, -1, 4, 2, 1.5, 3, 0, 0]]))
    codes = wanted.flip(0) + 0.01
    found = match_boxes(torch.zeros(2, 3), codes, torch.tensor([0, 0]), wanted, torch.ones(10))
    assert found.queries.tolist() == [0, 1] and found.wanted.tolist() == [1, 0]
    assert float(box_loss(codes, wanted, found, torch.ones(10))) == pytest.approx(0.1, abs=1e-5)
    # Where places agree, kinds decide.
    logits = torch.tensor([[5.0, -5], [-5.0, 5]])
    same = wanted[:1].repeat(2, 1)
    assert match_boxes(logits, same, torch.tensor([1, 0]), same, torch.ones(10)).wanted.tolist() == [1, 0]


def test_half_a_turn_more_is_another_heading_and_a_full_turn_is_none() -> None:
    box = torch.tensor([1.0, 2, 0, 4, 2, 1.5, 0.3, 1, 2])
    turn = torch.tensor([0, 0, 0, 0, 0, 0, 2 * math.pi, 0, 0])
    assert torch.allclose(normalise_boxes(box), normalise_boxes(box + turn), atol=1e-5)
    assert not torch.allclose(normalise_boxes(box), normalise_boxes(box + turn / 2), atol=0.1)


@given(SEEDS, st.booleans(), st.integers(0, 7))
@settings(max_examples=25, deadline=None)
def test_a_line_is_the_same_backwards_and_a_closed_one_from_any_start(seed: int, closed: bool, start: int) -> None:
    points = noise(seed, 8, 2).cumsum(0)
    if closed:
        ring = torch.cat([points, points[:1]])
        drawn = torch.cat([ring[:-1].roll(start, 0), ring[:-1].roll(start, 0)[:1]])
    else:
        ring, drawn = points, points
    for other in (drawn, drawn.flip(0)):
        matches, matched = match_lines(torch.zeros(1, 3), other[None], torch.tensor([1]), ring[None])
        assert float(line_loss(other[None], matched, matches)) == pytest.approx(0, abs=1e-5)
        assert float(direction_loss(other[None], matched, matches)) == pytest.approx(0, abs=1e-5)


def test_lines_are_compared_in_units_of_the_scale() -> None:
    wanted = torch.zeros(1, 2, 2)
    wanted[0, 1] = torch.tensor([10.0, 0.0])
    found = wanted + torch.tensor([3.0, 6.0])
    scale = torch.tensor([30.0, 60.0])
    matches, matched = match_lines(torch.zeros(1, 3), found, torch.tensor([0]), wanted, scale=scale)
    assert float(line_loss(found, matched, matches, scale=scale)) == pytest.approx(0.2)


@given(SEEDS, st.integers(1, 4))
def test_the_winner_is_the_mode_that_is_nearest_where_it_is_annotated(seed: int, agents: int) -> None:
    paths, wanted = noise(seed, agents, 6, 5, 2), noise(seed + 1, agents, 5, 2)
    valid = noise(seed + 2, agents, 5) > 0
    best = find_winning_modes(paths, wanted, valid)
    regression, entropy = trajectory_losses(paths, torch.zeros(agents, 6), wanted, valid)
    total, steps = 0.0, 0
    for agent in range(agents):
        if not valid[agent].any():
            continue
        distances = [float((path - wanted[agent]).norm(dim=-1)[valid[agent]].mean()) for path in paths[agent]]
        assert distances[int(best[agent])] == pytest.approx(min(distances), rel=1e-5)
        error = (paths[agent, int(best[agent])] - wanted[agent]).abs().sum(-1)[valid[agent]]
        total, steps = total + float(error.sum()), steps + len(error)
    assert float(regression) == pytest.approx(total / max(steps, 1), rel=1e-4)
    assert float(entropy) == pytest.approx(math.log(6) if steps else 0.0, rel=1e-5)


def test_steps_that_are_not_annotated_count_nowhere() -> None:
    plan = torch.zeros(6, 2)
    wanted = torch.full((6, 2), 100.0)
    wanted[:2] = 1.0
    valid = torch.tensor([True, True, False, False, False, False])
    assert float(plan_loss(plan, wanted, valid)) == 2.0
    assert float(plan_loss(plan, wanted, torch.zeros(6, dtype=torch.bool))) == 0.0


def test_masks_that_agree_lose_nothing() -> None:
    mask = (noise(0, 2, 8, 8) > 0).float()
    assert float(dice_loss(40 * mask - 20, mask)) == pytest.approx(0, abs=1e-4)
    assert float(dice_loss(20 - 40 * mask, mask)) > 0.9


def test_nothing_annotated_gives_zero_and_finite_gradients() -> None:
    logits, codes = noise(0, 4, 3).requires_grad_(), noise(1, 4, 10).requires_grad_()
    points, paths = noise(2, 4, 5, 2).requires_grad_(), noise(3, 0, 6, 12, 2).requires_grad_()
    none = torch.zeros(0, dtype=torch.int64)
    boxes = match_boxes(logits, codes, none, torch.zeros(0, 10), torch.ones(10))
    lines, matched = match_lines(logits, points, none, torch.zeros(0, 5, 2))
    losses = [
        box_loss(codes, torch.zeros(0, 10), boxes, torch.ones(10)),
        line_loss(points, matched, lines),
        direction_loss(points, matched, lines),
        *trajectory_losses(paths, torch.zeros(0, 6), torch.zeros(0, 12, 2), torch.zeros(0, 12, dtype=torch.bool)),
        dice_loss(torch.zeros(0, 4, requires_grad=True), torch.zeros(0, 4)),
    ]
    assert [float(loss.detach()) for loss in losses] == [0.0] * 6
    total = torch.stack([*losses, query_class_loss(logits, none, boxes)]).sum()
    total.backward()  # type: ignore[no-untyped-call]
    for each in (logits, codes, points):
        assert each.grad is not None and bool(torch.isfinite(each.grad).all())


NORTH = math.pi / 2
MIDDLE_M = EGO_CENTER_FROM_REAR_AXLE_M - LIDAR_FROM_REAR_AXLE_M
FRONT_M = MIDDLE_M + EGO_LENGTH_M / 2


def around(*cars: tuple[float, float, float], size: tuple[float, float] = (4.6, 1.9)) -> NearbyBodies:
    """Cars that stand, at x, y, yaw."""
    boxes = torch.tensor([[[x, y, *size, yaw]] * 6 for x, y, yaw in cars])
    return NearbyBodies(boxes[None], torch.ones(1, len(cars), 6, dtype=torch.bool))


def standing() -> Tensor:
    return torch.zeros(1, 1, 6, 2)


def test_room_ahead_is_wider_than_aside_and_nobody_behind_counts() -> None:
    for gap in (0.05, 0.2, ASIDE_M + 0.02, 1.0, AHEAD_M - 0.05, AHEAD_M + 0.05, 5.0):
        ahead = missing_room(standing(), around((0.0, FRONT_M + gap + 2.3, NORTH)))
        aside = missing_room(standing(), around((EGO_BODY_WIDTH_M / 2 + gap + 0.95, MIDDLE_M, NORTH)))
        for found, room_m in ((ahead, AHEAD_M), (aside, ASIDE_M)):
            torch.testing.assert_close(found[0, 0], torch.tensor(max(room_m - gap, 0.0)), atol=1e-4, rtol=0)
    assert float(missing_room(standing(), around((0.0, -4.0, NORTH)))) == 0.0


def test_the_plan_is_pushed_back_from_a_car_ahead_and_aside_from_one_beside() -> None:
    for car, axis in (((0.1, FRONT_M + 0.5 + 2.3, NORTH), 1), ((1.9, MIDDLE_M, NORTH), 0)):
        plan = standing().requires_grad_()
        missing_room(plan, around(car)).sum().backward()  # type: ignore[no-untyped-call]
        assert plan.grad is not None and bool((plan.grad[..., axis] > 0).all())


@settings(max_examples=50, deadline=None)
@given(
    x=st.floats(-6, 6),
    y=st.floats(1.0, 12),
    yaw=st.floats(-3.1, 3.1),
    speed=st.floats(1.0, 12),
    turn=st.floats(-0.3, 0.3),
)
def test_bodies_that_overlap_lack_room(x: float, y: float, yaw: float, speed: float, turn: float) -> None:
    steps = torch.arange(1, 7)
    headings = NORTH + turn * steps
    plan = torch.stack([(0.5 * speed * headings.cos()).cumsum(0), (0.5 * speed * headings.sin()).cumsum(0)], -1)
    found = missing_room(plan[None, None], around((x, y, yaw)))
    middles = plan + MIDDLE_M * torch.stack([headings.cos(), headings.sin()], -1)
    size = torch.tensor([EGO_LENGTH_M, EGO_BODY_WIDTH_M]).expand(6, 2)
    own = torch.cat([middles, size, headings[:, None]], -1).double().numpy()
    car = torch.tensor([[x, y, 4.6, 1.9, yaw]]).expand(6, 5).double().numpy()
    to_car = torch.tensor([x, y]) - middles
    along = (to_car * torch.stack([headings.cos(), headings.sin()], -1)).sum(-1)
    # Circles leave out the corners of the body by less than the room around it.
    ahead = (along > 0.0).numpy()
    if (boxes_overlap(own, car) & ahead).any():
        assert float(found) > 0.0
    far = torch.linalg.vector_norm(to_car, dim=-1) > 8.0
    if bool(far.all()):
        assert float(found) == 0.0


def test_frames_together_are_each_as_alone_and_who_is_not_known_takes_no_room() -> None:
    whole = a_frame()
    frames = [whole, empty(whole), a_frame(2), replace(whole, futures_valid=torch.zeros_like(whole.futures_valid))]
    plans = torch.stack([frame.ego_future * 2.0 for frame in frames]).requires_grad_()
    together = missing_room(plans[:, None], NearbyBodies.of(frames, 6))
    for plan, frame, found in zip(plans, frames, together[:, 0], strict=True):
        torch.testing.assert_close(room_loss(plan, frame), found)
    near, nobody, _, unknown = together.flatten().tolist()
    assert near > 0.0 and nobody == unknown == 0.0
    together[1].sum().backward()  # type: ignore[no-untyped-call]
    assert plans.grad is not None and float(plans.grad.abs().max()) == 0.0
