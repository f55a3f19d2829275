"""MUSIQ: names and shapes of the public weights, padding and positions, a slow oracle, and what blur and noise do."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.nn import functional

from benchmark.errors import InputError
from benchmark.extensions.quality.musiq import Musiq, MusiqConfig, Patches, _hash_positions, cut_multiscale_patches
from benchmark.extensions.quality.scoring import ImagingQuality, prepare_picture
from benchmark.weights.catalogue import MUSIQ
from tests.benchmark.extensions.quality.small_networks import SMALL_MUSIQ, save_musiq
from tests.benchmark.extensions.quality.synthetic_videos import Picture, blurred, noisy, strip

CPU = torch.device("cpu")


def test_the_full_network_has_the_public_names_shapes_and_size() -> None:
    with torch.device("meta"):
        state = Musiq().state_dict()
    encoder = "transformer_encoder"
    block = f"{encoder}.transformer.encoderblock_13"
    expected = {
        "conv_root.weight": (64, 3, 7, 7),
        "gn_root.bias": (64,),
        "block1.conv2.weight": (64, 64, 3, 3),
        "block1.conv_proj.weight": (256, 64, 1, 1),
        "block1.gn_proj.weight": (256,),
        "embedding.weight": (384, 16384),
        f"{encoder}.posembed_input.position_emb": (1, 100, 384),
        f"{encoder}.scaleembed_input.scale_emb": (3, 384),
        f"{encoder}.cls": (1, 1, 384),
        f"{encoder}.encoder_norm.weight": (384,),
        f"{block}.norm1.weight": (384,),
        f"{block}.attention.query.bias": (384,),
        f"{block}.attention.out.weight": (384, 384),
        f"{block}.mlp.fc1.weight": (1152, 384),
        f"{block}.mlp.fc2.bias": (384,),
        "head.weight": (1, 384),
    }
    assert {name: tuple(state[name].shape) for name in expected} == expected
    # The published file has 109 MB.
    assert 108.0 < sum(tensor.numel() for tensor in state.values()) * 4 / 1e6 < 109.5
    assert MusiqConfig.of(state, Path("x")) == MusiqConfig()


@settings(max_examples=25)
@given(st.integers(1, 200))
def test_positions_are_hashed_evenly(count: int) -> None:
    assert _hash_positions(count, 10).tolist() == [index * 10 // count for index in range(count)]


@settings(max_examples=20)
@given(st.integers(1, 300), st.integers(1, 300))
def test_patches_cover_a_picture_of_any_size_at_three_scales(height: int, width: int) -> None:
    found = cut_multiscale_patches(torch.ones(3, height, width))
    own = -(-height // 32) * -(-width // 32)
    at_own = found.scale == 2
    assert at_own.sum() == own and found.pixels[at_own].sum() == 3 * height * width
    assert set(found.scale.tolist()) == {0, 1, 2} and found.position.min() >= 0 and found.position.max() < 100
    assert (found.scale == 0).sum() <= 49 and (found.scale == 1).sum() <= 144


def test_a_patch_is_cut_where_it_lies() -> None:
    picture = torch.arange(3 * 40 * 70, dtype=torch.float32).reshape(3, 40, 70)
    found = cut_multiscale_patches(picture)
    # 40 x 70 becomes 64 x 96: 12 pixels above and below, 13 on either side.
    padded = functional.pad(picture, (13, 13, 12, 12))
    own = found.pixels[found.scale == 2]
    assert len(own) == 6 and torch.equal(own[4], padded[:, 32:64, 32:64])
    assert found.position[found.scale == 2].tolist() == [0, 3, 6, 50, 53, 56]


def slow_score(network: Any, picture: Patches) -> float:
    """The network as its description reads, one patch and one token at a time, with the mask of the public code."""
    tokens = []
    for pixels, position, scale in zip(picture.pixels, picture.position, picture.scale):
        token = network._tokens(pixels[None])[0]
        token = token + network.transformer_encoder.posembed_input.position_emb[0, position]
        tokens.append(token + network.transformer_encoder.scaleembed_input.scale_emb[scale])
    state = torch.stack([network.transformer_encoder.cls[0, 0], *tokens])
    for layer in network.transformer_encoder.transformer.values():
        normed = layer.norm1(state)
        query, key, value = (getattr(layer.attention, name)(normed) for name in ("query", "key", "value"))
        weights = torch.softmax(query @ key.T / query.shape[1] ** 0.5, dim=-1)
        state = state + layer.attention.out(weights @ value)
        state = state + layer.mlp(layer.norm2(state))
    return float(network.head(network.transformer_encoder.encoder_norm(state[0])))


def test_scores_do_not_depend_on_the_other_pictures_and_match_the_slow_way() -> None:
    torch.manual_seed(5)
    network = Musiq(SMALL_MUSIQ).eval()
    sizes = ((20, 90), (64, 33), (200, 31))
    pictures = [cut_multiscale_patches(torch.rand(3, *size) * 2 - 1) for size in sizes]
    with torch.inference_mode():
        together = network(pictures)
        for score, picture in zip(together.tolist(), pictures):
            assert score == pytest.approx(float(network([picture])[0]), abs=1e-5)
            assert score == pytest.approx(slow_score(network, picture), abs=1e-4)


def test_large_pictures_are_brought_down_as_vbench_does() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (150, 700, 3), dtype=np.uint8)
    found = prepare_picture(picture, 512)
    assert found.shape == (3, 109, 512) and found.min() >= -1 and found.max() <= 1
    levels = (found + 1) * 127.5
    assert torch.allclose(levels, levels.round(), atol=1e-3)
    assert prepare_picture(picture, 700).shape == (3, 150, 700)


def texture_network() -> Musiq:
    """Random filters whose responses are averaged over a picture: tokens say what a patch looks like and not where."""
    torch.manual_seed(7)
    network = Musiq(replace(SMALL_MUSIQ, hidden=64)).eval()
    encoder: Any = network.transformer_encoder
    layer = encoder.transformer["encoderblock_0"]
    with torch.no_grad():
        channels = torch.randn(64, 1, 128) / 64
        network.embedding.weight.copy_(channels.expand(64, 64, 128).flatten(1))
        query = layer.attention.query.weight
        for zero in (encoder.posembed_input.position_emb, encoder.scaleembed_input.scale_emb, query):
            zero.zero_()
        layer.attention.query.bias.zero_()
        layer.mlp.fc2.weight.zero_()
    return network


def fitted(path: Path) -> ImagingQuality:
    """Weights that order pictures, made in the test: the last layer of `texture_network` is fitted to strips.

    Not the public weights: it shows that the network sees blur and noise and that scores come out in order.
    """
    network = texture_network()
    pictures, wanted = [], []
    for seed in range(24):
        sharp = strip(seed)
        pictures += [sharp, blurred(sharp), noisy(sharp, seed=seed)]
        wanted += [90.0, 10.0, 10.0]
    states: list[Tensor] = []
    network.head.register_forward_pre_hook(lambda module, inputs: states.append(inputs[0]))
    with torch.no_grad():
        network([cut_multiscale_patches(prepare_picture(picture, 512)) for picture in pictures])
        features = torch.cat([states[0], torch.ones(len(pictures), 1)], dim=1).double()
        damped = features.T @ features + 0.1 * torch.eye(features.shape[1])
        solution = torch.linalg.solve(damped, features.T @ torch.tensor(wanted).double())
        network.head.weight.copy_(solution[None, :-1])
        network.head.bias.copy_(solution[-1:])
    save_musiq(path, network)
    return ImagingQuality(path / MUSIQ.files[0].name, CPU, 512, 16)


def test_blur_and_noise_lower_imaging_quality(tmp_path: Path) -> None:
    quality = fitted(tmp_path)
    sharp: list[Picture] = [strip(seed) for seed in range(1000, 1006)]
    as_is = quality.scores(sharp)
    for spoilt in ([blurred(picture) for picture in sharp], [noisy(picture) for picture in sharp]):
        worse = quality.scores(spoilt)
        assert all(bad < good for good, bad in zip(as_is, worse))


def test_other_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pth"
    for content, says in (
        ({"weight": torch.zeros(2)}, "does not hold the weights of MUSIQ"),
        ({**Musiq(SMALL_MUSIQ).state_dict(), "head.weight": torch.zeros(10, 16)}, "do not fit MUSIQ.*head.weight"),
        ({name: t for name, t in Musiq(SMALL_MUSIQ).state_dict().items() if name != "head.bias"}, "head.bias"),
    ):
        torch.save(content, path)
        with pytest.raises(InputError, match=says):
            Musiq.load(path)
    path.write_bytes(b"PK nonsense")
    with pytest.raises(InputError, match="damaged"):
        Musiq.load(path)
