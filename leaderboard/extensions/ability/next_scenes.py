"""Which scenes would sharpen a planner's rank most: by the information that they are expected to give.

A scene's information about the ability is averaged over the posterior. Scenes of one recording share what the planner
has with that recording: of I in total, I / (1 + I sd_u²) is about the ability.
"""

from dataclasses import dataclass

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from leaderboard.extensions.ability.fit import AbilityFit
from leaderboard.extensions.ability.likelihood import (
    ScoreItem,
    compute_binary_information,
    compute_score_information,
)


@dataclass(frozen=True, slots=True)
class NextScene:
    """A scene to run, and the deviation of the ability that is expected with it and those before it."""

    scene: str
    recording: str
    deviation: float


@dataclass(frozen=True, slots=True)
class NextScenes:
    """Scenes in the order of what they are worth.

    Attributes:
        scenes: The best first.
        deviation: Deviation of the planner's ability now.
        left: Scenes of the fit that the planner has no outcome in.
    """

    scenes: tuple[NextScene, ...]
    deviation: float
    left: int

    @property
    def loss(self) -> float:
        """Expected loss of the deviation with all of the scenes."""
        return self.deviation - (self.scenes[-1].deviation if self.scenes else self.deviation)


def compute_information(fit: AbilityFit, ability: Floats) -> Floats:
    """(N,) expected information of each scene about an ability of which (K,) draws go with those of the fit."""
    alpha = np.exp(fit.draw("log_alpha"))
    if fit.kind == "contact":
        return np.asarray(compute_binary_information(alpha, ability[:, None], fit.draw("beta")).mean(axis=0))
    item = ScoreItem(*(fit.draw(name) for name in ScoreItem._fields))
    return np.asarray((alpha**2 * compute_score_information(alpha * ability[:, None], item)).mean(axis=0))


def choose_next_scenes(fit: AbilityFit, planner: int | None, count: int) -> NextScenes:
    """Choose scenes one after the other, each the most informative beside those before it.

    At most one scene of a recording is chosen until every recording has one, those that the planner ran included.

    Args:
        fit: The joint fit of all planners.
        planner: Place of the planner in it; an average planner, of which nothing is known, where it is ``None``.
        count: Number of scenes; fewer where fewer are left.

    Raises:
        InputError: If the planner has an outcome in every scene.
    """
    theta = fit.draw("theta")
    if planner is None:
        # An average planner: a new one of the same population.
        spread = np.linspace(0.5, len(theta) - 0.5, len(theta)) / len(theta)
        ability = theta.mean(axis=1) + np.random.default_rng(0).permutation(_normal_quantiles(spread))
        deviation, ran = float(ability.std()), np.zeros(len(fit.scenes), np.bool_)
    else:
        ability, ran = theta[:, planner], fit.matrix.known[planner]
        deviation = fit.planners[planner].deviation
    if ran.all():
        raise InputError(
            f"{fit.planners[planner or 0].name} has an outcome in every one of the {len(ran)} scenes that any planner "
            f"ran of {fit.measured.words}: there is none left; build further scenes with challenger-bench generate"
        )
    information, variance = compute_information(fit, ability), deviation**2
    names, of_scene = fit.matrix.places
    shared = float(np.mean(np.square(fit.kept.sd_u))) if fit.kept.sd_u else 0.0
    seen = np.bincount(of_scene[ran], weights=information[ran], minlength=len(names))
    used = set(of_scene[ran].tolist())
    chosen: list[NextScene] = []
    left, precision = np.flatnonzero(~ran).tolist(), 1.0 / variance
    while left and len(chosen) < count:
        fresh = [scene for scene in left if of_scene[scene] not in used] or left
        gains = [_gain(seen[of_scene[scene]], information[scene], shared) for scene in fresh]
        best = fresh[int(np.argmax(gains))]
        precision += max(gains)
        seen[of_scene[best]] += information[best]
        used.add(int(of_scene[best]))
        left.remove(best)
        facts = fit.scenes[best]
        chosen.append(NextScene(facts.scene, facts.recording, float(precision**-0.5)))
    return NextScenes(tuple(chosen), deviation, int((~ran).sum()))


def _gain(before: float, more: float, shared: float) -> float:
    """What further information on a recording adds about the ability."""

    def about_ability(total: float) -> float:
        return total / (1.0 + total * shared)

    return about_ability(before + more) - about_ability(before)


def _normal_quantiles(probabilities: Floats) -> Floats:
    from scipy import stats

    return np.asarray(stats.norm.ppf(probabilities))
