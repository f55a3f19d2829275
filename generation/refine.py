"""Multi-round trajectory refinement: sample, score, resample, renew with a little diffusion noise, repeat.

Paper section 3 "Multi-round Trajectory Refinement", Algorithm 1 lines 4-18 and appendix of the same name.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from generation.hyperparameters import HyperParameters
from generation.physics import SimulatedMotion
from generation.scoring import Terms, final_scores, normalised


class Prior(Protocol):
    """Unconditional generator of driving: what refinement needs of a diffusion model.

    Waypoints are (B, 16, 3) x, y, heading at 2 Hz over 8 s, metres, in the rear-axle frame of the vehicle now;
    ``previous`` is its (3,) pose half a second ago in that frame.
    """

    @property
    def fingerprint(self) -> str:
        """Content key of weights and sampler settings."""

    def sample(self, count: int, previous: Floats, rng: np.random.Generator) -> Floats:
        """New trajectories by the full reverse process."""

    def mutate(self, waypoints: Floats, noise_level: int, previous: Floats, rng: np.random.Generator) -> Floats:
        """Trajectories after a truncated diffusion process of ``noise_level`` steps."""


Diversify = Callable[[Floats, np.random.Generator], Floats]
"""Spreads the speeds of an initial batch, which makes it diverse; the reference code does it, the paper is silent."""


@dataclass(frozen=True, slots=True)
class Evaluated:
    """One simulated and scored batch.

    Attributes:
        motion: What the candidates do.
        terms: Their score terms.
    """

    motion: SimulatedMotion
    terms: Terms


@dataclass(frozen=True, slots=True)
class Round:
    """What one round found.

    Attributes:
        scores: (B,) final scores, normalised within the round.
        collision_free: Candidates without contact over the horizon.
    """

    scores: Floats
    collision_free: int


@dataclass(frozen=True, slots=True)
class Refinement:
    """Result of one planning frame.

    Attributes:
        waypoints: (16, 3) chosen trajectory.
        motion: Batch that the chosen one belongs to.
        chosen: Its index in ``motion``.
        round: Its round, 0 is the initial batch.
        score: Its final score, normalised over all rounds together.
        collides: Whether even the chosen one touches something within the horizon.
        rounds: Trace, one entry per round.
    """

    waypoints: Floats
    motion: SimulatedMotion
    chosen: int
    round: int
    score: float
    collides: bool
    rounds: tuple[Round, ...]


def refine(
    prior: Prior,
    diversify: Diversify,
    evaluate: Callable[[Floats], Evaluated],
    previous: Floats,
    hyper: HyperParameters,
    rng: np.random.Generator,
) -> Refinement:
    """Search one planning frame.

    Args:
        prior: Diffusion model.
        diversify: Applied to the initial batch.
        evaluate: Simulates and scores (B, 16, 3) waypoints.
        previous: (3,) pose half a second ago in the local frame.
        hyper: Settings.
        rng: Source of every random number.

    Returns:
        The best candidate of all rounds (the reference forgets all but the last round).
    """
    waypoints = diversify(prior.sample(hyper.candidates, previous, rng), rng)
    batches: list[tuple[Floats, Evaluated, Floats]] = []
    rounds: list[Round] = []
    for level in (*hyper.noise_levels(), 0):
        start = rng.uniform(0.0, hyper.init_scale, len(waypoints))
        batch = evaluate(waypoints)
        scores = final_scores(batch.terms, start, hyper)
        batches.append((waypoints, batch, start))
        rounds.append(_summary(scores, batch.terms, hyper))
        if level:
            drawn = resample(scores, hyper, rng)
            waypoints = prior.mutate(waypoints[drawn], level, previous, rng)
    number, chosen, score = _best(batches, hyper, rng)
    waypoints, batch, _ = batches[number]
    collides = not np.isfinite(score) or bool(batch.terms.collision[chosen, : hyper.horizon].any())
    return Refinement(waypoints[chosen], batch.motion, chosen, number, score, collides, tuple(rounds))


def resample(scores: Floats, hyper: HyperParameters, rng: np.random.Generator) -> NDArray[np.int64]:
    """Draw a batch with replacement with probability softmax(-score x temperature).

    Args:
        scores: (B,) lower is better; infinite ones are never drawn.
        hyper: Temperature and ablation.
        rng: Randomness.

    Returns:
        (B,) indices. Uniform over the finite ones without scoring, over all where none is finite.
    """
    finite = np.isfinite(scores)
    if not finite.any():
        return np.arange(len(scores))
    sharpness = hyper.temperature if hyper.scored else 0.0
    weight = np.where(finite, np.exp(-sharpness * (np.where(finite, scores, 0.0) - scores[finite].min())), 0.0)
    return np.asarray(rng.choice(len(scores), size=len(scores), p=weight / weight.sum()), dtype=np.int64)


def _best(
    batches: list[tuple[Floats, Evaluated, Floats]], hyper: HyperParameters, rng: np.random.Generator
) -> tuple[int, int, float]:
    """Round, index and score of the best candidate, the challenge normalised over all rounds together."""
    finite = np.stack([batch.terms.finite for _, batch, _ in batches])
    challenge = normalised(np.stack([batch.terms.challenge for _, batch, _ in batches]), finite)
    safety = np.stack(
        [start + hyper.dac_weight * b.terms.dac + hyper.cr_weight * b.terms.cr for _, b, start in batches]
    )
    score = np.where(finite, safety + hyper.ac_weight * challenge, np.inf)
    if hyper.scored:
        number, chosen = np.unravel_index(int(np.argmin(score)), score.shape)
        return int(number), int(chosen), float(score[number, chosen])
    last = len(batches) - 1
    options = np.flatnonzero(finite[last]) if finite[last].any() else np.arange(score.shape[1])
    chosen = rng.choice(options)
    return last, int(chosen), float(score[last, chosen])


def _summary(scores: Floats, terms: Terms, hyper: HyperParameters) -> Round:
    free = terms.finite & ~terms.collision[:, : hyper.horizon].any(axis=1)
    return Round(scores, int(free.sum()))
