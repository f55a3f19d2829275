"""Eyes of the plan's own: what they begin with, what they have to say, and that nothing else changes with them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from adapters.extensions.training.front import (
    FRONT_BACKBONE_PREFIX,
    HEAT_CLASSES,
    FrontObjective,
    add_front_backbone,
    object_heat_loss,
)
from adapters.extensions.training.image_encoder import centre_loss, front_heat, image_targets
from adapters.extensions.training.sparse.phases import build_front_encoder, find_front_reader, network_inputs
from adapters.networks.layers.front_reader import FRONT
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseDrive, SparseInputs, SparseNetwork
from tests.adapters.extensions.training.sparse.test_objective import TINY, frame, network
from tests.adapters.networks.sparse.miniature import MINIATURE, filled

SEES = replace(MINIATURE, plan_sees_front=18)


def objective_of(built: SparseNetwork) -> FrontObjective:
    reader = find_front_reader(built)
    assert reader is not None
    return FrontObjective(built, reader, build_front_encoder(built))


def test_own_eyes_begin_as_the_layers_that_made_the_maps_of_all_cameras() -> None:
    without = replace(SparseConfig.miniature(), front_eyes=False)
    torch.manual_seed(3)
    trunk = SparseDrive(without).state_dict()
    begun = add_front_backbone(trunk)
    built = SparseDrive(SparseConfig.miniature())
    missing = built.load_state_dict({name: begun[name] for name in built.state_dict()})
    assert not missing.missing_keys and all(torch.equal(begun[name], value) for name, value in trunk.items())
    assert built.front_eyes is not None
    images = torch.randn(2, 3, 128, 224)
    with torch.inference_mode():
        fine, coarse = built.img_backbone(images)[:2]
        for own, other in zip(built.front_eyes.backbone(images), (fine, coarse), strict=True):
            torch.testing.assert_close(own, other)
        # Nothing is anywhere, and the rest is what the pyramid makes of the two finer stages.
        built.img_neck.get_parameter("lateral_convs.2.conv.bias").zero_()
        maps, said = built.img_neck([fine, coarse, torch.zeros(2, 512, 4, 7)])[0], built.front_eyes(images)
    assert (said[:, : len(HEAT_CLASSES)] == said[0, 0, 0, 0]).all() and said[0, 0, 0, 0].sigmoid() < 0.02
    torch.testing.assert_close(said[:, len(HEAT_CLASSES) :], maps[:, len(HEAT_CLASSES) :])
    assert add_front_backbone(begun).keys() == begun.keys()
    kept = dict(begun) | {
        f"{FRONT_BACKBONE_PREFIX}fine.bias": torch.ones_like(begun[f"{FRONT_BACKBONE_PREFIX}fine.bias"])
    }
    assert torch.equal(
        add_front_backbone(kept)[f"{FRONT_BACKBONE_PREFIX}fine.bias"], kept[f"{FRONT_BACKBONE_PREFIX}fine.bias"]
    )


def test_plans_look_at_the_front_camera_with_own_eyes_and_at_no_other() -> None:
    built = filled("sparsedrive", replace(SEES, front_eyes=True))
    given = network_inputs(frame(0))
    reader = find_front_reader(built)
    assert built.front_eyes is not None and reader is not None

    def front(inputs: SparseInputs) -> Tensor:
        built.reset()
        taken = built.predict(inputs).planner.front
        assert taken is not None
        return taken

    with torch.inference_mode():
        wanted = reader(built.front_eyes(given.images[FRONT : FRONT + 1]))
        torch.testing.assert_close(front(given), wanted)
        others = given.images.clone()
        others[FRONT + 1 :] += 1.0
        torch.testing.assert_close(front(replace(given, images=others)), wanted)
        for parameter in built.front_eyes.parameters():
            parameter.zero_()
        assert not torch.allclose(front(given), wanted)


def test_the_front_camera_is_asked_for_what_all_images_are() -> None:
    whole = frame(1)
    assert np.array_equal(front_heat(whole), image_targets(whole).heat[FRONT])


def test_things_are_walkers_and_vehicles_and_cost_least_where_they_are() -> None:
    frames = [frame(0), frame(2)]
    heats = torch.from_numpy(np.stack([front_heat(each) for each in frames]))
    wanted = torch.stack([heats[:, list(kinds)].amax(1) for kinds in HEAT_CLASSES], 1)
    assert (wanted == 1).any()
    maps = torch.randn(2, 5, *wanted.shape[-2:])
    torch.testing.assert_close(object_heat_loss(maps, frames), centre_loss(maps[:, :2], wanted))
    right, wrong = (torch.cat([sign * (16 * (wanted == 1) - 8.0), maps[:, 2:]], 1) for sign in (1, -1))
    assert float(object_heat_loss(right, frames)) < 0.1 < float(object_heat_loss(wrong, frames))


def test_own_eyes_learn_with_what_reads_their_maps_and_nothing_else_does() -> None:
    built = network("sparsedrive", replace(TINY, plan_sees_front=18, front_eyes=True))
    before = {name: value.clone() for name, value in built.state_dict().items()}
    objective, frames = objective_of(built), [frame(index) for index in range(3)]
    optimiser = torch.optim.Adam([each for each in built.parameters() if each.requires_grad], lr=3e-3)
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        found = objective.losses(frames)
        torch.stack(list(found.values())).sum().backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        losses.append(float(found["things"].detach()))
    assert losses[-1] < losses[0] / 3
    changed = {name for name, value in built.state_dict().items() if not torch.equal(value, before[name])}
    assert changed and all(
        name.startswith((FRONT_BACKBONE_PREFIX, "head.motion_plan_head.front_reader.")) for name in changed
    )
    assert any(name.startswith(f"{FRONT_BACKBONE_PREFIX}backbone.conv1") for name in changed)


@pytest.mark.parametrize("own_eyes", [False, True])
def test_only_own_eyes_have_to_say_where_things_are(own_eyes: bool) -> None:
    built = network("sparsedrive", replace(TINY, plan_sees_front=18, front_eyes=own_eyes))
    assert ("things" in objective_of(built).losses([frame(0)])) is own_eyes
