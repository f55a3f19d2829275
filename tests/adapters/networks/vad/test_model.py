"""VAD: what it remembers and forgets, what it reports, and in which precision."""

import math
from dataclasses import fields, replace

import pytest
import torch

from adapters.networks.layers.bev_geometry import BEVGrid
from adapters.networks.layers.deformable_decoder import are_within
from adapters.networks.layers.ego_motion import BEVMotion
from adapters.networks.vad.model import VAD, VADInputs
from adapters.networks.vad.selection import VADOutputs, select_boxes, select_lines
from benchmark.errors import InputError
from tests.adapters.networks.vad.small_vad import SMALL, small_frame, small_network

GRID = BEVGrid(100, 100, (-15.0, -30.0, -2.0, 15.0, 30.0, 2.0))


def run(network: VAD, *frames: VADInputs) -> list[VADOutputs]:
    with torch.inference_mode():
        return [network(frame) for frame in frames]


def same(one: VADOutputs, other: VADOutputs) -> bool:
    return all(torch.equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(VADOutputs))


def test_state_is_carried_and_forgotten() -> None:
    network = small_network()
    first, second = run(network, small_frame(0), small_frame(1))
    network.reset()
    # What it remembers is not what the caller holds.
    given = small_frame(0)
    again = run(network, given)[0]
    given.can_bus.fill_(math.nan)
    given.images.fill_(math.nan)
    assert same(first, again) and same(second, run(network, small_frame(1))[0])
    network.reset()
    fresh = run(network, small_frame(1))[0]
    assert not torch.equal(fresh.plan, second.plan)
    other_scene = run(network, small_frame(0), small_frame(1, scene="b"))[1]
    assert same(other_scene, fresh)
    assert same(run(small_network(), small_frame(1))[0], fresh)


def test_every_input_counts() -> None:
    network = small_network()

    def plan(frame: VADInputs) -> torch.Tensor:
        network.reset()
        return run(network, frame)[0].plan_modes

    frame = small_frame(0)
    base = plan(frame)
    assert not torch.equal(plan(replace(frame, images=frame.images + 1)), base)
    assert not torch.equal(plan(replace(frame, lidar2img=frame.lidar2img.roll(1, 0))), base)
    moved = frame.can_bus.clone()
    moved[13] += 1.0
    assert not torch.equal(plan(replace(frame, can_bus=moved)), base)
    away = frame.can_bus.clone()
    away[:3] += 100.0
    assert torch.equal(plan(replace(frame, can_bus=away)), base), "where in the world a scene starts is unknown to it"


def test_cameras_that_see_nothing_and_broken_ones() -> None:
    network = small_network()
    frame = small_frame(0)
    blind = run(network, replace(frame, lidar2img=torch.zeros_like(frame.lidar2img)))[0]
    assert blind.plan_modes.isfinite().all()
    broken = frame.lidar2img.clone()
    broken[2, 0, 0] = math.nan
    nowhere = frame.can_bus.clone()
    nowhere[1] = math.inf
    for bad in (replace(frame, lidar2img=broken), replace(frame, can_bus=nowhere)):
        with pytest.raises(InputError, match="scene a contain NaN or infinity"):
            run(network, bad)


def test_reports_are_in_metres_and_in_order() -> None:
    network = small_network()
    with torch.inference_mode():
        predictions = network.predict(small_frame(0))
        network.reset()
        outputs = network(small_frame(0))
        raw, lines = select_boxes(SMALL, predictions), select_lines(SMALL, predictions)
    count = len(outputs.boxes)
    assert 0 < count <= SMALL.max_boxes and outputs.boxes.shape == (count, 9)
    assert outputs.trajectories.shape == (count, 6, 6, 2)
    torch.testing.assert_close(outputs.trajectory_scores.sum(-1), torch.ones(count))
    assert (outputs.box_scores.diff() <= 0).all() and (outputs.map_scores.diff() <= 0).all()
    assert are_within(outputs.boxes[:, :2], (-20, -35), (20, 35)).all()
    assert outputs.map_points.shape == (len(outputs.map_labels), 4, 2)
    assert are_within(outputs.map_points, (-20, -35), (20, 35)).all()
    torch.testing.assert_close(lines.points.amin(1), lines.corners[:, :2])
    torch.testing.assert_close(lines.points.amax(1), lines.corners[:, 2:])
    # Headings point where the published yaw does: (-sin, -cos) of it in x, y.
    heading, yaw = outputs.boxes[:, 6], raw.boxes[:, 6]
    torch.testing.assert_close(heading.cos(), -yaw.sin(), rtol=0, atol=1e-5)
    torch.testing.assert_close(heading.sin(), -yaw.cos(), rtol=0, atol=1e-5)
    assert (heading.abs() <= math.pi + 1e-6).all()
    step = predictions.mode_offsets[raw.agents]
    torch.testing.assert_close(outputs.trajectories[:, :, 0], outputs.boxes[:, None, :2] + step[:, :, 0])
    torch.testing.assert_close(outputs.trajectories.diff(dim=2), step[:, :, 1:], rtol=0, atol=1e-5)
    codes = predictions.box_codes[-1, raw.agents]
    torch.testing.assert_close(outputs.boxes[:, 2] + outputs.boxes[:, 5] / 2, codes[:, 4], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("yaw_deg", [0.0, 35.0, 120.0, 300.0])
def test_a_step_ahead_shifts_the_view_ahead(yaw_deg: float) -> None:
    """The lidar's y axis points where the ego looks; its yaw is that of the world's x axis."""
    before, now = torch.zeros(18, dtype=torch.float64), torch.zeros(18, dtype=torch.float64)
    yaw = math.radians(yaw_deg)
    before[16], before[17] = yaw, yaw_deg
    now[16], now[17] = yaw, yaw_deg
    now[:2] = 6.0 * torch.tensor([math.cos(yaw), math.sin(yaw)])
    motion = BEVMotion.between(before, now, GRID, (100.0, 100.0))
    torch.testing.assert_close(motion.shift, torch.tensor([0.0, 0.1]), rtol=0, atol=1e-6)
    torch.testing.assert_close(motion.previous_cells, torch.tensor([[1.0, 0, 0], [0, 1.0, 0]]))
    assert motion.can_bus[16] == yaw and motion.can_bus[17] == 0
    first = BEVMotion.between(None, now, GRID, (100.0, 100.0))
    assert not first.shift.any() and not first.can_bus[:3].any() and first.can_bus[16] == yaw


def test_gradients_reach_every_part() -> None:
    network = small_network()
    predictions = network.predict(small_frame(0))
    predictions = (predictions, network.predict(small_frame(1)))[1]
    total = predictions.plan_offsets.sum() + predictions.box_codes.sum() + predictions.class_logits.square().sum()
    total = total + predictions.mode_offsets.sum() + predictions.mode_logits.sum() + predictions.map_points.sum()
    total = total + predictions.map_class_logits.square().sum()
    trained = {name: parameter for name, parameter in network.named_parameters() if parameter.requires_grad}
    gradients = torch.autograd.grad(total, list(trained.values()), allow_unused=True)
    assert [name for name, gradient in zip(trained, gradients, strict=True) if gradient is None] == []
