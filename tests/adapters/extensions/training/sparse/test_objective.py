"""Objectives of the sparse miniatures: the same numbers as the network itself, losses, anchors, and that they teach."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from adapters.extensions.training.frames import CachedFrames, TrainingFrame
from adapters.extensions.training.front import FRONT_BACKBONE_PREFIX, WEIGHTS, add_front_backbone
from adapters.extensions.training.sparse.losses import FORECAST, forecast_losses, plan_losses
from adapters.extensions.training.sparse.phases import (
    SparseObjective,
    SparsePlannerObjective,
    network_inputs,
    phases,
)
from adapters.extensions.training.sparse.start import (
    build_untrained,
    build_untrained_diffusion,
    collect_anchor_samples_in,
    transfer_from_sparsedrive,
)
from adapters.extensions.training.sparse.targets import LINE_CLASS_OF_LABEL, Targets, box_numbers, reduce_points
from adapters.networks.sparse.anchors import BOXES, FORECASTS, PLANS
from adapters.networks.sparse.boxes import decode_boxes
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import DiffusionDrive, SparseDrive
from tests.adapters.extensions.training.road_frames import OneScene
from tests.adapters.extensions.training.sparse.learner import TINY, frame, network
from tests.adapters.networks.sparse.miniature import MINIATURE, filled

CPU = torch.device("cpu")


def values(losses: Mapping[str, Tensor]) -> dict[str, float]:
    return {name: float(loss.detach()) for name, loss in losses.items()}


@pytest.mark.parametrize(("name", "numbers"), [("sparsedrive", 0), ("diffusiondrive", 18)])
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


def test_what_plans_read_in_the_front_camera_is_taught_and_phases_learn_their_parts() -> None:
    built = network("sparsedrive", replace(TINY, plan_sees_front=18))
    losses = SparseObjective(built).losses([frame(0), frame(1)])
    torch.stack([losses[name] for name in WEIGHTS]).sum().backward()  # type: ignore[no-untyped-call]
    taught = {name for name, parameter in built.named_parameters() if parameter.grad is not None}
    assert any("front_reader.read" in name for name in taught) and any(name.startswith("img_neck") for name in taught)
    learning = []
    for phase in phases():
        phase.objective(built)
        learning.append({name for name, parameter in built.named_parameters() if parameter.requires_grad})
    front, everything, planner = learning
    neck = {name for name, _ in built.named_parameters() if name.startswith("img_neck.")}
    assert not neck & front and neck <= everything
    assert planner and all(name.startswith(("head.motion_plan_head.", "depth_branch.")) for name in planner)


def test_plans_that_are_not_known_teach_nothing() -> None:
    objective = SparseObjective(network("sparsedrive"))
    first, last = (replace(frame(index), ego_future_valid=torch.arange(6) < 6 - 6 * index) for index in range(2))
    wild = replace(last, ego_future=last.ego_future + 99)
    assert values(objective.losses([first, last])) == values(objective.losses([first, wild]))


def test_clips_of_several_lengths_count_by_their_frames_and_the_past_counts_nothing() -> None:
    objective = SparseObjective(network("diffusiondrive"))
    short, long = [frame(0, "short")], [frame(index, "long") for index in range(3)]
    together, first, second = (values(objective.losses_of(clips)) for clips in ([short, long], [short], [long]))
    for key, value in together.items():
        assert value == pytest.approx(0.25 * first[key] + 0.75 * second[key], rel=1e-4)
    assert values(objective.losses(short)) == first


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
    fewer = reduce_points(ends[:, :1] * (1 - shares) + ends[:, 1:] * shares, points)
    assert fewer.shape == (3, points, 2) and torch.allclose(fewer[:, [0, -1]], ends, atol=1e-4)
    lengths = fewer.diff(dim=1).norm(dim=-1)
    assert torch.allclose(lengths, lengths.mean(1, keepdim=True).expand_as(lengths), atol=1e-3)
    assert Targets.of([frame(0, lines=3)], 4, CPU).line_labels.tolist() == list(LINE_CLASS_OF_LABEL) == [1, 0, 2]


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
    first, again, other = (
        build_untrained_diffusion(SparseConfig.miniature(), varied(80), seed).state_dict() for seed in (4, 4, 5)
    )
    assert all(torch.equal(value, again[key]) for key, value in first.items())
    assert not torch.equal(first["head.det_head.fc_before.weight"], other["head.det_head.fc_before.weight"])
    assert all(torch.equal(first[key], other[key]) for key in (BOXES, FORECASTS, PLANS))
    assert isinstance(build_untrained(SparseConfig.miniature(), varied(80), 4), SparseDrive)


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


# --- the plan alone

CLOSE = 2e-2
"""Features of images are kept in half precision."""


@pytest.mark.parametrize(("name", "own_eyes"), [("sparsedrive", True), ("diffusiondrive", False)])
def test_what_is_remembered_is_what_the_network_says_when_it_runs(name: str, own_eyes: bool) -> None:
    built = filled(name, replace(MINIATURE, plan_sees_front=18, front_eyes=own_eyes))
    objective, frames = SparsePlannerObjective(built), [frame(index, "one") for index in range(3)]
    store, _ = objective.look(OneScene(frames), range(3))
    clip = store.clip(2, 3)
    assert isinstance(store, CachedFrames) and all(len(each.images) == 0 for each in clip)
    targets = Targets.of(clip, MINIATURE.points_per_line, CPU)
    built.reset()
    with torch.inference_mode():
        for given, seen in zip(frames, objective.seen(clip, 1, targets), strict=True):
            own = built.predict(network_inputs(given), objective.draw_noise(given))
            torch.testing.assert_close(own.agents.anchors, seen.perceived.agents.anchors[0], atol=CLOSE, rtol=CLOSE)
            torch.testing.assert_close(own.agents.logits, seen.perceived.agents.logits[0], atol=CLOSE, rtol=CLOSE)
            torch.testing.assert_close(own.planner.status, seen.planned.status[0], atol=CLOSE, rtol=CLOSE)
            assert own.planner.front is not None and seen.planned.front is not None
            torch.testing.assert_close(own.planner.front, seen.planned.front, atol=CLOSE, rtol=CLOSE)
            if seen.denoised:
                last = seen.denoised[-1].offsets[0]
                torch.testing.assert_close(own.planner.plan_offsets[given.command], last, atol=5 * CLOSE, rtol=CLOSE)


@pytest.mark.parametrize("name", ["sparsedrive", "diffusiondrive"])
def test_losses_of_the_plan_alone_are_those_of_everything(name: str) -> None:
    built = network(name, replace(TINY, plan_sees_front=18, front_eyes=name == "sparsedrive"))
    frames = [frame(index) for index in range(3)]
    with torch.no_grad():
        everything = SparseObjective(built).losses(frames)
    objective = SparsePlannerObjective(built)
    store, _ = objective.look(OneScene(frames), range(3))
    found = objective.losses(store.clip(2, 3))
    assert set(found) == {each for each in everything if not each.startswith(("box", "line"))}
    for each, loss in found.items():
        torch.testing.assert_close(loss.detach(), everything[each], atol=CLOSE, rtol=CLOSE, msg=each)


def test_no_plan_is_learned_where_the_past_is_missing() -> None:
    built = network("sparsedrive", replace(TINY, plan_sees_front=18))
    objective, frames = SparsePlannerObjective(built), [frame(index) for index in range(4)]
    store, _ = objective.look(OneScene(frames), range(4))
    first, later = (objective.losses([store.clip(number, 1)[0]]) for number in (0, 3))
    assert float(first["plan"].detach()) > 0 == float(later["plan"].detach())
    assert float(later["forecast"].detach()) > 0 and float(later["status"].detach()) > 0
