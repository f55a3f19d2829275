"""Eyes of the plan's own go from one miniature to another, and its plan looks through them."""

import torch
from torch import nn

from adapters.extensions.training.front import FRONT_BACKBONE_PREFIX, transfer_sparse_front_backbone
from adapters.extensions.training.uniad.phases import transfer_from_vad
from adapters.extensions.training.vad.phases import transfer_start_weights
from adapters.networks.layers.front_reader import FRONT, FrontReader
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseDrive
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD


def vad() -> VAD:
    return VAD(VADConfig.miniature())


def reader_of(network: nn.Module) -> FrontReader:
    found = [module for module in network.modules() if isinstance(module, FrontReader)]
    assert len(found) == 1
    return found[0]


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
        map_there = sparse.finest_front(sparse.img_neck(sparse.img_backbone(images))[0], images)
        map_here = network.finest_front(network.img_neck(network.img_backbone(images))[0], images)
        torch.testing.assert_close(map_here, map_there)
        torch.testing.assert_close(reader_of(network)(map_here), reader_of(sparse)(map_there))
        # The others are not looked at.
        images[FRONT + 1 :] += 1.0
        torch.testing.assert_close(network.finest_front(map_here[:0], images), map_here)


def test_weights_of_the_same_network_are_taken_as_they_are() -> None:
    weights = vad().state_dict()
    taken = transfer_start_weights(weights)
    assert taken.keys() == weights.keys() and all(torch.equal(taken[name], weights[name]) for name in taken)
    without = {name: value for name, value in weights.items() if not name.startswith(FRONT_BACKBONE_PREFIX)}
    begun = transfer_start_weights(without)
    assert begun.keys() >= weights.keys()
    assert torch.equal(begun[f"{FRONT_BACKBONE_PREFIX}backbone.conv1.weight"], weights["img_backbone.conv1.weight"])


def test_uniad_takes_what_vad_sees_and_nothing_that_reads_another_map() -> None:
    taken = transfer_from_vad(vad().state_dict())
    assert "img_backbone.conv1.weight" in taken
    assert not any(name.startswith(FRONT_BACKBONE_PREFIX) or "front_reader" in name for name in taken)


def test_a_network_without_own_eyes_has_none_to_give() -> None:
    weights = SparseDrive(SparseConfig.miniature()).state_dict()
    without = {name: value for name, value in weights.items() if not name.startswith(FRONT_BACKBONE_PREFIX)}
    assert transfer_sparse_front_backbone(without, "reader.") == {}
    assert transfer_sparse_front_backbone(vad().state_dict(), "reader.") == {}
