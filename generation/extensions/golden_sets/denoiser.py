"""`challenger-bench verify denoiser`: golden outputs with synthetic weights, waypoints, and reverse processes."""

import re
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from benchmark.geometry import Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.filled_networks import fill_network, have_same_names_and_shapes
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder, GoldenSet
from benchmark.verification.synthetic_weights import WeightsRecipe, draw_seeded_normal, read_shapes
from generation.diffusion.denoiser import HISTORY_CHANNELS, TrajectoryDenoiser
from generation.diffusion.prior import diversify
from generation.diffusion.schedule import (
    ALPHA_BARS,
    BETAS,
    CLAMP,
    STEPS,
    add_noise,
    choose_strided_timesteps,
    compute_reverse_step,
    get_reference_eta,
    get_signal_and_noise,
    run_reverse_process,
)
from generation.diffusion.standardiser import (
    CHANNELS,
    WAYPOINTS,
    convert_actions_to_waypoints,
    convert_waypoints_to_actions,
)
from generation.extensions.golden_sets.built_in import BUILT_IN


class ParityComparison:
    """The file ``parity.npz`` with the network that it is about; ``taken`` names the arrays that were asked for."""

    def __init__(self, comparison: Comparison, stored: GoldenArrays, network: TrajectoryDenoiser) -> None:
        self.comparison, self.stored, self.network = comparison, stored, network
        self.taken: set[str] = set()

    def floats(self, name: str, *shape: int | None) -> Floats:
        """An array, see `GoldenArrays.floats`."""
        self.taken.add(name)
        return self.stored.floats(name, *shape)

    def actions(self, name: str) -> Tensor:
        """An array of B x 48 as (B, 16, 3) in single precision."""
        flat = self.floats(name, None, WAYPOINTS * CHANNELS).astype(np.float32)
        return torch.from_numpy(flat).view(-1, WAYPOINTS, CHANNELS)

    def compare(self, quantity: str, ours: Tensor, name: str, where: str = "") -> None:
        """Compare actions with those of an array."""
        self.comparison.numbers(quantity, ours.numpy(), self.actions(name).numpy(), where=where)

    def find_numbers(self, prefix: str, suffix: str = "") -> list[int]:
        """Numbers between a prefix and a suffix in the names of arrays, falling."""
        pattern = re.compile(f"{re.escape(prefix)}([0-9]+){re.escape(suffix)}")
        return sorted((int(hit[1]) for name in self.stored.names if (hit := pattern.fullmatch(name))), reverse=True)

    def call(self, noisy: Tensor, timestep: int) -> Tensor:
        """The network's answer at one timestep."""
        predicted: Tensor = self.network(noisy, torch.tensor([float(timestep)]))
        return predicted


def compare_processes(parity: ParityComparison) -> None:
    """Compare reverse processes."""
    _compare_full(parity)
    _compare_truncated(parity)
    _compare_stochastic(parity)


def _compare_full(parity: ParityComparison) -> None:
    """All 100 steps without chance, with the snapshots on the way that the set has."""
    noise = parity.actions("noise")
    after: dict[int, Tensor] = {}

    def observed(noisy: Tensor, timesteps: Tensor) -> Tensor:
        after[int(timesteps) + 1] = noisy
        answer: Tensor = parity.network(noisy, timesteps)
        return answer

    after[0] = run_reverse_process(observed, noise, choose_strided_timesteps(STEPS - 1, None))
    for timestep in parity.find_numbers("full_eta0_after_t"):
        name, where = f"full_eta0_after_t{timestep}", f"timestep {timestep}"
        parity.compare("full reverse process, on the way", after[timestep], name, where)
    parity.compare("full reverse process", after[0], "full_eta0_actions")
    if "clip_active_fraction_full" in parity.stored.names:
        # Share of the clean sample predicted first that the clamp changes.
        signal, spread = get_signal_and_noise(STEPS - 1)
        clean = (noise - spread * parity.call(noise, STEPS - 1)) / signal
        share = float((clean.abs() > CLAMP).to(torch.float64).mean())
        golden = parity.floats("clip_active_fraction_full")
        parity.comparison.numbers("share that is clamped at first", share, golden, 1.0 / noise.numel())


def _compare_truncated(parity: ParityComparison) -> None:
    """Re-noising by some levels, and the way back."""
    clean, fresh = parity.actions("trunc_start_actions"), parity.actions("renoise_eps")
    levels = parity.find_numbers("trunc", "_eta0_actions")
    for level in levels:
        noised, where = add_noise(clean, fresh, level - 1), f"level {level}"
        parity.compare("re-noised actions", noised, f"trunc{level}_noised", where)
        ours = run_reverse_process(parity.network, noised, choose_strided_timesteps(level - 1, None))
        parity.compare("truncated reverse processes", ours, f"trunc{level}_eta0_actions", where)
    parity.comparison.note("truncated reverse processes", f"levels {', '.join(map(str, levels))}")


