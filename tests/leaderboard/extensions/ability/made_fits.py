"""Outcomes of made-up planners, and posteriors that are given and not sampled."""

from collections.abc import Sequence

import numpy as np

from benchmark.records.run_schema import PlannerFacts
from leaderboard.extensions.ability.fit import AbilityFit, summarise_posterior
from leaderboard.extensions.ability.outcomes import GatheredOutcomes, Kind, Measured, PlannerOutcomes
from leaderboard.extensions.ability.posterior import Posterior

ABILITIES = {"good": 1.5, "fair": 0.2, "mini": -0.4, "stop": -1.2}


def gathered(
    kind: Kind = "contact", *, scenes: int = 8, variants: int = 2, holes: Sequence[tuple[str, int]] = ()
) -> GatheredOutcomes:
    """Four planners (one a miniature, one a reference) in scenes of which ``variants`` share a recording each."""
    rng = np.random.default_rng(3)
    names = [f"scene-{number}" for number in range(scenes)]
    planners = {}
    for name, ability in ABILITIES.items():
        drawn = 1.0 / (1.0 + np.exp(-(ability - np.linspace(-1.5, 1.5, scenes)) - rng.normal(0.0, 1.0, scenes)))
        values = (drawn > 0.5).astype(float) if kind == "contact" else np.round(drawn, 3)
        kept = {own: float(value) for at, (own, value) in enumerate(zip(names, values)) if (name, at) not in holes}
        planners[name] = PlannerOutcomes(PlannerFacts(name=name, privileged=False, miniature=name == "mini"), kept)
    sources = {name: f"recording-{at // variants}" for at, name in enumerate(names)}
    return GatheredOutcomes(Measured("d", "adv", "open", kind), "f" * 64, planners, sources, ("0123456789ab",))


def given_posterior(of: GatheredOutcomes, *, spread: float = 0.3, draws: int = 400, sd_u: float = 0.5) -> Posterior:
    """A posterior around the abilities, with difficulties from -1.5 to 1.5 and discriminations of 1."""
    rng, matrix = np.random.default_rng(5), of.matrix
    shape, scenes = (4, draws // 4), len(matrix.scenes)
    theta = np.array([ABILITIES[name] for name in matrix.planners])
    middle = np.linspace(-1.5, 1.5, scenes)
    drawn = {
        "theta": theta + spread * rng.standard_normal((*shape, len(theta))),
        "log_alpha": 0.2 * rng.standard_normal((*shape, scenes)),
        "beta": middle + 0.2 * rng.standard_normal((*shape, scenes)),
    }
    if matrix.outcome == "score":
        drawn |= {"omega": np.full((*shape, scenes), 1.5), "apart": np.full((*shape, scenes), 4.0)}
        drawn["g0"] = np.full((*shape, scenes), -2.0)
    if matrix.shares_recordings:
        drawn["sd_u"] = np.full(shape, sd_u)
    return Posterior(matrix, drawn, r_hat=1.003, divergent=0, seed=0)


def made_fit(of: GatheredOutcomes | None = None, *, sd_u: float = 0.5) -> AbilityFit:
    """A fit of that posterior."""
    own = gathered() if of is None else of
    return summarise_posterior(given_posterior(own, sd_u=sd_u), own)
