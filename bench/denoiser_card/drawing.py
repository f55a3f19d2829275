"""Where trajectories for given starts come from: a network asked for each start, or windows replayed."""

from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from torch import Tensor

from benchmark.geometry import Floats
from generation.diffusion.bank import normal_noise
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.diffusion.fast_sampling import solve, solver_timesteps
from generation.diffusion.kinematics import motion
from generation.diffusion.prior import SOLVER_CALLS
from generation.diffusion.residual_network import present_features
from generation.diffusion.schedule import Denoise
from generation.diffusion.standardiser import waypoints_from_actions

ATTEMPTS: Final = 64
CHUNK: Final = 256

Process = Callable[[Denoise, Tensor], Tensor]
"""Network and actions at the last timestep to clean actions."""
Source = Callable[[Floats, np.random.Generator], Floats]
"""(N, 3) poses half a second before each start to (N, 16, 3) actions, one for each start."""


def fast(calls: int = SOLVER_CALLS) -> Process:
    """The fast solver with so many calls."""
    return lambda denoise, noisy: solve(denoise, noisy, solver_timesteps(calls))


def asked(denoiser: TrajectoryDenoiser, process: Process | None = None) -> Source:
    """Samples of a network, told of each start how the vehicle moves there if it can be.

    Args:
        denoiser: In evaluation mode.
        process: From noise to actions; the fast solver by default.

    Returns:
        See `Source`.
    """
    process = process or fast()

    def draw(previous: Floats, rng: np.random.Generator) -> Floats:
        drawn = []
        for first in range(0, len(previous), CHUNK):
            poses = torch.from_numpy(previous[first : first + CHUNK].astype(np.float32))
            present = present_features(poses) if denoiser.config.conditioned else None

            def denoise(noisy: Tensor, timestep: Tensor, present: Tensor | None = present) -> Tensor:
                answer: Tensor = denoiser(noisy, timestep, present)
                return answer

            with torch.inference_mode():
                actions = process(denoise, denoiser.start(normal_noise(rng, len(poses)), present))
            drawn.append(actions.numpy().astype(np.float64))
        return np.concatenate(drawn)

    return draw


def replayed(actions: Floats) -> Source:
    """Actions of (A, 16, 3) drawn at random, whatever the start."""
    return lambda previous, rng: np.asarray(actions[rng.integers(0, len(actions), len(previous))])


def drawn_again(source: Source, previous: Floats, rng: np.random.Generator, attempts: int = ATTEMPTS) -> Floats:
    """Waypoints for each start, drawn again where a car could not drive them.

    Args:
        source: Gives actions.
        previous: (N, 3) poses half a second before each start.
        rng: Chance.
        attempts: Draws at most; 1 keeps the first whatever it is.

    Returns:
        (N, 16, 3) waypoints.
    """
    waypoints = waypoints_from_actions(source(previous, rng), previous)
    for _ in range(attempts - 1):
        bad = np.flatnonzero(motion(waypoints, previous).excess > 0)
        if not len(bad):
            break
        waypoints[bad] = waypoints_from_actions(source(previous[bad], rng), previous[bad])
    return waypoints
