"""How VAD learns: its inputs, its targets, what is hidden from it, and that losses fall."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from adapters.camera_inputs import RGB_MEAN_STD
from adapters.extensions.training.dataset_mixture import build_frames
from adapters.extensions.training.dense_targets import CHANNELS, VEHICLES, dense_targets
from adapters.extensions.training.frames import rotate_can_bus
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
from adapters.extensions.training.vad.phases import RARE, build_untrained, set_first_values
from adapters.networks.layers.bev_geometry import BEVGrid
from adapters.networks.layers.ego_motion import BEVMotion
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from adapters.networks.vad.planner import VADPlanner
from adapters.networks.vad.selection import VADPredictions, select
from benchmark.datasets.nuscenes import NuScenesData
from tests.adapters.extensions.training.vad.road_frames import a_frame, clip, empty, moved
from tests.adapters.networks.vad.small_vad import SMALL, small_network
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

GRID = BEVGrid(32, 24, (-30.0, -32.0, -2.5, 30.0, 32.0, 0.5))


FAST, STEPS = 5e-3, 120
"""Learning rate at first, and steps, of learning by heart."""


def total(losses: dict[str, Tensor]) -> Tensor:
    return torch.stack(list(losses.values())).sum()


def test_training_reads_what_the_planner_reads(tmp_path: Path) -> None:
    root = tmp_path / "root"
    write_root(root, [short_scene("scene-9901", ego_speed=6.0)])
    data = NuScenesData.open(root)
    planner = VADPlanner(VAD(VADConfig.miniature()), name="vad-mini", normalisation=RGB_MEAN_STD, device="cpu")
    store = build_frames(root, "val", tmp_path / "frames")
    for observation in data.observations("scene-9901"):
        seen, learned = planner._inputs(observation), network_inputs(store.frame(observation.index))
        assert seen.images.shape == learned.images.shape == (6, 3, 128, 224)
        # Stored pixels are whole numbers.
        assert float((seen.images - learned.images).abs().max()) < 0.51 / min(RGB_MEAN_STD.std)
        assert torch.equal(seen.lidar2img, learned.lidar2img) and torch.equal(seen.can_bus, learned.can_bus)
        assert (seen.command, seen.scene_token) == (learned.command, learned.scene_token)


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
    frame = a_frame()
    free = torch.tensor([[0.0, 0.5 * step] for step in range(1, 7)])
    assert agent_constraint(free, frame) == 0 and boundary_constraint(free, frame) == 0
    assert float(direction_constraint(free, frame)) == pytest.approx(0.0, abs=1e-6)
    # The car ahead is at y 14, 16, ..., 24, a metre to the right.
    into = torch.tensor([[0.0, 14.0], [0, 16], [0, 18], [0, 20], [0, 22], [0, 24]], requires_grad=True)
    loss = agent_constraint(into, frame)
    assert float(loss.detach()) == pytest.approx(0.5 + 3.0)
    (gradient,) = torch.autograd.grad(loss, into)
    assert (gradient[:, 0] > 0).all()
    aside = torch.tensor([[5.5, 2.0 * step] for step in range(1, 7)], requires_grad=True)
    loss = boundary_constraint(aside, frame)
    assert float(loss.detach()) == pytest.approx(0.5, abs=1e-3)
    assert (torch.autograd.grad(loss, aside)[0][:, 0] > 0).all()
    slanted = torch.tensor([[0.3 * step, 0.4 * step] for step in range(1, 7)]) * 1.5
    assert float(direction_constraint(slanted, frame)) == pytest.approx(0.2 * 5 / 6, abs=1e-6)
    none = empty(frame)
    for constraint in (agent_constraint, boundary_constraint, direction_constraint):
        assert constraint(into, none) == 0


def test_perfect_predictions_have_no_loss_and_are_reported_as_annotated() -> None:
    frame, config = a_frame(aside=0.5), SMALL
    raw = predict(small_network(), network_inputs(frame), None, True)
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
    perfect = replace(
        raw,
        box_codes=codes,
        class_logits=logits,
        map_points=points,
        map_class_logits=map_logits,
        mode_offsets=offsets,
        mode_logits=torch.full_like(raw.mode_logits, -20.0).index_put(
            (torch.tensor([3, 7]), torch.tensor([4, 0])), torch.tensor(20.0)
        ),
        plan_offsets=plan,
    )
    losses = frame_losses(small_network(), perfect, frame)
    for name in ("class", "box", "forecast", "mode", "line_class", "line", "line_direction", "plan", "plan_steps"):
        assert float(losses[name].detach()) == pytest.approx(0.0, abs=2e-4), name
    outputs = select(config, perfect, 2)
    heading = torch.remainder(outputs.boxes[:2, 6] - frame.boxes[:, 6] + math.pi, 2 * math.pi) - math.pi
    assert torch.allclose(heading, torch.zeros(2), atol=1e-5)
    assert torch.allclose(outputs.boxes[:2, [0, 1, 4, 3, 7, 8]], frame.boxes[:, [0, 1, 3, 4, 7, 8]], atol=1e-5)
    assert torch.allclose(outputs.trajectories[0, 4], frame.futures[0, :6, :2], atol=1e-5)


def test_untrained_queries_are_where_things_are() -> None:
    frames = [moved(a_frame(number), seed) for number, seed in enumerate(range(60))]
    config = VADConfig.miniature()
    network = build_untrained(config, frames, 3)
    assert all(
        torch.equal(one, two) for one, two in zip(network.parameters(), build_untrained(config, frames, 3).parameters())
    )
    assert not torch.equal(
        network.pts_bbox_head.bev_embedding.weight,
        build_untrained(config, frames, 4).pts_bbox_head.bev_embedding.weight,
    )
    head, channels = network.pts_bbox_head, network.config.channels
    low = torch.tensor(network.config.perception_range_m[:2])
    size = torch.tensor(network.config.perception_range_m[3:5]) - low
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
    objective = VADObjective(small_network())
    found = []
    for seed in (1, 1, 2):
        torch.manual_seed(seed)
        found.append(objective.losses(clip()))
    assert set(found[0]) == set(WEIGHTS)
    sums = [float(total(losses).detach()) for losses in found]
    assert sums[0] == sums[1] != sums[2]


def test_what_is_learned_reaches_every_weight_but_those_that_stay() -> None:
    network = small_network(config=replace(SMALL, plan_sees_front=18, plan_knows_motion=True))
    objective = VADObjective(network)
    torch.manual_seed(0)
    total(objective.losses(clip())).backward()  # type: ignore[no-untyped-call]
    without = {name for name, weight in network.named_parameters() if weight.grad is None}
    kept = {name for name in without if name.startswith(tuple(f"img_backbone.{part}." for part in ENCODER_KEPT))}
    assert kept and without - kept == {"pts_bbox_head.code_weights", "pts_bbox_head.map_code_weights"}
    assert all(torch.isfinite(weight.grad).all() for weight in network.parameters() if weight.grad is not None)


def test_nothing_annotated_is_no_reason_to_fail() -> None:
    objective = VADObjective(small_network())
    losses = objective.losses([empty(a_frame())])
    assert torch.isfinite(total(losses)) and losses["plan"] == 0 and losses["box"] == 0
    total(losses).backward()  # type: ignore[no-untyped-call]


def test_disguises_are_as_often_as_they_say() -> None:
    torch.manual_seed(0)
    drawn = [EgoMotionAugmentation.drawn() for _ in range(400)]
    assert sum(not each.speed_known for each in drawn) / 400 == pytest.approx(WITHOUT_SPEED, abs=0.08)
    assert sum(not each.past_known for each in drawn) / 400 == pytest.approx(WITHOUT_PAST, abs=0.08)
    assert all(0 <= each.turn_rad < 2 * math.pi for each in drawn)


def test_two_clips_are_learned_by_heart() -> None:
    torch.manual_seed(0)
    config = replace(SMALL, encoder_layers=1, decoder_layers=1, channels=32, backbone_outputs=(2,), pyramid_levels=1)
    network = VAD(config)
    spread = torch.stack([torch.linspace(0.35, 0.65, 12), torch.linspace(0.5, 0.75, 12)], -1)
    set_first_values(network, spread, spread[::2][:5], torch.zeros(3, 6, 2))
    objective = VADObjective(network)
    clips = [[a_frame(0)], [a_frame(0, "b", steps_per_s=2.0, aside=0.8)]]
    optimiser = torch.optim.AdamW([each for each in network.parameters() if each.requires_grad], lr=FAST)
    first = [float(total(objective.losses(each)).detach()) for each in clips]
    for step in range(STEPS):
        optimiser.param_groups[0]["lr"] = FAST * (1 - step / STEPS)
        optimiser.zero_grad()
        total(objective.losses(clips[step % 2])).backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
    last = [float(total(objective.losses(each)).detach()) for each in clips]
    assert max(last) < min(first) / 5
    for (frame,) in clips:
        network.reset()
        with torch.inference_mode():
            outputs = network(network_inputs(frame))
        assert (outputs.plan - frame.ego_future).norm(dim=-1).max() < 0.3
        assert torch.cdist(outputs.boxes[:2, :2], frame.boxes[:, :2]).amin(0).max() < 1.0
