"""How sure one is of a newcomer after scenes that ``leaderboard next`` chooses, and after scenes in random order.

All other planners are fitted together. The newcomer's posterior is exact given the draws of that fit: on a grid of its
ability, with what it has with each recording integrated out, and with every draw weighed by the newcomer's outcomes.
"""

from typing import Any, Final

import numpy as np
from scipy import special

from benchmark.geometry import Floats
from benchmark.records.run_schema import PlannerFacts
from leaderboard.extensions.ability.fit import AbilityFit, summarise_posterior
from leaderboard.extensions.ability.likelihood import (
    NUMPY,
    ScoreItem,
    clip_scores,
    compute_binary_log_likelihood,
    compute_score_log_likelihood,
)
from leaderboard.extensions.ability.next_scenes import choose_next_scenes
from leaderboard.extensions.ability.outcomes import GatheredOutcomes, Kind, Measured, PlannerOutcomes
from leaderboard.extensions.ability.posterior import Posterior

MOST: Final = 40
"""Scenes that are chosen one by one."""
GRID: Final = np.linspace(-4.0, 4.0, 49)
NODES: Final = 9


class Newcomer:
    """Weights of (K draws, G abilities) given the outcomes so far; the newcomer is the last planner of the fit."""

    def __init__(self, fit: AbilityFit) -> None:
        self.fit = fit
        nodes, weights = special.roots_hermitenorm(NODES)
        self._log_weights = np.log(weights / weights.sum())
        names, self._of_scene = fit.matrix.places
        drawn = len(fit.kept.theta)
        sd_u = np.array(fit.kept.sd_u or np.zeros(drawn))
        self._ability = GRID[:, None] + sd_u[:, None, None] * nodes
        self._of_recording = np.zeros((len(names), *self._ability.shape))
        self._summed = np.zeros((len(names), drawn, len(GRID)))
        self._values = np.full(len(fit.scenes), np.nan)
        items = ("log_alpha", "beta", *(("omega", "g0", "apart") if fit.kind == "score" else ()))
        self._items = {name: fit.draw(name)[:, :, None, None] for name in items}

    def add(self, scene: int, value: float) -> None:
        """One more outcome."""
        own = {name: values[:, scene] for name, values in self._items.items()}
        alpha = np.exp(own.pop("log_alpha"))
        if self.fit.kind == "contact":
            log_likelihood = compute_binary_log_likelihood(value, alpha, self._ability, own["beta"], NUMPY)
        else:
            score = clip_scores(np.array(value))
            log_likelihood = compute_score_log_likelihood(score, alpha * self._ability, ScoreItem(**own), NUMPY)
        recording = self._of_scene[scene]
        self._of_recording[recording] += log_likelihood
        self._summed[recording] = np.logaddexp.reduce(self._of_recording[recording] + self._log_weights, axis=-1)
        self._values[scene] = value

    @property
    def weights(self) -> Floats:
        """(K, G), of sum 1."""
        log_density = self._summed.sum(axis=0) - 0.5 * GRID**2
        density = np.exp(log_density - log_density.max())
        return np.asarray(density / density.sum())

    @property
    def deviation(self) -> float:
        """Standard deviation of the ability."""
        of_ability = self.weights.sum(axis=0)
        return float(np.sqrt(of_ability @ GRID**2 - (of_ability @ GRID) ** 2))

    def choose(self) -> int:
        """The scene that ``leaderboard next`` would name, from as many draws as a stored fit has."""
        fit, drawn = self.fit, len(self.fit.kept.theta)
        places = np.searchsorted(np.cumsum(self.weights.ravel()), (np.arange(drawn) + 0.5) / drawn)
        draws, abilities = np.unravel_index(np.minimum(places, self.weights.size - 1), self.weights.shape)
        kept = {name: [rows[at] for at in draws] for name, rows in fit.kept.model_dump().items() if rows}
        kept["theta"] = [[*row[:-1], float(GRID[at])] for row, at in zip(kept["theta"], abilities)]
        values = [None if np.isnan(value) else float(value) for value in self._values]
        now = fit.model_copy(
            update={"kept": fit.kept.model_copy(update=kept), "values": [*fit.values[:-1], values]},
        )
        (chosen,) = choose_next_scenes(now, len(fit.planners) - 1, 1).scenes
        return [scene.scene for scene in fit.scenes].index(chosen.scene)


def summarise_fit(posterior: Posterior) -> AbilityFit:
    """The fit that the product would store."""
    matrix = posterior.matrix
    facts = {name: PlannerFacts(name=name, privileged=False, miniature=False) for name in matrix.planners}
    planners = {name: PlannerOutcomes(own, {}) for name, own in facts.items()}
    kind: Kind = "contact" if matrix.outcome == "contact" else "score"
    sources = dict(zip(matrix.scenes, matrix.recordings))
    measured = Measured("simulated", "adv", "open", kind)
    return summarise_posterior(posterior, GatheredOutcomes(measured, "0" * 64, planners, sources, ()))


def run_newcomers(posterior: Posterior, outcomes: Floats, rng: np.random.Generator) -> dict[str, Any]:
    """Deviations of each newcomer's ability after 1, 2, ... scenes, chosen and in random order."""
    fit = summarise_fit(posterior)
    found: dict[str, list[list[float]]] = {"adaptive": [], "random": []}
    for row in outcomes:
        order = rng.permutation(len(row)).tolist()
        for name, count in (("adaptive", min(MOST, len(row))), ("random", len(row))):
            newcomer, deviations = Newcomer(fit), []
            for at in range(count):
                scene = newcomer.choose() if name == "adaptive" else order[at]
                newcomer.add(scene, float(row[scene]))
                deviations.append(round(newcomer.deviation, 4))
            found[name].append(deviations)
    return {**found, "r_hat": posterior.r_hat}


def summarise_newcomers(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean deviation after some chosen scenes, the random scenes that give the same, and the share that is saved."""
    adaptive, shuffled = (
        np.mean([row for line in lines for row in line[name]], axis=0) for name in ("adaptive", "random")
    )
    found: dict[str, Any] = {"newcomers": sum(len(line["random"]) for line in lines)}
    for count in (5, 10, 20, 30, 40):
        if count <= len(adaptive):
            deviation = float(adaptive[count - 1])
            reached = np.flatnonzero(shuffled <= deviation)
            needed = int(reached[0]) + 1 if len(reached) else None
            saved = round(100.0 * (1.0 - count / needed)) if needed else None
            found[str(count)] = {"deviation": round(deviation, 3), "random": needed, "saved": saved}
    return found
