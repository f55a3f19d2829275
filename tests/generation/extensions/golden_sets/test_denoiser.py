"""`verify denoiser` on sets of a stranger, with wrong numbers and with wrong descriptions."""

import importlib.util
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.geometry import Floats
from benchmark.verification.checks import format_report
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.denoiser import GOLDEN as DENOISER
from tests.benchmark.verification.damaged import said
from tests.generation.extensions.golden_sets.golden_copies import Arrays, change, failures, load, save, shifted


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


def strangers_numbers(arrays: Arrays, keys: dict[str, Any], salt: str, rules: dict[str, float]) -> Arrays:
    """The arrays of a set with other weights and two trajectories, by the formulas of the specification in float64."""
    by_name = golden_weights()
    network = TrajectoryDenoiser().eval()
    weights = {name: by_name.tensor_for(name, tuple(entry["shape"]), salt, rules) for name, entry in keys.items()}
    network.load_state_dict({name: torch.from_numpy(value) for name, value in weights.items()})
    betas = np.linspace(1e-4**0.5, 0.02**0.5, 100) ** 2
    bars = np.cumprod(1.0 - betas)

    def call(noisy: Floats, timestep: int) -> Floats:
        asked = torch.from_numpy(noisy.reshape(-1, 16, 3)).float()
        with torch.inference_mode():
            return np.asarray(network(asked, torch.tensor([float(timestep)])).double().numpy().reshape(-1, 48))

    def step(noisy: Floats, timestep: int, eta: float = 0.0, fresh: Floats | float = 0.0) -> tuple[Floats, Floats]:
        here, there = bars[timestep], bars[timestep - 1] if timestep else 1.0
        epsilon = call(noisy, timestep)
        clean = np.clip((noisy - (1 - here) ** 0.5 * epsilon) / here**0.5, -1.0, 1.0)
        spread = eta * ((1 - there) / (1 - here) * (1 - here / there)) ** 0.5
        return there**0.5 * clean + (1 - there - spread**2) ** 0.5 * epsilon + spread * fresh, clean

    made = {name: value for name, value in arrays.items() if name.startswith(("aug", "stoch_eta", "sigma"))}
    noise = made["noise"] = by_name.normal("noise", (2, 48), salt)
    fresh = made["step_noise"] = by_name.normal("step", (2, 48), salt)
    made |= {f"denoise_t{timestep}": call(noise, timestep) for timestep in (3, 60)}
    for timestep in (99, 10):
        eta = float(arrays[f"stoch_eta_t{timestep}"])
        made[f"stoch_t{timestep}"], made[f"stoch_x0_t{timestep}"] = step(noise, timestep, eta, fresh)
    actions = noise
    for timestep in range(99, -1, -1):
        actions, _ = step(actions, timestep)
    made["full_eta0_actions"] = actions
    start = made["trunc_start_actions"] = np.clip(actions[::-1], -0.3, 0.3)
    made["renoise_eps"] = by_name.normal("renoise", (2, 48), salt)
    noised = made["trunc2_noised"] = bars[1] ** 0.5 * start + (1 - bars[1]) ** 0.5 * made["renoise_eps"]
    made["trunc2_eta0_actions"] = step(step(noised, 1)[0], 0)[0]
    history = made["verlet_history"] = by_name.normal("history", (2, 5, 7), salt)
    for name, (before, now) in {
        "full_eta0_trajectory_zero_history": np.zeros((2, 2, 3)),
        "verlet_untransform_with_history": history[:, -2:, :3].transpose(1, 0, 2),
    }.items():
        path = [before, now]
        for action in actions.reshape(2, 16, 3).transpose(1, 0, 2):
            path.append(2 * path[-1] - path[-2] + 4 * action)
        made[name] = np.stack(path[2:], axis=1).reshape(2, 48)
    made["verlet_transform_back"] = actions
    return {name: value.astype(np.float32) if value.ndim else value for name, value in made.items()}


def golden_weights() -> Any:
    path = Path(__file__).resolve().parents[3] / "golden" / "weights_by_name.py"
    found = importlib.util.spec_from_file_location("weights_by_name", path)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def test_a_strangers_set_agrees_whatever_its_salt_rules_batch_and_timesteps(slim: Path) -> None:
    rules = {"decoder_mlp": 0.1, r"norm_1\.": 0.7, "bias$": 0.05}
    (slim / "manifest.json").write_text(json.dumps({"salt": "a stranger's", "std_rules": rules, "made": "today"}))
    keys = json.loads((slim / "keys.json").read_text())
    save(slim / "parity.npz", strangers_numbers(load(slim / "parity.npz"), keys, "a stranger's", rules))
    checks = DENOISER.verify(slim)
    assert not failures(checks), format_report(checks)
    assert next(check.note for check in checks if check.quantity == "predicted noise") == "timesteps 60, 3"


def test_every_array_is_compared_or_named(slim: Path) -> None:
    arrays = load(slim / "parity.npz")
    save(slim / "parity.npz", arrays | {"something_new": np.zeros(3)})
    notes = " ".join(check.note for check in DENOISER.verify(slim))
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
