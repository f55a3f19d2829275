"""Recovery and coverage of abilities by simulation: matrices of known truth, fitted as the product fits them.

``python -m bench.ability --outcome contact --planners 7 --scenes 19 --recordings 10 --replicates 60``. All replicates
are sampled side by side, with the model, priors and sampler of `leaderboard.extensions.ability.sampling`. Truth: log α
~ N(0.4, 0.35); β ~ N(-0.3, 1.2), with recordings 0.6 of that and N(0, 0.9) of the recording; planner and recording
N(0, 0.6); of scores o ~ N(1.5, 0.6), g0 ~ N(-1.6, 0.9), log (g1 - g0) ~ N(1.1, 0.3).
"""

import argparse
import json
import time
from typing import Any

import numpy as np
from scipy import stats

from benchmark.geometry import Floats
from benchmark.metrics.ranks import rank_planners
from leaderboard.extensions.ability.likelihood import clip_scores, make_mathematics
from leaderboard.extensions.ability.matrix import OutcomeMatrix
from leaderboard.extensions.ability.posterior import rank_draws
from leaderboard.extensions.ability.sampling import (
    BLOCK,
    CHAINS,
    LEAST,
    MOST_R_HAT,
    WARM_UP,
    JointModel,
    compute_r_hat,
    start_chains,
)

EFFECT = 0.6
"""Standard deviation of what a planner has with a recording."""


def draw_truth(rng: np.random.Generator, planners: int, of_scene: Any, outcome: str) -> tuple[Floats, Floats]:
    """(S,) abilities and (S, N) outcomes."""
    scenes, recordings = len(of_scene), int(of_scene.max()) + 1
    shared = recordings < scenes
    theta = rng.standard_normal(planners)
    alpha = np.exp(rng.normal(0.4, 0.35, scenes))
    beta = rng.normal(-0.3, 1.2, scenes)
    ability = np.repeat(theta[:, None], scenes, axis=1)
    if shared:
        beta = -0.3 + 0.6 * (beta + 0.3) + rng.normal(0.0, 0.9, recordings)[of_scene]
        ability = ability + rng.normal(0.0, EFFECT, (planners, recordings))[:, of_scene]
    expit = make_mathematics().special.expit
    if outcome == "contact":
        return theta, (rng.random(ability.shape) < expit(alpha * (ability - beta))).astype(float)
    omega, g0 = rng.normal(1.5, 0.6, scenes), rng.normal(-1.6, 0.9, scenes)
    upper = g0 + np.exp(rng.normal(1.1, 0.3, scenes))
    t = alpha * ability
    a, b = np.exp((t - beta + omega) / 2), np.exp((omega - t + beta) / 2)
    between, chance = rng.beta(a, b), rng.random(t.shape)
    zero, one = chance < expit(g0 - t), chance > 1 - expit(t - upper)
    return theta, np.where(zero, 0.0, np.where(one, 1.0, between))


def find_ranks(values: Floats) -> Any:
    """Rank 1 is the largest."""
    return np.argsort(np.argsort(-values)) + 1


def measure(theta: Floats, draws: Floats, values: Floats, recordings: list[str]) -> dict[str, Any]:
    """Whether intervals cover the truth of one replicate, and who is told apart, rightly or wrongly."""
    centred, truth = draws - draws.mean(axis=1, keepdims=True), theta - theta.mean()
    low, high = np.quantile(draws, (0.025, 0.975), axis=0)
    low_c, high_c = np.quantile(centred, (0.025, 0.975), axis=0)
    ranks, true_ranks = rank_draws(draws), find_ranks(theta)
    called = ranks.better > 0.975
    scenes = [f"s{at}" for at in range(values.shape[1])]
    totals = [dict(zip(scenes, ((float(value), 1.0) for value in row))) for row in values]
    boot = rank_planners(totals, dict(zip(scenes, recordings)), lower_is_better=False) or []
    return {
        "theta": (low <= theta) & (theta <= high),
        "contrast": (low_c <= truth) & (truth <= high_c),
        "rank": (np.array(ranks.best) <= true_ranks) & (true_ranks <= np.array(ranks.worst)),
        "width": np.array(ranks.worst) - np.array(ranks.best),
        "bootstrap rank": [own.best <= rank <= own.worst for own, rank in zip(boot, true_ranks)],
        "tau": stats.kendalltau(draws.mean(axis=0), theta).statistic,
        "bootstrap tau": stats.kendalltau(values.mean(axis=1), theta).statistic,
        "called": called[np.triu_indices(len(theta), 1)] | called.T[np.triu_indices(len(theta), 1)],
        "wrong": [bool(theta[a] < theta[b]) for a, b in zip(*np.nonzero(called))],
    }


