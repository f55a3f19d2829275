"""Objectives of the sparse miniatures: the same numbers as the network itself, losses, anchors, and that they teach."""

from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from adapters.camera_inputs import MINIATURE_IMAGE, RGB_MEAN_STD
from adapters.extensions.training.dataset_mixture import build_frames
from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.front import FRONT_BACKBONE_PREFIX, WEIGHTS, add_front_backbone
from adapters.extensions.training.losses import assign
from adapters.extensions.training.sparse.losses import FORECAST, forecast_losses, plan_losses
from adapters.extensions.training.sparse.phases import SparseObjective, find_front_reader, network_inputs, phases
from adapters.extensions.training.sparse.start import (
    build_untrained,
    build_untrained_diffusion,
    collect_anchor_samples_in,
    initialise,
    transfer_from_sparsedrive,
)
from adapters.extensions.training.sparse.targets import LINE_CLASS_OF_LABEL, Targets, box_numbers, reduce_points
from adapters.networks.sparse.anchors import BOXES, FORECASTS, PLANS
from adapters.networks.sparse.boxes import decode_boxes
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import DiffusionDrive, SparseDrive, SparseNetwork
from adapters.networks.sparse.planner import SparsePlanner
from benchmark.datasets.nuscenes import NuScenesData
from tests.adapters.networks.sparse.miniature import MINIATURE, filled, projections
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

TINY = replace(
    MINIATURE, interaction_blocks=1, channels=16, heads=2, anchors=12, remembered_anchors=6, stages=2, queue_frames=2
)
HEIGHT, WIDTH = TINY.image_height_px, TINY.image_width_px
SPEED = 2.0
STEPS = 90
CPU = torch.device("cpu")


def frame(index: int, scene: str = "scene", *, boxes: int = 3, lines: int = 2, turn: float = 0.0) -> TrainingFrame:
    """An ego that drives north at 6 m/s, and what stands and drives beside it."""
    generator = torch.Generator().manual_seed(7 * index + len(scene))
    pose = torch.eye(4, dtype=torch.float64)
    pose[1, 3] = SPEED * 0.5 * index
    steps = torch.arange(1, 13)[:, None] * 0.5
    future = torch.cat([turn * steps[:6] ** 2, SPEED * steps[:6]], 1)
    places = torch.tensor([[4.0, 9.0], [-5.0, 14.0], [0.0, -12.0]])[:boxes]
    numbers = torch.tensor([-1.0, 4.5, 1.9, 1.6, 1.2, 1.0, -2.0]).repeat(boxes, 1)
    paths = places[:, None] + steps * torch.tensor([1.0, -2.0])
    return TrainingFrame(
        scene=scene,
        index=index,
        timestamp_s=100.0 + 0.5 * index,
        images=torch.randint(0, 256, (6, 3, HEIGHT, WIDTH), generator=generator, dtype=torch.uint8),
        lidar2img=torch.from_numpy(projections()).double(),
        global_T_lidar=pose,
        can_bus=torch.zeros(18, dtype=torch.float64).index_fill(0, torch.tensor([13]), SPEED),
        command=2,
        ego_future=future,
        ego_future_valid=torch.ones(6, dtype=torch.bool),
        boxes=torch.cat([places, numbers], 1),
        labels=torch.arange(boxes) % 2,
        instances=torch.arange(boxes),
        futures=torch.cat([paths, torch.full((boxes, 12, 1), 1.2)], -1),
        futures_valid=torch.ones(boxes, 12, dtype=torch.bool),
        lines=torch.stack([torch.full((20,), 2.0), torch.linspace(-10, 10, 20)], -1).expand(lines, -1, -1).clone(),
        line_labels=torch.arange(lines) % 3,
        drivable=torch.ones(128, 128, dtype=torch.bool),
    )


def network(name: str, config: SparseConfig = TINY) -> SparseNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        made = DiffusionDrive(config) if name == "diffusiondrive" else SparseDrive(config)
        for layer in made.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight)
        initialise(made)
    decoder, lines = made.head.det_head, made.head.map_head
    with torch.no_grad():
        decoder.instance_bank.anchor[:, :2] *= 12
        decoder.instance_bank.anchor[:, 2:] *= 0.3
        lines.instance_bank.anchor.mul_(10)
        speeds, steps = torch.linspace(0, 4, 6)[:, None], torch.arange(1, 7) * 0.5
        anchors = made.head.motion_plan_head.plan_anchor
        anchors.copy_(torch.stack([torch.zeros(6, 6), speeds * steps], -1).expand(3, -1, -1, -1))
        anchors[0, ..., 0] = 0.2 * steps**2
        anchors[1, ..., 0] = -0.2 * steps**2
    return made


