"""`challenger-bench verify denoiser`: the published architecture against golden outputs with synthetic weights."""

from typing import Final

import torch

from benchmark.verification.checks import Comparison
from benchmark.verification.filled_networks import fill, same_names_and_shapes
from benchmark.verification.golden import GoldenArrays, GoldenFolder, GoldenSet
from benchmark.verification.synthetic_weights import WeightsRecipe, read_shapes, seeded_normal
from generation.diffusion.denoiser import HISTORY_CHANNELS, TrajectoryDenoiser
from generation.diffusion.schedule import ALPHA_BARS, BETAS, STEPS, reverse_step, strided_timesteps
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.processes import Parity, compare_processes
from generation.extensions.golden_sets.trajectories import compare_trajectories

NOISE: Final = "noise by name"
NOT_COMPARED: Final = {"history_features_ignored": "the reference discards it and the network here has no such input"}


def _compare_denoiser(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare the network, its schedule and its processes; names and shapes alone if they differ."""
    recipe = WeightsRecipe.model_validate(folder.facts("manifest.json"))
    shapes, network = read_shapes(folder.facts("keys.json")), TrajectoryDenoiser().eval()
    if not same_names_and_shapes(comparison, network, shapes, said="{elements:,} parameters"):
        return
    fill(comparison, network, recipe, shapes)
    _compare_schedule(comparison, folder.arrays("schedule.npz"))
    parity = Parity(comparison, folder.arrays("parity.npz"), network)
    with torch.inference_mode():
        _compare_parts(parity, recipe)
        _compare_calls(parity)
        compare_trajectories(parity)
        compare_processes(parity)
    names = sorted(parity.stored.names - parity.taken)
    if left_out := [f"{name} ({NOT_COMPARED.get(name, 'unknown here')})" for name in names]:
        comparison.note(NOISE, f"not compared: {', '.join(left_out)}")


def _compare_schedule(comparison: Comparison, stored: GoldenArrays) -> None:
    """Noise levels, and at which of them the network is asked."""
    clean, silence = torch.full((1, 1, 1), 0.5, dtype=torch.float64), torch.zeros((1, 1, 1), dtype=torch.float64)
    last = (reverse_step(ALPHA_BARS[0] ** 0.5 * clean, silence, 0, -1) / clean) ** 2
    comparison.numbers("schedule: betas", BETAS, stored.floats("betas", STEPS))
    comparison.numbers("schedule: alphas", 1.0 - BETAS, stored.floats("alphas", STEPS))
    comparison.numbers("schedule: products of alphas", ALPHA_BARS, stored.floats("alphas_cumprod", STEPS))
    comparison.numbers("schedule: product after the last step", last.item(), stored.floats("final_alpha_cumprod"))
    comparison.same("schedule: timesteps", strided_timesteps(STEPS - 1, None), stored.integers("timesteps", STEPS))


def _compare_parts(parity: Parity, recipe: WeightsRecipe) -> None:
    """Compare the outputs of the network before the transformer."""
    noise, network = parity.actions("noise"), parity.network
    drawn = seeded_normal("noise", (len(noise), noise[0].numel()), recipe.salt).reshape(noise.shape)
    parity.comparison.numbers(NOISE, drawn, noise.numpy())
    history, width = network.config.history_tokens, network.config.feature_dim
    tokens = network.history_encoder(torch.zeros(1, history, HISTORY_CHANNELS))
    parts = {
        "history tokens": ("scene_features", tokens),
        "type of history tokens": ("scene_type_embedding", network.type_embedding.weight[0]),
    }
    for quantity, (name, ours) in parts.items():
        if name in parity.stored.names:
            golden = parity.floats(name, None, history, width)
            parity.comparison.numbers(quantity, ours.expand(golden.shape).numpy(), golden)
    for timestep in parity.numbered("sigma_sinusoid_t"):
        golden = parity.floats(f"sigma_sinusoid_t{timestep}", None, 1, width)
        ours = network.sigma_encoder[0](torch.full((len(golden),), timestep / STEPS))[:, None]
        parity.comparison.numbers("noise level features", ours.numpy(), golden, where=f"timestep {timestep}")


def _compare_calls(parity: Parity) -> None:
    """Single calls of the network."""
    noise, timesteps = parity.actions("noise"), parity.numbered("denoise_t")
    for timestep in timesteps:
        ours, where = parity.call(noise, timestep), f"timestep {timestep}"
        parity.compare("predicted noise", ours, f"denoise_t{timestep}", where)
    parity.comparison.note("predicted noise", f"timesteps {', '.join(map(str, timesteps))}")


GOLDEN: Final = GoldenSet(
    name="denoiser",
    files=("parity.npz", "keys.json", "manifest.json", "schedule.npz"),
    compare=(_compare_denoiser,),
    quantities={
        # Numbers of about one that the reference computed in single precision.
        NOISE: 1e-6,
        "schedule: *": 1e-6,
        "type of history tokens": 1e-6,
        "noise level features": 1e-6,
        # One call of the network in single precision.
        "history tokens": 2e-5,
        "predicted noise": 2e-5,
        # A product and a sum, with factors whose small complements of one lose digits.
        "re-noised actions": 2e-5,
        # The reference takes the root of a small difference.
        "stochasticity of a step": 1e-5,
        # The reference sums 16 steps in single precision, and here it is double.
        "* (of the largest)": 5e-6,
        # A process of up to 100 calls, whose errors add up.
        "*": 5e-5,
    },
    built_in=BUILT_IN / "denoiser",
)
