"""Draws of the joint posterior, and what they say of planners: abilities, ranks, who is better than whom."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmark.geometry import Floats
from leaderboard.extensions.ability.likelihood import ScoreItem, compute_expected_score
from leaderboard.extensions.ability.matrix import OutcomeMatrix


@dataclass(frozen=True)
class Posterior:
    """(C, D, ...) draws of parameters by name: C chains of D draws.

    Attributes:
        matrix: Outcomes that it was fitted to.
        draws: ``theta`` (.., S), ``log_alpha`` and ``beta`` (.., N); of scores ``omega``, ``g0``, ``apart``; with
            recording effects ``u`` (.., S, R), ``sd_u`` and ``rho``.
        r_hat: Largest split R-hat of abilities, discriminations and difficulties.
        divergent: Draws at which the trajectory diverged.
        seed: Seed of the sampler.
    """

    matrix: OutcomeMatrix
    draws: Mapping[str, Floats]
    r_hat: float
    divergent: int
    seed: int

    def flat(self, name: str) -> Floats:
        """(C D, ...) draws of a parameter."""
        values = self.draws[name]
        return values.reshape(-1, *values.shape[2:])

    @cached_property
    def contrasts(self) -> Floats:
        """(C D, S) abilities less the mean of the planners shown: what can be told without a prior on their place."""
        theta = self.flat("theta")
        return np.asarray(theta - theta.mean(axis=1, keepdims=True))

    @cached_property
    def middle(self) -> Floats:
        """(C D, N) difficulties on the scale of contrasts: where the chance of being safe, or the mean score, is half.

        For ordered outcomes it is that of the first step.
        """
        alpha, beta = np.exp(self.flat("log_alpha")), self.flat("beta")
        if self.matrix.outcome == "score":
            item = ScoreItem(*(self.flat(name) for name in ScoreItem._fields))
            place = find_half(item) / alpha
        else:
            place = beta / alpha if self.matrix.outcome == "ordered" else beta
        return np.asarray(place - self.flat("theta").mean(axis=1, keepdims=True))

    def compute_expected(self) -> Floats:
        """(C D, S) expected outcome of each planner over all scenes of the matrix."""
        theta, alpha, beta = self.flat("theta")[:, :, None], np.exp(self.flat("log_alpha"))[:, None], self.flat("beta")
        if self.matrix.outcome == "score":
            item = ScoreItem(*(self.flat(name)[:, None] for name in ScoreItem._fields))
            return np.asarray(compute_expected_score(alpha * theta, item).mean(axis=2))
        return np.asarray((1.0 / (1.0 + np.exp(-alpha * (theta - beta[:, None])))).mean(axis=2))


def find_half(item: ScoreItem) -> Floats:
    """The t at which the expected score is 0.5, by bisection, of the shape of the parameters; within ±50."""
    low, high = np.full(np.shape(item.beta), -50.0), np.full(np.shape(item.beta), 50.0)
    for _ in range(50):
        at = (low + high) / 2.0
        above = compute_expected_score(at, item) > 0.5
        low, high = np.where(above, low, at), np.where(above, at, high)
    return np.asarray((low + high) / 2.0)


@dataclass(frozen=True, slots=True)
class RankDistribution:
    """Ranks of P planners by joint draws; rank 1 is the largest ability, ties go by index."""

    best: tuple[int, ...]
    worst: tuple[int, ...]
    mean: tuple[float, ...]
    first: tuple[float, ...]
    better: Floats


def rank_draws(abilities: Floats) -> RankDistribution:
    """Ranks of (K, P) joint draws: 95 % intervals in whole numbers, means, P(best), and (P, P) P(row above column)."""
    ranks = np.argsort(np.argsort(-abilities, axis=1, kind="stable"), axis=1) + 1
    low, high = np.quantile(ranks, (0.025, 0.975), axis=0, method="inverted_cdf")
    better = (abilities[:, :, None] > abilities[:, None, :]).mean(axis=0)
    return RankDistribution(
        tuple(map(int, low)),
        tuple(map(int, high)),
        tuple(map(float, ranks.mean(axis=0))),
        tuple(map(float, (ranks == 1).mean(axis=0))),
        better,
    )
