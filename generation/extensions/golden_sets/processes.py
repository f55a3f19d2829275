"""Golden reverse processes of the denoiser: full, truncated, and single stochastic steps."""

import re
from typing import Final

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError
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

PROCESS_TOLERANCE: Final = 5e-5
"""A process of up to 100 calls in single precision, whose errors add up."""
NOISING_TOLERANCE: Final = 2e-5
"""A product and a sum in single precision, with factors whose small complements of one lose digits."""
ETA_TOLERANCE: Final = 1e-5
"""The reference takes the root of a small difference in single precision."""


class Parity:
    """The file ``parity.npz`` with the network that it is about; notes which arrays were asked for.

    Attributes:
        stored: The file.
        network: With the set's weights, in evaluation mode.
        taken: Names of arrays that were compared or used.
    """

    def __init__(self, stored: GoldenArrays, network: TrajectoryDenoiser) -> None:
        self.stored, self.network = stored, network
        self.taken: set[str] = set()

    def floats(self, name: str, *shape: int | None) -> Floats:
        """An array, see `GoldenArrays.floats`."""
        self.taken.add(name)
        return self.stored.floats(name, *shape)

    def actions(self, name: str, count: int | None = None) -> Tensor:
        """An array of B x 48 as (B, 16, 3) in single precision."""
        flat = self.floats(name, count, WAYPOINTS * CHANNELS).astype(np.float32)
        if not len(flat):
            raise InputError(f"array {name} in {self.stored.path} is empty; make the file again")
        return torch.from_numpy(flat).view(-1, WAYPOINTS, CHANNELS)

    def numbered(self, prefix: str, suffix: str = "", *, first: int = 0, last: int = STEPS - 1) -> list[int]:
        """Numbers between a prefix and a suffix in the names of arrays.

        Args:
            prefix: Start of the names.
            suffix: Their end.
            first: Smallest number that makes sense.
            last: Largest.

        Returns:
            The numbers, falling.

        Raises:
            InputError: If one makes no sense.
        """
        pattern = re.compile(f"{re.escape(prefix)}([0-9]+){re.escape(suffix)}")
        numbers = sorted((int(hit[1]) for name in self.stored.names if (hit := pattern.fullmatch(name))), reverse=True)
        if numbers and not first <= numbers[-1] <= numbers[0] <= last:
            raise InputError(
                f"{self.stored.path} has an array {prefix}N{suffix} with N outside {first} to {last}, which the "
                f"schedule of {STEPS} steps does not have; make the file again"
            )
        return numbers

    def call(self, noisy: Tensor, timestep: int) -> Tensor:
        """The network's answer at one timestep."""
        predicted: Tensor = self.network(noisy, torch.tensor([float(timestep)]))
        return predicted


def compare_processes(comparison: Comparison, parity: Parity) -> None:
    """Compare reverse processes.

    Args:
        comparison: Takes the results.
        parity: The golden numbers.

    Raises:
        InputError: If arrays are absent or do not fit.
    """
    _compare_full(comparison, parity)
    _compare_truncated(comparison, parity)
    _compare_stochastic(comparison, parity)


def _compare_full(comparison: Comparison, parity: Parity) -> None:
    """All 100 steps without chance, with the snapshots on the way that the set has."""
    noise = parity.actions("noise")
    after: dict[int, Tensor] = {}

    def observed(noisy: Tensor, timesteps: Tensor) -> Tensor:
        after[int(timesteps) + 1] = noisy
        answer: Tensor = parity.network(noisy, timesteps)
        return answer

    after[0] = reverse(observed, noise, strided_timesteps(STEPS - 1, None))
    for timestep in parity.numbered("full_eta0_after_t"):
        golden = parity.actions(f"full_eta0_after_t{timestep}", len(noise)).numpy()
        where, ours = f"timestep {timestep}", after[timestep].numpy()
        comparison.numbers("full reverse process, on the way", ours, golden, PROCESS_TOLERANCE, where=where)
    golden = parity.actions("full_eta0_actions", len(noise)).numpy()
    comparison.numbers("full reverse process", after[0].numpy(), golden, PROCESS_TOLERANCE)
    if "clip_active_fraction_full" in parity.stored.names:
        _compare_clipped(comparison, parity, noise)


def _compare_clipped(comparison: Comparison, parity: Parity, noise: Tensor) -> None:
    """Share of the clean sample predicted first that the clamp changes."""
    signal, spread = signal_and_noise(STEPS - 1)
    clean = (noise - spread * parity.call(noise, STEPS - 1)) / signal
    share = float((clean.abs() > CLAMP).to(torch.float64).mean())
    golden = parity.floats("clip_active_fraction_full")
    comparison.numbers("share that is clamped at first", np.array(share), golden, 1.0 / noise.numel())


def _compare_truncated(comparison: Comparison, parity: Parity) -> None:
    """Re-noising by some levels, and the way back."""
    clean = parity.actions("trunc_start_actions")
    fresh = parity.actions("renoise_eps", len(clean))
    levels = parity.numbered("trunc", "_eta0_actions", first=1, last=STEPS)
    if not levels:
        raise InputError(f"{parity.stored.path} has no array trunc5_eta0_actions or of another level; make it again")
    for level in levels:
        noised, where = add_noise(clean, fresh, level - 1), f"level {level}"
        golden = parity.actions(f"trunc{level}_noised", len(clean)).numpy()
        comparison.numbers("re-noised actions", noised.numpy(), golden, NOISING_TOLERANCE, where=where)
        ours = reverse(parity.network, noised, strided_timesteps(level - 1, None)).numpy()
        golden = parity.actions(f"trunc{level}_eta0_actions", len(clean)).numpy()
        comparison.numbers("truncated reverse processes", ours, golden, PROCESS_TOLERANCE, where=where)
    comparison.note("truncated reverse processes", f"levels {', '.join(map(str, levels))}")


def _compare_stochastic(comparison: Comparison, parity: Parity) -> None:
    """Single steps with the reference's noise in them."""
    noise = parity.actions("noise")
    fresh = parity.actions("step_noise", len(noise))
    timesteps = parity.numbered("stoch_t")
    if not timesteps:
        raise InputError(f"{parity.stored.path} has no array stoch_t99 or of another timestep; make it again")
    for timestep in timesteps:
        predicted, eta, where = parity.call(noise, timestep), reference_eta(timestep), f"timestep {timestep}"
        golden_eta = parity.floats(f"stoch_eta_t{timestep}")
        comparison.numbers("stochasticity of a step", np.array(eta), golden_eta, ETA_TOLERANCE, where=where)
        moved = reverse_step(noise, predicted, timestep, timestep - 1, eta=eta, fresh=fresh).numpy()
        golden = parity.actions(f"stoch_t{timestep}", len(noise)).numpy()
        comparison.numbers("stochastic steps", moved, golden, PROCESS_TOLERANCE, where=where)
        if f"stoch_x0_t{timestep}" in parity.stored.names:
            clean = reverse_step(noise, predicted, timestep, -1).numpy()
            golden = parity.actions(f"stoch_x0_t{timestep}", len(noise)).numpy()
            comparison.numbers("clean sample of a step", clean, golden, PROCESS_TOLERANCE, where=where)
