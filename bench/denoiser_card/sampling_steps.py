"""What fewer network calls cost: in truncated processes, which refine candidates, and in full ones, which make them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from torch import Tensor

from bench.denoiser_card.drawing import Process, asked, drawn_again, fast
from bench.denoiser_card.evaluation import HeldOut, quantities, wasserstein
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from generation.diffusion.bank import normal_noise
from generation.diffusion.checkpoint import load_denoiser
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.diffusion.kinematics import motion
from generation.diffusion.prior import SamplerSettings, TrajectoryPrior, diversify
from generation.diffusion.schedule import STEPS, Denoise, reverse, strided_timesteps

ROUND_NOISE_LEVELS: Final = (5, 4, 3, 2, 1)
FULL_CALLS: Final = (32, 16, 12, 8, 6, 4)
FULL_SAMPLES: Final = 1024


@dataclass(frozen=True, slots=True)
class FullProcess:
    """Full processes of some kind with some number of calls.

    Attributes:
        process: ``reference`` or ``solver``.
        calls: Network calls.
        distance: Mean over quantities of the 1-Wasserstein distance from held-out driving, in spreads of it.
        from_reference: The same from the samples of the reference's 100 calls.
        off_m: Root mean square distance of waypoints from the finest solution with the same starting noise; ``None``
            where noise is added on the way, so that samples cannot be compared one by one.
        drivable_raw: Share of samples that a car can drive from a held-out start, without drawing again.
    """

    process: str
    calls: int
    distance: float
    from_reference: float
    off_m: float | None
    drivable_raw: float


def full_process_costs(weights: Path, held_out: HeldOut, seed: int = 0) -> tuple[FullProcess, ...]:
    """Sample full processes with fewer and fewer calls and compare each with held-out driving.

    Args:
        weights: Weights.
        held_out: What to compare with.
        seed: Of the starting noise, which all share, and of the starts.

    Returns:
        The reference's process with 100 calls, then the solver by falling number of calls.

    Raises:
        InputError: If the weights cannot be used.
    """
    denoiser, rng = load_denoiser(weights), np.random.default_rng(content_seed("full process starts", seed))
    starts = rng.permutation(len(held_out.previous))[:FULL_SAMPLES]
    previous, actual = held_out.previous[starts], quantities(motion(held_out.waypoints, held_out.previous))
    finest = _drawn(denoiser, fast(STEPS), previous, seed)
    costs: list[FullProcess] = []
    complete: dict[str, Floats] = {}
    for name, calls in (("reference", STEPS), *(("solver", calls) for calls in FULL_CALLS)):
        noise = np.random.default_rng(content_seed("full process steps", seed))
        process = _reference(noise) if name == "reference" else fast(calls)
        raw = _drawn(denoiser, process, previous, seed)
        again = np.random.default_rng(content_seed("full process draws", seed))
        model = quantities(motion(drawn_again(asked(denoiser, process), previous, again), previous))
        complete = complete or model
        distance, from_reference = (
            float(np.mean([wasserstein(model[name], other[name]) / actual[name].std() for name in actual]))
            for other in (actual, complete)
        )
        off = None if name == "reference" else _rms_metres(raw - finest)
        drivable = float((motion(raw, previous).excess == 0).mean())
        costs.append(FullProcess(name, calls, distance, from_reference, off, drivable))
    return tuple(costs)


def _drawn(denoiser: TrajectoryDenoiser, process: Process, previous: Floats, seed: int) -> Floats:
    """Waypoints of one sample for each start; the starting noise is the same for every process."""
    noise = np.random.default_rng(content_seed("full process", seed))
    return drawn_again(asked(denoiser, process), previous, noise, attempts=1)


def _reference(rng: np.random.Generator) -> Process:
    """The reference's 100 steps with their noise, which has a generator of its own."""

    def process(denoise: Denoise, noisy: Tensor) -> Tensor:
        return reverse(denoise, noisy, strided_timesteps(STEPS - 1, None), draw=lambda: normal_noise(rng, len(noisy)))

    return process


@dataclass(frozen=True, slots=True)
class StrideError:
    """What fewer network calls in a truncated process change, root mean square metres over waypoints.

    Attributes:
        noise_level: Of 100.
        two_draws: Difference of two draws of the reference's process, one call per level.
        by_calls: Difference from the reference's process with the same noise, by number of calls.
    """

    noise_level: int
    two_draws: float
    by_calls: dict[int, float]


def stride_errors(weights: Path, calls: Sequence[int] = (1, 2), seed: int = 0) -> tuple[StrideError, ...]:
    """Compare strided truncated processes with the reference's, over the five rounds of a diversified batch at 8 m/s.

    Args:
        weights: Weights.
        calls: Numbers of calls to compare.
        seed: Of batch and noise.

    Returns:
        One entry per round.
    """
    previous = np.array([-4.0, 0.0, 0.0])
    full = TrajectoryPrior.load(weights, SamplerSettings(mutation_steps=None, drivable=False))
    strided = {
        count: TrajectoryPrior.load(weights, SamplerSettings(mutation_steps=count, drivable=False)) for count in calls
    }
    rng = np.random.default_rng(content_seed("stride errors", seed))
    candidates = diversify(full.sample(256, previous, rng), rng)
    errors = []
    for level in ROUND_NOISE_LEVELS:
        first, second = (content_seed("stride errors", seed, level, draw) for draw in (0, 1))
        reference = full.mutate(candidates, level, previous, np.random.default_rng(first))
        other = full.mutate(candidates, level, previous, np.random.default_rng(second))
        by_calls = {
            count: _rms_metres(prior.mutate(candidates, level, previous, np.random.default_rng(first)) - reference)
            for count, prior in strided.items()
        }
        errors.append(StrideError(level, _rms_metres(other - reference), by_calls))
        candidates = reference
    return tuple(errors)


def _rms_metres(difference: Floats) -> float:
    return float(np.sqrt((difference[..., :2] ** 2).sum(axis=-1).mean()))
