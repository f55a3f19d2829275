"""Can two sets of trajectories be told apart? Energy distance with a permutation test.

Szekely and Rizzo 2013: twice the mean distance between the sets less the mean distances within them is zero only for
equal distributions. Under the hypothesis of equality labels can be swapped, which gives the p-value without a model.
"""

from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from generation.diffusion.kinematics import Motion

PERMUTATIONS: Final = 199
SIGNIFICANCE: Final = 0.05
FEATURES: Final = (
    "speed after 2 s, m/s",
    "speed after 4 s, m/s",
    "speed after 8 s, m/s",
    "mean acceleration, m/s^2",
    "spread of acceleration, m/s^2",
    "spread of the change of acceleration, m/s^2",
    "mean lateral acceleration, m/s^2",
    "spread of lateral acceleration, m/s^2",
    "turn over 8 s, rad",
    "spread of the yaw rate, rad/s",
)
"""What the test sees of a trajectory."""


def motion_features(moved: Motion) -> Floats:
    """Features of (N,) trajectories.

    Args:
        moved: Of (N, 16, 3) waypoints.

    Returns:
        (N, 10) in the order of `FEATURES`.
    """
    along, across, yaw_rate = moved.acceleration, moved.lateral, moved.yaw_rate
    columns = [
        moved.speed[:, 4],
        moved.speed[:, 8],
        moved.speed[:, 16],
        along.mean(axis=1),
        along.std(axis=1),
        np.diff(along, axis=1).std(axis=1),
        across.mean(axis=1),
        across.std(axis=1),
        moved.turn.sum(axis=1),
        yaw_rate.std(axis=1),
    ]
    return np.column_stack(columns)


def energy_distance(first: Floats, second: Floats) -> float:
    """Energy distance of two samples, as the mean over all pairs (never negative).

    Args:
        first: (N, D).
        second: (M, D), in the same units.

    Returns:
        Distance in the units of the features.

    Raises:
        InputError: If a sample is empty, not finite, or the dimensions differ.
    """
    distance = _pairwise(first, second)
    return float(_statistics(distance, np.arange(len(distance))[None] < len(first))[0])


def permutation_test(
    first: Floats, second: Floats, rng: np.random.Generator, permutations: int = PERMUTATIONS
) -> tuple[float, float]:
    """Energy distance and the share of relabellings that are at least as far apart.

    Args:
        first: (N, D) independent draws.
        second: (M, D) independent draws.
        rng: Chance.
        permutations: Relabellings.

    Returns:
        Distance, p-value; the observed labelling counts as one, so the p-value is never zero.

    Raises:
        InputError: As `energy_distance`.
    """
    distance = _pairwise(first, second)
    observed = np.arange(len(distance))[None] < len(first)
    relabelled = rng.permuted(np.repeat(observed, permutations, axis=0), axis=1)
    statistics = _statistics(distance, np.concatenate([observed, relabelled]))
    as_far = int((statistics[1:] >= statistics[0] * (1 - 1e-12)).sum())
    return float(statistics[0]), (1 + as_far) / (1 + permutations)


def rejection_rate(first: Floats, second: Floats, size: int, repeats: int, rng: np.random.Generator) -> float | None:
    """How often two samples of a size are told apart at 5 %.

    Args:
        first: (V, D) one row of each of V vehicles.
        second: (V, D) another row of each. A vehicle is in one of the two samples of a test at most, because its rows
            resemble each other; ``first`` and ``second`` may be the same.
        size: Of each sample.
        repeats: Tests, each with its own draw of vehicles.
        rng: Chance.

    Returns:
        Share of tests with a p-value of at most 0.05; ``None`` where there are fewer than twice ``size`` vehicles.
    """
    if len(first) < 2 * size:
        return None
    told_apart = 0
    for _ in range(repeats):
        vehicles = rng.choice(len(first), 2 * size, replace=False)
        told_apart += permutation_test(first[vehicles[:size]], second[vehicles[size:]], rng)[1] <= SIGNIFICANCE
    return told_apart / repeats


def _pairwise(first: Floats, second: Floats) -> Floats:
    """(N + M, N + M) Euclidean distances between all draws."""
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if first.ndim != 2 or second.ndim != 2 or first.shape[1] != second.shape[1] or not len(first) or not len(second):
        raise InputError(f"two samples need rows of the same features, got {first.shape} and {second.shape}")
    pooled = np.concatenate([first, second])
    if not np.isfinite(pooled).all():
        raise InputError("a sample holds NaN or infinity; leave those trajectories out before the test")
    squared = (pooled**2).sum(axis=1)
    distance = squared[:, None] + squared - 2.0 * pooled @ pooled.T
    np.fill_diagonal(distance, 0.0)
    return np.asarray(np.sqrt(np.maximum(distance, 0.0)))


def _statistics(distance: Floats, in_first: Bools) -> Floats:
    """Energy distance of each labelling (P, N + M): a quadratic form in weights 1/N and -1/M."""
    count = in_first.sum(axis=1, keepdims=True)
    weights = np.where(in_first, 1.0 / count, -1.0 / (in_first.shape[1] - count))
    return np.asarray(-((weights @ distance) * weights).sum(axis=1))
