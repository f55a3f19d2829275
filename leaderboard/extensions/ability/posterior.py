"""Draws of the joint posterior, and what they say of planners: abilities, ranks, who is better than whom."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmark.geometry import Floats
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
