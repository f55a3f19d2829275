"""Published weights in every form they may come in, and what is not one of them."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import safetensors.torch
import torch
from torch import Tensor

from benchmark.errors import InputError
from generation.extensions.magicdrive.checkpoint import NULL_PROMPT, load_published_network
from tests.generation.extensions.magicdrive.small_network import (
    CONFIG,
    noise,
    random_conditions,
    small_network,
    velocity,
)

State = dict[str, Tensor]
ROUNDED = replace(CONFIG, rounded=True)


def state() -> State:
    return dict(small_network().state_dict())


def saved(tensors: State, path: Path) -> Path:
    if path.suffix == ".safetensors":
        safetensors.torch.save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    else:
        torch.save(tensors, path)
    return path


@pytest.mark.parametrize("name", ["ema.pt", "ema.safetensors"])
def test_both_forms_give_the_network(name: str, tmp_path: Path) -> None:
    path = saved(state() | {"pos_embed": torch.zeros(3), "pos_embed_temporal": torch.zeros(1, 4)}, tmp_path / name)
    network = load_published_network(path, CONFIG, dtype=torch.float32)
    conditions = random_conditions()
    latent = noise(network, conditions)
    assert torch.equal(velocity(network, conditions, latent), velocity(small_network(), conditions, latent))
    assert not network.training and not any(parameter.requires_grad for parameter in network.parameters())


def test_weights_are_rounded_as_the_published_pipeline_does(tmp_path: Path) -> None:
    path = saved(state(), tmp_path / "ema.pt")
    half, exact = load_published_network(path, ROUNDED), load_published_network(path, ROUNDED, dtype=torch.float32)
    for name, tensor in state().items():
        assert half.state_dict()[name].dtype == torch.bfloat16
        assert torch.equal(half.state_dict()[name], tensor.bfloat16())
        assert torch.equal(exact.state_dict()[name], tensor.bfloat16().float())


def test_a_shorter_null_prompt_goes_on_with_its_last_token(tmp_path: Path) -> None:
    short = state()
    short[NULL_PROMPT] = short[NULL_PROMPT][:3]
    network = load_published_network(saved(short, tmp_path / "ema.pt"), CONFIG, dtype=torch.float32)
    prompt = network.y_embedder.y_embedding
    assert torch.equal(prompt[:3], short[NULL_PROMPT]) and torch.equal(prompt[3:], prompt[2:3].expand(9, -1))


HIDDEN = CONFIG.hidden
WRONG: dict[str, State | None] = {
    r"1 missing \(first: base_token\)": None,
    r"1 too many \(first: extra\)": {"extra": torch.zeros(2)},
    r"1 of another shape \(first: rope.freqs\)": {"rope.freqs": torch.zeros(3)},
    r"1 without fractions \(first: base_token\)": {"base_token": torch.zeros(HIDDEN, dtype=torch.int64)},
    "NaN or infinity in base_token": {"base_token": torch.full((HIDDEN,), float("inf"))},
    r"1 of another shape \(first: y_embedder.y_embedding\)": {NULL_PROMPT: torch.zeros(0, 24)},
}


@pytest.mark.parametrize("name", ["ema.pt", "ema.safetensors"])
@pytest.mark.parametrize("message", WRONG)
def test_other_tensors_are_refused(message: str, name: str, tmp_path: Path) -> None:
    tensors = state() | (WRONG[message] or {})
    if WRONG[message] is None:
        del tensors["base_token"]
    path = saved(tensors, tmp_path / name)
    with pytest.raises(InputError, match=message):
        load_published_network(path, CONFIG)


@pytest.mark.parametrize("name", ["ema.pt", "ema.safetensors"])
def test_damaged_files_are_refused(name: str, tmp_path: Path) -> None:
    path = saved(state(), tmp_path / name)
    whole = path.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], whole[:40], b"<html>", b"\x80\x02}q\x00", b"\xff" * 64):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="ema"):
            load_published_network(path, CONFIG)
    path.unlink()
    for absent in (path, tmp_path):
        with pytest.raises(InputError, match="cannot read"):
            load_published_network(absent, CONFIG)


class _Hostile:
    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.marker),)


def test_a_file_that_would_run_code_is_refused_unread(tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    torch.save({"base_token": _Hostile(marker)}, tmp_path / "ema.pt")
    with pytest.raises(InputError, match="could run code"):
        load_published_network(tmp_path / "ema.pt", CONFIG)
    assert not marker.exists()
