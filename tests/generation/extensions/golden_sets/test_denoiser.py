"""`verify denoiser` on sets of a stranger, with wrong numbers and with wrong descriptions."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.verification.checks import format_report
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.denoiser import GOLDEN as DENOISER
from tests.benchmark.verification.damaged import said
from tests.generation.extensions.golden_sets.golden_copies import change, failures, load, save, shifted


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def slim(tmp_path: Path) -> Path:
    """The built-in denoiser set with one trajectory and few processes, because a call of the network takes time."""
    folder = Path(shutil.copytree(BUILT_IN / "denoiser", tmp_path / "slim"))
    arrays = load(folder / "parity.npz")
    dropped = ("trunc50", "trunc5", "trunc4", "clip_active", "stoch_t50", "stoch_t4")
    kept = {name: value for name, value in arrays.items() if not name.startswith(dropped)}
    save(folder / "parity.npz", {n: v if n.startswith("aug") or not v.shape else v[:1] for n, v in kept.items()})
    return folder


def test_wrong_denoiser_outputs_fail_where_they_are_wrong(slim: Path) -> None:
    change(
        slim / "parity.npz",
        denoise_t25=shifted(1e-4, 0, 5),
        trunc3_eta0_actions=shifted(1e-4, 0, 5),
        stoch_t10=shifted(1e-4, 0, 5),
        full_eta0_after_t50=shifted(1e-4, 0, 5),
        aug_out=shifted(1.0, 3, 5),
    )
    change(slim / "schedule.npz", betas=shifted(1e-5, 50), timesteps=shifted(1, 3))
    checks = DENOISER.verify(slim)
    assert failures(checks) == {
        "predicted noise", "truncated reverse processes", "stochastic steps", "full reverse process, on the way",
        "varied first batch (of the largest)", "schedule: betas", "schedule: timesteps",
    }  # fmt: skip
    assert "worst in timestep 25" in next(check.note for check in checks if check.quantity == "predicted noise")


def test_silent_zeros_fail(slim: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TrajectoryDenoiser, "forward", lambda self, noisy, timesteps: torch.zeros_like(noisy))
    assert {"predicted noise", "full reverse process", "stochastic steps"} <= failures(DENOISER.verify(slim))


def test_another_architecture_is_said_first_and_nothing_else(slim: Path) -> None:
    keys = json.loads((slim / "keys.json").read_text())
    keys["sigma_proj_layer.weight"]["shape"] = [256, 511]
    (slim / "keys.json").write_text(json.dumps(keys))
    (check,) = DENOISER.verify(slim)
    assert not check.ok and check.error == 1 and "sigma_proj_layer.weight" in check.note


def test_another_salt_and_other_rules_need_other_numbers(slim: Path) -> None:
    for manifest in ({"salt": "other", "std_rules": {}}, {"salt": "dev", "std_rules": {"decoder_mlp": 0.3}}):
        (slim / "manifest.json").write_text(json.dumps(manifest))
        assert "predicted noise" in failures(DENOISER.verify(slim))


@pytest.mark.path
def test_a_set_of_another_size_agrees_and_every_array_is_compared_or_named(slim: Path) -> None:
    arrays = load(slim / "parity.npz")
    save(slim / "parity.npz", arrays | {"something_new": np.zeros(3)})
    checks = DENOISER.verify(slim)
    assert not failures(checks), format_report(checks)
    notes = " ".join(check.note for check in checks)
    assert "history_features_ignored (the reference discards it" in notes
    assert "something_new (unknown here)" in notes


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("manifest.json", "{"),
        ("manifest.json", '{"std_rules": {}}'),
        ("manifest.json", '{"salt": "dev", "std_rules": {"(": 1.0}}'),
        ("manifest.json", '{"salt": "dev", "kept_buffers": {"sigma_proj_layer.bias": [1.0]}}'),
        ("keys.json", "[1, 2]"),
        ("keys.json", '{"a": {"shape": "x"}}'),
    ],
)
def test_descriptions_that_are_wrong_are_one_sentence(slim: Path, name: str, text: str) -> None:
    (slim / name).write_text(text)
    said(DENOISER.verify, slim)
