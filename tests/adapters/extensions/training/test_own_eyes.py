"""Eyes of the plan's own: what they begin with, what they say, and how they go from one miniature to another."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from adapters.extensions.training.front import (
    FRONT_BACKBONE_PREFIX,
    HEAT_CLASSES,
    add_front_backbone,
    object_heat_loss,
    transfer_sparse_front_backbone,
)
from adapters.extensions.training.image_encoder import centre_loss, front_heat, image_targets
from adapters.extensions.training.sparse.phases import network_inputs
from adapters.extensions.training.uniad.phases import transfer_from_vad
from adapters.extensions.training.vad.phases import transfer_start_weights
from adapters.networks.layers.front_reader import FRONT, FrontReader
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseDrive, SparseInputs
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from tests.adapters.extensions.training.sparse.learner import frame
from tests.adapters.networks.sparse.miniature import MINIATURE, filled


def vad() -> VAD:
    return VAD(VADConfig.miniature())


def reader_of(network: nn.Module) -> FrontReader:
    (found,) = [module for module in network.modules() if isinstance(module, FrontReader)]
    return found


def without_eyes(network: nn.Module) -> dict[str, Tensor]:
    state = network.state_dict()
    return {name: value for name, value in state.items() if not name.startswith(FRONT_BACKBONE_PREFIX)}


def test_own_eyes_begin_as_the_layers_that_made_the_maps_of_all_cameras() -> None:
    torch.manual_seed(3)
    trunk = SparseDrive(replace(SparseConfig.miniature(), front_eyes=False)).state_dict()
    begun = add_front_backbone(trunk)
    built = SparseDrive(SparseConfig.miniature())
    built.load_state_dict({name: begun[name] for name in built.state_dict()})
    assert built.front_eyes is not None and all(torch.equal(begun[name], value) for name, value in trunk.items())
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
    # What has eyes already keeps them.
    bias = f"{FRONT_BACKBONE_PREFIX}fine.bias"
    again = add_front_backbone(begun | {bias: torch.ones_like(begun[bias])})
    assert again.keys() == begun.keys() and bool((again[bias] == 1).all())


def test_plans_look_at_the_front_camera_with_own_eyes_and_at_no_other() -> None:
    built = filled("sparsedrive", replace(MINIATURE, plan_sees_front=18, front_eyes=True))
    given = network_inputs(frame(0))
    assert built.front_eyes is not None

    def front(inputs: SparseInputs) -> Tensor:
        built.reset()
        taken = built.predict(inputs).planner.front
        assert taken is not None
        return taken

    with torch.inference_mode():
        wanted = reader_of(built)(built.front_eyes(given.images[FRONT : FRONT + 1]))
        torch.testing.assert_close(front(given), wanted)
        others = given.images.clone()
        others[FRONT + 1 :] += 1.0
        torch.testing.assert_close(front(replace(given, images=others)), wanted)
        for parameter in built.front_eyes.parameters():
            parameter.zero_()
        assert not torch.allclose(front(given), wanted)


def test_things_are_walkers_and_vehicles_and_cost_least_where_they_are() -> None:
    frames = [frame(0), frame(2)]
    assert np.array_equal(front_heat(frames[0]), image_targets(frames[0]).heat[FRONT])
    heats = torch.from_numpy(np.stack([front_heat(each) for each in frames]))
    wanted = torch.stack([heats[:, list(kinds)].amax(1) for kinds in HEAT_CLASSES], 1)
    assert (wanted == 1).any()
    maps = torch.randn(2, 5, *wanted.shape[-2:])
    torch.testing.assert_close(object_heat_loss(maps, frames), centre_loss(maps[:, :2], wanted))
    right, wrong = (torch.cat([sign * (16 * (wanted == 1) - 8.0), maps[:, 2:]], 1) for sign in (1, -1))
    assert float(object_heat_loss(right, frames)) < 0.1 < float(object_heat_loss(wrong, frames))


def test_what_a_sparse_miniature_reads_in_the_front_camera_vad_reads() -> None:
    torch.manual_seed(5)
    sparse, network = SparseDrive(SparseConfig.miniature()), vad()
    before = {name: value.clone() for name, value in network.state_dict().items()}
    taken = transfer_start_weights(sparse.state_dict())
    assert all(before[name].shape == value.shape for name, value in taken.items())
    network.load_state_dict(taken, strict=False)
    changed = {name for name, value in network.state_dict().items() if not torch.equal(value, before[name])}
    # Images, boxes and what the plan makes of the numbers stay its own.
    assert changed and all(name.startswith(FRONT_BACKBONE_PREFIX) or ".front_reader." in name for name in changed)
    assert not any(".front_reader.tell" in name for name in changed)
    images = torch.randn(6, 3, 128, 224)
    with torch.inference_mode():
        there, here = (
            each.finest_front(each.img_neck(each.img_backbone(images))[0], images) for each in (sparse, network)
        )
        torch.testing.assert_close(here, there)
        torch.testing.assert_close(reader_of(network)(here), reader_of(sparse)(there))


def test_of_weights_each_network_takes_what_it_can_use() -> None:
    weights, without = vad().state_dict(), without_eyes(vad())
    taken, begun = transfer_start_weights(weights), transfer_start_weights(without)
    assert taken.keys() == weights.keys() and all(torch.equal(taken[name], weights[name]) for name in taken)
    assert begun.keys() >= weights.keys()
    assert torch.equal(begun[f"{FRONT_BACKBONE_PREFIX}backbone.conv1.weight"], without["img_backbone.conv1.weight"])
    # UniAD reads another map with its front camera.
    given = transfer_from_vad(weights)
    assert "img_backbone.conv1.weight" in given
    assert not any(name.startswith(FRONT_BACKBONE_PREFIX) or "front_reader" in name for name in given)
    for none in (without_eyes(SparseDrive(SparseConfig.miniature())), weights):
        assert transfer_sparse_front_backbone(none, "reader.") == {}
