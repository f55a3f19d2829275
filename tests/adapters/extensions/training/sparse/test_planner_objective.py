"""The planners of the sparse networks learn from what was seen once: the numbers of the network itself."""

from dataclasses import replace

import pytest
import torch

from adapters.extensions.training.frames import CachedFrames
from adapters.extensions.training.front import FRONT_BACKBONE_PREFIX
from adapters.extensions.training.sparse.phases import (
    PERCEPTION,
    SparseObjective,
    SparsePlannerObjective,
    network_inputs,
)
from adapters.extensions.training.sparse.targets import Targets
from tests.adapters.extensions.training.one_scene import OneScene
from tests.adapters.extensions.training.sparse.test_objective import CPU, TINY, frame, network
from tests.adapters.networks.sparse.miniature import MINIATURE, filled

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
def test_losses_of_the_planner_are_those_of_everything_and_it_learns_alone(name: str) -> None:
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
    torch.stack(list(found.values())).sum().backward()  # type: ignore[no-untyped-call]
    learned = {key for key, value in built.named_parameters() if value.grad is not None}
    assert learned and not any(key.startswith((*PERCEPTION, FRONT_BACKBONE_PREFIX)) for key in learned)


def test_some_of_what_is_remembered_is_forgotten_in_each_step() -> None:
    built = network("sparsedrive", replace(TINY, plan_sees_front=18))
    objective, frames = SparsePlannerObjective(built), [frame(index) for index in range(3)]
    store, _ = objective.look(OneScene(frames), range(3))

    def forecast_loss(seed: int) -> float:
        torch.manual_seed(seed)
        return float(objective.losses(store.clip(2, 3))["forecast"].detach())

    assert forecast_loss(0) == forecast_loss(1)
    built.train()
    assert forecast_loss(0) == forecast_loss(0) != forecast_loss(1)


def test_no_plan_is_learned_where_the_past_is_missing() -> None:
    built = network("sparsedrive", replace(TINY, plan_sees_front=18))
    objective, frames = SparsePlannerObjective(built), [frame(index) for index in range(4)]
    store, _ = objective.look(OneScene(frames), range(4))
    first, later = (objective.losses([store.clip(number, 1)[0]]) for number in (0, 3))
    assert float(first["plan"].detach()) > 0 == float(later["plan"].detach())
    assert float(later["forecast"].detach()) > 0 and float(later["status"].detach()) > 0
