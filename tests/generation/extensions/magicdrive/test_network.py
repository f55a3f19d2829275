"""The network: what must hold whatever its weights; its numbers are those of the golden set (`test_parity`)."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.layers import (
    round_to_bfloat16,
)
from generation.extensions.magicdrive.model import EncodedConditions
from generation.extensions.magicdrive.sampling import build_null_conditions
from tests.generation.extensions.magicdrive.small_network import (
    CONFIG,
    assert_same,
    noise,
    random_conditions,
    small_network,
    velocity,
)

NETWORK = small_network()


@settings(max_examples=8, deadline=None)
@given(
    frames=st.integers(1, 11),
    rows=st.integers(1, 7),
    columns=st.integers(1, 7),
    boxes=st.integers(1, 3),
    multiple=st.sampled_from([1, 3, 4]),
)
def test_any_size_gives_a_velocity_of_its_size(frames: int, rows: int, columns: int, boxes: int, multiple: int) -> None:
    conditions = random_conditions(frames=frames, rows=rows, columns=columns, boxes=boxes)
    latent = noise(NETWORK, conditions)
    encoded = NETWORK.encode(conditions, rows_multiple=multiple)
    assert encoded.size.tokens % multiple == 0
    assert encoded.size.grid[0] - math.ceil(rows / 2) < multiple
    found = NETWORK(latent, torch.tensor([700.0]), encoded)
    assert found.shape == latent.shape and bool(torch.isfinite(found).all()) and found.dtype == torch.float32


@settings(max_examples=4, deadline=None)
@given(order=st.permutations(range(4)))
def test_the_order_of_boxes_does_not_matter(order: list[int]) -> None:
    conditions = random_conditions(boxes=4)
    permuted = replace(
        conditions,
        bboxes=conditions.bboxes[:, :, order],
        classes=conditions.classes[:, :, order],
        masks=conditions.masks[:, :, order],
        box_latent=conditions.box_latent[order],
    )
    latent = noise(NETWORK, conditions)
    assert_same(velocity(NETWORK, permuted, latent), velocity(NETWORK, conditions, latent))


def test_absent_and_hidden_boxes_say_nothing_of_themselves() -> None:
    latent = noise(NETWORK, random_conditions())
    for mask in (0, -1):
        first, second = (
            replace(found, masks=torch.full_like(found.masks, mask))
            for found in (random_conditions(), replace(random_conditions(), bboxes=random_conditions(seed=5).bboxes))
        )
        assert torch.equal(velocity(NETWORK, first, latent), velocity(NETWORK, second, latent))


def test_a_batch_of_two_is_two_single_ones() -> None:
    clips = [random_conditions(seed=seed) for seed in (1, 2)]
    latents = [noise(NETWORK, clip, seed) for seed, clip in enumerate(clips)]
    times, given = torch.tensor([900.0, 30.0]), torch.tensor([[True, False], [False, True]])
    encoded = [NETWORK.encode(clip) for clip in clips]
    both = NETWORK(torch.cat(latents), times, EncodedConditions.batch(encoded), given)
    for row, (latent, single) in enumerate(zip(latents, encoded, strict=True)):
        alone = NETWORK(latent, times[row : row + 1], single, given[row : row + 1])
        assert_same(both[row : row + 1], alone)


def test_clips_of_other_sizes_are_no_batch() -> None:
    clip = NETWORK.encode(random_conditions())
    for other in (random_conditions(rows=5), random_conditions(boxes=2), random_conditions(words=7)):
        with pytest.raises(ValueError, match="different sizes"):
            EncodedConditions.batch([clip, NETWORK.encode(other)])


def test_kept_keys_and_values_change_nothing() -> None:
    conditions = random_conditions()
    latent, time = noise(NETWORK, conditions), torch.tensor([500.0])
    kept = NETWORK.encode(conditions, keep_keys_values=True)
    assert kept.keys_values is not None and len(kept.keys_values) == 2 * (CONFIG.depth + CONFIG.control_depth)
    assert torch.equal(NETWORK(latent, time, kept), velocity(NETWORK, conditions, latent))


def test_one_empty_box_stands_for_many() -> None:
    conditions = random_conditions(boxes=7)
    once = build_null_conditions(NETWORK, conditions, keep_map=False)
    plain = replace(
        once,
        bboxes=torch.zeros_like(conditions.bboxes),
        classes=torch.zeros_like(conditions.classes),
        masks=torch.zeros_like(conditions.masks),
        box_latent=torch.zeros_like(conditions.box_latent),
    )
    latent, time = noise(NETWORK, conditions), torch.tensor([500.0])
    repeated = NETWORK.encode(once, box_repeats=7)
    assert repeated.tokens.length == NETWORK.encode(plain).tokens.length == repeated.tokens.sequence().shape[3]
    expected = velocity(NETWORK, plain, latent)
    assert_same(NETWORK(latent, time, repeated), expected)
    batch = EncodedConditions.batch([NETWORK.encode(conditions), repeated])
    together = NETWORK(latent.repeat(2, 1, 1, 1, 1), time.repeat(2), batch)
    assert_same(together[1:], expected)
    fewer = NETWORK(latent, time, NETWORK.encode(once, box_repeats=1))
    assert float((fewer - expected).abs().max()) > 1e-3


def test_rounding_is_of_what_goes_in() -> None:
    network = small_network(replace(CONFIG, rounded=True))
    conditions = random_conditions()
    latent = noise(network, conditions)
    names = ("bboxes", "box_latent", "cams", "rel_pos")
    rounded = {name: round_to_bfloat16(getattr(conditions, name)) for name in names}
    words = replace(conditions.text, hidden=round_to_bfloat16(conditions.text.hidden))
    same = replace(conditions, text=words, **rounded)  # type: ignore[arg-type]
    first = velocity(network, conditions, latent, 511.9)
    assert torch.equal(velocity(network, same, latent, 512.0), first)
    assert not torch.equal(velocity(small_network(), conditions, latent, 511.9), first)


def test_blocks_are_compiled_whole_and_give_the_same() -> None:
    network = small_network(replace(CONFIG, depth=1, control_depth=1))
    conditions = random_conditions()
    latent = noise(network, conditions)
    expected = velocity(network, conditions, latent)
    network.compile_blocks(backend="eager")
    assert_same(velocity(network, conditions, latent), expected)
    assert [*network.state_dict()] == [*small_network(network.config).state_dict()]


def test_conditions_and_latents_of_another_network_are_refused() -> None:
    conditions = random_conditions()
    with pytest.raises(ValueError, match="another network"):
        NETWORK.encode(random_conditions(replace(CONFIG, caption_channels=7)))
    with pytest.raises(ValueError, match="latent has shape"):
        NETWORK(torch.zeros(1, 96, 2, 4, 7), torch.tensor([1.0]), NETWORK.encode(conditions))
    with pytest.raises(ValueError, match="heads"):
        MagicDriveConfig(hidden=50)
    with pytest.raises(ValueError, match="control blocks"):
        MagicDriveConfig(depth=2)