def values(losses: Mapping[str, Tensor]) -> dict[str, float]:
    return {name: float(loss.detach()) for name, loss in losses.items()}


@pytest.mark.parametrize("numbers", [0, 18])
@pytest.mark.parametrize("name", ["sparsedrive", "diffusiondrive"])
def test_several_clips_at_once_are_what_the_network_says_of_each(name: str, numbers: int) -> None:
    built = filled(name, replace(MINIATURE, plan_sees_front=numbers, plan_compares_front=True))
    objective = SparseObjective(built)
    clips = [[frame(index, scene) for index in range(3)] for scene in ("one", "other")]
    clips = [[replace(each, command=number) for each in clip] for number, clip in enumerate(clips)]
    frames = [each for together in zip(*clips, strict=True) for each in together]
    targets = Targets.of(frames, MINIATURE.points_per_line, CPU)
    with torch.inference_mode():
        learned = objective.seen(frames, 2, targets)
        for number, clip in enumerate(clips):
            built.reset()
            for step, each in enumerate(clip):
                own = built.predict(network_inputs(each), objective.draw_noise(each))
                seen = learned[step]
                for expected, found in zip(own.agents.stages, seen.perceived.agents.stages, strict=True):
                    assert torch.allclose(expected.logits, found.logits[number], atol=1e-3)
                    assert torch.allclose(expected.anchors[:, :8], found.anchors[number, :, :8], atol=1e-3)
                for expected, found in zip(own.lines.stages, seen.perceived.lines.stages, strict=True):
                    assert torch.allclose(expected.anchors, found.anchors[number], atol=1e-3)
                if own.planner.front is not None and seen.planned.front is not None:
                    assert torch.allclose(own.planner.front[0], seen.planned.front[number], atol=1e-3)
                assert (own.planner.front is None) is (seen.planned.front is None) is (numbers == 0)
                assert torch.allclose(own.planner.status, seen.planned.status[number], atol=1e-3)
                if name == "diffusiondrive":
                    last = seen.denoised[-1]
                    assert torch.allclose(own.planner.plan_offsets[0], last.offsets[number], atol=1e-3)
                    assert torch.allclose(own.planner.plan_logits[0], last.logits[number], atol=1e-3)


@pytest.mark.parametrize("name", ["sparsedrive", "diffusiondrive"])
def test_plans_follow_the_front_camera_once_it_has_a_say(name: str) -> None:
    built = filled(name, replace(MINIATURE, plan_sees_front=18))
    reader = find_front_reader(built)
    assert reader is not None
    with torch.inference_mode():
        first = built(network_inputs(frame(0))).plan_modes
        reader.zero_message()
        built.reset()
        silent = built(network_inputs(frame(0))).plan_modes
        plain = filled(name)
        plain.load_state_dict({key: value for key, value in built.state_dict().items() if "front_reader" not in key})
        without = plain(network_inputs(frame(0))).plan_modes
    torch.testing.assert_close(silent, without)
    assert not torch.allclose(first, silent)


def test_what_plans_read_in_the_front_camera_is_taught() -> None:
    config = replace(TINY, plan_sees_front=18)
    objective = SparseObjective(network("sparsedrive", config))
    losses = objective.losses([frame(0), frame(1)])
    assert set(WEIGHTS) <= set(losses)
    torch.stack([losses[name] for name in WEIGHTS]).sum().backward()  # type: ignore[no-untyped-call]
    taught = {name for name, parameter in objective.network.named_parameters() if parameter.grad is not None}
    assert any("front_reader.read" in name for name in taught) and any(name.startswith("img_neck") for name in taught)
    front, everything, planner = phases()
    built = network("sparsedrive", config)
    front.objective(built)
    assert not any(parameter.requires_grad for parameter in built.img_neck.parameters())
    everything.objective(built)
    assert all(parameter.requires_grad for parameter in built.img_neck.parameters())
    planner.objective(built)
    learns = {name for name, parameter in built.named_parameters() if parameter.requires_grad}
    assert learns and all(name.startswith(("head.motion_plan_head.", "depth_branch.")) for name in learns)


