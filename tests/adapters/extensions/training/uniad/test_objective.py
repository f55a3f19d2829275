"""How UniAD learns: its inputs, its targets, tracks that keep their agents, and that losses fall."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
import shapely.affinity
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from adapters.extensions.training.losses import Matches
from adapters.extensions.training.uniad.losses import (
    LINE_HALF_WIDTH_M,
    AgentTargets,
    MapTargets,
    box_targets,
    detection_losses,
    ego_box,
    match_agents,
    motion_anchors,
    network_inputs,
    occupancy_targets,
    query_places,
)
from adapters.extensions.training.uniad.objective import BEV_MODULES, FALSE_FROM, FROZEN, UniADObjective
from adapters.extensions.training.uniad.phases import HeadsObjective, phases, transfer_from_vad
from adapters.networks.layers.deformable_decoder import decode_boxes
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD
from adapters.networks.uniad.occupancy import CELL_M
from adapters.networks.uniad.tracking import NO_TRACK, convert_yaws
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD, VADInputs
from tests.adapters.extensions.training.road_frames import OneScene
from tests.adapters.extensions.training.uniad.learner import LEARNER, a_frame, clip, learner, many_frames

UNUSED = (
    "seg_head.bev_embedding",
    "seg_head.reg_branches2",
    "seg_head.cls_thing_branches",
    "seg_head.cls_stuff_branches",
    "motion_head.layer_track_query_fuser",
    "occ_head.transformer_decoder.post_norm",
    "pts_bbox_head.past_traj_reg_branches",
    "things_mask_head.blocks.0.attn.linear",
    "stuff_mask_head.blocks.0.attn.linear",
    "img_backbone.layer4",
)
"""Parameters that published checkpoints hold and no prediction reads, or none of the miniature."""


def total(losses: dict[str, Tensor]) -> Tensor:
    return torch.stack(list(losses.values())).sum()


@settings(max_examples=25, deadline=None)
@given(heading=st.floats(-math.pi, math.pi), counterclockwise=st.booleans())
def test_targets_are_what_the_network_decodes(heading: float, counterclockwise: bool) -> None:
    config = replace(LEARNER, counterclockwise_yaw=counterclockwise)
    box = torch.tensor([[3.0, -4.0, -1.0, 4.5, 1.9, 1.6, heading, 2.0, 1.0]])
    found = decode_boxes(box_targets(box, config))
    torch.testing.assert_close(found[0, [0, 1, 2, 4, 3, 5, 7, 8]], box[0, [0, 1, 2, 3, 4, 5, 7, 8]])
    apart = convert_yaws(found[0, 6], config) - heading
    assert float(torch.cos(apart)) == pytest.approx(1.0, abs=1e-5)


@settings(max_examples=25, deadline=None)
@given(
    x=st.floats(-8, 8), y=st.floats(-8, 8), length=st.floats(1, 8), width=st.floats(0.6, 3), heading=st.floats(-4, 4)
)
def test_occupied_cells_are_those_whose_centre_is_in_the_box(
    x: float, y: float, length: float, width: float, heading: float
) -> None:
    whole, boxes = a_frame(), torch.tensor([[x, y, -1.0, length, width, 1.6, heading, 0.0, 0.0]])
    frame = replace(
        whole,
        boxes=boxes,
        futures=boxes[:, None, [0, 1, 6]].repeat(1, 12, 1),
        labels=whole.labels[:1],
        instances=whole.instances[:1],
        futures_valid=torch.tensor([[True, False] * 6]),
    )
    masks, valid = occupancy_targets(AgentTargets.of(frame, LEARNER), torch.tensor([0]), LEARNER)
    assert valid.tolist() == [[True, True, False, True, False]]
    upright = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    turned = shapely.affinity.rotate(upright, heading, (0, 0), use_radians=True)
    shape = shapely.affinity.translate(turned, x, y)
    axis = (np.arange(masks.shape[-1]) + 0.5) * CELL_M - LEARNER.occupancy_half_m
    points = shapely.points(*np.meshgrid(axis, axis))
    decided = shapely.distance(shape.exterior, points) > 1e-4
    assert (masks[0, 0].bool().numpy() == shapely.contains(shape, points))[decided].all()


def test_masks_of_lines_are_the_cells_near_them() -> None:
    frame = a_frame()
    bent = torch.tensor([[-12.0, -9.0], [-3.0, 2.0], [8.0, 2.5]])
    frame = replace(frame, lines=bent[None], line_labels=frame.line_labels[:1])
    road = MapTargets.of(frame, LEARNER)
    line = shapely.LineString(bent.tolist())
    for cell, centre in enumerate(LEARNER.grid.centres() * 32 - 16):
        distance_m = line.distance(shapely.Point(*centre.tolist()))
        if abs(distance_m - LINE_HALF_WIDTH_M) > 1e-4:
            assert bool(road.masks[0, cell]) == (distance_m < LINE_HALF_WIDTH_M)
    torch.testing.assert_close(road.rectangles[0], torch.tensor([14 / 32, 12.75 / 32, 20 / 32, 11.5 / 32]))
    centres = LEARNER.grid.centres() * 32 - 16
    assert torch.equal(road.drivable.bool(), centres[:, 0].abs() < 6)


def test_forecast_anchors_point_where_agents_go() -> None:
    turned = []
    for number, frame in enumerate(many_frames()):
        heading = 2 * math.pi * number / 20
        boxes, futures = frame.boxes.clone(), frame.futures.clone()
        boxes[0, 6] = heading
        ahead = torch.tensor([math.cos(heading), math.sin(heading)])
        futures[0, :, :2] = boxes[0, :2] + (0.5 + 0.1 * number) * torch.arange(1, 13)[:, None] * ahead
        turned.append(replace(frame, boxes=boxes, futures=futures))
    anchors = motion_anchors(turned, LEARNER)
    assert anchors.shape == (4, 6, 12, 2)
    assert float(anchors[0, ..., 0].abs().amax()) < 1e-3 and float(anchors[0, ..., 1].amin()) > 0.4


def test_untrained_queries_look_where_agents_are() -> None:
    network = learner()
    places = query_places(many_frames(), LEARNER)
    low, high = torch.tensor(LEARNER.perception_range_m[:3]), torch.tensor(LEARNER.perception_range_m[3:])
    seen = low + network.fresh_queries().reference_logits.detach().sigmoid() * (high - low)
    torch.testing.assert_close(seen[:-1, :2], places[:, :2], atol=0.05, rtol=0)
    assert float(seen[-1, :2].abs().amax()) < 0.05
    assert all(
        torch.equal(mine, yours)
        for mine, yours in zip(network.state_dict().values(), learner().state_dict().values(), strict=True)
    )


def test_objective_sees_what_inference_sees() -> None:
    """The first frame of a clip, with the world as it is: the same detections as the network's own."""
    network, frame = learner(), a_frame()
    objective = UniADObjective(network, "perception", 1)
    found = objective.clip_losses([frame], 0.0, True)
    network.reset()
    predictions = network.predict(network_inputs(frame))
    agents = AgentTargets.of(frame, LEARNER)
    matches = match_agents(predictions.detections, agents, torch.zeros(0, dtype=torch.int64), LEARNER.queries)
    wanted = detection_losses(
        predictions.detections, agents, matches, box_targets(ego_box(frame), LEARNER), LEARNER.queries
    )
    for name, loss in wanted.items():
        torch.testing.assert_close(found[name], loss, rtol=1e-3, atol=1e-4)


