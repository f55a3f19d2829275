"""Where candidate trajectories come from: samples of the diffusion model, and small changes of earlier ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final, Self

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_key, file_sha256
from generation.diffusion.checkpoint import (
    PACKAGED_WEIGHTS,
    draw_normal_noise,
    find_bank_path,
    load_denoiser,
    read_bank,
)
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.diffusion.kinematics import DRAWN_FIRST, TrajectoryDraws, compute_motion, select_most_drivable
from generation.diffusion.network_calls import ACCELERATOR_ROWS, BatchedNetwork, parse_device
from generation.diffusion.schedule import (
    STEPS,
    Denoise,
    add_noise,
    choose_solver_timesteps,
    choose_strided_timesteps,
    run_reverse_process,
    solve,
)
from generation.diffusion.standardiser import (
    CHANNELS,
    WAYPOINTS,
    convert_actions_to_waypoints,
    convert_waypoints_to_actions,
)
from generation.search.proposals import MutationRequest, Request, SamplingRequest

SAMPLER_VERSION: Final = "2"
"""Part of every fingerprint; changes when the same weights and settings would give other samples."""
MOST_BATCHES: Final = 8
"""Batches that are drawn at most in search of drivable trajectories."""
SOLVER_CALLS: Final = 8
"""Network calls of a fast full process; the model card says what fewer and more give."""
SLOWER_X: Final = (0.2, 0.8)
FASTER_X: Final = (1.2, 1.8)
BOTH_AXES: Final = (0.5, 1.5)
"""Ranges of the reference's ``aug_traj``."""


class CandidateSource(StrEnum):
    """Source of new candidates: drawn afresh by the fast solver or by the reference's process, or stored ones."""

    FRESH = "fresh"
    REFERENCE = "reference"
    STORED = "stored"


@dataclass(frozen=True, slots=True)
class SamplerSettings:
    """Settings of the questions to the network.

    Attributes:
        samples: ``fresh`` draws every batch from noise by the fast solver, ``reference`` by the reference's 100 steps,
            ``stored`` picks from the samples beside the weights, made once by the reference's steps.
        solver_calls: Network calls of a full process of ``fresh``.
        conditioned: Whether a network that can be told is told how the vehicle moves now. Stored samples are not.
        mutation_steps: Network calls of a truncated one at most, spread over its steps; ``None`` is the reference's one
            per noise level. What fewer cost is in the model card.
        stochastic: Whether reverse steps add the reference's small noise.
        drivable: Whether samples that no car could drive from the present speed are drawn again, and changes that
            make a candidate less drivable not made. A model that is not told the speed brakes slow cars into reverse.
        dropout: Whether the network samples with dropout on, as the reference does by an omission.
    """

    samples: CandidateSource = CandidateSource.FRESH
    solver_calls: int = SOLVER_CALLS
    conditioned: bool = True
    mutation_steps: int | None = None
    stochastic: bool = True
    drivable: bool = True
    dropout: bool = False


