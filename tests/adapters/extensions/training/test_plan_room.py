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
from tests.adapters.extensions.training.uniad.objectives import a_frame, without_annotations

NORTH = math.pi / 2
MIDDLE_M = EGO_CENTER_FROM_REAR_AXLE_M - LIDAR_FROM_REAR_AXLE_M
FRONT_M = MIDDLE_M + EGO_LENGTH_M / 2


def around(*cars: tuple[float, float, float], size: tuple[float, float] = (4.6, 1.9)) -> NearbyBodies:
    """Cars that stand, at x, y, yaw."""
    boxes = torch.tensor([[[x, y, *size, yaw]] * 6 for x, y, yaw in cars])
    return NearbyBodies(boxes[None], torch.ones(1, len(cars), 6, dtype=torch.bool))


def standing(*, learns: bool = False) -> Tensor:
    return torch.zeros(1, 1, 6, 2).requires_grad_(learns)


def test_room_ahead_ends_at_the_bumper() -> None:
    for gap in (0.2, 1.0, AHEAD_M - 0.05, AHEAD_M + 0.05, 5.0):
        found = missing_room(standing(), around((0.0, FRONT_M + gap + 2.3, NORTH)))
        torch.testing.assert_close(found[0, 0], torch.tensor(max(AHEAD_M - gap, 0.0)), atol=1e-4, rtol=0)


def test_room_aside_is_narrower_than_a_lane() -> None:
    for gap in (0.05, ASIDE_M + 0.02, 1.0):
        car = (EGO_BODY_WIDTH_M / 2 + gap + 0.95, MIDDLE_M, NORTH)
        torch.testing.assert_close(
            missing_room(standing(), around(car))[0, 0], torch.tensor(max(ASIDE_M - gap, 0.0)), atol=1e-4, rtol=0
        )


def test_whoever_comes_from_behind_keeps_the_distance() -> None:
    assert float(missing_room(standing(), around((0.0, -4.0, NORTH)))) == 0.0


def test_the_plan_is_pushed_back_from_a_car_ahead_and_aside_from_one_beside() -> None:
    plan = standing(learns=True)
    missing_room(plan, around((0.1, FRONT_M + 0.5 + 2.3, NORTH))).sum().backward()  # type: ignore[no-untyped-call]
    assert plan.grad is not None and bool((plan.grad[..., 1] > 0).all())
    plan = standing(learns=True)
    missing_room(plan, around((1.9, MIDDLE_M, NORTH))).sum().backward()  # type: ignore[no-untyped-call]
    assert plan.grad is not None and bool((plan.grad[..., 0] > 0).all())


@settings(max_examples=100, deadline=None)
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


def test_frames_together_are_each_as_alone() -> None:
    frames = [a_frame(0), without_annotations(a_frame(1)), a_frame(2)]
    plans = torch.stack([frame.ego_future * 2.0 for frame in frames])
    together = missing_room(plans[:, None], NearbyBodies.of(frames, 6))
    for plan, frame, found in zip(plans, frames, together[:, 0], strict=True):
        torch.testing.assert_close(room_loss(plan, frame), found)
    assert float(together[0]) > 0.0 and float(together[1]) == 0.0


def test_nobody_known_is_nobody_there() -> None:
    frame = a_frame()
    unknown = replace(frame, futures_valid=torch.zeros_like(frame.futures_valid))
    assert float(room_loss(frame.ego_future * 2.0, unknown)) == 0.0
    plan = frame.ego_future.clone().requires_grad_()
    room_loss(plan, without_annotations(frame)).backward()  # type: ignore[no-untyped-call]
    assert plan.grad is not None and float(plan.grad.abs().max()) == 0.0
