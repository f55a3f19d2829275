"""Guidance and the sampler: the same by seed, resumed to the same bytes, frames that are given stay."""

from dataclasses import replace
from pathlib import Path

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
    build_null_conditions,
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
    velocity,
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


def test_timesteps_of_the_published_size() -> None:
    exact, rounded = (choose_timesteps(224, 400, 241, 30, rounded=flag) for flag in (False, True))
    assert exact[[1, 2, 29]].tolist() == pytest.approx([992.5048, 984.5978, 136.034], abs=1e-3)
    assert rounded[[1, 2, 29]].tolist() == pytest.approx([992.4988, 984.5858, 135.9404], abs=1e-3)


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not() -> None:
    assert torch.equal(sampled(5), sampled(5))
    assert not torch.allclose(sampled(5), sampled(6), atol=0.1)


def test_noise_is_rounded_where_inputs_are() -> None:
    rounding = small_network(replace(CONFIG, rounded=True))
    exact, rounded = draw_first_state(NETWORK, CLIP, 4).latent, draw_first_state(rounding, CLIP, 4).latent
    assert torch.equal(rounded, round_to_bfloat16(exact)) and not torch.equal(rounded, exact)


@pytest.mark.parametrize("stop", [1, 2, 3])
def test_a_killed_run_goes_on_to_the_same_bytes(stop: int, tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"

    def save_and_die(state: SamplingState) -> None:
        state.save(path, "key")
        if state.step == stop:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample_latents(NETWORK, CLIP, draw_first_state(NETWORK, CLIP, 7), OPTIONS, on_step=save_and_die)
    kept = SamplingState.load(path, "key")
    assert kept is not None and (kept.step, kept.seed) == (stop, 7)
    assert torch.equal(sample_latents(NETWORK, CLIP, kept, OPTIONS), sampled(7))


def test_states_are_the_same_bytes_and_only_whole_ones_count(tmp_path: Path) -> None:
    state = draw_first_state(NETWORK, CLIP, 1)
    first, second = tmp_path / "first", tmp_path / "second"
    state.save(first, "key")
    state.save(second, "key")
    assert first.read_bytes() == second.read_bytes()
    assert SamplingState.load(tmp_path / "absent", "key") is None
    assert SamplingState.load(first, "another key") is None
    whole = first.read_bytes()
    changed = whole[:-5] + bytes([whole[-5] ^ 1]) + whole[-4:]
    for damaged in (b"", whole[:100], whole[:-3], b"{}", b"\x00" * 200, changed):
        second.write_bytes(damaged)
        assert SamplingState.load(second, "key") is None


@pytest.mark.parametrize("mode", ["rflow-slice", "rflow"])
def test_both_branches_together_are_two_calls(mode: str) -> None:
    options = replace(OPTIONS, mode=mode)  # type: ignore[arg-type]
    apart = sampled(options=options)
    assert_same(sampled(options=replace(options, together=True)), apart)
    assert_same(sampled(options=replace(options, keep_keys_values=True)), apart)


def test_modes_differ_by_the_map_of_the_null_branch() -> None:
    assert not torch.allclose(sampled(), sampled(options=replace(OPTIONS, mode="rflow")), atol=1e-3)
    told, null = (build_null_conditions(NETWORK, CLIP, keep_map=keep) for keep in (True, False))
    assert torch.equal(told.maps, CLIP.maps) and not bool(null.maps.any())


def test_guidance_follows_the_difference() -> None:
    latent, time = noise(NETWORK, CLIP), torch.tensor([500.0])
    told, null = GuidedModel.of(NETWORK, CLIP).compute_branches(latent, time)
    assert torch.equal(told, velocity(NETWORK, CLIP, latent))
    for scale in (0.0, 1.0, 2.5):
        found = GuidedModel.of(NETWORK, CLIP, scale=scale).velocity(latent, time)
        assert_same(found, null + scale * (told - null))


def test_the_null_branch_knows_nothing_of_the_clip() -> None:
    latent, time = noise(NETWORK, CLIP), torch.tensor([500.0])
    other = replace(random_conditions(seed=8), text=TextStates(-CLIP.text.hidden, CLIP.text.mask))
    first, second = (GuidedModel.of(NETWORK, clip).compute_branches(latent, time)[1] for clip in (CLIP, other))
    assert torch.equal(first, second)


def test_a_negative_prompt_is_cut_to_the_prompt() -> None:
    hidden = random_conditions(seed=8).text.hidden
    long = replace(CLIP, negative_text=TextStates(hidden, torch.ones(12, dtype=torch.bool)))
    latent, time = noise(NETWORK, CLIP), torch.tensor([500.0])
    null = GuidedModel.of(NETWORK, long).compute_branches(latent, time)[1]
    beyond = hidden.clone()
    beyond[int(CLIP.text.mask.sum()) + 1 :] = 7.0
    same = replace(long, negative_text=TextStates(beyond, CLIP.text.mask))
    assert torch.equal(GuidedModel.of(NETWORK, same).compute_branches(latent, time)[1], null)
    assert not torch.equal(GuidedModel.of(NETWORK, CLIP).compute_branches(latent, time)[1], null)


def test_given_frames_stay_and_guide_the_others() -> None:
    latent = noise(NETWORK, CLIP, 11)
    known = GivenFrames(latent, torch.tensor([0.0, 1.0]))
    found = sample_latents(NETWORK, CLIP, draw_first_state(NETWORK, CLIP, 3), OPTIONS, given=known)
    assert torch.equal(found[:, :, 0], latent[:, :, 0])
    assert not torch.allclose(found[:, :, 1], sampled(3)[:, :, 1], atol=1e-3)
    everything = GivenFrames(latent, torch.ones(2))
    assert torch.equal(
        sample_latents(NETWORK, CLIP, draw_first_state(NETWORK, CLIP, 3), OPTIONS, given=everything), sampled(3)
    )


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
