"""Training: resumable, seeded, deaf to held-out sources; its model card."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.errors import InputError
from benchmark.weights.tensors import read_tensors
from generation.diffusion.checkpoint import load_denoiser, save_denoiser, write_bank
from generation.diffusion.denoiser import PACKAGED, DenoiserConfig, TrajectoryDenoiser
from generation.extensions.denoiser_training import loop as training
from generation.extensions.denoiser_training.card import write_model_card
from generation.extensions.denoiser_training.loop import TrainingConfig, train_denoiser
from tests.generation.extensions.denoiser_training.test_tracks import drive, write_tracks

TINY = replace(PACKAGED, feature_dim=16, heads=2, layers=1, feedforward_dim=16)

REFERENCE_LIKE = DenoiserConfig(feature_dim=16, heads=2, layers=1, feedforward_dim=16)


def config(folder: Path, out: Path, **changes: object) -> TrainingConfig:
    base = TrainingConfig(folder, out, steps=6, batch=8, warmup=2, checkpoint_every=2, stride_s=0.5, denoiser=TINY)
    return replace(base, **changes)  # type: ignore[arg-type]


@pytest.fixture
def tracks(tmp_path: Path) -> Path:
    torch.set_num_threads(1)
    folder = tmp_path / "tracks"
    folder.mkdir()
    rng = np.random.default_rng(0)
    made = [drive(np.clip(rng.uniform(3, 15) + 0.1 * rng.uniform(-1, 1) * np.arange(120), 0, 20)) for _ in range(6)]
    write_tracks(folder / "made_up.npz", made)
    return folder


def weights(path: Path) -> dict[str, torch.Tensor]:
    return read_tensors(path)[0]


@pytest.mark.path
def test_interrupted_training_ends_with_the_same_bytes(tracks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    straight = train_denoiser(config(tracks, tracks.parent / "a.safetensors"))
    taken = training._take_step

    def dies(run: object, settings: object, actions: object, step: int) -> float:
        if step == 5:
            raise KeyboardInterrupt
        return taken(run, settings, actions, step)  # type: ignore[arg-type]

    monkeypatch.setattr(training, "_take_step", dies)
    out = tracks.parent / "b.safetensors"
    with pytest.raises(KeyboardInterrupt):
        train_denoiser(config(tracks, out))
    monkeypatch.undo()
    assert not out.exists()
    assert out.with_suffix(".progress.safetensors").exists()
    assert train_denoiser(config(tracks, out)).read_bytes() == straight.read_bytes()
    assert out.with_suffix(".log.jsonl").read_bytes() == straight.with_suffix(".log.jsonl").read_bytes()
    assert not out.with_suffix(".progress.safetensors").exists()
    assert [json.loads(row)["step"] for row in out.with_suffix(".log.jsonl").read_text().splitlines()] == [2, 4, 6]
    other = weights(train_denoiser(config(tracks, tracks.parent / "c.safetensors", seed=1)))
    changed = {name.split(".")[0] for name, value in weights(straight).items() if not value.equal(other[name])}
    assert len(changed) > 1


def test_held_out_sources_are_not_learnt_from(tracks: Path) -> None:
    once = {"checkpoint_every": 6}
    alone = train_denoiser(config(tracks, tracks.parent / "a.safetensors", **once))
    write_tracks(tracks / "interaction_sample.npz", [drive(np.full(150, 6.0), 0.3)])
    beside = train_denoiser(config(tracks, tracks.parent / "b.safetensors", **once))
    assert all(torch.equal(weights(alone)[name], weights(beside)[name]) for name in weights(alone))
    log = [json.loads(row) for row in beside.with_suffix(".log.jsonl").read_text().splitlines()]
    assert all(row["held_out_loss"] > 0 and row["held_out_loss_of_rounds"] > 0 for row in log)


def test_the_state_that_is_best_on_held_out_windows_is_kept(tracks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_tracks(tracks / "interaction_sample.npz", [drive(np.full(150, 6.0), 0.3)])
    checks = iter([0.5, 0.3, 0.4])
    checked = training._evaluate_held_out

    def told(*arguments: Any) -> dict[str, float | None]:
        loss = next(checks, None)
        if loss is None:
            raise RuntimeError
        return {**checked(*arguments), "held_out_loss": loss}

    monkeypatch.setattr(training, "_evaluate_held_out", told)
    best = read_tensors(train_denoiser(config(tracks, tracks.parent / "a.safetensors")))
    assert best[1]["best_step"] == 4
    stopped, checks = tracks.parent / "b.safetensors", iter([0.5, 0.3])
    # The third check finds no number: what was best until then is there.
    with pytest.raises(RuntimeError):
        train_denoiser(config(tracks, stopped))
    kept = weights(stopped)
    assert all(torch.equal(best[0][name], kept[name]) for name in kept)
    # Stored in half precision, but for the Gaussian.
    assert {name.split(".")[0] for name, tensor in kept.items() if tensor.dtype != torch.float16} == {"preconditioner"}


def test_published_architecture_can_be_trained(tracks: Path) -> None:
    asked = config(tracks, tracks.parent / "a.safetensors", batch=2, steps=1).of_architecture("published")
    assert asked.denoiser == DenoiserConfig()
    assert asked.learning_rate < config(tracks, tracks).learning_rate
    learnt = load_denoiser(train_denoiser(asked))
    assert sum(parameter.numel() for parameter in learnt.parameters()) == 6_717_187


@pytest.mark.slow
def test_a_network_learns_to_use_what_it_is_told(tracks: Path) -> None:
    """Slow cars speed up and fast ones slow down here, so the present speed says much."""
    slow, fast = np.clip(2 + 0.1 * np.arange(120), 0, 14), np.clip(14 - 0.1 * np.arange(120), 2, 14)
    write_tracks(tracks / "made_up.npz", [drive(slow), drive(fast)] * 3)
    write_tracks(tracks / "interaction_sample.npz", [drive(slow + 0.2), drive(fast - 0.1)])
    out = tracks.parent / "a.safetensors"
    train_denoiser(config(tracks, out, steps=300, batch=64, checkpoint_every=300, size_jitter=0.0))
    (row,) = [json.loads(row) for row in out.with_suffix(".log.jsonl").read_text().splitlines()]
    assert row["held_out_loss"] < 0.95 * row["held_out_loss_untold"]


def test_noise_levels_need_a_positive_power(tracks: Path) -> None:
    with pytest.raises(InputError, match="power of the noise levels"):
        config(tracks, tracks.parent / "a.safetensors", level_power=0.0)


def test_learning_lowers_the_loss(tracks: Path) -> None:
    out = tracks.parent / "a.safetensors"
    plain = replace(REFERENCE_LIKE, history_tokens=0, far_logit_bias=0.0, noise_level_scale=100.0, dropout=0.0)
    learnt = train_denoiser(config(tracks, out, steps=60, batch=32, checkpoint_every=20, warmup=10, denoiser=plain))
    assert load_denoiser(learnt).config == plain
    losses = [json.loads(row)["loss"] for row in out.with_suffix(".log.jsonl").read_text().splitlines()]
    assert losses[-1] < 0.7 * losses[0]


def test_progress_of_another_run_is_refused(tracks: Path) -> None:
    out = tracks.parent / "a.safetensors"
    done = train_denoiser(config(tracks, out, steps=2))
    done.rename(out.with_suffix(".progress.safetensors"))
    with pytest.raises(InputError, match="other settings"):
        train_denoiser(config(tracks, out))


def test_nothing_to_learn_from_is_refused(tracks: Path) -> None:
    (tracks / "made_up.npz").rename(tracks / "interaction_sample.npz")
    with pytest.raises(InputError, match="outside the held-out sources"):
        train_denoiser(config(tracks, tracks.parent / "a.safetensors"))


@pytest.fixture
def trained(tmp_path: Path) -> Path:
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


def test_card_says_what_was_learnt_from_and_that_nothing_was_measured(trained: Path) -> None:
    text = write_model_card(trained, trained.parent).read_text()
    assert "Not made." in text and "docs/studies/trajectory-model.md" in text
    assert "Not trained on, they only check the result: INTERACTION." in text
    measured = write_model_card(trained, trained.parent, ["## Measured here\n"]).read_text()
    assert measured == text.partition("## Measurements")[0] + "## Measured here\n"


def test_card_without_held_out_sources_names_none(trained: Path) -> None:
    (trained.parent / "interaction_sample.npz").unlink()
    assert "INTERACTION" not in write_model_card(trained, trained.parent).read_text()


def test_weights_that_do_not_say_how_they_were_trained_have_no_card(trained: Path) -> None:
    save_denoiser(trained, load_denoiser(trained), {"seed": 0})
    with pytest.raises(InputError, match="does not record its batch, licences, steps, windows"):
        write_model_card(trained, trained.parent)
