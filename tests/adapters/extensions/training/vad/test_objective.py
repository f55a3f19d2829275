"""How VAD learns: its inputs, its targets, what is hidden from it, and that losses fall."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from adapters.extensions.training.dense_targets import CHANNELS, VEHICLES, dense_targets
from adapters.extensions.training.frames import TrainingFrame, rotate_can_bus
from adapters.extensions.training.losses import normalise_boxes
from adapters.extensions.training.plan_room import agent_constraint, boundary_constraint, direction_constraint
from adapters.extensions.training.vad.objective import (
    ENCODER_KEPT,
    WEIGHTS,
    WITHOUT_PAST,
    WITHOUT_SPEED,
    EgoMotionAugmentation,
    VADObjective,
    frame_losses,
    network_inputs,
    predict,
)
from adapters.extensions.training.vad.phases import RARE, add_finer_map, build_untrained
from adapters.networks.layers.bev_geometry import BEVGrid
from adapters.networks.layers.deformable_attention import SamplingPattern
from adapters.networks.layers.ego_motion import BEVMotion
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from adapters.networks.vad.selection import VADPredictions, select
from tests.adapters.extensions.training.road_frames import a_frame, clip, empty
from tests.adapters.networks.vad.small_vad import SMALL, small_network

GRID = BEVGrid(32, 24, (-30.0, -32.0, -2.5, 30.0, 32.0, 0.5))


def total(losses: dict[str, Tensor]) -> Tensor:
    return torch.stack(list(losses.values())).sum()


def test_training_computes_what_the_planner_computes() -> None:
    network, previous = VAD(replace(SMALL, plan_sees_front=18, plan_knows_motion=True)).requires_grad_(False), None
    for frame in clip():
        inputs = network_inputs(frame)
        with torch.no_grad():
            expected, found = network.predict(inputs), predict(network, inputs, previous, True)
        for name in VADPredictions.__slots__:
            if name != "front":
                assert torch.equal(getattr(expected, name), getattr(found, name)), name
        assert expected.front is not None and found.front is not None
        assert torch.equal(expected.front, found.front)
        previous = inputs.can_bus, found.bev


def test_a_network_that_is_not_told_cannot_know_the_speed() -> None:
    network = small_network()
    past = torch.randn(SMALL.grid.cells, SMALL.channels)
    fast = a_frame(1)
    quicker = replace(fast, can_bus=fast.can_bus + torch.tensor([0.0] * 7 + [3.0] * 9 + [0.0] * 2))
    with torch.no_grad():
        plans = [
            predict(network, network_inputs(frame), (a_frame(0).can_bus, past), known).plan_offsets
            for known in (False, True)
            for frame in (fast, quicker)
        ]
    assert torch.equal(plans[0], plans[1]) and not torch.equal(plans[2], plans[3])


@settings(max_examples=25, deadline=None)
@given(st.floats(0, 2 * math.pi), st.floats(0, 2 * math.pi), st.floats(-12, 12), st.floats(-12, 12), st.floats(-40, 40))
def test_a_turned_world_has_the_same_motion(turn: float, heading: float, dx: float, dy: float, yaw_deg: float) -> None:
    def can_bus(x: float, y: float, heading_rad: float) -> Tensor:
        vector = torch.zeros(18, dtype=torch.float64)
        vector[0], vector[1] = x, y
        vector[16] = heading_rad % (2 * math.pi)
        vector[17] = math.degrees(float(vector[16]))
        return vector

    before, after = can_bus(300, 900, heading), can_bus(300 + dx, 900 + dy, heading + math.radians(yaw_deg))
    plain = BEVMotion.between(before, after, GRID, (12.0, 16.0))
    turned = BEVMotion.between(rotate_can_bus(before, turn), rotate_can_bus(after, turn), GRID, (12.0, 16.0))
    assert torch.allclose(plain.shift, turned.shift, atol=1e-5)
    assert torch.allclose(plain.previous_cells, turned.previous_cells, atol=1e-4)


def test_targets_of_the_ground_lie_where_things_are() -> None:
    targets, known = dense_targets(a_frame(aside=1.0), GRID)
    assert targets.shape == known.shape == (GRID.cells, CHANNELS)
    view = targets.view(GRID.rows, GRID.columns, CHANNELS)
    for row, column in np.ndindex(GRID.rows, GRID.columns):
        x, y = -30 + (column + 0.5) * 2.5, -32 + (row + 0.5) * 2.0
        drivable, divider, crossing, boundary, vehicle, other = view[row, column].tolist()
        assert drivable == (abs(x) < 6.0)
        assert divider == (abs(x - 0.5) <= 1.25 and abs(y) <= 31) and not crossing
        assert boundary == (min(abs(x - 6), abs(x + 6)) <= 1.25 and abs(y) <= 31)
        assert vehicle == (abs(x - 2.0) <= 0.95 + 1.25 and abs(y - 12) <= 2.25 + 1.25)
        if math.hypot(x + 5, y - 8) > 2.6:
            assert not other
    assert view[..., 5].sum() >= 1 and 0 in VEHICLES
    inside = known.view(GRID.rows, GRID.columns, CHANNELS)
    assert inside[:, :, 0].all() and not inside[:, 0, 1:4].any() and inside[16, 12].all()


def test_constraints_are_metres_too_near() -> None:
    frame, steps = a_frame(), torch.arange(1.0, 7)
    free = torch.stack([0 * steps, 0.5 * steps], -1)
    assert agent_constraint(free, frame) == 0 and boundary_constraint(free, frame) == 0
    assert float(direction_constraint(free, frame)) == pytest.approx(0.0, abs=1e-6)
    # The car ahead is at y 14, 16, ..., 24, a metre to the right; the boundary is at 6 m.
    into, aside = torch.stack([0 * steps, 12 + 2 * steps], -1), torch.stack([5.5 + 0 * steps, 2 * steps], -1)
    for plan, constraint, wanted in ((into, agent_constraint, 0.5 + 3.0), (aside, boundary_constraint, 0.5)):
        plan.requires_grad_()
        loss = constraint(plan, frame)
        assert float(loss.detach()) == pytest.approx(wanted, abs=1e-3)
        assert (torch.autograd.grad(loss, plan)[0][:, 0] > 0).all()
    slanted = torch.stack([0.45 * steps, 0.6 * steps], -1)
    assert float(direction_constraint(slanted, frame)) == pytest.approx(0.2 * 5 / 6, abs=1e-6)
    for constraint in (agent_constraint, boundary_constraint, direction_constraint):
        assert constraint(into, empty(frame)) == 0


def test_perfect_predictions_have_no_loss_and_are_reported_as_annotated() -> None:
    frame, config, network = a_frame(aside=0.5), SMALL, small_network()
    raw = predict(network, network_inputs(frame), None, True)
    codes, logits = raw.box_codes.detach().clone(), torch.full_like(raw.class_logits, -12.0)
    boxes = torch.cat([frame.boxes[:, :6], -frame.boxes[:, 6:7] - math.pi / 2, frame.boxes[:, 7:]], 1)
    codes[:, [3, 7]] = normalise_boxes(boxes)
    logits[:, 3, 0], logits[:, 7, 8] = 12.0, 12.0
    low, high = torch.tensor(config.perception_range_m[:2]), torch.tensor(config.perception_range_m[3:5])
    points, map_logits = raw.map_points.detach().clone(), torch.full_like(raw.map_class_logits, -12.0)
    lines = torch.stack([torch.stack([torch.full((4,), x), torch.linspace(30, -30, 4)], -1) for x in (-6.0, 0.5, 6.0)])
    points[:, :3] = (lines - low) / (high - low)
    for line, kind in enumerate((2, 0, 2)):
        map_logits[:, line, kind] = 12.0
    offsets, plan = torch.zeros_like(raw.mode_offsets), raw.plan_offsets.detach().clone()
    offsets[3, 4, :, 1] = 2.0
    plan[2] = torch.diff(frame.ego_future, dim=0, prepend=torch.zeros(1, 2))
    modes = torch.full_like(raw.mode_logits, -20.0)
    modes[3, 4], modes[7, 0] = 20.0, 20.0
    perfect = replace(
        raw,
        box_codes=codes,
        class_logits=logits,
        map_points=points,
        map_class_logits=map_logits,
        mode_offsets=offsets,
        mode_logits=modes,
        plan_offsets=plan,
    )
    losses = frame_losses(network, perfect, frame)
    for name in ("class", "box", "forecast", "mode", "line_class", "line", "line_direction", "plan", "plan_steps"):
        assert float(losses[name].detach()) == pytest.approx(0.0, abs=2e-4), name
    outputs = select(config, perfect, 2)
    heading = torch.remainder(outputs.boxes[:2, 6] - frame.boxes[:, 6] + math.pi, 2 * math.pi) - math.pi
    assert torch.allclose(heading, torch.zeros(2), atol=1e-5)
    assert torch.allclose(outputs.boxes[:2, [0, 1, 4, 3, 7, 8]], frame.boxes[:, [0, 1, 3, 4, 7, 8]], atol=1e-5)
    assert torch.allclose(outputs.trajectories[0, 4], frame.futures[0, :6, :2], atol=1e-5)


def moved(frame: TrainingFrame, seed: int) -> TrainingFrame:
    """The same with everything elsewhere."""
    by = 16.0 * torch.rand(2, generator=torch.Generator().manual_seed(seed)) - 8.0
    boxes = frame.boxes.clone()
    boxes[:, :2] += by
    return replace(frame, boxes=boxes, lines=frame.lines + by)


def test_untrained_queries_are_where_things_are() -> None:
    frames, config = [moved(a_frame(number), number) for number in range(60)], VADConfig.miniature()
    network, again, other = (build_untrained(config, frames, seed) for seed in (3, 3, 4))
    assert all(torch.equal(*pair) for pair in zip(network.parameters(), again.parameters(), strict=True))
    head, channels = network.pts_bbox_head, config.channels
    assert not torch.equal(head.bev_embedding.weight, other.pts_bbox_head.bev_embedding.weight)
    low = torch.tensor(config.perception_range_m[:2])
    size = torch.tensor(config.perception_range_m[3:5]) - low
    with torch.no_grad():
        shares = head.transformer.reference_points(head.query_embedding.weight[:, :channels]).sigmoid()
        points = (head.map_instance_embedding.weight[:, None] + head.map_pts_embedding.weight)[..., :channels]
        lines = head.transformer.map_reference_points(points).sigmoid()
        found = network.predict(replace(network_inputs(a_frame()), can_bus=torch.zeros(18, dtype=torch.float64)))
    places = torch.cat([frame.boxes[:, :2] for frame in frames])
    assert torch.cdist(low + shares[:, :2] * size, places).amin(1).max() < 4.0
    middles = torch.cat([frame.lines.mean(1) for frame in frames])
    assert torch.cdist(low + lines.mean(1) * size, middles).amin(1).max() < 4.0
    assert (lines[:, 1:, 1] > lines[:, :-1, 1]).all() and torch.allclose(lines[:, 0, 0], lines[:, -1, 0], atol=1e-4)
    assert float(found.class_logits.sigmoid().mean()) == pytest.approx(RARE, abs=0.03)


def test_losses_depend_on_the_seed_alone_and_every_weight_has_one() -> None:
    objective, found = VADObjective(small_network()), []
    for seed in (1, 1, 2):
        torch.manual_seed(seed)
        found.append(objective.losses(clip()))
    sums = [float(total(losses).detach()) for losses in found]
    assert set(found[0]) == set(WEIGHTS) and sums[0] == sums[1] != sums[2]
    # The speed and the past are hidden as often as they should be.
    drawn = [EgoMotionAugmentation.drawn() for _ in range(400)]
    assert sum(not each.speed_known for each in drawn) / 400 == pytest.approx(WITHOUT_SPEED, abs=0.08)
    assert sum(not each.past_known for each in drawn) / 400 == pytest.approx(WITHOUT_PAST, abs=0.08)


def test_what_is_learned_reaches_every_weight_but_those_that_stay() -> None:
    network = small_network(config=replace(SMALL, plan_sees_front=18, plan_knows_motion=True))
    objective = VADObjective(network)
    torch.manual_seed(0)
    total(objective.losses(clip())).backward()  # type: ignore[no-untyped-call]
    without = {name for name, weight in network.named_parameters() if weight.grad is None}
    kept = {name for name in without if name.startswith(tuple(f"img_backbone.{part}." for part in ENCODER_KEPT))}
    assert kept and without - kept == {"pts_bbox_head.code_weights", "pts_bbox_head.map_code_weights"}
    assert all(torch.isfinite(weight.grad).all() for weight in network.parameters() if weight.grad is not None)


# --- weights of a miniature with one feature map of an image, for one with two

ONE_MAP = replace(VADConfig.miniature(), backbone_outputs=(2,), pyramid_levels=1)


@pytest.fixture(scope="module")
def old() -> VAD:
    torch.manual_seed(0)
    network = VAD(ONE_MAP)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return network


@pytest.fixture(scope="module")
def new(old: VAD) -> VAD:
    network = VAD(VADConfig.miniature())
    network.load_state_dict(add_finer_map(old.state_dict()))
    return network


def test_the_coarse_map_stays_and_the_finer_one_is_made_of_it(old: VAD, new: VAD) -> None:
    images = torch.randn(6, 3, 128, 224)
    with torch.no_grad():
        before = old.img_neck(old.img_backbone(images))[0]
        finer, coarse = new.img_neck(new.img_backbone(images))
        lateral = old.img_neck.lateral_convs[0](old.img_backbone(images)[0])
        spread = old.img_neck.fpn_convs[0](F.interpolate(lateral, size=finer.shape[-2:], mode="nearest"))
    assert torch.equal(coarse, before)
    torch.testing.assert_close(finer, spread)
    # What has two maps or none stays.
    state, eyes = new.state_dict(), {"img_backbone.conv1.weight": torch.ones(3)}
    again = add_finer_map(state)
    assert again.keys() == state.keys() and all(torch.equal(again[name], value) for name, value in state.items())
    assert add_finer_map(eyes) == eyes


def test_cells_look_at_the_same_places_of_both_maps_and_at_each_with_half_the_weight(old: VAD, new: VAD) -> None:
    cells, seen = torch.randn(7, 64), []
    for network in (old, new):
        (pattern,) = [
            module
            for name, module in network.named_modules()
            if isinstance(module, SamplingPattern) and name.endswith("attentions.1.deformable_attention")
        ]
        with torch.no_grad():
            seen.append((pattern.offsets(cells), pattern.weights(cells)))
    (offsets, weights), (offsets_of_two, weights_of_two) = seen
    torch.testing.assert_close(offsets_of_two, torch.cat([2 * offsets, offsets], 2))
    torch.testing.assert_close(weights_of_two, torch.cat([weights, weights], 2) / 2)
