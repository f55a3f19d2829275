"""The denoiser against an obvious loop version of itself, and against the reference's numbers where they are."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion import schedule
from generation.diffusion.denoiser import PACKAGED, DenoiserConfig, TrajectoryDenoiser
from generation.diffusion.preconditioning import compute_present_features

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
OWN_GOLDEN = GOLDEN / "denoiser" / "small.npz"
SMALL = DenoiserConfig(feature_dim=16, heads=2, layers=2, feedforward_dim=24)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def synthetic(denoiser: TrajectoryDenoiser) -> TrajectoryDenoiser:
    """Weights that are a plain function of name and shape, so that no file is needed."""
    state = {}
    for number, (name, tensor) in enumerate(sorted(denoiser.state_dict().items())):
        ramp = np.arange(tensor.numel(), dtype=np.float64)
        value = np.sin(1.7 * ramp + number) / math.sqrt(tensor.shape[-1])
        state[name] = torch.from_numpy(value.reshape(tensor.shape)).to(torch.float32)
    denoiser.load_state_dict(state)
    return denoiser.eval()


def small_input() -> Floats:
    return np.asarray(np.cos(0.37 * np.arange(2 * 16 * 3)).reshape(2, 16, 3))


def norm(row: Floats, weight: Floats, bias: Floats) -> Floats:
    return np.asarray((row - row.mean()) / np.sqrt(row.var() + 1e-5) * weight + bias)


def rotate(row: Floats, position: int) -> Floats:
    out = row.copy()
    for pair in range(len(row) // 2):
        angle = position * 1e4 ** (-2 * pair / len(row))
        even, odd = row[2 * pair], row[2 * pair + 1]
        out[2 * pair] = even * math.cos(angle) - odd * math.sin(angle)
        out[2 * pair + 1] = odd * math.cos(angle) + even * math.sin(angle)
    return out


def loop_attention(h: Floats, kinds: list[int], config: DenoiserConfig, w: dict[str, Floats], at: str) -> Floats:
    """One token, one head at a time."""
    width, size = config.feature_dim, config.feature_dim // config.heads
    query: list[Floats] = []
    key: list[Floats] = []
    value: list[Floats] = []
    for token, row in enumerate(h):
        typed = row + w["type_embedding.weight"][kinds[token]]
        for rows, source, part in ((query, typed, 0), (key, typed, 1), (value, row, 2)):
            inside = slice(part * width, (part + 1) * width)
            projected = w[at + "sa1.in_proj_weight"][inside] @ source + w[at + "sa1.in_proj_bias"][inside]
            rows.append(projected if part == 2 else rotate(projected, token))
    out = np.zeros_like(h)
    for head in range(config.heads):
        mine = slice(head * size, (head + 1) * size)
        for i in range(len(h)):
            logits = np.array([query[i][mine] @ key[j][mine] / math.sqrt(size) for j in range(len(h))])
            logits += [config.far_logit_bias if abs(i - j) > 1 else 0.0 for j in range(len(h))]
            weight = np.exp(logits - logits.max())
            out[i, mine] = sum(weight[j] / weight.sum() * value[j][mine] for j in range(len(h)))
    return out @ w[at + "sa1.out_proj.weight"].T + w[at + "sa1.out_proj.bias"]


def loop_denoise(config: DenoiserConfig, state: dict[str, Any], noisy: Floats, timestep: int) -> Floats:
    """The specification word by word, in float64, for one trajectory (16, 3)."""
    w = {name: np.asarray(tensor.numpy(), np.float64) for name, tensor in state.items()}

    def mlp(row: Floats, name: str, first: int, second: int) -> Floats:
        hidden = np.maximum(w[f"{name}.{first}.weight"] @ row + w[f"{name}.{first}.bias"], 0)
        return np.asarray(w[f"{name}.{second}.weight"] @ hidden + w[f"{name}.{second}.bias"])

    tokens = [mlp(np.zeros(7), "history_encoder", 0, 2) for _ in range(config.history_tokens)]
    tokens += [w["trajectory_encoder.weight"] @ row + w["trajectory_encoder.bias"] for row in noisy]
    half = config.feature_dim // 2
    frequencies = np.exp(-np.arange(half) * math.log(1e4) / (half - 1))
    angles = timestep / 100 * config.noise_level_scale * frequencies
    sigma = mlp(np.concatenate([np.sin(angles), np.cos(angles)]), "sigma_encoder", 1, 3)
    projection, shift = w["sigma_proj_layer.weight"], w["sigma_proj_layer.bias"]
    h = np.stack([projection @ np.concatenate([token, sigma]) + shift for token in tokens])
    kinds = [0] * config.history_tokens + [1] * 16
    for layer in range(config.layers):
        at = f"global_attention_layers.{layer}."
        h = h + loop_attention(h, kinds, config, w, at)
        h = np.stack([norm(row, w[at + "norm_1.weight"], w[at + "norm_1.bias"]) for row in h])
        h = h + np.stack([mlp(row, at + "ffn_12", 0, 3) for row in h])
        h = np.stack([norm(row, w[at + "norm_122.weight"], w[at + "norm_122.bias"]) for row in h])
    return np.stack([mlp(row, "decoder_mlp", 0, 2) for row in h[-16:]])


@pytest.mark.parametrize(
    "config",
    [SMALL, DenoiserConfig(16, 2, 2, 24, history_tokens=0, far_logit_bias=0.0, noise_level_scale=100.0)],
    ids=["reference habits", "without them"],
)
def test_network_equals_the_obvious_loops(config: DenoiserConfig) -> None:
    denoiser = synthetic(TrajectoryDenoiser(config))
    noisy = small_input()
    for timestep in (0, 4, 99):
        with torch.inference_mode():
            fast = denoiser(torch.from_numpy(noisy).float(), torch.tensor([float(timestep)])).numpy()
        slow = np.stack([loop_denoise(config, denoiser.state_dict(), row, timestep) for row in noisy])
        assert np.abs(fast - slow).max() < 1e-5
        assert np.abs(slow).max() > 0.1


def test_network_equals_the_packaged_numbers() -> None:
    """Numbers made once by the loops; they catch a change of both versions and a broken linear algebra library."""
    denoiser = synthetic(TrajectoryDenoiser(SMALL))
    with np.load(OWN_GOLDEN) as golden, torch.inference_mode():
        noisy = torch.from_numpy(golden["noisy"])
        for timestep in (0, 4, 99):
            answer = denoiser(noisy, torch.tensor([float(timestep)])).numpy()
            assert np.abs(answer - golden[f"noise_t{timestep}"]).max() < 1e-5


def test_far_tokens_are_not_hidden_but_favoured() -> None:
    noisy = torch.from_numpy(small_input()).float()
    at = torch.tensor([10.0])
    moved = noisy.clone()
    moved[:, 15] += 1.0
    with torch.inference_mode():
        favoured = synthetic(TrajectoryDenoiser(SMALL))
        # Two layers of a hard mask would reach two tokens far, and leave the first one exactly as it was.
        assert (favoured(moved, at)[:, 0] - favoured(noisy, at)[:, 0]).abs().max() > 1e-6
        plain = synthetic(TrajectoryDenoiser(DenoiserConfig(16, 2, 2, 24, far_logit_bias=0.0)))
        assert (favoured(noisy, at) - plain(noisy, at)).abs().max() > 1e-5


def test_published_checkpoint_has_this_shape() -> None:
    denoiser = TrajectoryDenoiser()
    state = denoiser.state_dict()
    assert len(state) == 113
    assert sum(tensor.numel() for tensor in state.values()) == 6_717_187
    assert state["global_attention_layers.7.sa1.in_proj_weight"].shape == (768, 256)
    assert state["sigma_proj_layer.weight"].shape == (256, 512)


@pytest.mark.parametrize("fields", [{"layers": 0}, {"feature_dim": 60, "heads": 8}, {"history_tokens": -1}])
def test_impossible_shapes_are_refused(fields: dict[str, int]) -> None:
    with pytest.raises(InputError, match="denoiser"):
        DenoiserConfig(**fields)  # type: ignore[arg-type]


def test_only_a_network_without_attention_can_be_told_the_speed() -> None:
    with pytest.raises(InputError, match="without attention"):
        DenoiserConfig(conditioned=True)


def test_gaussian_knows_all_about_gaussian_data() -> None:
    """The network is silent before training: the preconditioner alone is the exact posterior mean of Gaussian data."""
    rng = np.random.default_rng(3)
    mix = rng.standard_normal((48, 48)) * np.geomspace(1e-3, 0.3, 48)
    clean = (rng.standard_normal((20_000, 48)) @ mix.T + 0.05).reshape(-1, 16, 3)
    denoiser = TrajectoryDenoiser(PACKAGED).eval()
    assert denoiser.preconditioner is not None
    standing = torch.zeros(len(clean), 3)
    denoiser.preconditioner.fit(clean, compute_present_features(standing))
    covariance, mean = np.cov(clean.reshape(-1, 48).T, ddof=0), clean.reshape(-1, 48).mean(0)
    for timestep in (0, 30, 99):
        noise = rng.standard_normal((64, 16, 3))
        noisy = schedule.add_noise(torch.from_numpy(clean[:64]), torch.from_numpy(noise), timestep).float()
        signal, spread = schedule.get_signal_and_noise(timestep)
        gain = np.linalg.solve(signal**2 * covariance + spread**2 * np.eye(48), spread * np.eye(48))
        expected = (noisy.numpy().reshape(64, 48) - signal * mean) @ gain
        with torch.inference_mode():
            answer = denoiser(noisy, torch.tensor([float(timestep)])).numpy().reshape(64, 48)
        assert np.abs(answer - expected).max() < 2e-3 * np.abs(expected).max()
