"""How samples of the model compare with driving that it never saw."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.storage import content_seed
from generation.diffusion.bank import bank_beside, read_bank
from generation.diffusion.kinematics import STEP_S, Motion, motion
from generation.diffusion.prior import TrajectoryPrior, diversify
from generation.diffusion.standardiser import ACTION_SCALE, actions_from_waypoints, waypoints_from_actions
from generation.diffusion.training import HELD_OUT_SOURCES, load_track_data

ATTEMPTS: Final = 64
NEIGHBOURS_OF: Final = 1000
ROUND_NOISE_LEVELS: Final = (5, 4, 3, 2, 1)
CURVATURE_ABOVE: Final = 2.0
"""m/s; slower, the curvature of a 2 Hz path is mostly noise."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One quantity.

    Attributes:
        quantity: Name with unit.
        held_out_spread: Standard deviation over held-out windows, to read the distances by.
        model: 1-Wasserstein distance of samples from held-out driving.
        replay: The same for accelerations of the training windows themselves, replayed from the held-out starts: what
            an unconditional model that knows its training data perfectly would reach.
        learnt: 1-Wasserstein distance of samples from that replay.
    """

    quantity: str
    held_out_spread: float
    model: float
    replay: float
    learnt: float


@dataclass(frozen=True, slots=True)
class Report:
    """Figures of the model card.

    Attributes:
        comparisons: By quantity.
        held_out_windows: Real windows compared with.
        drivable_raw: Share of samples that a car can drive from a held-out start, without drawing again.
        drivable: The same with drawing again, as `TrajectoryPrior.sample` does.
        nearest_sample: Median distance from a sample to the nearest training window, root mean square m/s^2.
        nearest_held_out: The same from a held-out window: samples should not be nearer, or they are copies.
    """

    comparisons: tuple[Comparison, ...]
    held_out_windows: int
    drivable_raw: float
    drivable: float
    nearest_sample: float
    nearest_held_out: float


def wasserstein(first: Floats, second: Floats) -> float:
    """1-Wasserstein distance of two samples of one quantity, by their quantiles.

    Args:
        first: Values of any shape.
        second: Values of any shape.

    Returns:
        Distance in the unit of the values.
    """
    at = (np.arange(2000) + 0.5) / 2000
    quantiles = [
        np.interp(at * (values.size - 1), np.arange(values.size), np.sort(values, axis=None))
        for values in (np.asarray(first), np.asarray(second))
    ]
    return float(np.abs(quantiles[0] - quantiles[1]).mean())


def replay(actions: Floats, previous: Floats, rng: np.random.Generator, attempts: int = ATTEMPTS) -> Floats:
    """Actions drawn at random for each start, and drawn again where a car could not drive them.

    Args:
        actions: (A, 16, 3) to draw from.
        previous: (N, 3) poses half a second before each start.
        rng: Chance.
        attempts: Draws at most; 1 keeps the first whatever it is.

    Returns:
        (N, 16, 3) waypoints.
    """
    waypoints = waypoints_from_actions(actions[rng.integers(0, len(actions), len(previous))], previous)
    for _ in range(attempts - 1):
        bad = np.flatnonzero(motion(waypoints, previous).excess > 0)
        if not len(bad):
            break
        again = actions[rng.integers(0, len(actions), len(bad))]
        waypoints[bad] = waypoints_from_actions(again, previous[bad])
    return waypoints


def _quantities(moved: Motion) -> dict[str, Floats]:
    between = 0.5 * (moved.speed[..., 1:] + moved.speed[..., :-1])
    return {
        "speed after 8 s, m/s": moved.speed[..., -1],
        "acceleration, m/s^2": moved.acceleration,
        "change of acceleration per half second, m/s^2": np.diff(moved.acceleration, axis=-1),
        "lateral acceleration, m/s^2": moved.lateral,
        "yaw rate, rad/s": moved.yaw_rate,
        "curvature above 2 m/s, 1/m": moved.curvature[between > CURVATURE_ABOVE],
        "turn over 8 s, rad": moved.turn.sum(axis=-1),
    }


def _nearest(actions: Floats, references: Floats) -> float:
    """Median over actions of the root mean square difference to the nearest reference, m/s^2, x and y only."""
    flat = actions[..., :2].reshape(len(actions), -1)
    others = references[..., :2].reshape(len(references), -1)
    squared = (flat**2).sum(1)[:, None] + (others**2).sum(1) - 2 * flat @ others.T
    nearest = np.sqrt(np.maximum(squared.min(axis=1), 0.0) / (flat.shape[1] / 2))
    return float(np.median(nearest) * ACTION_SCALE / STEP_S**2)


def compare_with_held_out(weights: Path, tracks: Path, seed: int = 0) -> Report:
    """Compare the bank of a model with windows of sources it was not trained on.

    Args:
        weights: Weights with a bank beside them.
        tracks: Folder of track files that holds the held-out sources.
        seed: Of the draws.

    Returns:
        See `Report`.

    Raises:
        InputError: If bank or held-out sources are missing.
    """
    data = load_track_data(tracks, HELD_OUT_SOURCES, stride_s=0.5)
    if not data.held_out:
        raise InputError(f"{tracks} has none of the held-out sources {', '.join(HELD_OUT_SOURCES)}; nothing to compare")
    bank = read_bank(bank_beside(weights), weights)
    previous = np.concatenate([windows.previous for windows in data.held_out.values()])
    real = np.concatenate([windows.waypoints for windows in data.held_out.values()])
    learnt_from = np.concatenate(
        [actions_from_waypoints(windows.waypoints, windows.previous) for windows in data.training.values()]
    )
    mirrored = np.concatenate([learnt_from, learnt_from * [1.0, -1.0, -1.0]])
    rng = np.random.default_rng(content_seed("held-out comparison", seed))
    raw, sampled = replay(bank, previous, rng, attempts=1), replay(bank, previous, rng)
    ideal = _quantities(motion(replay(mirrored, previous, rng), previous))
    actual, model = _quantities(motion(real, previous)), _quantities(motion(sampled, previous))
    pick = rng.choice(len(previous), size=min(NEIGHBOURS_OF, len(previous)), replace=False)
    return Report(
        comparisons=tuple(
            Comparison(
                name,
                float(actual[name].std()),
                wasserstein(model[name], actual[name]),
                wasserstein(ideal[name], actual[name]),
                wasserstein(model[name], ideal[name]),
            )
            for name in actual
        ),
        held_out_windows=len(previous),
        drivable_raw=float((motion(raw, previous).excess == 0).mean()),
        drivable=float((motion(sampled, previous).excess == 0).mean()),
        nearest_sample=_nearest(bank[:NEIGHBOURS_OF], mirrored),
        nearest_held_out=_nearest(actions_from_waypoints(real[pick], previous[pick]), mirrored),
    )


@dataclass(frozen=True, slots=True)
class StrideError:
    """What fewer network calls in a truncated process change, root mean square metres over waypoints.

    Attributes:
        noise_level: Of 100.
        two_draws: Difference of two draws of the reference's process, one call per level.
        by_calls: Difference from the reference's process with the same noise, by number of calls.
    """

    noise_level: int
    two_draws: float
    by_calls: dict[int, float]


def stride_errors(weights: Path, calls: Sequence[int] = (1, 2), seed: int = 0) -> tuple[StrideError, ...]:
    """Compare strided truncated processes with the reference's, over the five rounds of a diversified batch at 8 m/s.

    Args:
        weights: Weights with a bank beside them.
        calls: Numbers of calls to compare.
        seed: Of batch and noise.

    Returns:
        One entry per round.
    """
    previous = np.array([-4.0, 0.0, 0.0])
    full = TrajectoryPrior.load(weights, mutation_steps=None, drivable=False)
    strided = {count: TrajectoryPrior.load(weights, mutation_steps=count, drivable=False) for count in calls}
    rng = np.random.default_rng(content_seed("stride errors", seed))
    candidates = diversify(full.sample(256, previous, rng), rng)
    errors = []
    for level in ROUND_NOISE_LEVELS:
        first, second = (content_seed("stride errors", seed, level, draw) for draw in (0, 1))
        reference = full.mutate(candidates, level, previous, np.random.default_rng(first))
        other = full.mutate(candidates, level, previous, np.random.default_rng(second))
        by_calls = {
            count: _rms_metres(prior.mutate(candidates, level, previous, np.random.default_rng(first)) - reference)
            for count, prior in strided.items()
        }
        errors.append(StrideError(level, _rms_metres(other - reference), by_calls))
        candidates = reference
    return tuple(errors)


def _rms_metres(difference: Floats) -> float:
    return float(np.sqrt((difference[..., :2] ** 2).sum(axis=-1).mean()))
