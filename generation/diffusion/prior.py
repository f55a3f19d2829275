"""Where candidate trajectories come from: samples of the diffusion model, and small changes of earlier ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_key, file_sha256
from generation.diffusion.bank import bank_beside, normal_noise, read_bank
from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, load_denoiser
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.diffusion.kinematics import motion
from generation.diffusion.schedule import STEPS, add_noise, reverse, strided_timesteps
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS, actions_from_waypoints, waypoints_from_actions
from generation.search.proposals import Mutation, Request, Sampling

EXACT_ROUNDS: Final = 8
"""Batches that exact sampling draws at most in search of drivable trajectories."""
SLOWER_X: Final = (0.2, 0.8)
FASTER_X: Final = (1.2, 1.8)
BOTH_AXES: Final = (0.5, 1.5)
"""Ranges of the reference's ``aug_traj``."""
PROCESSOR_ROWS: Final = 256
"""Trajectories of one network call on a processor: their features fit into its cache."""
ACCELERATOR_ROWS: Final = 4096
"""Trajectories of one network call on an accelerator. Fixed, and filled up where there are fewer, because a matrix
product's last bits depend on its shape: so an answer does not depend on who asks beside it."""


@dataclass(frozen=True, slots=True)
class SamplerSettings:
    """How the network is asked.

    Attributes:
        steps: Network calls of a full reverse process; ``None`` is the reference's 100.
        mutation_steps: Network calls of a truncated one at most, spread over its steps; ``None`` is the reference's one
            per noise level. What fewer cost is in the model card.
        stochastic: Whether reverse steps add the reference's small noise.
        drivable: Whether samples that no car could drive from the present speed are drawn again, and changes that
            make a candidate less drivable not made. The model does not know the speed: braking samples would drive a
            slow car backwards.
        dropout: Whether the network samples with dropout on, as the reference does by an omission.
    """

    steps: int | None = None
    mutation_steps: int | None = None
    stochastic: bool = True
    drivable: bool = True
    dropout: bool = False