@pytest.mark.parametrize("name", ["sparsedrive", "diffusiondrive"])
def test_a_few_clips_are_learned_by_heart(name: str) -> None:
    built = network(name)
    objective = SparseObjective(built)
    clips = [[frame(0, "straight")], [frame(0, "turn", turn=0.2)]]
    clips[1] = [replace(each, command=0) for each in clips[1]]
    optimiser = torch.optim.AdamW([p for p in built.parameters() if p.requires_grad], lr=6e-3)
    losses = []
    for step in range(STEPS):
        for group in optimiser.param_groups:
            group["lr"] = 6e-3 * (1 - step / STEPS)
        found = objective.losses_of(clips)
        losses.append(values(found))
        optimiser.zero_grad(set_to_none=True)
        torch.stack(list(found.values())).sum().backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(built.parameters(), 5.0)
        optimiser.step()
    assert sum(losses[-1].values()) < sum(losses[0].values()) / 5
    for clip in clips:
        built.reset()
        with torch.inference_mode():
            for each in clip:
                plan = built(network_inputs(each)).plan
        assert float((plan - clip[-1].ego_future).norm(dim=-1).mean()) < 0.3


def test_losses_do_not_depend_on_what_was_seen_before() -> None:
    objective = SparseObjective(network("diffusiondrive"))
    clip = [frame(index) for index in range(2)]
    first = objective.losses(clip)
    objective.losses([frame(index, "another") for index in range(3)])
    again = objective.losses(clip)
    assert values(first) == values(again)


@pytest.mark.parametrize("name", ["sparsedrive", "diffusiondrive"])
def test_what_is_not_annotated_teaches_nothing(name: str) -> None:
    objective = SparseObjective(network(name))
    empty = [
        replace(frame(index, boxes=0, lines=0), ego_future_valid=torch.zeros(6, dtype=torch.bool)) for index in range(2)
    ]
    losses = objective.losses(empty)
    assert all(torch.isfinite(value) for value in losses.values())
    nothing = {"box", "box around", "box quality", "line", "line direction", "forecast", "forecast class"}
    nothing |= {"plan", "plan aside", "plan chosen", "plan class"}
    assert all(values(losses)[key] == 0 for key in nothing)
    torch.stack(list(losses.values())).sum().backward()  # type: ignore[no-untyped-call]
    gradients = [p.grad for p in objective.network.parameters() if p.grad is not None]
    assert all(bool(gradient.isfinite().all()) for gradient in gradients)
    unfinished = [frame(index) for index in range(2)]
    wild = replace(unfinished[1], ego_future=unfinished[1].ego_future + 99, ego_future_valid=torch.arange(6) < 0)
    calm = replace(unfinished[1], ego_future_valid=torch.arange(6) < 0)
    first, second = (values(objective.losses([unfinished[0], last])) for last in (wild, calm))
    assert first == second


def test_clips_of_several_lengths_count_by_their_frames() -> None:
    objective = SparseObjective(network("sparsedrive"))
    short, long = [frame(0, "short")], [frame(index, "long") for index in range(3)]
    together = values(objective.losses_of([short, long]))
    first, second = values(objective.losses(short)), values(objective.losses(long))
    for key, value in together.items():
        assert value == pytest.approx(0.25 * first[key] + 0.75 * second[key], rel=1e-4)


