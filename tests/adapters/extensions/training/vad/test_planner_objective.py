"""The planner of VAD learns from what was seen once: the numbers of the network itself, and nothing else learns."""

from dataclasses import replace

import torch
from torch import nn

from adapters.extensions.training.frames import CachedFrames, TrainingFrame
from adapters.extensions.training.front import FRONT_BACKBONE_PREFIX
from adapters.extensions.training.vad.objective import WEIGHTS, frame_losses, network_inputs
from adapters.extensions.training.vad.phases import PERCEPTION, VADPlannerObjective
from tests.adapters.extensions.training.one_scene import OneScene
from tests.adapters.extensions.training.vad.road_frames import clip, empty
from tests.adapters.networks.vad.small_vad import SMALL, small_network


def looked_at(frames: list[TrainingFrame]) -> tuple[VADPlannerObjective, CachedFrames]:
    config = replace(SMALL, plan_sees_front=18, plan_compares_front=True, front_eyes=True, plan_knows_motion=True)
    network = small_network(config=config)
    head = network.pts_bbox_head
    assert head.motion_teller is not None and head.front_reader is not None
    assert head.front_reader.tell_change is not None
    for layer in (head.motion_teller.tell, head.front_reader.tell_change):
        nn.init.normal_(layer.weight)
    objective = VADPlannerObjective(network)
    store, _ = objective.look(OneScene(frames), range(len(frames)))
    assert isinstance(store, CachedFrames)
    return objective, store


def test_losses_are_those_of_the_network_when_it_runs() -> None:
    frames = clip()
    objective, store = looked_at(frames)
    objective.network.reset()
    for number, frame in enumerate(frames):
        with torch.no_grad():
            expected = frame_losses(objective.network, objective.network.predict(network_inputs(frame)), frame)
            found = objective.losses(store.clip(number, 1))
        assert {"forecast", "mode", "plan", "lane"} <= set(found) < set(WEIGHTS)
        for name, loss in found.items():
            torch.testing.assert_close(loss, WEIGHTS[name] * expected[name], rtol=1e-4, atol=1e-5)


def test_forecasts_and_the_plan_learn_and_nothing_else() -> None:
    objective, store = looked_at(clip())
    torch.stack(list(objective.losses(store.clip(1, 1)).values())).sum().backward()  # type: ignore[no-untyped-call]
    learned = {name for name, weight in objective.network.named_parameters() if weight.grad is not None}
    able = {name for name, weight in objective.network.named_parameters() if weight.requires_grad}
    assert learned == able and not any(name.startswith((*PERCEPTION, FRONT_BACKBONE_PREFIX)) for name in able)
    assert any("motion_teller" in name for name in learned)
    # What is read in the front camera stays, what it tells the plan learns.
    assert {name for name in learned if "front_reader" in name} == {
        f"pts_bbox_head.front_reader.{part}" for part in ("tell.weight", "tell.bias", "tell_change.weight")
    }


def test_some_of_what_is_remembered_is_forgotten_in_each_step() -> None:
    objective, store = looked_at(clip())

    def plan_loss(seed: int) -> float:
        torch.manual_seed(seed)
        return float(objective.losses(store.clip(1, 1))["plan"].detach())

    assert plan_loss(0) == plan_loss(1)
    objective.network.train()
    assert plan_loss(0) == plan_loss(0) != plan_loss(1)


def test_nothing_annotated_is_no_reason_to_fail() -> None:
    objective, store = looked_at([empty(frame) for frame in clip()])
    total = torch.stack(list(objective.losses(store.clip(0, 1)).values())).sum()
    assert torch.isfinite(total)
    total.backward()  # type: ignore[no-untyped-call]