def test_tracks_keep_their_agents_and_lose_those_that_go() -> None:
    network, frame = learner(), a_frame()
    agents = AgentTargets.of(frame, LEARNER)
    queries = network.fresh_queries()
    carried = torch.tensor([99, 7])
    tracks = replace(queries.kept(torch.tensor([0, 1])), track_ids=carried)
    entering = queries.then(tracks)
    bev = torch.zeros(LEARNER.grid.cells, LEARNER.channels)
    detections = network.pts_bbox_head.detect(bev, entering.queries, entering.reference_logits)
    matches = match_agents(detections, agents, carried, LEARNER.queries)
    pairs = dict(zip(matches.queries.tolist(), agents.instances[matches.wanted].tolist(), strict=True))
    assert pairs.pop(LEARNER.queries + 2) == 7
    assert list(pairs.values()) == [3] and all(query < LEARNER.queries for query in pairs)


def test_false_tracks_are_the_most_certain_that_stand_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adapters.extensions.training.uniad.objective.TRACK_DROPOUT", 0.0)
    monkeypatch.setattr("adapters.extensions.training.uniad.objective.MOST_FALSE", 2)
    network = learner()
    objective = UniADObjective(network, clip_frames=2)
    instances, own = network.fresh_queries(), LEARNER.queries
    scores = torch.linspace(0.1, 0.9, own + 1)
    matches = Matches(torch.tensor([own - 1, 2]), torch.tensor([0, 1]))
    handed_on = objective._next_queries(replace(instances, scores=scores), matches)
    tracks = handed_on.kept(slice(own + 1, None))
    assert torch.equal(tracks.scores, scores[[own - 1, 2, own - 2, own - 3]])
    # Who is hardly certain would not be a track when the network runs.
    faint = objective._next_queries(replace(instances, scores=scores * FALSE_FROM / 0.75), matches)
    assert len(faint.scores) == own + 1 + 2 + 1
    # In the next frame nobody is theirs: they learn that nothing is there.
    carried = torch.tensor([3, 7, NO_TRACK, NO_TRACK])
    entering = instances.then(replace(tracks, track_ids=carried))
    bev = torch.zeros(LEARNER.grid.cells, LEARNER.channels)
    detections = network.pts_bbox_head.detect(bev, entering.queries, entering.reference_logits)
    found = match_agents(detections, AgentTargets.of(a_frame(), LEARNER), carried, own)
    assert sorted(found.queries.tolist()) == [own + 1, own + 2]


