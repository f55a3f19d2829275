"""What fewer network calls cost: in truncated processes, which refine candidates, and in full ones, which make them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from bench.denoiser_card.evaluation import HeldOut, quantities, replay, wasserstein
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from generation.diffusion.bank import sample_actions
from generation.diffusion.checkpoint import load_denoiser
from generation.diffusion.kinematics import motion
from generation.diffusion.prior import SamplerSettings, TrajectoryPrior, diversify
from generation.diffusion.schedule import STEPS

ROUND_NOISE_LEVELS: Final = (5, 4, 3, 2, 1)
FULL_CALLS: Final = (STEPS, 50, 20, 10, 5)
FULL_SAMPLES: Final = 1024


@dataclass(frozen=True, slots=True)
class FullProcess:
    """Full processes with some number of calls.

    Attributes:
        calls: Network calls.
        distance: Mean over quantities of the 1-Wasserstein distance from held-out driving, in spreads of it.
        from_all_calls: The same from the samples of 100 calls with the same starting noise.
        drivable_raw: Share of samples that a car can drive from a held-out start, without drawing again.
    """

    calls: int
    distance: float
    from_all_calls: float
    drivable_raw: float


def full_process_costs(weights: Path, held_out: HeldOut, seed: int = 0) -> tuple[FullProcess, ...]:
    """Sample full processes with fewer and fewer calls and compare each with held-out driving.

    Args:
        weights: Weights.
        held_out: What to compare with.
        seed: Of the starting noise, which all share, and of the draws.

    Returns:
        One entry per number of calls, 100 first.

    Raises:
        InputError: If the weights cannot be used.
    """
    denoiser, previous = load_denoiser(weights), held_out.previous
    actual = quantities(motion(held_out.waypoints, previous))
    costs: list[FullProcess] = []
    complete: dict[str, Floats] = {}
    for calls in FULL_CALLS:
        rng = np.random.default_rng(content_seed("full process", seed))
        actions = sample_actions(denoiser, FULL_SAMPLES, calls, rng)
        draw = np.random.default_rng(content_seed("full process draws", seed))
        raw = motion(replay(actions, previous, draw, attempts=1), previous)
        model = quantities(motion(replay(actions, previous, draw), previous))
        complete = complete or model
        distance, from_all = (
            float(np.mean([wasserstein(model[name], other[name]) / actual[name].std() for name in actual]))
            for other in (actual, complete)
        )
        costs.append(FullProcess(calls, distance, from_all, float((raw.excess == 0).mean())))
    return tuple(costs)


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
        weights: Weights with a bank beside them.
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
