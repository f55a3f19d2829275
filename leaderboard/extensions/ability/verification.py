"""`challenger-bench verify ability`: cells in closed form, and joint posteriors against those of another sampler."""

import csv
import importlib.util
import io
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.geometry import Floats
from benchmark.untrusted.files import JSON, read_file
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet
from leaderboard.extensions.ability.likelihood import (
    NUMPY,
    ScoreItem,
    clip_scores,
    compute_score_gradients,
    compute_score_information,
    compute_score_log_likelihood,
)
from leaderboard.extensions.ability.matrix import Outcome, OutcomeMatrix
from leaderboard.extensions.ability.posterior import Posterior, rank_draws

BUILT_IN: Final = Path(__file__).parent / "golden" / "ability"
"""Cells and one small matrix."""
_CELLS: Final = "cells.json"
_MATRICES: Final[dict[str, Outcome]] = {"binary": "contact", "zoib": "score", "graded": "ordered"}
"""Kinds of outcomes by the first word of a matrix' name."""
_LEAST: Final = 3000
"""Draws of each chain, twice as many as the stored posteriors have."""
_SMALL: Final = 500
"""Matrices of fewer cells get twice as many: discriminations have long tails there, and means of them wander."""
_SECONDS: Final = 900.0
_BATCH: Final = 100
_ITEMS: Final = {"alpha": "discriminations", "beta": "difficulties"}


def compare_cells(comparison: Comparison, golden: GoldenFolder) -> None:
    """Log likelihood, gradients and information of single scores."""
    cells = golden.facts(_CELLS)
    columns = {name: np.array([cell[name] for cell in cells], np.float64) for name in cells[0]}
    x, t = clip_scores(columns["x"]), columns["t"]
    item = ScoreItem(columns["beta"], columns["omega"], columns["g0"], columns["D"])
    ours = {"loglik": compute_score_log_likelihood(x, t, item, NUMPY)}
    gradients = compute_score_gradients(x, t, item)
    ours |= dict(zip(("d_t", "d_beta", "d_omega", "d_g0", "d_D"), gradients, strict=True))
    ours["information_about_t"] = compute_score_information(t, item)
    for name, values in ours.items():
        comparison.numbers(f"cells: {name}", values, columns[name])


def compare_matrices(comparison: Comparison, golden: GoldenFolder) -> None:
    """Posteriors of every matrix of the set; where numpyro is not installed, a note says that none was compared."""
    folders = [path.parent for path in golden.named("*/matrix.csv")]
    if folders and importlib.util.find_spec("numpyro") is None:
        comparison.note("cells: loglik", f"{len(folders)} posteriors are not compared: numpyro is not installed")
        return
    from leaderboard.extensions.ability.sampling import fit_posterior

    for folder in folders:
        kind = _MATRICES[folder.name.partition("-")[0]]
        matrix = read_matrix(folder, kind)
        least = _LEAST if matrix.values.size >= _SMALL else 2 * _LEAST
        posterior = fit_posterior(matrix, max_seconds=_SECONDS, least_draws=least)
        compare_posterior(comparison.at(folder.name), posterior, GoldenFolder(folder).facts("posterior.json"))


def read_matrix(folder: Path, kind: Outcome) -> OutcomeMatrix:
    """A matrix and the recordings of its scenes, from CSV."""
    (_, *scenes), *rows = _read_csv(folder / "matrix.csv")
    source_of = dict(row for row in _read_csv(folder / "recordings.csv")[1:])
    values = np.array([[float(cell) if cell else np.nan for cell in row[1:]] for row in rows])
    recordings = tuple(source_of[scene] for scene in scenes)
    return OutcomeMatrix(kind, tuple(row[0] for row in rows), tuple(scenes), recordings, values)


def _read_csv(path: Path) -> list[list[str]]:
    return [row for row in csv.reader(io.StringIO(read_file(path, JSON).decode())) if row]


def compare_posterior(comparison: Comparison, posterior: Posterior, stored: Any) -> None:
    """Abilities, ranks, who is better than whom, and parameters of scenes, within the tolerances of the set."""
    theta, theirs = posterior.flat("theta"), {name: np.array(values) for name, values in stored["theta"].items()}
    own_error = compute_standard_error(posterior.draws["theta"])
    allowed = 0.05 + 4.0 * np.sqrt(theirs["mcse_mean"] ** 2 + own_error**2)
    comparison.errors("abilities: means, of what is allowed", (theta.mean(axis=0) - theirs["mean"]) / allowed)
    comparison.errors("abilities: deviations, ratio less 1", theta.std(axis=0) / theirs["sd"] - 1.0)
    ranks = rank_draws(theta)
    ends = np.array([ranks.best, ranks.worst])
    comparison.numbers("ranks: ends of intervals", ends, np.array([theirs["rank_lo"], theirs["rank_hi"]]))
    comparison.numbers("ranks: better than", ranks.better, np.array(stored["prob_row_better_than_column"]))
    ours = {"alpha": np.exp(posterior.flat("log_alpha")).mean(axis=0), "beta": posterior.flat("beta").mean(axis=0)}
    for name, words in _ITEMS.items():
        if name in stored["items"]:
            golden = np.array(stored["items"][name]["mean"])
            comparison.errors(f"scenes: {words}, 1 less correlation", 1.0 - np.corrcoef(ours[name], golden)[0, 1])


def compute_standard_error(draws: Floats) -> Floats:
    """Monte Carlo standard error of the mean of (C, D, ...) draws, by means of batches."""
    batches = draws[:, : draws.shape[1] // _BATCH * _BATCH].reshape(-1, _BATCH, *draws.shape[2:]).mean(axis=1)
    return np.asarray(batches.std(axis=0, ddof=1) / np.sqrt(len(batches)))


GOLDEN: Final = GoldenSet(
    name="ability",
    files=(_CELLS,),
    compare=(compare_cells, compare_matrices),
    quantities={
        "cells: *": 1e-9,
        "abilities: means, of what is allowed": 1.0,
        "abilities: deviations, ratio less 1": 0.1,
        "ranks: ends of intervals": 1.0,
        "ranks: better than": 0.04,
        "scenes: *": 0.01,
    },
    built_in=BUILT_IN,
    usual="irt",
)
