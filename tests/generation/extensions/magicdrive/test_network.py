"""The network: what must hold whatever its weights, and fast forms against slow ones."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from generation.extensions.magicdrive.blocks import CrossViewAttention
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.encoders import pool_in_time
from generation.extensions.magicdrive.layers import (
    LatentSize,
    PatchEmbedding,
    RotaryFrequencies,
    compute_fourier_features,
    compute_grid_embedding,
    pack_views,
    round_to_bfloat16,
    unpack_views,
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


@settings(max_examples=12, deadline=None)
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


def test_padded_rows_are_computed_with_and_cropped() -> None:
    conditions = random_conditions(rows=6, columns=6)
    latent = noise(NETWORK, conditions)
    padded = NETWORK.encode(conditions, rows_multiple=4)
    assert (padded.size.rows, padded.size.padded_rows, padded.size.grid) == (6, 8, (4, 3))
    # The same clip with two rows of zeros at the bottom, but for where its tokens are and where its map ends.
    taller = replace(conditions, height=64)
    longer = NETWORK.encode(taller)
    whole = NETWORK(
        F.pad(latent, (0, 0, 0, 2)),
        torch.tensor([500.0]),
        replace(longer, control=padded.control, position=padded.position),
    )
    assert_same(NETWORK(latent, torch.tensor([500.0]), padded), whole[..., :6, :])
    assert not torch.allclose(velocity(NETWORK, conditions, latent), whole[..., :6, :], atol=1e-3)


@pytest.mark.parametrize(
    ("frames", "height", "width", "multiple", "expected"),
    [
        (241, 224, 400, 4, LatentSize(61, 28, 50, 32)),
        (240, 224, 400, 8, LatentSize(60, 28, 50, 32)),
        (17, 224, 400, 1, LatentSize(5, 28, 50, 28)),
        (9, 424, 800, 4, LatentSize(3, 53, 100, 56)),
        (1, 848, 1600, 4, LatentSize(1, 106, 200, 106)),
    ],
)
def test_published_sizes(frames: int, height: int, width: int, multiple: int, expected: LatentSize) -> None:
    assert LatentSize.of(frames, height, width, multiple) == expected


@pytest.mark.parametrize("view", range(6))
def test_a_view_reaches_its_neighbours_and_nobody_else(view: int) -> None:
    network = small_network(replace(CONFIG, depth=1, control_depth=0))
    conditions = random_conditions()
    latent = noise(network, conditions)
    views = unpack_views(latent, 6).clone()
    views[:, view] += 1
    moved = (velocity(network, conditions, pack_views(views)) - velocity(network, conditions, latent)).abs()
    reached = unpack_views(moved, 6).amax((0, 2, 3, 4, 5)) > 1e-4
    assert set(np.flatnonzero(reached.numpy()).tolist()) == {(view - 1) % 6, view, (view + 1) % 6}


def test_packing_is_channel_major_and_view_minor() -> None:
    latent = torch.arange(96.0).reshape(1, 96, 1, 1, 1)
    apart = unpack_views(latent, 6)
    assert apart[0, 2, 5].item() == 5 * 6 + 2
    assert torch.equal(pack_views(apart), latent)


@settings(max_examples=8, deadline=None)
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


def test_boxes_of_one_view_stand_for_all() -> None:
    conditions = random_conditions()
    for_each = replace(
        conditions, bboxes=conditions.bboxes.repeat(6, 1, 1, 1, 1), classes=conditions.classes.repeat(6, 1, 1)
    )
    latent = noise(NETWORK, conditions)
    assert torch.equal(velocity(NETWORK, for_each, latent), velocity(NETWORK, conditions, latent))


@pytest.mark.parametrize("name", ["bboxes", "classes", "masks", "box_latent", "cams", "rel_pos", "maps"])
def test_every_condition_matters(name: str) -> None:
    conditions, other = random_conditions(), random_conditions(seed=9)
    latent = noise(NETWORK, conditions)
    changed = velocity(NETWORK, replace(conditions, **{name: getattr(other, name)}), latent)
    assert float((changed - velocity(NETWORK, conditions, latent)).abs().max()) > 1e-4


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


def test_attention_between_views_projects_each_view_once() -> None:
    torch.manual_seed(3)
    layer = CrossViewAttention(12, 3).requires_grad_(False)
    x = torch.randn(2, 6, 2, 5, 12)
    expected = torch.zeros_like(x)
    for scene in range(2):
        for view in range(6):
            for near in ((view - 1) % 6, (view + 1) % 6):
                for frame in range(2):
                    expected[scene, view, frame] += _asked(layer, x[scene, view, frame], x[scene, near, frame])
    assert_same(layer(x), expected)


def _asked(layer: CrossViewAttention, own: Tensor, other: Tensor) -> Tensor:
    """One view asks another one, head by head."""
    q, k, v = (part for part in layer.qkv.weight.chunk(3))
    heads = []
    for head in range(3):
        rows = slice(4 * head, 4 * head + 4)
        query, key, value = own @ q[rows].T, other @ k[rows].T, other @ v[rows].T
        query, key = (row / (row.square().mean(-1, keepdim=True) + 1e-6).sqrt() for row in (query, key))
        heads.append(((query * layer.q_norm.weight) @ (key * layer.k_norm.weight).T / 2).softmax(-1) @ value)
    out: Tensor = layer.proj(torch.cat(heads, -1))
    return out


def test_no_frame_given_is_the_plain_form() -> None:
    conditions = random_conditions()
    latent, time, encoded = noise(NETWORK, conditions), torch.tensor([500.0]), NETWORK.encode(conditions)
    nothing = torch.zeros(1, 2, dtype=torch.bool)
    assert_same(NETWORK(latent, time, encoded, nothing), NETWORK(latent, time, encoded))
    everything = NETWORK(latent, time, encoded, ~nothing)
    assert not torch.allclose(everything, NETWORK(latent, time, encoded), atol=1e-3)


@settings(max_examples=20, deadline=None)
@given(frames=st.integers(1, 30))
def test_pooling_in_time_averages_pairs_from_the_end(frames: int) -> None:
    values = torch.arange(float(frames))[:, None]
    slow = [values[frame : frame + 2].mean() for frame in range(frames % 2, frames, 2)]
    expected = torch.stack(([values[0, 0]] if frames % 2 else []) + slow)
    assert_same(pool_in_time(values)[:, 0], expected)
    assert len(pool_in_time(pool_in_time(values))) == LatentSize.of(frames, 8, 8).frames


def test_rotation_turns_adjacent_channels() -> None:
    rotary = RotaryFrequencies(6)
    x = torch.randn(4, 6)
    turned = rotary.rotation(4, torch.float32, rounded=False)(x)
    for position in range(4):
        for pair in range(3):
            angle = position * 10000 ** (-2 * pair / 6)
            number = complex(*x[position, 2 * pair : 2 * pair + 2]) * complex(math.cos(angle), math.sin(angle))
            assert complex(*turned[position, 2 * pair : 2 * pair + 2]) == pytest.approx(number, abs=1e-5)


def test_rounded_rotation_has_the_published_errors() -> None:
    rotary = RotaryFrequencies(72)
    exact, rounded = (rotary.rotation(61, torch.float32, rounded=flag) for flag in (False, True))
    positions = torch.arange(61, dtype=torch.bfloat16)
    angles = (positions[:, None] * rotary.freqs.bfloat16()).float()
    assert torch.equal(rounded.cosine, angles.cos())
    assert 0.1 < float((exact.sine - rounded.sine).abs().max()) < 0.23


def test_fourier_goes_octave_by_octave() -> None:
    x = torch.tensor([0.3, -2.0, 5.0])
    waves = [wave(2**octave * x) for octave in range(4) for wave in (torch.sin, torch.cos)]
    assert torch.equal(compute_fourier_features(x), torch.cat([x, *waves]))


def test_grid_has_the_column_first() -> None:
    found = compute_grid_embedding(3, 5, (48, 80), 8, rounded=False, device=torch.device("cpu"))
    scale, side = math.sqrt(48 * 80) / 512, round(math.sqrt(15))
    for row in range(3):
        for column in range(5):
            expected = []
            for place in (column / scale * side / 5, row / scale * side / 3):
                angles = [place * 10000 ** (-2 * k / 4) for k in range(2)]
                expected += [math.sin(angle) for angle in angles] + [math.cos(angle) for angle in angles]
            assert found[5 * row + column].tolist() == pytest.approx(expected, abs=1e-4)


def test_patches_are_the_convolution() -> None:
    layer = PatchEmbedding(3, 7).requires_grad_(False)
    cells = torch.randn(2, 6, 3, 4, 5, 3)
    padded = F.pad(cells, (0, 1, 0, 1)).flatten(0, 1)
    expected = F.conv3d(padded, layer.proj.weight, layer.proj.bias, (1, 2, 2)).flatten(3).permute(0, 2, 3, 1)
    assert_same(layer(cells).flatten(0, 1), expected)


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


def test_half_precision_is_close() -> None:
    network = small_network(replace(CONFIG, rounded=True))
    conditions = random_conditions()
    latent = noise(network, conditions)
    exact = velocity(network, conditions, latent)
    half = velocity(network.to(torch.bfloat16), conditions, latent)
    assert half.dtype == torch.float32
    assert np.corrcoef(exact.ravel(), half.ravel())[0, 1] > 0.999


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
