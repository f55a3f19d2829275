"""Guidance and the sampler: the same by seed, resumed to the same bytes; its numbers are those of the golden set."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from benchmark.errors import InputError
from generation.extensions.magicdrive.conditions import TextStates
from generation.extensions.magicdrive.layers import round_to_bfloat16
from generation.extensions.magicdrive.sampling import (
    GivenFrames,
    GuidedModel,
    SamplingOptions,
    SamplingState,
    choose_timesteps,
    draw_first_state,
    sample_latents,
)
from tests.generation.extensions.magicdrive.small_network import (
    CONFIG,
    assert_same,
    noise,
    random_conditions,
    small_network,
)

NETWORK = small_network()
CLIP = random_conditions()
OPTIONS = SamplingOptions(steps=3)


def sampled(seed: int = 0, options: SamplingOptions = OPTIONS) -> Tensor:
    return sample_latents(NETWORK, CLIP, draw_first_state(NETWORK, CLIP, seed), options)


@given(
    frames=st.sampled_from([1, *range(8, 250, 8), *range(9, 250, 8)]),
    height=st.integers(224, 900),
    width=st.integers(400, 1700),
    steps=st.integers(1, 60),
    rounded=st.booleans(),
)
def test_timesteps_fall_from_pure_noise(frames: int, height: int, width: int, steps: int, rounded: bool) -> None:
    found = choose_timesteps(height, width, frames, steps, rounded=rounded)
    assert len(found) == steps
    assert found[0].item() == pytest.approx(1000.0, abs=1e-3)
    assert bool((found.diff() < 0).all()) and found[-1].item() > 0


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not() -> None:
    assert torch.equal(sampled(5), sampled(5))
    assert not torch.allclose(sampled(5), sampled(6), atol=0.1)


def test_noise_is_rounded_where_inputs_are() -> None:
    rounding = small_network(replace(CONFIG, rounded=True))
    exact, rounded = draw_first_state(NETWORK, CLIP, 4).latent, draw_first_state(rounding, CLIP, 4).latent
    assert torch.equal(rounded, round_to_bfloat16(exact)) and not torch.equal(rounded, exact)


@pytest.mark.parametrize("mode", ["rflow-slice", "rflow"])
def test_both_branches_together_are_two_calls(mode: str) -> None:
    options = replace(OPTIONS, mode=mode)  # type: ignore[arg-type]
    apart = sampled(options=options)
    assert_same(sampled(options=replace(options, together=True)), apart)
    assert_same(sampled(options=replace(options, keep_keys_values=True)), apart)


def test_the_null_branch_knows_nothing_of_the_clip() -> None:
    latent, time = noise(NETWORK, CLIP), torch.tensor([500.0])
    other = replace(random_conditions(seed=8), text=TextStates(-CLIP.text.hidden, CLIP.text.mask))
    first, second = (GuidedModel.of(NETWORK, clip).compute_branches(latent, time)[1] for clip in (CLIP, other))
    assert torch.equal(first, second)


def test_a_frame_may_join_later_and_be_resumed() -> None:
    times = choose_timesteps(CLIP.height, CLIP.width, CLIP.frames, 3, rounded=False)
    share = float(times[1] + times[0]) / 2000
    latent = noise(NETWORK, CLIP, 11)
    known = GivenFrames(latent, torch.tensor([share, 1.0]))
    states: list[SamplingState] = []
    found = sample_latents(
        NETWORK, CLIP, draw_first_state(NETWORK, CLIP, 3), OPTIONS, given=known, on_step=states.append
    )
    assert torch.equal(states[0].latent[:, :, 0], latent[:, :, 0])
    assert not torch.allclose(states[1].latent[:, :, 0], latent[:, :, 0], atol=1e-2)
    for state in states:
        assert torch.equal(sample_latents(NETWORK, CLIP, state, OPTIONS, given=known), found)


def test_numbers_that_are_none_stop_the_run() -> None:
    broken = small_network()
    broken.final_layer.linear.bias.fill_(float("nan"))
    with pytest.raises(InputError, match="NaN or infinity at step 1 of 3"):
        sample_latents(broken, CLIP, draw_first_state(broken, CLIP, 0), OPTIONS)