@given(data=st.data())
@settings(max_examples=30, deadline=None)
def test_matches_stay_in_their_key_frame_and_are_the_cheapest(data: st.DataObject) -> None:
    queries = data.draw(st.integers(1, 5))
    counts = data.draw(st.lists(st.integers(0, 3), min_size=1, max_size=3))
    seed = data.draw(st.integers(0, 1000))
    cost = torch.rand(len(counts) * queries, sum(counts), generator=torch.Generator().manual_seed(seed))
    found = assign(cost, queries, counts)
    total, start = 0.0, 0
    for number, count in enumerate(counts):
        block = cost[number * queries : (number + 1) * queries, start : start + count].numpy()
        total += cheapest(block)
        start += count
    owners = torch.repeat_interleave(torch.arange(len(counts)), torch.tensor(counts))
    assert torch.equal(found.queries // queries, owners[found.wanted])
    assert len(found.queries) == sum(min(queries, count) for count in counts)
    assert float(cost[found.queries, found.wanted].sum()) == pytest.approx(total, abs=1e-5)


def cheapest(block: np.ndarray[tuple[int, int], np.dtype[np.float32]]) -> float:
    small, large = sorted(block.shape)
    wide = block if block.shape[0] == small else block.T
    ways = permutations(range(large), small)
    return min((sum(float(wide[row, column]) for row, column in enumerate(way)) for way in ways), default=0.0)


def test_boxes_come_back_from_their_numbers() -> None:
    boxes = torch.tensor([[3.0, -4.0, -1.0, 4.5, 1.9, 1.6, 2.5, 1.0, -3.0], [0, 0, 0, 0.5, 0.6, 1.7, -3.0, 0, 0]])
    decoded = decode_boxes(box_numbers(boxes))
    assert torch.allclose(decoded[:, :9], boxes, atol=1e-5)
    assert bool((decoded[:, 9] == 0).all())


@given(points=st.integers(2, 20), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_fewer_points_are_evenly_spaced_and_keep_the_ends(points: int, seed: int) -> None:
    ends = torch.rand(3, 2, 2, generator=torch.Generator().manual_seed(seed)) * 40 - 20
    shares = torch.linspace(0, 1, 20)[:, None]
    lines = ends[:, :1] * (1 - shares) + ends[:, 1:] * shares
    fewer = reduce_points(lines, points)
    assert fewer.shape == (3, points, 2)
    assert torch.allclose(fewer[:, [0, -1]], ends, atol=1e-4)
    lengths = fewer.diff(dim=1).norm(dim=-1)
    assert torch.allclose(lengths, lengths.mean(1, keepdim=True).expand_as(lengths), atol=1e-3)


def test_line_labels_are_those_of_the_network() -> None:
    targets = Targets.of([frame(0, lines=3)], 4, CPU)
    assert targets.line_labels.tolist() == list(LINE_CLASS_OF_LABEL) == [1, 0, 2]


def test_the_plan_whose_anchor_is_nearest_learns() -> None:
    targets = Targets.of(
        [replace(frame(0), ego_future=torch.arange(1.0, 7)[:, None] * torch.tensor([0.0, 2.0]))], 4, CPU
    )
    anchors = torch.arange(1.0, 7)[:, None] * torch.tensor([[[[0.0, 2.5]], [[0.0, 9.0]]]])
    offsets = torch.tensor([0.0, 9.0]).expand(1, 2, 6, 2).clone().requires_grad_()
    logits = torch.zeros(1, 2, requires_grad=True)
    losses = plan_losses(logits, offsets, anchors, targets)
    torch.stack(list(losses.values())).sum().backward()  # type: ignore[no-untyped-call]
    assert logits.grad is not None and logits.grad[0, 0] < 0 < logits.grad[0, 1]
    assert offsets.grad is not None
    pulled = offsets.grad[0, :, :, 1].sum(-1)
    assert pulled[0] > pulled[1] > 0, "the other plan learns as far as it may be chosen"


def test_the_forecast_whose_anchor_is_nearest_learns() -> None:
    wanted = torch.arange(1.0, 4)[:, None] * torch.tensor([[[1.0, 0.0]]])
    anchors = torch.arange(1.0, 4)[:, None] * torch.tensor([[[[0.0, 0.0]], [[1.2, 0.0]]]])
    offsets = torch.zeros(1, 2, 3, 2, requires_grad=True)
    valid = torch.tensor([[True, False, True]])
    losses = forecast_losses(torch.zeros(1, 2), offsets, anchors, wanted, valid)
    losses["forecast"].backward()  # type: ignore[no-untyped-call]
    assert offsets.grad is not None
    assert bool((offsets.grad[0, 0] == 0).all()) and bool((offsets.grad[0, 1, :, 0] < 0).all())
    assert values(losses)["forecast"] == pytest.approx(FORECAST * (1 + 3) / 2), "the second step is not known"


def test_anchors_are_what_there_is_to_be_found() -> None:
    frames = [frame(index, turn=0.1 * index) for index in range(4)]
    found = collect_anchor_samples_in(frames, TINY)
    assert np.shape(found.box_centres) == (12, 3) and np.shape(found.line_centres) == (8, 2)
    forward = np.asarray(found.futures[0])[0]
    heading, speed = 1.2, np.array([1.0, -2.0])
    ahead = speed @ [np.cos(heading), np.sin(heading)]
    assert forward[:, 0] == pytest.approx(ahead * np.arange(1, 13) * 0.5)
    assert np.shape(found.plans[2]) == (4, 6, 2) and np.shape(found.plans[0]) == (0, 6, 2)


def varied(count: int) -> list[TrainingFrame]:
    generator = torch.Generator().manual_seed(0)
    found = []
    for index in range(count):
        each = frame(index, turn=0.02 * index)
        moved = each.boxes.clone()
        moved[:, :2] += torch.rand(len(moved), 2, generator=generator) * 20 - 10
        shifted = each.lines + torch.rand(2, 1, 2, generator=generator) * 10
        found.append(replace(each, boxes=moved, lines=shifted, command=index % 3))
    return found


def test_untrained_networks_start_at_the_anchors() -> None:
    first, again = (build_untrained_diffusion(SparseConfig.miniature(), varied(80), 4) for _ in range(2))
    other = build_untrained_diffusion(SparseConfig.miniature(), varied(80), 5)
    state = first.state_dict()
    assert all(torch.equal(value, again.state_dict()[key]) for key, value in state.items())
    assert not torch.equal(
        state["head.det_head.fc_before.weight"], other.state_dict()["head.det_head.fc_before.weight"]
    )
    assert all(torch.equal(state[key], other.state_dict()[key]) for key in (BOXES, FORECASTS, PLANS))
    assert isinstance(first, DiffusionDrive) and isinstance(
        build_untrained(SparseConfig.miniature(), varied(80), 4), SparseDrive
    )


def test_what_learns() -> None:
    objective = SparseObjective(network("diffusiondrive"))
    torch.stack(list(objective.losses([frame(0), frame(1)]).values())).sum().backward()  # type: ignore[no-untyped-call]
    learned = {name for name, parameter in objective.network.named_parameters() if parameter.grad is not None}
    assert {PLANS, FORECASTS, "img_backbone.conv1.weight", "img_backbone.layer1.0.conv1.weight"}.isdisjoint(learned)
    parts = ["img_backbone.layer4", "img_neck", "head.det_head", "head.map_head", "head.motion_plan_head"]
    assert all(any(name.startswith(part) for name in learned) for part in parts)


def test_diffusiondrive_starts_where_sparsedrive_ended() -> None:
    trunk = SparseDrive(TINY).state_dict()
    given, own = transfer_from_sparsedrive(trunk), DiffusionDrive(TINY).state_dict()
    taken = {name: value for name, value in given.items() if not name.startswith(FRONT_BACKBONE_PREFIX)}
    assert set(given) - set(taken) == set(add_front_backbone(trunk)) - set(trunk) != set()
    assert set(taken) <= set(own) and all(taken[key].shape == own[key].shape for key in taken)
    missing = set(own) - set(taken)
    assert all(key.startswith("head.motion_plan_head.") for key in missing)
    assert {key.split(".")[2] for key in missing} == {"diff_layers", "plan_pos_encoder", "time_mlp"}


def test_the_planner_gives_the_network_what_the_objective_gives(tmp_path: Path) -> None:
    root = tmp_path / "root"
    write_root(root, [short_scene("scene-9901", seconds=4.5)])
    store = build_frames(root, "val", tmp_path / "frames")
    config = replace(SparseConfig.miniature(), memory_crosses_scenes=False)
    assert config.image_format == MINIATURE_IMAGE
    built = SparsePlanner(SparseDrive(config), name="small", normalisation=RGB_MEAN_STD, device="cpu")
    data = NuScenesData.open(root)
    for index, seen in enumerate(data.observations(store.scenes[0])):
        planned, learned = built.inputs(seen), network_inputs(store.frame(index))
        for field in fields(planned):
            given_, taught = getattr(planned, field.name), getattr(learned, field.name)
            if not isinstance(given_, Tensor):
                assert given_ == taught, field.name
            elif field.name == "images":
                assert float((given_ - taught).abs().max()) < 0.5 / 57 + 1e-3, "pixels are kept as bytes"
            else:
                assert torch.allclose(given_, taught.to(given_.dtype), atol=1e-5), field.name
        if index == 2:
            return
