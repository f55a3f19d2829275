"""Where candidate trajectories come from: samples of the diffusion model, and small changes of earlier ones."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
import torch

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.storage import content_key, file_sha256
from generation.diffusion.bank import bank_beside, read_bank, sample_actions
from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, load_denoiser
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.diffusion.kinematics import motion
from generation.diffusion.schedule import add_noise, reverse, strided_timesteps
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS, actions_from_waypoints, waypoints_from_actions

EXACT_ROUNDS: Final = 8
"""Batches that exact sampling draws at most in search of drivable trajectories."""
SLOWER_X: Final = (0.2, 0.8)
FASTER_X: Final = (1.2, 1.8)
BOTH_AXES: Final = (0.5, 1.5)
"""Ranges of the reference's ``aug_traj``."""


@dataclass(frozen=True, slots=True)
class SamplerSettings:
    """How the network is asked.

    Attributes:
        steps: Network calls of a full reverse process; ``None`` is the reference's 100.
        mutation_steps: Network calls of a truncated one, spread over its steps; ``None`` is the reference's one per
            noise level. Two differ from five by less than what the noise of the last round changes (model card).
        stochastic: Whether reverse steps add the reference's small noise.
        drivable: Whether samples that no car could drive from the present speed are drawn again, and changes that
            make a candidate less drivable not made. The model does not know the speed: braking samples would drive a
            slow car backwards.
    """

    steps: int | None = None
    mutation_steps: int | None = 2
    stochastic: bool = True
    drivable: bool = True


class TrajectoryPrior:
    """What background vehicles could do in the next eight seconds (paper, Diffusion Trajectory Generator).

    Waypoints are (B, 16, 3): x, y, heading at 2 Hz over 8 s, metres and radians, in the rear-axle frame of the vehicle
    now, x forward. Results depend on the arguments and the state of the generator only; numerical libraries are
    expected to use one thread (`benchmark.workers.single_threaded`).

    Attributes:
        fingerprint: SHA-256 of weights, bank and sampler settings.
        settings: See `SamplerSettings`.
    """

    fingerprint: str
    settings: SamplerSettings

    def __init__(
        self, denoiser: TrajectoryDenoiser, settings: SamplerSettings, fingerprint: str, bank: Floats | None = None
    ) -> None:
        self._denoiser, self._bank = denoiser, bank
        self.settings, self.fingerprint = settings, fingerprint

    @classmethod
    def load(
        cls,
        path: Path | None = None,
        *,
        steps: int | None = None,
        bank: bool = True,
        mutation_steps: int | None = 2,
        drivable: bool = True,
    ) -> Self:
        """Load weights.

        Args:
            path: safetensors of ours, or the published checkpoint (a bare state dict); ``None`` is the packaged model.
            steps: Network calls of a full reverse process, 100 by default. A bank is always made of full processes,
                so asking for fewer calls samples without it.
            bank: Whether to draw from the pre-sampled bank beside the weights, where there is one.
            mutation_steps: See `SamplerSettings`.
            drivable: See `SamplerSettings`.

        Returns:
            The prior.

        Raises:
            InputError: If weights or bank cannot be used.
        """
        weights = PACKAGED_WEIGHTS if path is None else path
        settings = SamplerSettings(steps=steps, mutation_steps=mutation_steps, drivable=drivable)
        for calls in (steps, mutation_steps):
            strided_timesteps(0, calls)
        denoiser = load_denoiser(weights)
        beside = bank_beside(weights)
        use_bank = bank and steps is None and beside.is_file()
        held = read_bank(beside, weights) if use_bank else None
        digests = [file_sha256(weights), file_sha256(beside) if use_bank else None]
        return cls(denoiser, settings, content_key("trajectory prior", digests, asdict(settings)), held)

    def sample(self, count: int, previous: Floats, rng: np.random.Generator) -> Floats:
        """Trajectories from noise.

        Args:
            count: How many.
            previous: (3,) pose half a second ago in the local frame; x is negative or zero when driving forward.
            rng: All chance.

        Returns:
            (count, 16, 3) waypoints. Drawn without replacement as long as the bank has enough that suit the speed.

        Raises:
            InputError: If ``count`` is not positive or ``previous`` is not a finite pose.
        """
        previous = _pose(previous)
        if count < 1:
            raise InputError(f"at least one trajectory must be asked for, got {count}")
        if self._bank is None:
            return self._sample_exactly(count, previous, rng)
        waypoints = waypoints_from_actions(self._bank, previous)
        if self.settings.drivable:
            waypoints = waypoints[_most_drivable(waypoints, previous, min(count, len(waypoints)))]
        chosen = rng.choice(len(waypoints), size=count, replace=count > len(waypoints))
        return np.asarray(waypoints[chosen])

    def _sample_exactly(self, count: int, previous: Floats, rng: np.random.Generator) -> Floats:
        """Full reverse processes, repeated until enough of them suit the speed."""
        drawn = np.zeros((0, WAYPOINTS, CHANNELS))
        for _ in range(EXACT_ROUNDS if self.settings.drivable else 1):
            actions = sample_actions(self._denoiser, count, self.settings.steps, rng)
            drawn = np.concatenate([drawn, waypoints_from_actions(actions, previous)])
            if (motion(drawn, previous).excess == 0).sum() >= count:
                break
        if not self.settings.drivable:
            return drawn
        return np.asarray(drawn[_most_drivable(drawn, previous, count)[:count]])

    def mutate(self, waypoints: Floats, noise_level: int, previous: Floats, rng: np.random.Generator) -> Floats:
        """Re-noise a little and denoise again (paper, Algorithm 1; appendix, Multi-round Trajectory Refinement).

        Args:
            waypoints: (B, 16, 3) earlier candidates.
            noise_level: 1..100 of 100 steps; noise of timestep ``noise_level - 1`` is added.
            previous: (3,) pose half a second ago in the local frame.
            rng: All chance.

        Returns:
            (B, 16, 3) new candidates. Where the change made one less drivable it is given back unchanged, unless
            ``drivable`` is off in the settings: slow cars would otherwise drift into reverse.

        Raises:
            InputError: If the noise level is outside the schedule, or shapes or numbers are not waypoints.
        """
        previous, waypoints = _pose(previous), np.asarray(waypoints, np.float64)
        if waypoints.ndim != 3 or waypoints.shape[1:] != (WAYPOINTS, CHANNELS) or not np.isfinite(waypoints).all():
            raise InputError(f"candidates must be finite (B, {WAYPOINTS}, {CHANNELS}) waypoints, got {waypoints.shape}")
        timesteps = strided_timesteps(noise_level - 1, self.settings.mutation_steps)
        start = waypoints.copy()
        start[..., 2] = np.unwrap(np.concatenate([np.zeros((len(start), 1)), start[..., 2]], axis=1), axis=1)[:, 1:]
        actions = torch.from_numpy(actions_from_waypoints(start, previous).astype(np.float32))

        def draw() -> torch.Tensor:
            return torch.from_numpy(rng.standard_normal(start.shape).astype(np.float32))

        with torch.inference_mode():
            noisy = add_noise(actions, draw(), timesteps[0])
            clean = reverse(self._denoiser, noisy, timesteps, draw=draw if self.settings.stochastic else None)
        changed = waypoints_from_actions(clean.numpy().astype(np.float64), previous)
        if self.settings.drivable:
            before, after = motion(start, previous).excess, motion(changed, previous).excess
            changed = np.where((after > before)[:, None, None], start, changed)
        return changed