def _compare_stochastic(parity: ParityComparison) -> None:
    """Single steps with the reference's noise in them."""
    noise, fresh = parity.actions("noise"), parity.actions("step_noise")
    for timestep in parity.find_numbers("stoch_t"):
        predicted, eta, where = parity.call(noise, timestep), get_reference_eta(timestep), f"timestep {timestep}"
        parity.comparison.numbers("stochasticity of a step", eta, parity.floats(f"stoch_eta_t{timestep}"), where=where)
        moved = compute_reverse_step(noise, predicted, timestep, timestep - 1, eta=eta, fresh=fresh)
        parity.compare("stochastic steps", moved, f"stoch_t{timestep}", where)
        if f"stoch_x0_t{timestep}" in parity.stored.names:
            clean = compute_reverse_step(noise, predicted, timestep, -1)
            parity.compare("clean sample of a step", clean, f"stoch_x0_t{timestep}", where)


class _ReplayedGenerator(np.random.Generator):
    """Gives back uniform numbers that were drawn elsewhere, one array for each call."""

    def __init__(self, *draws: Floats) -> None:
        super().__init__(np.random.PCG64(0))
        self._draws = list(draws)

    def random(self, size: Any = None, dtype: Any = np.float64, out: Any = None) -> Any:
        """The next array."""
        return self._draws.pop(0)


def compare_trajectories(parity: ParityComparison) -> None:
    """Compare waypoints: from rest, from a history and back, and quarters of a batch scaled by the stored draws."""
    actions = _read_waypoints(parity, "full_eta0_actions")
    still = convert_actions_to_waypoints(actions, np.zeros(CHANNELS))
    _compare_shares(parity, "waypoints from rest", still, "full_eta0_trajectory_zero_history")
    history = parity.floats("verlet_history", len(actions), None, None)[:, -2:, :CHANNELS]
    previous, now = history[:, 0], history[:, 1]
    ours, moved = convert_actions_to_waypoints(actions, previous, now), "verlet_untransform_with_history"
    _compare_shares(parity, "waypoints from a history", ours, moved)
    golden = _read_waypoints(parity, moved)
    ours, largest = convert_waypoints_to_actions(golden, previous, now), float(np.abs(golden).max(initial=1.0))
    _compare_shares(parity, "actions from waypoints", ours, "verlet_transform_back", largest)
    plain = _read_waypoints(parity, "aug_in")
    draws = [parity.floats(f"aug_u{part}", len(plain) // 4, 1)[:, 0] for part in (1, 2, 3)]
    _compare_shares(parity, "varied first batch", diversify(plain, _ReplayedGenerator(*draws)), "aug_out")


def _compare_shares(
    parity: ParityComparison, quantity: str, ours: Floats, name: str, largest: float | None = None
) -> None:
    """Compare as shares of the largest waypoint, in metres or radians but at least one."""
    golden = _read_waypoints(parity, name)
    scale = float(np.abs(golden).max(initial=1.0)) if largest is None else largest
    parity.comparison.numbers(f"{quantity} (of the largest)", ours / scale, golden / scale)


def _read_waypoints(parity: ParityComparison, name: str) -> Floats:
    """An array of B x 48 as (B, 16, 3) in double precision."""
    return parity.floats(name, None, WAYPOINTS * CHANNELS).reshape(-1, WAYPOINTS, CHANNELS)


NOISE: Final = "noise by name"
NOT_COMPARED: Final = {"history_features_ignored": "the reference discards it and the network here has no such input"}


def _compare_denoiser(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare the network, its schedule and its processes; names and shapes alone if they differ."""
    recipe = WeightsRecipe.model_validate(folder.facts("manifest.json"))
    shapes, network = read_shapes(folder.facts("keys.json")), TrajectoryDenoiser().eval()
    if not have_same_names_and_shapes(comparison, network, shapes, said="{elements:,} parameters"):
        return
    fill_network(comparison, network, recipe, shapes)
    _compare_schedule(comparison, folder.arrays("schedule.npz"))
    parity = ParityComparison(comparison, folder.arrays("parity.npz"), network)
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
    last = (compute_reverse_step(ALPHA_BARS[0] ** 0.5 * clean, silence, 0, -1) / clean) ** 2
    comparison.numbers("schedule: betas", BETAS, stored.floats("betas", STEPS))
    comparison.numbers("schedule: alphas", 1.0 - BETAS, stored.floats("alphas", STEPS))
    comparison.numbers("schedule: products of alphas", ALPHA_BARS, stored.floats("alphas_cumprod", STEPS))
    comparison.numbers("schedule: product after the last step", last.item(), stored.floats("final_alpha_cumprod"))
    comparison.same(
        "schedule: timesteps", choose_strided_timesteps(STEPS - 1, None), stored.integers("timesteps", STEPS)
    )


def _compare_parts(parity: ParityComparison, recipe: WeightsRecipe) -> None:
    """Compare the outputs of the network before the transformer."""
    noise, network = parity.actions("noise"), parity.network
    drawn = draw_seeded_normal("noise", (len(noise), noise[0].numel()), recipe.salt).reshape(noise.shape)
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
    for timestep in parity.find_numbers("sigma_sinusoid_t"):
        golden = parity.floats(f"sigma_sinusoid_t{timestep}", None, 1, width)
        ours = network.sigma_encoder[0](torch.full((len(golden),), timestep / STEPS))[:, None]
        parity.comparison.numbers("noise level features", ours.numpy(), golden, where=f"timestep {timestep}")


def _compare_calls(parity: ParityComparison) -> None:
    """Single calls of the network."""
    noise, timesteps = parity.actions("noise"), parity.find_numbers("denoise_t")
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