def simulate(given: argparse.Namespace) -> dict[str, Any]:
    """Coverage over the replicates whose chains agreed."""
    import jax

    rng, started = np.random.default_rng(given.seed), time.process_time()
    of_scene = np.arange(given.scenes) * given.recordings // given.scenes
    drawn = [draw_truth(rng, given.planners, of_scene, given.outcome) for _ in range(given.replicates)]
    recordings = [f"r{at:03}" for at in of_scene]
    names = tuple(f"p{at}" for at in range(given.planners)), tuple(f"s{at}" for at in range(given.scenes))
    first = OutcomeMatrix(given.outcome, *names, tuple(recordings), drawn[0][1])
    model = JointModel.of(first)
    x = np.repeat(np.array([clip_scores(values) for _, values in drawn]), CHAINS, axis=0)
    with jax.experimental.enable_x64():
        state, advance = start_chains(model, x, given.seed)
        for _ in range(-(-WARM_UP // BLOCK)):
            state, *_ = advance(state, x)
        kept: dict[str, list[Floats]] = {"theta": [], "log_alpha": [], "beta": []}
        worst = np.full(given.replicates, np.inf)
        while worst.max() > MOST_R_HAT and len(kept["theta"]) * BLOCK < given.most:
            state, variables, _ = advance(state, x)
            built = model.build(variables, make_mathematics())
            for name, blocks in kept.items():
                blocks.append(np.asarray(built[name]).reshape(given.replicates, CHAINS, BLOCK, -1))
            if (drawn_so_far := len(kept["theta"]) * BLOCK) >= LEAST and drawn_so_far % (5 * BLOCK) == 0:
                joined = {name: np.concatenate(blocks, axis=2) for name, blocks in kept.items()}
                worst = np.array(
                    [max(compute_r_hat(own[at]) for own in joined.values()) for at in range(given.replicates)]
                )
    theta = np.concatenate(kept["theta"], axis=2).reshape(given.replicates, -1, given.planners)
    agreed = np.flatnonzero(worst <= MOST_R_HAT).tolist()
    found = [measure(drawn[at][0], theta[at], drawn[at][1], recordings) for at in agreed]

    def mean(name: str) -> float:
        return float(np.mean(np.concatenate([np.atleast_1d(each[name]).astype(float) for each in found])))

    shares = {name: 100 * mean(name) for name in ("theta", "contrast", "rank", "bootstrap rank", "called")}
    return {
        "replicates": given.replicates,
        "agreed": len(agreed),
        "draws": CHAINS * len(kept["theta"]) * BLOCK,
        **{name: round(value, 1) for name, value in shares.items()},
        "wrong": round(100 * mean("wrong"), 1),
        **{name: round(mean(name), 3) for name in ("width", "tau", "bootstrap tau")},
        "cpu_s": round(time.process_time() - started, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--outcome", choices=("contact", "score"), default="contact")
    for name, default in (("planners", 7), ("scenes", 19), ("recordings", 10), ("replicates", 60), ("seed", 0)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--most", type=int, default=4000, help="draws of a chain after which it is left out")
    given = parser.parse_args()
    print(
        json.dumps({"of": f"{given.outcome} {given.planners} x {given.scenes} ({given.recordings})", **simulate(given)})
    )


if __name__ == "__main__":
    main()
