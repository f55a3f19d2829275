"""The model card of the training command: from the facts of a training alone."""

from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.errors import InputError
from generation.diffusion.checkpoint import load_denoiser, save_denoiser, write_bank
from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser
from generation.extensions.denoiser_training.card import write_model_card
from tests.generation.extensions.denoiser_training.test_tracks import drive, write_tracks


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """Beside tracks of two sources, one of them held out."""
    for name in ("made_up", "interaction_sample"):
        write_tracks(tmp_path / f"{name}.npz", [drive(np.full(120, 8.0))], source=np.array(name))
    torch.manual_seed(0)
    small = DenoiserConfig(feature_dim=16, heads=2, layers=1, feedforward_dim=16, history_tokens=0)
    path = tmp_path / "denoiser.safetensors"
    facts = {"seed": 0, "steps": 1, "batch": 1, "windows": {"made_up": 3}, "licences": {"made_up": "none"}}
    save_denoiser(path, TrajectoryDenoiser(small).eval(), facts)
    write_bank(path, count=4)
    return path


def test_card_says_what_was_learnt_from_and_that_nothing_was_measured(weights: Path) -> None:
    text = write_model_card(weights, weights.parent).read_text()
    assert "Not made." in text and "docs/studies/trajectory-model.md" in text
    assert "Not trained on, they only check the result: INTERACTION." in text
    measured = write_model_card(weights, weights.parent, ["## Measured here\n"]).read_text()
    assert measured == text.partition("## Measurements")[0] + "## Measured here\n"


def test_card_without_held_out_sources_names_none(weights: Path) -> None:
    (weights.parent / "interaction_sample.npz").unlink()
    assert "INTERACTION" not in write_model_card(weights, weights.parent).read_text()


def test_weights_that_do_not_say_how_they_were_trained_have_no_card(weights: Path) -> None:
    save_denoiser(weights, load_denoiser(weights), {"seed": 0})
    with pytest.raises(InputError, match="does not record its batch, licences, steps, windows"):
        write_model_card(weights, weights.parent)