def test_what_vad_sees_uniad_sees() -> None:
    torch.manual_seed(2)
    vad = VAD(VADConfig.miniature())
    network = UniAD(UniADConfig.miniature(), torch.randn(4, 6, 12, 2), solver=None)
    left = network.load_state_dict(transfer_from_vad(vad.state_dict()), strict=False)
    # Nothing reads the last stage of the image network, which VAD's does without.
    missing = [name for name in left.missing_keys if not name.startswith("img_backbone.layer4.")]
    assert not left.unexpected_keys
    assert not any(name.startswith(("img_", "pts_bbox_head.transformer.encoder")) for name in missing)
    assert transfer_from_vad(network.state_dict()).keys() == network.state_dict().keys(), "its own weights stay its own"
    inputs = network_inputs(replace(a_frame(), images=torch.randint(0, 256, (6, 3, 128, 224), dtype=torch.uint8)))
    with torch.inference_mode():
        seen = vad.predict(VADInputs(inputs.images, inputs.lidar2img, inputs.can_bus, 2, "a"))
        assert torch.equal(network.predict(inputs).bev, seen.bev)
        queries = network.fresh_queries()
        agents = queries.kept(slice(0, -1))
        found = network.pts_bbox_head.detect(seen.bev, agents.queries, agents.reference_logits)
        assert float((queries.reference_logits[-1, :2].sigmoid() - 0.5).abs().amax()) < 1e-3
    torch.testing.assert_close(found.class_logits, seen.class_logits)
    signs = torch.ones(10).index_fill(0, torch.tensor([6]), -1.0)
    torch.testing.assert_close(found.box_codes, seen.box_codes * signs, rtol=1e-4, atol=1e-4)


def test_the_heads_learn_first_from_the_views_of_the_network_when_it_runs() -> None:
    network, frames = learner(), clip(3)
    heads, clips, _ = phases()
    objective = heads.objective(network)
    assert isinstance(objective, HeadsObjective)
    store, _ = objective.look(OneScene(frames), range(3))
    seen = list(objective._encode_frames([network_inputs(frame) for frame in frames], aware=True))
    network.reset()
    for frame, view in zip(frames, seen, strict=True):
        with torch.inference_mode():
            torch.testing.assert_close(view.bev, network.predict(network_inputs(frame)).bev, rtol=2e-3, atol=2e-3)
    total(objective.losses(store.clip(2, 3))).backward()  # type: ignore[no-untyped-call]
    learned = {name for name, parameter in network.named_parameters() if parameter.grad is not None}
    assert learned and not any(name.startswith(BEV_MODULES) for name in learned)
    clips.objective(network)
    assert network.pts_bbox_head.bev_embedding.weight.requires_grad
    assert not any(network.get_submodule(name).weight.requires_grad for name in FROZEN[:1])


def test_every_parameter_that_is_read_learns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adapters.extensions.training.uniad.objective.OCCUPANCY_SHARE", 1.0)
    objective = UniADObjective(learner(), clip_frames=3)
    for aware in (True, False):
        total(objective.clip_losses(clip(3), 0.0, aware)).backward()  # type: ignore[no-untyped-call]
    for name, parameter in objective.network.named_parameters():
        if name.startswith(FROZEN):
            assert parameter.grad is None, name
        elif parameter.requires_grad and not any(unused in name for unused in UNUSED):
            assert parameter.grad is not None, name


def test_a_network_that_is_not_told_its_speed_cannot_know_it() -> None:
    objective = UniADObjective(learner(), clip_frames=1)
    fast, slow = a_frame(), replace(a_frame(), can_bus=torch.zeros(18, dtype=torch.float64))
    for aware in (True, False):
        losses = []
        for frame in (fast, slow):
            torch.manual_seed(0)
            losses.append(float(total(objective.clip_losses([frame], 0.3, aware)).detach()))
        assert (losses[0] == losses[1]) is not aware


def test_only_the_occupancy_learns_what_it_normalises(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adapters.extensions.training.uniad.objective.OCCUPANCY_SHARE", 1.0)
    objective = UniADObjective(learner())
    objective.network.train()
    before = {name: value.clone() for name, value in objective.network.named_buffers() if "running_" in name}
    objective.losses(clip())
    state = objective.network.state_dict()
    changed = {name for name, value in before.items() if not torch.equal(value, state[name])}
    assert changed == {name for name in before if name.startswith("occ_head.")} != set()
    assert not objective.network.motion_head.training
