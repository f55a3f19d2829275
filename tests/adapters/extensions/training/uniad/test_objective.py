"""How UniAD learns: its inputs, its targets, tracks that keep their agents, and that losses fall."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import shapely.affinity
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn

from adapters.camera_inputs import RGB_MEAN_STD
from adapters.extensions.training.dataset_mixture import build_frames
from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.losses import Matches
from adapters.extensions.training.uniad.losses import (
    LINE_HALF_WIDTH_M,
    AgentTargets,
    MapTargets,
    box_targets,
    detection_losses,
    ego_box,
    mask_loss,
    match_agents,
    motion_anchors,
    network_inputs,
    occupancy_targets,
    query_places,
)
from adapters.extensions.training.uniad.objective import BEV_MODULES, FALSE_FROM, FROZEN, UniADObjective
from adapters.extensions.training.uniad.phases import HeadsObjective, build_untrained, phases, transfer_from_vad
from adapters.networks.layers.deformable_decoder import decode_boxes
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD
from adapters.networks.uniad.occupancy import CELL_M
from adapters.networks.uniad.planner import UniADPlanner
from adapters.networks.uniad.tracking import NO_TRACK, convert_yaws
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD, VADInputs
from benchmark.datasets.nuscenes import NuScenesData
from tests.adapters.extensions.training.one_scene import OneScene
from tests.adapters.extensions.training.uniad.objectives import LEARNER, a_frame, many_frames, without_annotations
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

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


STEPS = 120


def learner(seed: int = 0) -> UniAD:
    return build_untrained(LEARNER, many_frames(), seed)


def clip(count: int = 2, scene: str = "a") -> list[TrainingFrame]:
    return [a_frame(number, scene) for number in range(count)]


def total(losses: dict[str, Tensor]) -> Tensor:
    return torch.stack(list(losses.values())).sum()


def test_training_reads_what_the_planner_reads(tmp_path: Path) -> None:
    root = tmp_path / "root"
    write_root(root, [short_scene("scene-9901", ego_speed=6.0)])
    data = NuScenesData.open(root)
    network = UniAD(UniADConfig.miniature(), solver=None)
    planner = UniADPlanner(network, name="uniad-mini", normalisation=RGB_MEAN_STD, device="cpu")
    store = build_frames(root, "val", tmp_path / "frames")
    for observation in data.observations("scene-9901"):
        seen, learned = planner.inputs(observation), network_inputs(store.frame(observation.index))
        assert seen.images.shape == learned.images.shape == (6, 3, 128, 224)
        # Training images are rounded to whole grey levels.
        assert float((seen.images - learned.images).abs().amax()) < 0.51 / min(RGB_MEAN_STD.std)
        for name in ("lidar2img", "can_bus", "l2g_r_mat", "l2g_t"):
            torch.testing.assert_close(getattr(seen, name), getattr(learned, name))
        assert (seen.command, seen.scene_token) == (learned.command, learned.scene_token)
        assert seen.timestamp == pytest.approx(learned.timestamp)


@given(heading=st.floats(-math.pi, math.pi), counterclockwise=st.booleans())
def test_targets_are_what_the_network_decodes(heading: float, counterclockwise: bool) -> None:
    config = replace(LEARNER, counterclockwise_yaw=counterclockwise)
    box = torch.tensor([[3.0, -4.0, -1.0, 4.5, 1.9, 1.6, heading, 2.0, 1.0]])
    found = decode_boxes(box_targets(box, config))
    torch.testing.assert_close(found[0, [0, 1, 2, 4, 3, 5, 7, 8]], box[0, [0, 1, 2, 3, 4, 5, 7, 8]])
    apart = convert_yaws(found[0, 6], config) - heading
    assert float(torch.cos(apart)) == pytest.approx(1.0, abs=1e-5)


@given(
    x=st.floats(-8, 8), y=st.floats(-8, 8), length=st.floats(1, 8), width=st.floats(0.6, 3), heading=st.floats(-4, 4)
)
def test_occupied_cells_are_those_whose_centre_is_in_the_box(
    x: float, y: float, length: float, width: float, heading: float
) -> None:
    frame = a_frame()
    boxes = torch.tensor([[x, y, -1.0, length, width, 1.6, heading, 0.0, 0.0]])
    held = boxes[:, None, [0, 1, 6]].repeat(1, 12, 1)
    frame = replace(
        frame,
        boxes=boxes,
        futures=held,
        labels=frame.labels[:1],
        instances=frame.instances[:1],
        futures_valid=torch.tensor([[True, False] * 6]),
    )
    masks, valid = occupancy_targets(AgentTargets.of(frame, LEARNER), torch.tensor([0]), LEARNER)
    assert valid.tolist() == [[True, True, False, True, False]]
    shape = shapely.affinity.translate(
        shapely.affinity.rotate(
            shapely.box(-length / 2, -width / 2, length / 2, width / 2), heading, (0, 0), use_radians=True
        ),
        x,
        y,
    )
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
    turned_frames = []
    for number, frame in enumerate(many_frames()):
        heading = 2 * math.pi * number / 20
        distance = (0.5 + 0.1 * number) * torch.arange(1, 13)
        ahead = torch.tensor([math.cos(heading), math.sin(heading)])
        boxes, futures = frame.boxes.clone(), frame.futures.clone()
        boxes[0, 6] = heading
        futures[0, :, :2] = boxes[0, :2] + distance[:, None] * ahead
        turned_frames.append(replace(frame, boxes=boxes, futures=futures))
    anchors = motion_anchors(turned_frames, LEARNER)
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


def test_a_miniature_starts_every_scene_alike() -> None:
    network = learner()
    with torch.inference_mode():
        first = network.predict(network_inputs(a_frame(3, "b")))
        other = [network.predict(network_inputs(frame)) for frame in clip(2)][-1]
        again = network.predict(network_inputs(a_frame(3, "b")))
    assert torch.equal(first.plan.positions_m, again.plan.positions_m)
    assert not torch.equal(first.plan.positions_m, other.plan.positions_m)
    published = UniAD(replace(LEARNER, motion_across_scenes=True), network.motion_head.anchors)
    inputs = network_inputs(a_frame(3, "b"))
    assert (
        float(network.ego_motion(inputs).shift.abs().sum()) == 0 < float(published.ego_motion(inputs).shift.abs().sum())
    )


def test_frames_that_only_leave_a_past_have_no_gradients(monkeypatch: pytest.MonkeyPatch) -> None:
    objective = UniADObjective(learner(), clip_frames=3, learned_frames=2)
    graded: list[bool] = []
    frame = objective._frame

    def noted(*given: Any, **named: Any) -> Any:
        graded.append(torch.is_grad_enabled())
        return frame(*given, **named)

    monkeypatch.setattr(objective, "_frame", noted)
    total(objective.losses(clip(3))).backward()  # type: ignore[no-untyped-call]
    objective.losses(clip(2))
    assert graded == [False, True, True, True, True]


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
    taken = transfer_from_vad(vad.state_dict())
    left = network.load_state_dict(taken, strict=False)
    assert not left.unexpected_keys
    # Nothing reads the last stage of the image network, which VAD's does without.
    missing = [name for name in left.missing_keys if not name.startswith("img_backbone.layer4.")]
    assert not any(name.startswith(("img_", "pts_bbox_head.transformer.encoder")) for name in missing)
    assert transfer_from_vad(network.state_dict()).keys() == network.state_dict().keys(), "its own weights stay its own"
    frame = replace(a_frame(), images=torch.randint(0, 256, (6, 3, 128, 224), dtype=torch.uint8))
    with torch.inference_mode():
        inputs = network_inputs(frame)
        seen = vad.predict(VADInputs(inputs.images, inputs.lidar2img, inputs.can_bus, 2, "a"))
        assert torch.equal(network.predict(inputs).bev, seen.bev)
        queries = network.fresh_queries()
        ego = queries.reference_logits[-1, :2].sigmoid() - 0.5
        agents = queries.kept(slice(0, -1))
        found = network.pts_bbox_head.detect(seen.bev, agents.queries, agents.reference_logits)
    assert float(ego.abs().amax()) < 1e-3
    torch.testing.assert_close(found.class_logits, seen.class_logits)
    signs = torch.ones(10).index_fill(0, torch.tensor([6]), -1.0)
    torch.testing.assert_close(found.box_codes, seen.box_codes * signs, rtol=1e-4, atol=1e-4)


def test_plans_follow_the_front_camera_once_it_has_a_say() -> None:
    network = learner()
    reader = network.planning_head.front_reader
    assert reader is not None
    inputs = network_inputs(a_frame())
    with torch.inference_mode():
        silent = network.predict(inputs).plan.positions_m
        nn.init.normal_(reader.tell.weight)
        network.reset()
        told = network.predict(inputs).plan
    assert told.front is not None and told.front.shape == (1, LEARNER.plan_sees_front)
    assert not torch.allclose(silent, told.positions_m)
    published = UniAD(replace(LEARNER, plan_sees_front=0), network.motion_head.anchors)
    assert published.planning_head.front_reader is None and not any("front" in name for name in published.state_dict())


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
    silent = [
        name
        for name, parameter in objective.network.named_parameters()
        if parameter.grad is None and not name.startswith(FROZEN) and parameter.requires_grad
    ]
    assert all(any(unused in name for unused in UNUSED) for name in silent), silent
    assert all(
        parameter.grad is None for name, parameter in objective.network.named_parameters() if name.startswith(FROZEN)
    )


def test_a_network_that_is_not_told_its_speed_cannot_know_it() -> None:
    objective = UniADObjective(learner(), clip_frames=1)
    fast, slow = a_frame(), replace(a_frame(), can_bus=torch.zeros(18, dtype=torch.float64))
    for aware in (True, False):
        losses = []
        for frame in (fast, slow):
            torch.manual_seed(0)
            losses.append(float(total(objective.clip_losses([frame], 0.3, aware)).detach()))
        assert (losses[0] == losses[1]) is not aware


def test_frames_without_annotations_only_teach_that_nothing_is_there() -> None:
    objective = UniADObjective(learner())
    losses = objective.losses([without_annotations(frame) for frame in clip()])
    assert all(bool(torch.isfinite(loss)) for loss in losses.values())
    assert all(float(losses[name].detach()) == 0 for name in ("plan", "forecast", "occupancy", "map mask"))
    total(losses).backward()  # type: ignore[no-untyped-call]
    assert all(
        bool(torch.isfinite(parameter.grad).all())
        for parameter in objective.network.parameters()
        if parameter.grad is not None
    )


def test_only_the_occupancy_learns_what_it_normalises() -> None:
    objective = UniADObjective(learner())
    objective.network.train()
    before = {name: value.clone() for name, value in objective.network.named_buffers() if "running_" in name}
    for seed in range(8):
        torch.manual_seed(seed)
        objective.losses(clip())
    changed = {name for name, value in objective.network.named_buffers() if name in before and
               not torch.equal(value, before[name])}  # fmt: skip
    assert changed == {name for name in before if name.startswith("occ_head.")} != set()
    assert not objective.network.motion_head.training


def test_masks_are_right_when_values_are() -> None:
    targets = torch.tensor([[1.0, 1.0, 0.0, 0.0, 0.0]])
    right, empty, full = (float(mask_loss(values, targets)) for values in (targets, 0 * targets, 1 + 0 * targets))
    assert right == pytest.approx(0.0, abs=1e-6)
    assert empty > 1 and full > 1


def test_clips_are_learned_by_heart() -> None:
    objective = UniADObjective(learner())
    clips = [clip(1, "a"), clip(1, "b")]
    learned = [parameter for parameter in objective.network.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(learned, 4e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    torch.manual_seed(0)
    history = []
    for _ in range(STEPS):
        optimiser.zero_grad()
        losses = [objective.clip_losses(each, 0.0, True) for each in clips]
        (torch.stack([total(each) for each in losses]).sum() / 2).backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(learned, 5.0)
        optimiser.step()
        schedule.step()
        history.append(sum(float((total(each) - each["occupancy"]).detach()) for each in losses))
    assert history[-1] < history[0] / 5
    network = objective.network
    for each in clips:
        network.reset()
        with torch.inference_mode():
            plan = [network.predict(network_inputs(frame)) for frame in each][-1].plan.positions_m
        assert float((plan - each[-1].ego_future).norm(dim=-1).mean()) < 0.3
