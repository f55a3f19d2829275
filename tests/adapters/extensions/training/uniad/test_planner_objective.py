"""The plan of UniAD learns from what the network makes of a scene when it runs, and nothing else learns."""

import torch
from torch import nn

from adapters.extensions.training.frames import CachedFrames, TrainingFrame
from adapters.extensions.training.uniad.losses import network_inputs
from adapters.extensions.training.uniad.objective import plan_losses
from adapters.extensions.training.uniad.phases import UniADPlannerObjective, build_untrained
from tests.adapters.extensions.training.one_scene import OneScene
from tests.adapters.extensions.training.uniad.objectives import LEARNER, a_frame, many_frames, without_annotations


def looked_at(frames: list[TrainingFrame]) -> tuple[UniADPlannerObjective, CachedFrames]:
    network = build_untrained(LEARNER, many_frames(), 0)
    for said in (network.planning_head.motion_teller, network.planning_head.front_reader):
        assert said is not None
        nn.init.normal_(said.tell.weight)
    objective = UniADPlannerObjective(network)
    store, _ = objective.look(OneScene(frames), range(len(frames)))
    assert isinstance(store, CachedFrames)
    return objective, store


def drive_of(count: int = 3) -> list[TrainingFrame]:
    return [a_frame(number) for number in range(count)]


def test_losses_are_those_of_the_network_when_it_runs() -> None:
    frames = drive_of()
    objective, store = looked_at(frames)
    objective.network.eval()
    for number, frame in enumerate(frames):
        with torch.no_grad():
            plan = objective.network.predict(network_inputs(frame)).plan
            found = objective.losses(store.clip(number, 1))
        expected = plan_losses(plan, frame)
        assert {"plan", "plan aside", "plan agents", "plan boundary"} < set(found) == set(expected)
        for name, loss in found.items():
            torch.testing.assert_close(loss, expected[name], rtol=2e-2, atol=2e-2)


def test_the_plan_learns_and_nothing_else() -> None:
    objective, store = looked_at(drive_of())
    torch.stack(list(objective.losses(store.clip(1, 1)).values())).sum().backward()  # type: ignore[no-untyped-call]
    learned = {name for name, weight in objective.network.named_parameters() if weight.grad is not None}
    able = {name for name, weight in objective.network.named_parameters() if weight.requires_grad}
    assert learned == able and all(name.startswith("planning_head.") for name in learned)
    assert any("motion_teller" in name for name in learned)
    # What is read in the front camera stays, what it tells the plan learns.
    assert {name for name in learned if "front_reader" in name} == {
        f"planning_head.front_reader.tell.{part}" for part in ("weight", "bias")
    }


def test_the_planner_alone_forgets_in_each_step() -> None:
    objective, store = looked_at(drive_of())

    def plan_loss(seed: int) -> float:
        torch.manual_seed(seed)
        return float(objective.losses(store.clip(1, 1))["plan"].detach())

    objective.network.eval()
    assert plan_loss(0) == plan_loss(1)
    objective.network.train()
    first = plan_loss(0)
    assert plan_loss(0) == first != plan_loss(1)
    assert not objective.network.occ_head.training and objective.network.planning_head.training


def test_nothing_annotated_is_no_reason_to_fail() -> None:
    objective, store = looked_at([without_annotations(frame) for frame in drive_of(2)])
    total = torch.stack(list(objective.losses(store.clip(0, 1)).values())).sum()
    assert torch.isfinite(total)
    total.backward()  # type: ignore[no-untyped-call]