def _most_drivable(waypoints: Floats, previous: Floats, at_least: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Indices of the drivable trajectories; the least bad ones fill up where there are not enough."""
    excess = motion(waypoints, previous).excess
    order = np.argsort(excess, kind="stable")
    chosen = order[: max(int((excess == 0).sum()), at_least)]
    return np.asarray(chosen, dtype=np.int64)


def _pose(previous: Floats) -> Floats:
    previous = np.asarray(previous, np.float64)
    if previous.shape != (CHANNELS,) or not np.isfinite(previous).all():
        raise InputError(f"the pose half a second ago must be finite x, y, heading, got {previous.tolist()}")
    return previous


def diversify(waypoints: Floats, rng: np.random.Generator) -> Floats:
    """Make the first batch varied: the reference's ``aug_traj``, which the paper does not mention.

    Quarters of the batch in order: unchanged; x scaled by 0.2-0.8; x scaled by 1.2-1.8; x and y scaled by 0.5-1.5, one
    factor per trajectory. Headings stay; the vehicle's are found by tracking later.

    Args:
        waypoints: (B, 16, 3).
        rng: All chance.

    Returns:
        (B, 16, 3).
    """
    varied = np.array(waypoints, dtype=np.float64)
    first, second, third = (len(varied) * quarter // 4 for quarter in (1, 2, 3))
    parts: tuple[tuple[slice, int, tuple[float, float]], ...] = (
        (slice(first, second), 1, SLOWER_X),
        (slice(second, third), 1, FASTER_X),
        (slice(third, None), 2, BOTH_AXES),
    )
    for part, axes, (low, high) in parts:
        factor = low + (high - low) * rng.random(len(varied[part]))
        varied[part, :, :axes] *= factor[:, None, None]
    return varied
