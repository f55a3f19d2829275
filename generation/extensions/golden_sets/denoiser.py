"""`challenger-bench verify denoiser`: the published architecture against golden outputs with synthetic weights."""

from pathlib import Path
from typing import Final

import numpy as np
import torch

from benchmark.errors import InputError
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.filled_networks import fill, same_names_and_shapes
from benchmark.verification.golden import GoldenArrays, golden_directory
from benchmark.verification.synthetic_weights import WeightsRecipe, read_recipe, read_shapes, seeded_normal
from generation.diffusion.denoiser import HISTORY_CHANNELS, TrajectoryDenoiser
from generation.diffusion.schedule import ALPHA_BARS, BETAS, STEPS, reverse_step, strided_timesteps
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.processes import Parity, compare_processes
from generation.extensions.golden_sets.trajectories import compare_trajectories

CALL_TOLERANCE: Final = 2e-5
"""One call of the network in single precision."""
SINGLE_PRECISION: Final = 1e-6
"""Of numbers of about one that the reference computed in single precision."""
NOISE: Final = "noise by name"
NOT_COMPARED: Final = {"history_features_ignored": "the reference discards it and the network here has no such input"}


def verify_denoiser(golden: Path | None = None) -> list[Check]:
    """Compare the network, its schedule and its processes with a golden set.

    Args:
        golden: Directory with ``keys.json``, ``manifest.json``, ``schedule.npz`` and ``parity.npz``; the built-in set
            by default.

    Returns:
        One check for each quantity; the first alone if names or shapes differ, since weights cannot be filled then.

    Raises:
        InputError: If the set cannot be used.
    """
    names = ("parity.npz", "keys.json", "manifest.json", "schedule.npz")
    folder = golden_directory(golden or BUILT_IN / "denoiser", "denoiser", *names)
    recipe, shapes = read_recipe(folder / "manifest.json", WeightsRecipe), read_shapes(folder / "keys.json")
    schedule, stored = GoldenArrays.read(folder / "schedule.npz"), GoldenArrays.read(folder / "parity.npz")
    comparison = Comparison()
    network = TrajectoryDenoiser().eval()
    if not same_names_and_shapes(comparison, network, shapes, said="{elements:,} parameters"):
        return comparison.checks()
    fill(comparison, network, recipe, shapes, None, folder / "manifest.json")
    _compare_schedule(comparison, schedule)
    parity = Parity(stored, network)
    with torch.inference_mode():
        _compare_parts(comparison, parity, recipe)
        _compare_calls(comparison, parity)
        compare_trajectories(comparison, parity)
        compare_processes(comparison, parity)
    left_out = [f"{name} ({NOT_COMPARED.get(name, 'unknown here')})" for name in sorted(stored.names - parity.taken)]
    if left_out:
        comparison.note(NOISE, f"not compared: {', '.join(left_out)}")
    return comparison.checks()


def _compare_schedule(comparison: Comparison, stored: GoldenArrays) -> None:
    """Noise levels, and at which of them the network is asked."""
    betas = stored.floats("betas", STEPS)
    comparison.numbers("schedule: betas", BETAS, betas, SINGLE_PRECISION)
    comparison.numbers("schedule: alphas", 1.0 - BETAS, stored.floats("alphas", STEPS), SINGLE_PRECISION)
    bars = stored.floats("alphas_cumprod", STEPS)
    comparison.numbers("schedule: products of alphas", ALPHA_BARS, bars, SINGLE_PRECISION)
    clean, silence = torch.full((1, 1, 1), 0.5, dtype=torch.float64), torch.zeros((1, 1, 1), dtype=torch.float64)
    last = (reverse_step(ALPHA_BARS[0] ** 0.5 * clean, silence, 0, -1) / clean) ** 2
    final = stored.floats("final_alpha_cumprod")
    comparison.numbers("schedule: product after the last step", last.numpy().reshape(()), final, SINGLE_PRECISION)
    timesteps = stored.integers("timesteps", STEPS)
    comparison.verdicts("schedule: timesteps", timesteps != np.array(strided_timesteps(STEPS - 1, None)))


def _compare_parts(comparison: Comparison, parity: Parity, recipe: WeightsRecipe) -> None:
    """What the network makes before the transformer."""
    noise, network = parity.actions("noise"), parity.network
    drawn = seeded_normal("noise", (len(noise), noise[0].numel()), recipe.salt).reshape(noise.shape)
    comparison.numbers(NOISE, drawn, noise.numpy(), SINGLE_PRECISION)
    history, width = network.config.history_tokens, network.config.feature_dim
    if "scene_features" in parity.stored.names:
        silence = torch.zeros(1, history, HISTORY_CHANNELS)
        golden = parity.floats("scene_features", None, history, width)
        ours = network.history_encoder(silence).expand(golden.shape).numpy()
        comparison.numbers("history tokens", ours, golden, CALL_TOLERANCE)
    if "scene_type_embedding" in parity.stored.names:
        golden = parity.floats("scene_type_embedding", None, history, width)
        ours = network.type_embedding.weight[0].expand(golden.shape).numpy()
        comparison.numbers("type of history tokens", ours, golden, SINGLE_PRECISION)
    for timestep in parity.numbered("sigma_sinusoid_t"):
        golden = parity.floats(f"sigma_sinusoid_t{timestep}", None, 1, width)
        level = torch.full((len(golden),), timestep / STEPS)
        ours = network.sigma_encoder[0](level)[:, None].numpy()
        comparison.numbers("noise level features", ours, golden, SINGLE_PRECISION, where=f"timestep {timestep}")


def _compare_calls(comparison: Comparison, parity: Parity) -> None:
    """Single calls of the network."""
    noise = parity.actions("noise")
    timesteps = parity.numbered("denoise_t")
    if not timesteps:
        raise InputError(f"{parity.stored.path} has no array denoise_t0 or of another timestep; make it again")
    for timestep in timesteps:
        ours = parity.call(noise, timestep).numpy()
        golden = parity.actions(f"denoise_t{timestep}", len(noise)).numpy()
        comparison.numbers("predicted noise", ours, golden, CALL_TOLERANCE, where=f"timestep {timestep}")
    comparison.note("predicted noise", f"timesteps {', '.join(map(str, timesteps))}")
