"""Weights of a miniature with one feature map of an image, for one with two."""

from dataclasses import replace

import torch
import torch.nn.functional as F

from adapters.extensions.training.vad.phases import add_finer_map
from adapters.networks.layers.deformable_attention import SamplingPattern, deformable_sampling
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD

ONE_MAP = replace(VADConfig.miniature(), backbone_outputs=(2,), pyramid_levels=1)


def one_map() -> VAD:
    torch.manual_seed(0)
    network = VAD(ONE_MAP)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return network


def two_maps(old: VAD) -> VAD:
    network = VAD(VADConfig.miniature())
    network.load_state_dict(add_finer_map(old.state_dict()))
    return network


def test_the_coarse_map_stays_and_the_finer_one_is_made_of_it() -> None:
    old = one_map()
    new = two_maps(old)
    images = torch.randn(6, 3, 128, 224)
    with torch.no_grad():
        before = old.img_neck(old.img_backbone(images))[0]
        finer, coarse = new.img_neck(new.img_backbone(images))
        lateral = old.img_neck.lateral_convs[0](old.img_backbone(images)[0])
        spread = old.img_neck.fpn_convs[0](F.interpolate(lateral, size=finer.shape[-2:], mode="nearest"))
    assert torch.equal(coarse, before)
    torch.testing.assert_close(finer, spread)


def looks_at_images(network: VAD) -> SamplingPattern:
    (pattern,) = [
        module
        for name, module in network.named_modules()
        if isinstance(module, SamplingPattern) and name.endswith("attentions.1.deformable_attention")
    ]
    return pattern


def test_cells_look_at_the_same_places_of_both_maps_and_at_each_with_half_the_weight() -> None:
    old = one_map()
    new = two_maps(old)
    cells = torch.randn(7, 64)
    patterns = [looks_at_images(network) for network in (old, new)]
    with torch.no_grad():
        (offsets, weights), (offsets_of_two, weights_of_two) = [
            (pattern.offsets(cells), pattern.weights(cells)) for pattern in patterns
        ]
    torch.testing.assert_close(offsets_of_two, torch.cat([2 * offsets, offsets], 2))
    torch.testing.assert_close(weights_of_two, torch.cat([weights, weights], 2) / 2)
    # Of maps that are the same ramp across the image they see the same.
    coarse = torch.linspace(0, 1, 29)[:-1] + 0.5 / 28
    values = [coarse.repeat(16), (torch.linspace(0, 1, 57)[:-1] + 0.5 / 56).repeat(32)]
    references = torch.full((7, 1, 1, 1, 2), 0.5)
    seen = deformable_sampling(
        values[0].view(1, -1, 1, 1).expand(-1, -1, 2, -1), [(16, 28)], references, offsets, weights
    )
    both = deformable_sampling(
        torch.cat(values[::-1]).view(1, -1, 1, 1).expand(-1, -1, 2, -1),
        [(32, 56), (16, 28)],
        references,
        offsets_of_two,
        weights_of_two,
    )
    inside = (offsets.abs() < 6).all()
    assert inside, "the ramp ends at the edges of the maps"
    torch.testing.assert_close(both, seen)


def test_what_has_two_maps_or_none_stays() -> None:
    new = two_maps(one_map()).state_dict()
    again = add_finer_map(new)
    assert again.keys() == new.keys() and all(torch.equal(again[name], value) for name, value in new.items())
    eyes = {"img_backbone.conv1.weight": torch.ones(3)}
    assert add_finer_map(eyes) == eyes