class TrajectoryPrior:
    """Prior over background vehicles' trajectories of the next eight seconds (paper, Diffusion Trajectory Generator).

    Waypoints are (B, 16, 3): x, y, heading at 2 Hz over 8 s, metres and radians, in the rear-axle frame of the vehicle
    now, x forward. Results depend on the arguments and the state of the generator only; numerical libraries are
    expected to use one thread (`benchmark.machine.workers.single_threaded`).

    Attributes:
        fingerprint: Content key of weights, bank, sampler settings and the sampler's version.
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
        """Put a network to work; ``fingerprint`` is the content key of all that decides its answers.

        ``bank`` (N, 16, 3) has the actions that stored samples are drawn from. ``block`` trajectories make one network
        call, filled up where there are fewer; ``None`` asks for each search alone, which suits a processor.
        """
        options = {"conditioned": settings.conditioned, "dropout": settings.dropout}
        self._network = BatchedNetwork(denoiser, device or torch.device("cpu"), block, **options)
        self._bank, self.settings, self.fingerprint = bank, settings, fingerprint

    @classmethod
    def load(
        cls,
        path: Path | None = None,
        settings: SamplerSettings | None = None,
        *,
        device: str = "cpu",
    ) -> Self:
        """Load the packaged weights or others: safetensors of ours, or the published checkpoint (a bare state dict).

        Other kinds of device round differently, so their results have content keys of their own.
        """
        weights = PACKAGED_WEIGHTS if path is None else path
        settings = settings or SamplerSettings()
        choose_strided_timesteps(0, settings.mutation_steps)
        choose_solver_timesteps(settings.solver_calls)
        target = parse_device(device)
        denoiser = load_denoiser(weights)
        stored = settings.samples is CandidateSource.STORED
        held = _read_bank(weights, settings) if stored else None
        digests = [file_sha256(weights), file_sha256(find_bank_path(weights)) if stored else None]
        fingerprint = content_key("trajectory prior", SAMPLER_VERSION, digests, asdict(settings), target.type)
        block = None if target.type == "cpu" else ACCELERATOR_ROWS
        return cls(denoiser, settings, fingerprint, held, target, block)

    def answer(self, requests: Sequence[Request]) -> list[Floats]:
        """(B, 16, 3) waypoints for each request of several searches, the same as if it were the only request."""
        if self._network.block is None or self.settings.dropout:
            # One call for each: a processor gains nothing from larger batches, and dropout draws inside the network.
            return [waypoints for request in requests for waypoints in self._answer([request])]
        return self._answer(requests)

    def sample(self, count: int, previous: Floats, rng: np.random.Generator) -> Floats:
        """Trajectories from noise.

        Args:
            previous: (3,) pose half a second ago in the local frame; x is negative or zero when driving forward.

        Returns:
            (count, 16, 3) waypoints. Stored ones are without repetition as long as enough of them suit the speed.
        """
        return self._answer([SamplingRequest(count, previous, rng)])[0]

    def mutate(self, waypoints: Floats, noise_level: int, previous: Floats, rng: np.random.Generator) -> Floats:
        """Re-noise a little and denoise again (paper, Algorithm 1; appendix, Multi-round Trajectory Refinement).

        Args:
            waypoints: (B, 16, 3) earlier candidates.
            noise_level: 1..100 of 100 steps; noise of timestep ``noise_level - 1`` is added.
            previous: (3,) pose half a second ago in the local frame.

        Returns:
            (B, 16, 3) new candidates. Where the change made one less drivable it is given back unchanged, unless
            ``drivable`` is off in the settings: slow cars would otherwise drift into reverse.
        """
        return self._answer([MutationRequest(waypoints, noise_level, previous, rng)])[0]

    def _answer(self, requests: Sequence[Request]) -> list[Floats]:
        answers: dict[int, Floats] = {}
        levels: dict[int, list[tuple[int, MutationRequest]]] = {}
        exact: list[tuple[int, SamplingRequest]] = []
        for index, request in enumerate(requests):
            if isinstance(request, MutationRequest):
                levels.setdefault(request.noise_level, []).append((index, request))
            elif self._bank is not None:
                answers[index] = self._draw_from_bank(self._bank, request)
            else:
                exact.append((index, request))
        for level, group in levels.items():
            changed = self._mutate_together([request for _, request in group], level)
            answers.update(zip((index for index, _ in group), changed, strict=True))
        sampled = self._sample_together([request for _, request in exact])
        answers.update(zip((index for index, _ in exact), sampled, strict=True))
        return [answers[index] for index in range(len(requests))]

    def _draw_from_bank(self, bank: Floats, request: SamplingRequest) -> Floats:
        count, previous = _check_count(request.count), _check_pose(request.previous)
        waypoints = convert_actions_to_waypoints(bank, previous)
        if self.settings.drivable:
            excess = compute_motion(waypoints, previous).excess
            waypoints = waypoints[select_most_drivable(excess, min(count, len(waypoints)))]
        chosen = request.rng.choice(len(waypoints), size=count, replace=count > len(waypoints))
        return np.asarray(waypoints[chosen])

    def _sample_together(self, requests: Sequence[SamplingRequest]) -> list[Floats]:
        """Full reverse processes, repeated for those that have not enough that suit the speed."""
        drawn = [TrajectoryDraws.empty() for _ in requests]
        previous = [_check_pose(request.previous) for request in requests]
        more = DRAWN_FIRST if self.settings.drivable else 1.0
        wanted = {index: math.ceil(more * _check_count(request.count)) for index, request in enumerate(requests)}
        for _ in range(MOST_BATCHES if self.settings.drivable else 1):
            if not wanted:
                break
            rngs = [requests[index].rng for index in wanted]
            noise = [draw_normal_noise(rng, count) for rng, count in zip(rngs, wanted.values(), strict=True)]
            actions = self._denoise(noise, rngs, [previous[index] for index in wanted])
            for index, part in zip(wanted, actions, strict=True):
                drawn[index] = drawn[index].extend(convert_actions_to_waypoints(part, previous[index]), previous[index])
            wanted = {index: missing for index in wanted if (missing := drawn[index].missing(requests[index].count))}
        if not self.settings.drivable:
            return [draws.waypoints for draws in drawn]
        return [draws.select_best(request.count) for draws, request in zip(drawn, requests, strict=True)]

    def _denoise(
        self, noise: Sequence[Tensor], rngs: Sequence[np.random.Generator], previous: Sequence[Floats]
    ) -> list[Floats]:
        sizes = [len(part) for part in noise]
        present = self._network.present(previous, sizes)
        start, denoise = self._network.denoiser.start(self._network.put(noise), present), self._network.told(present)
        if self.settings.samples is CandidateSource.REFERENCE:
            return self._reverse(denoise, start, choose_strided_timesteps(STEPS - 1, None), rngs, sizes)
        with self._network.inference_context(rngs):
            clean = solve(denoise, start, choose_solver_timesteps(self.settings.solver_calls))
        return _split_by_request(clean, sizes)

    def _mutate_together(self, requests: Sequence[MutationRequest], level: int) -> list[Floats]:
        timesteps = choose_strided_timesteps(level - 1, self.settings.mutation_steps)
        previous = [_check_pose(request.previous) for request in requests]
        before = [_unwrap_headings(request.waypoints) for request in requests]
        actions = [
            torch.from_numpy(convert_waypoints_to_actions(start, pose).astype(np.float32))
            for start, pose in zip(before, previous, strict=True)
        ]
        noise = [draw_normal_noise(request.rng, len(start)) for request, start in zip(requests, before, strict=True)]
        noisy = add_noise(self._network.put(actions), self._network.put(noise), timesteps[0])
        rngs, sizes = [request.rng for request in requests], [len(part) for part in noise]
        clean = self._reverse(self._network.told(self._network.present(previous, sizes)), noisy, timesteps, rngs, sizes)
        return [
            self._kept(start, convert_actions_to_waypoints(part, pose), pose)
            for start, part, pose in zip(before, clean, previous, strict=True)
        ]

    def _kept(self, before: Floats, after: Floats, previous: Floats) -> Floats:
        """Changed waypoints, but the old ones where the change made them less drivable."""
        if not self.settings.drivable:
            return after
        excess = compute_motion(after, previous).excess
        bad = np.flatnonzero(excess > 0)
        worse = bad[excess[bad] > compute_motion(before[bad], previous).excess]
        merged = after.copy()
        merged[worse] = before[worse]
        return merged

    def _reverse(
        self,
        denoise: Denoise,
        noisy: Tensor,
        timesteps: Sequence[int],
        rngs: Sequence[np.random.Generator],
        sizes: Sequence[int],
    ) -> list[Floats]:

        def draw() -> Tensor:
            drawn = [draw_normal_noise(rng, size) for rng, size in zip(rngs, sizes, strict=True)]
            return self._network.put(drawn)

        with self._network.inference_context(rngs):
            clean = run_reverse_process(denoise, noisy, timesteps, draw=draw if self.settings.stochastic else None)
        return _split_by_request(clean, sizes)


def _split_by_request(clean: Tensor, sizes: Sequence[int]) -> list[Floats]:
    return [part.numpy().astype(np.float64) for part in torch.split(clean.cpu(), list(sizes))]


def _read_bank(weights: Path, settings: SamplerSettings) -> Floats:
    beside = find_bank_path(weights)
    if settings.dropout:
        raise InputError("stored samples were drawn without dropout; draw afresh, or leave dropout off")
    if not beside.is_file():
        raise InputError(f"no stored samples at {beside}; draw afresh, or use weights of train denoiser")
    return read_bank(beside, weights)


def _unwrap_headings(waypoints: Floats) -> Floats:
    waypoints = np.asarray(waypoints, np.float64)
    if waypoints.ndim != 3 or waypoints.shape[1:] != (WAYPOINTS, CHANNELS) or not np.isfinite(waypoints).all():
        raise InputError(f"candidates must be finite (B, {WAYPOINTS}, {CHANNELS}) waypoints, got {waypoints.shape}")
    start = waypoints.copy()
    if np.abs(np.diff(start[..., 2], axis=1, prepend=0.0)).max(initial=0.0) < np.pi:
        return start
    start[..., 2] = np.unwrap(np.concatenate([np.zeros((len(start), 1)), start[..., 2]], axis=1), axis=1)[:, 1:]
    return start


def _check_count(count: int) -> int:
    if count < 1:
        raise InputError(f"at least one trajectory must be requested, got {count}")
    return count


def _check_pose(previous: Floats) -> Floats:
    previous = np.asarray(previous, np.float64)
    if previous.shape != (CHANNELS,) or not np.isfinite(previous).all():
        raise InputError(f"the pose half a second ago must be finite x, y, heading, got {previous.tolist()}")
    return previous


def diversify(waypoints: Floats, rng: np.random.Generator) -> Floats:
    """Vary the first batch of (B, 16, 3) waypoints: the reference's ``aug_traj``, which the paper does not mention.

    Quarters of the batch in order: unchanged; x scaled by 0.2-0.8; x scaled by 1.2-1.8; x and y scaled by 0.5-1.5, one
    factor per trajectory. Headings stay; the vehicle's are found by tracking later.
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
