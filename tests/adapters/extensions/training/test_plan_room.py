"""The room that plans leave: nothing of it is missing where bodies are apart; what is missing pushes the right way."""

import math
from dataclasses import replace

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from adapters.extensions.training.plan_room import AHEAD_M, ASIDE_M, NearbyBodies, missing_room, room_loss
from benchmark.constants import (
    EGO_BODY_WIDTH_M,
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_LENGTH_M,
    LIDAR_FROM_REAR_AXLE_M,
)
from benchmark.geometry import boxes_overlap
from tests.adapters.extensions.training.road_frames import empty
from tests.adapters.extensions.training.uniad.learner import a_frame

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