class TrajectoryPrior:
    """What background vehicles could do in the next eight seconds (paper, Diffusion Trajectory Generator).

    Waypoints are (B, 16, 3): x, y, heading at 2 Hz over 8 s, metres and radians, in the rear-axle frame of the vehicle
    now, x forward. Results depend on the arguments and the state of the generator only; numerical libraries are
    expected to use one thread (`benchmark.machine.workers.single_threaded`).

    Attributes:
        fingerprint: SHA-256 of weights, bank and sampler settings.
        settings: How the network is asked.
    """

    fingerprint: str
    settings: SamplerSettings

    def __init__(
        self,
        denoiser: TrajectoryDenoiser,
        settings: SamplerSettings,
        fingerprint: str,
        bank: Floats | None = None,
        device: torch.device | None = None,
        block: int | None = None,
    ) -> None:
        """Put a network to work.

        Args:
            denoiser: The network.
            settings: How it is asked.
            fingerprint: Content key of all that decides its answers.
            bank: (N, 16, 3) actions to draw from instead of full reverse processes.
            device: Where the network runs, the processor by default.
            block: Trajectories of one network call, filled up where there are fewer; ``None`` asks for each search
                alone, which suits a processor.
        """
        self._device, self._block = device or torch.device("cpu"), block
        self._denoiser, self._bank = denoiser.to(self._device).train(settings.dropout), bank
        self.settings, self.fingerprint = settings, fingerprint

    @classmethod
    def load(
        cls,
        path: Path | None = None,
        settings: SamplerSettings | None = None,
        *,
        bank: bool = True,
        device: str = "cpu",
    ) -> Self:
        """Load weights.

        Args:
            path: safetensors of ours, or the published checkpoint (a bare state dict); ``None`` is the packaged model.
            settings: How the network is asked. A bank is always made of full processes without dropout, so asking for
                anything else samples without it.
            bank: Whether to draw from the pre-sampled bank beside the weights, where there is one.
            device: Where the network runs, for example ``cuda``. Other kinds of device round differently, so their
                results have content keys of their own.

        Returns:
            The prior.

        Raises:
            InputError: If weights, bank, settings or device cannot be used.
        """
        weights = PACKAGED_WEIGHTS if path is None else path
        settings = settings or SamplerSettings()
        for calls in (settings.steps, settings.mutation_steps):
            strided_timesteps(0, calls)
        target = _device(device)
        denoiser = load_denoiser(weights)
        beside = bank_beside(weights)
        whole = settings.steps is None and settings.stochastic and not settings.dropout
        use_bank = bank and whole and beside.is_file()
        held = read_bank(beside, weights) if use_bank else None
        digests = [file_sha256(weights), file_sha256(beside) if use_bank else None]
        fingerprint = content_key("trajectory prior", digests, asdict(settings), target.type)
        block = None if target.type == "cpu" else ACCELERATOR_ROWS
        return cls(denoiser, settings, fingerprint, held, target, block)

    def answer(self, requests: Sequence[Request]) -> list[Floats]:
        """Answer several searches at once.

        Args:
            requests: Of any kind and number.

        Returns:
            (B, 16, 3) waypoints for each, the same as if it were the only request.

        Raises:
            InputError: As `sample` and `mutate`.
        """
        if self._block is None or self.settings.dropout:
            # One call for each: a processor gains nothing from larger batches, and dropout draws inside the network.
            return [waypoints for request in requests for waypoints in self._answer([request])]
        return self._answer(requests)

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
        return self._answer([Sampling(count, previous, rng)])[0]

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
        return self._answer([Mutation(waypoints, noise_level, previous, rng)])[0]

    def _answer(self, requests: Sequence[Request]) -> list[Floats]:
        answers: dict[int, Floats] = {}
        levels: dict[int, list[tuple[int, Mutation]]] = {}
        exact: list[tuple[int, Sampling]] = []
        for index, request in enumerate(requests):
            if isinstance(request, Mutation):
                levels.setdefault(request.noise_level, []).append((index, request))
            elif self._bank is not None:
                answers[index] = self._from_bank(self._bank, request)
            else:
                exact.append((index, request))
        for level, group in levels.items():
            changed = self._mutate_together([request for _, request in group], level)
            answers.update(zip((index for index, _ in group), changed, strict=True))
        sampled = self._sample_together([request for _, request in exact])
        answers.update(zip((index for index, _ in exact), sampled, strict=True))
        return [answers[index] for index in range(len(requests))]

    def _from_bank(self, bank: Floats, request: Sampling) -> Floats:
        count, previous = _count(request.count), _pose(request.previous)
        waypoints = waypoints_from_actions(bank, previous)
        if self.settings.drivable:
            waypoints = waypoints[_most_drivable(waypoints, previous, min(count, len(waypoints)))]
        chosen = request.rng.choice(len(waypoints), size=count, replace=count > len(waypoints))
        return np.asarray(waypoints[chosen])

    def _sample_together(self, requests: Sequence[Sampling]) -> list[Floats]:
        """Full reverse processes, repeated for those that have not enough that suit the speed."""
        drawn = [np.zeros((0, WAYPOINTS, CHANNELS)) for _ in requests]
        previous = [_pose(request.previous) for request in requests]
        open_ones = list(range(len(requests)))
        for _ in range(EXACT_ROUNDS if self.settings.drivable else 1):
            if not open_ones:
                break
            batch = [requests[index] for index in open_ones]
            noise = [normal_noise(request.rng, _count(request.count)) for request in batch]
            start = self._denoiser.start(torch.cat(noise).to(self._device))
            rngs = [request.rng for request in batch]
            actions = self._reverse(start, strided_timesteps(STEPS - 1, self.settings.steps), rngs, noise)
            for index, part in zip(open_ones, actions, strict=True):
                drawn[index] = np.concatenate([drawn[index], waypoints_from_actions(part, previous[index])])
            open_ones = [
                index
                for index in open_ones
                if (motion(drawn[index], previous[index]).excess == 0).sum() < requests[index].count
            ]
        if not self.settings.drivable:
            return drawn
        return [
            np.asarray(found[_most_drivable(found, pose, request.count)[: request.count]])
            for found, pose, request in zip(drawn, previous, requests, strict=True)
        ]

    def _mutate_together(self, requests: Sequence[Mutation], level: int) -> list[Floats]:
        """Truncated processes of one noise level."""
        timesteps = strided_timesteps(level - 1, self.settings.mutation_steps)
        previous = [_pose(request.previous) for request in requests]
        before = [_continuous(request.waypoints) for request in requests]
        actions = [
            torch.from_numpy(actions_from_waypoints(start, pose).astype(np.float32))
            for start, pose in zip(before, previous, strict=True)
        ]
        noise = [normal_noise(request.rng, len(start)) for request, start in zip(requests, before, strict=True)]
        noisy = add_noise(torch.cat(actions).to(self._device), torch.cat(noise).to(self._device), timesteps[0])
        clean = self._reverse(noisy, timesteps, [request.rng for request in requests], noise)
        return [
            self._kept(start, waypoints_from_actions(part, pose), pose)
            for start, part, pose in zip(before, clean, previous, strict=True)
        ]

    def _kept(self, before: Floats, after: Floats, previous: Floats) -> Floats:
        """Changed waypoints, but the old ones where the change made them less drivable."""
        if not self.settings.drivable:
            return after
        worse = motion(after, previous).excess > motion(before, previous).excess
        return np.where(worse[:, None, None], before, after)

    def _reverse(
        self, noisy: Tensor, timesteps: Sequence[int], rngs: Sequence[np.random.Generator], like: Sequence[Tensor]
    ) -> list[Floats]:
        """Clean actions of each request; ``like`` are tensors of the requests' sizes."""
        sizes = [len(part) for part in like]

        def draw() -> Tensor:
            drawn = [normal_noise(rng, size) for rng, size in zip(rngs, sizes, strict=True)]
            return torch.cat(drawn).to(self._device)

        with torch.inference_mode(), torch.random.fork_rng(enabled=self.settings.dropout):
            if self.settings.dropout:
                torch.manual_seed(int(rngs[0].integers(2**62)))
            clean = reverse(self._predict, noisy, timesteps, draw=draw if self.settings.stochastic else None)
        return [part.numpy().astype(np.float64) for part in torch.split(clean.cpu(), sizes)]

    def _predict(self, noisy: Tensor, timestep: Tensor) -> Tensor:
        """The network's answer, in blocks."""
        count = len(noisy)
        if self._block is not None:
            noisy = torch.cat([noisy, noisy.new_zeros(-count % self._block, *noisy.shape[1:])])
        blocks = torch.split(noisy, self._block or PROCESSOR_ROWS)
        return torch.cat([self._denoiser(block, timestep) for block in blocks])[:count]


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.ones(1, device=device).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise InputError(
            f"this machine cannot compute on device {name!r}; use cpu, or cuda where there is a GPU"
        ) from (error)
    return device


def _continuous(waypoints: Floats) -> Floats:
    """Waypoints whose headings do not jump by a full turn."""
    waypoints = np.asarray(waypoints, np.float64)
    if waypoints.ndim != 3 or waypoints.shape[1:] != (WAYPOINTS, CHANNELS) or not np.isfinite(waypoints).all():
        raise InputError(f"candidates must be finite (B, {WAYPOINTS}, {CHANNELS}) waypoints, got {waypoints.shape}")
    start = waypoints.copy()
    start[..., 2] = np.unwrap(np.concatenate([np.zeros((len(start), 1)), start[..., 2]], axis=1), axis=1)[:, 1:]
    return start


def _count(count: int) -> int:
    if count < 1:
        raise InputError(f"at least one trajectory must be asked for, got {count}")
    return count


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
