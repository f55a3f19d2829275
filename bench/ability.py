"""Recovery and coverage of abilities by simulation, and what ``leaderboard next`` saves.

``python -m bench.ability --outcome contact --planners 7 --scenes 19 --recordings 10 --replicates 60 --to FILE`` fits
matrices of known truth one after the other, as the product does: one compiled sampler for all of them, a line of FILE
each, so that a second call goes on where the first ended. ``--next N`` measures instead how sure one is of N newcomers
after scenes chosen one by one, and after scenes in random order.

Truth: log α ~ N(0.4, 0.35); β ~ N(-0.3, 1.2), with recordings 0.6 of that and N(0, 0.9) of the recording; planner and
recording N(0, 0.6); of scores o ~ N(1.5, 0.6), g0 ~ N(-1.6, 0.9), log (g1 - g0) ~ N(1.1, 0.3).
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy import special, stats

from bench.ability_next import run_newcomers, summarise_newcomers
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.metrics.ranks import rank_planners
from leaderboard.extensions.ability.matrix import OutcomeMatrix
from leaderboard.extensions.ability.posterior import Posterior, rank_draws
from leaderboard.extensions.ability.sampling import CompiledChains, JointModel, fit_posterior

EFFECT: Final = 0.6
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
    expit = special.expit
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


def measure(truth: Floats, posterior: Posterior) -> dict[str, Any]:
    """Shares of intervals of one replicate that hold the truth, and of pairs told apart, rightly or wrongly."""
    theta, centred, matrix = posterior.flat("theta"), posterior.contrasts, posterior.matrix
    held = {}
    for name, draws, true in (("theta", theta, truth), ("contrast", centred, truth - truth.mean())):
        low, high = np.quantile(draws, (0.025, 0.975), axis=0)
        held[name] = float(((low <= true) & (true <= high)).mean())
    ranks, true_ranks = rank_draws(theta), find_ranks(truth)
    best, worst = np.array(ranks.best), np.array(ranks.worst)
    called = np.argwhere(ranks.better > 0.975)
    totals = [dict(zip(matrix.scenes, ((float(value), 1.0) for value in row))) for row in matrix.values]
    boot = rank_planners(totals, dict(zip(matrix.scenes, matrix.recordings)), lower_is_better=False) or []
    pairs = len(truth) * (len(truth) - 1) // 2
    return {
        **held,
        "rank": float(((best <= true_ranks) & (true_ranks <= worst)).mean()),
        "bootstrap rank": float(np.mean([own.best <= rank <= own.worst for own, rank in zip(boot, true_ranks)])),
        "called": len(called) / pairs,
        "wrong": float(sum(truth[a] < truth[b] for a, b in called)) / pairs,
        "width": float((worst - best).mean()),
        "tau": float(stats.kendalltau(theta.mean(axis=0), truth).statistic),
        "bootstrap tau": float(stats.kendalltau(matrix.values.mean(axis=1), truth).statistic),
        "bias": float((theta.mean(axis=0) - truth).mean()),
        "rmse": float(np.sqrt(np.mean((centred.mean(axis=0) - truth + truth.mean()) ** 2))),
        "r_hat": posterior.r_hat,
        "draws": len(theta),
    }


def run_replicate(given: argparse.Namespace, replicate: int, compiled: list[CompiledChains]) -> dict[str, Any]:
    """One matrix: its measures, or that its chains did not agree."""
    rng = np.random.default_rng([given.seed, replicate])
    of_scene = np.arange(given.scenes) * given.recordings // given.scenes
    truth, values = draw_truth(rng, given.planners + given.next, of_scene, given.outcome)
    kept, newcomers = values[: given.planners], values[given.planners :]
    if given.next:
        # A row for whoever is new, without an outcome.
        kept = np.vstack([kept, np.full((1, given.scenes), np.nan)])
    names = tuple(f"p{at:02}" for at in range(len(kept))), tuple(f"s{at:03}" for at in range(given.scenes))
    matrix = OutcomeMatrix(given.outcome, *names, tuple(f"r{at:03}" for at in of_scene), kept)
    if not compiled:
        compiled.append(CompiledChains.of(JointModel.of(matrix)))
    try:
        posterior = fit_posterior(matrix, seed=replicate, max_seconds=given.max_seconds, compiled=compiled[0])
    except InputError as error:
        return {"refused": str(error)}
    return run_newcomers(posterior, newcomers, rng) if given.next else measure(truth, posterior)


def summarise(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over the replicates whose chains agreed, shares in %."""
    agreed = [line for line in lines if "refused" not in line]
    found: dict[str, Any] = {"replicates": len(lines), "agreed": len(agreed)}
    found["cpu_s"] = round(sum(line["cpu_s"] for line in lines), 1)
    if not agreed:
        return found
    if "adaptive" in agreed[0]:
        return found | summarise_newcomers(agreed)
    measured = [name for name, value in agreed[0].items() if isinstance(value, float | int)]
    means = {name: float(np.mean([line[name] for line in agreed])) for name in measured}
    shares = ("theta", "contrast", "rank", "bootstrap rank", "called")
    found |= {name: round(100.0 * means[name], 1) for name in shares}
    found["wrong of called"] = round(100.0 * means["wrong"] / max(means["called"], 1e-9), 2)
    return found | {
        name: round(means[name], 3) for name in ("width", "tau", "bootstrap tau", "bias", "rmse", "r_hat", "draws")
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--outcome", choices=("contact", "score"), default="contact")
    sizes = {"planners": 7, "scenes": 19, "recordings": 10, "replicates": 60, "seed": 0, "next": 0}
    for name, default in sizes.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--max-seconds", type=float, default=600.0, help="of a replicate's chains")
    parser.add_argument("--to", type=Path, required=True, help="a line a replicate; gone on with if it exists")
    given = parser.parse_args()
    of = [given.outcome, given.planners, given.scenes, given.recordings, given.next, given.seed]
    done = [json.loads(line) for line in given.to.read_text().splitlines()] if given.to.is_file() else []
    done = [line for line in done if line["of"] == of and line["replicate"] < given.replicates]
    compiled: list[CompiledChains] = []
    for replicate in sorted(set(range(given.replicates)) - {line["replicate"] for line in done}):
        started = time.process_time()
        found = run_replicate(given, replicate, compiled)
        cpu_s = round(time.process_time() - started, 1)
        done.append({"of": of, "replicate": replicate, "cpu_s": cpu_s, **found})
        with given.to.open("a") as file:
            file.write(json.dumps(done[-1]) + "\n")
    print(json.dumps({"of": of, **summarise(done)}))


if __name__ == "__main__":
    main()
