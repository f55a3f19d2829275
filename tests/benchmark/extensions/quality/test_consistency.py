"""Subject consistency: VBench's formula, and what a real (tiny, random) ViT makes of subjects."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from benchmark.errors import InputError
from benchmark.extensions.quality.masks import CroppedMask, compute_overlap
from benchmark.extensions.quality.scoring import SubjectFeatureExtractor, compute_similarities, crop_subject
from benchmark.geometry import Floats
from benchmark.weights.catalogue import DINO
from tests.benchmark.extensions.quality.synthetic_videos import texture

CPU = torch.device("cpu")
WHOLE = CroppedMask(0, 0, np.ones((96, 96), bool))


def slow_similarities(features: Floats) -> list[float]:
    """The formula, one frame after the other."""
    values = []
    for index in range(1, len(features)):
        to_previous = max(0.0, sum(a * b for a, b in zip(features[index - 1], features[index])))
        to_first = max(0.0, sum(a * b for a, b in zip(features[0], features[index])))
        values.append((to_previous + to_first) / 2)
    return values


@given(arrays(np.float64, st.tuples(st.integers(0, 6), st.just(4)), elements=st.floats(-1, 1)))
def test_the_formula_is_that_of_vbench(features: Floats) -> None:
    lengths = np.linalg.norm(features, axis=1, keepdims=True)
    features = features / np.where(lengths > 1e-6, lengths, 1.0)
    found = compute_similarities(features)
    assert found.tolist() == pytest.approx(slow_similarities(features)) and ((found >= 0) & (found <= 1 + 1e-9)).all()


def test_a_single_appearance_has_no_consistency() -> None:
    assert len(compute_similarities(np.ones((1, 3)))) == 0 and len(compute_similarities(np.zeros((0, 0)))) == 0


def test_identical_appearances_are_fully_consistent_and_a_swap_midway_is_not(networks: Path) -> None:
    dino = SubjectFeatureExtractor(networks / DINO.name, CPU, 64, 4)
    first, second = texture("first"), texture("second")
    same = compute_similarities(dino.features([(first, WHOLE)] * 6))
    swapped = compute_similarities(dino.features([(first, WHOLE)] * 3 + [(second, WHOLE)] * 3))
    assert same == pytest.approx(np.ones(5), abs=1e-6)
    assert swapped[:2] == pytest.approx(np.ones(2), abs=1e-6) and swapped.mean() < 1 - 1e-3
    # At the swap both cosines drop, later only the one with the first appearance.
    assert swapped[2] < swapped[3] < 1 - 1e-4


def test_features_do_not_depend_on_the_batch(networks: Path) -> None:
    appearances = [(texture(str(index)), WHOLE) for index in range(5)]
    found = [
        SubjectFeatureExtractor(networks / DINO.name, CPU, 64, batch).features(appearances) for batch in (1, 2, 16)
    ]
    assert found[0] == pytest.approx(found[1], abs=1e-6) and found[0] == pytest.approx(found[2], abs=1e-6)
    assert np.linalg.norm(found[0], axis=1) == pytest.approx(np.ones(5))


def test_what_lies_around_a_subject_does_not_count(networks: Path) -> None:
    inside = np.zeros((96, 96), bool)
    inside[20:70, 30:80] = True
    mask = CroppedMask.of(inside)
    assert mask is not None
    first = texture("a")
    second = np.where(inside[..., None], first, texture("b")).astype(np.uint8)
    assert torch.equal(crop_subject(first, mask, 32), crop_subject(second, mask, 32))
    assert not torch.equal(crop_subject(first, WHOLE, 32), crop_subject(second, WHOLE, 32))


def test_a_subject_stands_in_the_middle_of_a_square_with_its_proportions() -> None:
    wide = CroppedMask(0, 0, np.ones((10, 40), bool))
    square = crop_subject(np.full((10, 40, 3), 255, np.uint8), wide, 40)
    assert square.shape == (3, 40, 40)
    assert (square[:, 15:25] > 2).all() and square[:, :14].abs().max() < 1e-5 and square[:, 26:].abs().max() < 1e-5


def test_masks_are_cut_to_their_rectangle() -> None:
    whole = np.zeros((20, 30), bool)
    assert CroppedMask.of(whole) is None
    whole[3, 4] = whole[10, 20] = True
    mask = CroppedMask.of(whole)
    assert mask is not None
    assert (mask.top, mask.left, mask.pixels.shape, mask.area_px) == (3, 4, (8, 17), 2)
    assert mask.cut(np.zeros((20, 30, 3), np.uint8)).shape == (8, 17, 3)
    assert (
        compute_overlap(whole, whole) == 1
        and compute_overlap(whole, ~whole) == 0
        and compute_overlap(whole & False, whole & False) == 0
    )


def test_crops_that_do_not_fit_and_folders_without_weights_are_one_sentence(networks: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="do not divide into the patches of 16"):
        SubjectFeatureExtractor(networks / DINO.name, CPU, 50, 4)
    with pytest.raises(InputError, match="does not hold a ViTModel"):
        SubjectFeatureExtractor(tmp_path, CPU, 64, 4)
    (tmp_path / "config.json").write_bytes((networks / DINO.name / "config.json").read_bytes())
    (tmp_path / "model.safetensors").write_bytes(b"nothing")
    with pytest.raises(InputError, match="does not hold a ViTModel"):
        SubjectFeatureExtractor(tmp_path, CPU, 64, 4)
