"""Driving scores of a run: means and shares of its samples' sub-scores, and the totals made of them."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats
from benchmark.metrics.rates import compute_ratios_over_scenes
from benchmark.pdm.definition import DEFINITION, NOTE, PDM, VERSION
from benchmark.pdm.totals import FILTERED, DrivenPlan, SubScores
from benchmark.records.row_schema import SampleRow
from benchmark.records.run_schema import DrivingSummary

__all__ = [
    "COLUMNS",
    "DEFINITION",
    "NOTE",
    "PDM",
    "SUB_SCORES",
    "TOTALS",
    "VERSION",
    "read_sample_scores",
    "summarise_driving_scores",
]
# Imported by the leaderboard for its text on the definition.

SUB_SCORES: Final = ("nc", "dac", "ddc", "ep", "ttc", "lk", "hc", "ec")
TOTALS: Final = ("score", "score_without_ec")
COLUMNS: Final = (
    *TOTALS,
    *SUB_SCORES,
    *(f"filtered_{name}" for name in (*TOTALS, *(name for name in SUB_SCORES if name != "ec"))),
)
"""Columns of a summary; EC is not filtered."""


def summarise_driving_scores(rows: Sequence[SampleRow], scenes: Sequence[str], *, seed: int) -> DrivingSummary | None:
    """Means and shares over the samples that have driving scores; ``scenes`` are recorded ones that are drawn together.

    A sample without a predecessor has no EC and no ``score``, one without a history no HC; both are in
    ``score_without_ec``, where HC counts as 1 without a history, as officially.
    """
    counted = [(row.driving, scene) for row, scene in zip(rows, scenes, strict=True) if row.driving is not None]
    if not counted:
        return None
    return summarise_score_columns(
        read_sample_scores([driving for driving, _ in counted]), [scene for _, scene in counted], len(rows), seed=seed
    )


def summarise_score_columns(
    scores: tuple[Floats, Bools], scenes: Sequence[str], planned: int, *, seed: int
) -> DrivingSummary:
    """Means and shares from the columns of `read_sample_scores`; ``planned`` is how many samples have a plan.

    ``scenes`` are S names of the recorded scenes that are drawn together.
    """
    values, known = scores
    weights = np.concatenate([known, known], axis=1).astype(np.float64)
    both = np.concatenate([values, values == 1.0], axis=1) * weights
    rates = compute_ratios_over_scenes(both, weights, scenes, seed=seed)
    columns = {
        name: {"mean": mean, "ones": ones}
        for name, mean, ones in zip(COLUMNS, rates[: len(COLUMNS)], rates[len(COLUMNS) :], strict=True)
    }
    return DrivingSummary(version=VERSION, columns=columns, counted=len(scenes), incomplete=planned - len(scenes))


def read_sample_scores(rows: Sequence[DrivenPlan]) -> tuple[Floats, Bools]:
    """Driving scores of S samples: (S, C) values in the order of ``COLUMNS`` and (S, C) whether each exists."""
    always = {name: np.array([getattr(row, name) for row in rows], np.float64) for name in SUB_SCORES[:6]}
    # A missing score is null and becomes NaN.
    hc, ec = (np.array([getattr(row, name) for row in rows], np.float64) for name in ("hc", "ec"))
    scores = SubScores(**always, hc=np.where(np.isnan(hc), 1.0, hc))
    forgiven = {name: np.array([name in row.forgiven for row in rows], np.bool_) for name in FILTERED}
    filtered = scores.forgive(forgiven)
    columns = {
        "score": scores.score(ec),
        "score_without_ec": scores.score_without_ec,
        **always,
        "hc": hc,
        "ec": ec,
        "filtered_score": filtered.score(ec),
        "filtered_score_without_ec": filtered.score_without_ec,
        **{f"filtered_{name}": getattr(filtered, name) for name in FILTERED},
        "filtered_hc": np.where(np.isnan(hc) & ~forgiven["hc"], np.nan, filtered.hc),
    }
    values = np.stack([columns[name] for name in COLUMNS], axis=1)
    known = ~np.isnan(values)
    return np.where(known, values, 0.0), known
