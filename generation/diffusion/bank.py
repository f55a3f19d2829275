"""Actions sampled in advance: the model is unconditional, so its samples do not depend on the scene."""

from pathlib import Path
from typing import Final

import numpy as np
import torch

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.progress import Count, progress
from benchmark.machine.storage import content_seed, file_sha256
from benchmark.weights.tensors import read_tensors, write_tensors
from generation.diffusion.checkpoint import load_denoiser
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.diffusion.network_calls import device_of
from generation.diffusion.schedule import STEPS, reverse, strided_timesteps
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

BANK_SIZE: Final = 4096
CHUNK: Final = 256


def bank_beside(weights: Path) -> Path:
    """Bank of a weights file: ``NAME.bank.safetensors`` beside it."""
    return weights.with_suffix(".bank.safetensors")


def normal_noise(rng: np.random.Generator, count: int) -> torch.Tensor:
    """(count, 16, 3) standard normal, drawn in float64 so that it is the same everywhere."""
    return torch.from_numpy(rng.standard_normal((count, WAYPOINTS, CHANNELS)).astype(np.float32))


def sample_actions(denoiser: TrajectoryDenoiser, count: int, steps: int | None, rng: np.random.Generator) -> Floats:
    """The full reverse process from noise, with the reference's small stochasticity.

    (count, 16, 3) standardised actions, told nothing of the vehicle; ``steps`` of ``None`` asks the network at each
    of the 100.
    """
    device = next(denoiser.parameters()).device

    def draw() -> torch.Tensor:
        return normal_noise(rng, count).to(device)

    with torch.inference_mode():
        actions = reverse(denoiser, denoiser.start(draw()), strided_timesteps(STEPS - 1, steps), draw=draw)
    return actions.cpu().numpy().astype(np.float64)


def write_bank(weights: Path, *, count: int = BANK_SIZE, seed: int = 0, device: str = "cpu") -> Path:
    """Sample a bank of actions by the full reverse process and write it beside the weights.

    Args:
        weights: A file that `load_denoiser` reads.
        count: Trajectories.
        seed: Recorded in the file.
        device: Where the network runs.

    Returns:
        The bank file: float16, with the SHA-256 of the weights that made it.

    Raises:
        InputError: If weights or device cannot be used or the bank not be written.
    """
    if count < 1:
        raise InputError(f"a bank needs at least one trajectory, got {count}")
    denoiser, digest = load_denoiser(weights).to(device_of(device)), file_sha256(weights)
    sizes = [min(CHUNK, count - start) for start in range(0, count, CHUNK)]
    chunks = (
        sample_actions(denoiser, size, None, np.random.default_rng(content_seed("bank", seed, chunk)))
        for chunk, size in enumerate(sizes)
    )
    trajectories = Count("trajectory", total=count, each=len)
    actions = np.concatenate(list(progress(chunks, total=len(sizes), label="sampling bank", count=trajectories)))
    held = torch.from_numpy(actions).to(torch.float16)
    facts = {"weights_sha256": digest, "seed": seed, "count": count, "steps": STEPS}
    write_tensors(bank_beside(weights), {"actions": held}, facts)
    return bank_beside(weights)


def read_bank(path: Path, weights: Path) -> Floats:
    """Read a bank, (N, 16, 3) actions; it must have been made from ``weights``."""
    tensors, facts = read_tensors(path)
    if facts.get("weights_sha256") != file_sha256(weights):
        raise InputError(f"the bank {path} was not sampled from {weights}; remove it or sample it again")
    actions = tensors.get("actions", torch.empty(0)).to(torch.float64).numpy()
    if actions.ndim != 3 or actions.shape[1:] != (WAYPOINTS, CHANNELS) or not np.isfinite(actions).all():
        raise InputError(f"the bank {path} does not hold (N, {WAYPOINTS}, {CHANNELS}) finite actions; sample it again")
    return np.asarray(actions)
