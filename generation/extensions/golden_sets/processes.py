"""Golden reverse processes of the denoiser: full, truncated, and single stochastic steps."""

import re

import numpy as np
import torch
from torch import Tensor

from benchmark.geometry import Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.diffusion.schedule import (
    CLAMP,
    STEPS,
    add_noise,
    reference_eta,
    reverse,
    reverse_step,
    signal_and_noise,
    strided_timesteps,
)
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS


class Parity:
    """The file ``parity.npz`` with the network that it is about; notes which arrays were asked for.

    The network has the set's weights and is in evaluation mode; ``taken`` names the arrays.
    """

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

    def numbered(self, prefix: str, suffix: str = "") -> list[int]:
        """Numbers between a prefix and a suffix in the names of arrays, falling."""
        pattern = re.compile(f"{re.escape(prefix)}([0-9]+){re.escape(suffix)}")
        return sorted((int(hit[1]) for name in self.stored.names if (hit := pattern.fullmatch(name))), reverse=True)

    def call(self, noisy: Tensor, timestep: int) -> Tensor:
        """The network's answer at one timestep."""
        predicted: Tensor = self.network(noisy, torch.tensor([float(timestep)]))
        return predicted


def compare_processes(parity: Parity) -> None:
    """Compare reverse processes."""
    _compare_full(parity)
    _compare_truncated(parity)
    _compare_stochastic(parity)


def _compare_full(parity: Parity) -> None:
    """All 100 steps without chance, with the snapshots on the way that the set has."""
    noise = parity.actions("noise")
    after: dict[int, Tensor] = {}

    def observed(noisy: Tensor, timesteps: Tensor) -> Tensor:
        after[int(timesteps) + 1] = noisy
        answer: Tensor = parity.network(noisy, timesteps)
        return answer

    after[0] = reverse(observed, noise, strided_timesteps(STEPS - 1, None))
    for timestep in parity.numbered("full_eta0_after_t"):
        name, where = f"full_eta0_after_t{timestep}", f"timestep {timestep}"
        parity.compare("full reverse process, on the way", after[timestep], name, where)
    parity.compare("full reverse process", after[0], "full_eta0_actions")
    if "clip_active_fraction_full" in parity.stored.names:
        # Share of the clean sample predicted first that the clamp changes.
        signal, spread = signal_and_noise(STEPS - 1)
        clean = (noise - spread * parity.call(noise, STEPS - 1)) / signal
        share = float((clean.abs() > CLAMP).to(torch.float64).mean())
        golden = parity.floats("clip_active_fraction_full")
        parity.comparison.numbers("share that is clamped at first", share, golden, 1.0 / noise.numel())


def _compare_truncated(parity: Parity) -> None:
    """Re-noising by some levels, and the way back."""
    clean, fresh = parity.actions("trunc_start_actions"), parity.actions("renoise_eps")
    levels = parity.numbered("trunc", "_eta0_actions")
    for level in levels:
        noised, where = add_noise(clean, fresh, level - 1), f"level {level}"
        parity.compare("re-noised actions", noised, f"trunc{level}_noised", where)
        ours = reverse(parity.network, noised, strided_timesteps(level - 1, None))
        parity.compare("truncated reverse processes", ours, f"trunc{level}_eta0_actions", where)
    parity.comparison.note("truncated reverse processes", f"levels {', '.join(map(str, levels))}")


def _compare_stochastic(parity: Parity) -> None:
    """Single steps with the reference's noise in them."""
    noise, fresh = parity.actions("noise"), parity.actions("step_noise")
    for timestep in parity.numbered("stoch_t"):
        predicted, eta, where = parity.call(noise, timestep), reference_eta(timestep), f"timestep {timestep}"
        parity.comparison.numbers("stochasticity of a step", eta, parity.floats(f"stoch_eta_t{timestep}"), where=where)
        moved = reverse_step(noise, predicted, timestep, timestep - 1, eta=eta, fresh=fresh)
        parity.compare("stochastic steps", moved, f"stoch_t{timestep}", where)
        if f"stoch_x0_t{timestep}" in parity.stored.names:
            clean = reverse_step(noise, predicted, timestep, -1)
            parity.compare("clean sample of a step", clean, f"stoch_x0_t{timestep}", where)
