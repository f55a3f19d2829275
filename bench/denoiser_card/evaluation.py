"""How samples of the model compare with driving that it never saw."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from bench.denoiser_card.drawing import Source, asked, drawn_again, replayed
from bench.denoiser_card.feasibility import Tracking, track
from bench.denoiser_card.two_sample import motion_features, permutation_test, rejection_rate
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from generation.diffusion.checkpoint import load_denoiser
from generation.diffusion.kinematics import STEP_S, Motion, motion
from generation.diffusion.residual_network import present_features
from generation.diffusion.schedule import add_noise, signal_and_noise
from generation.diffusion.standardiser import ACTION_SCALE, actions_from_waypoints
from generation.extensions.denoiser_training.loop import HELD_OUT_SOURCES
from generation.extensions.denoiser_training.window_pool import WindowPool, load_track_data

NEIGHBOURS_OF: Final = 1000
REPLAYED: Final = 20_000
"""Training windows that are replayed, drawn as training draws them but not scaled."""
TRACKED_STARTS: Final = 400
TEST_SIZES: Final = (25, 50, 100, 200, 300)
TEST_REPEATS: Final = 100
TEST_DRAWS: Final = 5
"""What is tested is drawn so many times; a single draw of a few hundred is lucky or not."""
NOISE_LEVELS: Final = (1, 3, 5, 10, 20, 50, 100)
CURVATURE_ABOVE: Final = 2.0
"""m/s; slower, the curvature of a 2 Hz path is mostly noise."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """What is compared with, and what the model learnt from.

    Attributes:
        previous: (N, 3) pose half a second before each held-out window.
        waypoints: (N, 16, 3) held-out windows.
        vehicle: (N,) which vehicle each is of; windows of one vehicle resemble each other.
        learnt_from: (A, 16, 3) actions of all training windows, as they are and mirrored.
        replayed: (R, 16, 3) actions drawn from them as in training, but not scaled.
    """

    previous: Floats
    waypoints: Floats
    vehicle: NDArray[np.int64]
    learnt_from: Floats
    replayed: Floats


def load_held_out(tracks: Path, sources: tuple[str, ...] = HELD_OUT_SOURCES, seed: int = 0) -> HeldOut:
    """Read and cut a folder of recordings for a comparison.

    Args:
        tracks: Folder that holds the held-out sources.
        sources: Their names.
        seed: Of the replayed draws.

    Returns:
        See `HeldOut`.

    Raises:
        InputError: If the folder has none of the held-out sources or nothing else.
    """
    data = load_track_data(tracks, sources, stride_s=0.5)
    if not data.held_out:
        raise InputError(f"{tracks} has none of the held-out sources {', '.join(sources)}; nothing to compare")
    pool = WindowPool.of(data.training)
    vehicles = [windows.track + 1_000_000 * index for index, windows in enumerate(data.held_out.values())]
    return HeldOut(
        previous=np.concatenate([windows.previous for windows in data.held_out.values()]),
        waypoints=np.concatenate([windows.waypoints for windows in data.held_out.values()]),
        vehicle=np.concatenate(vehicles),
        learnt_from=np.concatenate([pool.actions, pool.actions * [1.0, -1.0, -1.0]]),
        replayed=pool.draw(REPLAYED, 0.0, np.random.default_rng(content_seed("replayed windows", seed))).actions,
    )


@dataclass(frozen=True, slots=True)
class DistributionDistances:
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
        denoising_error: By noise level of 100, root mean square error of the accelerations that the network finds in
            noisy held-out windows, m/s^2.
        tracking: How a simulated car follows samples, and the real windows of the same starts.
        told_apart: See `TwoSample`.
    """

    comparisons: tuple[DistributionDistances, ...]
    held_out_windows: int
    drivable_raw: float
    drivable: float
    nearest_sample: float
    nearest_held_out: float
    denoising_error: dict[int, float]
    tracking: dict[str, Tracking]
    told_apart: "TwoSample"


@dataclass(frozen=True, slots=True)
class TwoSample:
    """Tests of what is told apart from held-out driving, one window of each vehicle.

    The names are ``samples``, ``replay`` (of training windows), ``replay of held-out`` (each at the start of another)
    and ``held-out`` (some of the vehicles against others).

    Attributes:
        vehicles: Held-out vehicles.
        full: By name, energy distance and p-value of the largest samples, halves of the vehicles; means over
            `TEST_DRAWS` draws.
        rates: By name, share of tests at 5 % that told samples of each of `TEST_SIZES` apart; ``None`` where there
            are too few vehicles.
    """

    vehicles: int
    full: dict[str, tuple[float, float]]
    rates: dict[str, tuple[float | None, ...]]


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


def quantities(moved: Motion) -> dict[str, Floats]:
    """Values by quantity, with units, of trajectories that are compared by their distributions."""
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


def compare_with_held_out(weights: Path, held_out: HeldOut, seed: int = 0) -> Report:
    """Compare samples of a model, as a search draws them, with windows of sources it was not trained on.

    Args:
        weights: Of the model.
        held_out: What to compare with.
        seed: Of the draws.

    Returns:
        See `Report`.

    Raises:
        InputError: If the weights are missing or broken.
    """
    source = asked(load_denoiser(weights))
    previous, real = held_out.previous, held_out.waypoints
    rng = np.random.default_rng(content_seed("held-out comparison", seed))
    # What is replayed and which starts are tracked and tested is the same for every model.
    choice = np.random.default_rng(content_seed("held-out starts", seed))
    raw, sampled = drawn_again(source, previous, rng, attempts=1), drawn_again(source, previous, rng)
    again = drawn_again(replayed(held_out.replayed), previous, choice)
    actual, ideal, model = (quantities(motion(part, previous)) for part in (real, again, sampled))
    pick = choice.choice(len(previous), size=min(NEIGHBOURS_OF, len(previous)), replace=False)
    starts = choice.permutation(len(previous))[:TRACKED_STARTS]
    tested = {
        "samples": source,
        "replay": replayed(held_out.replayed),
        "replay of held-out": _held_out_replayed(held_out),
    }
    return Report(
        comparisons=tuple(
            DistributionDistances(
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
        nearest_sample=_nearest(actions_from_waypoints(raw[pick], previous[pick]), held_out.learnt_from),
        nearest_held_out=_nearest(actions_from_waypoints(real[pick], previous[pick]), held_out.learnt_from),
        denoising_error=_denoising_error(weights, held_out, choice),
        tracking={
            "samples": track(sampled[starts][:, None], previous[starts]),
            "held-out": track(real[starts][:, None], previous[starts]),
        },
        told_apart=_told_apart(tested, held_out, choice),
    )


def _held_out_replayed(held_out: HeldOut) -> Source:
    """Held-out windows, each at the start of another: a model that knows them perfectly but not the start."""
    return replayed(actions_from_waypoints(held_out.waypoints, held_out.previous))


def _denoising_error(weights: Path, held_out: HeldOut, rng: np.random.Generator) -> dict[int, float]:
    denoiser, poses = load_denoiser(weights), torch.from_numpy(held_out.previous.astype(np.float32))
    present = present_features(poses) if denoiser.config.conditioned else None
    clean = torch.from_numpy(actions_from_waypoints(held_out.waypoints, held_out.previous).astype(np.float32))
    noise = torch.from_numpy(rng.standard_normal(clean.shape).astype(np.float32))
    errors = {}
    for level in NOISE_LEVELS:
        with torch.inference_mode():
            predicted = denoiser(add_noise(clean, noise, level - 1), torch.tensor([float(level - 1)]), present)
        signal, spread = signal_and_noise(level - 1)
        error = (spread / signal) * (predicted - noise).numpy()[..., :2]
        errors[level] = float(np.sqrt((error**2).mean()) * ACTION_SCALE / STEP_S**2)
    return errors


def _told_apart(sources: dict[str, Source], held_out: HeldOut, rng: np.random.Generator) -> TwoSample:
    """Some vehicles stand for held-out driving, what is tested starts where as many others did."""
    shuffled = rng.permutation(len(held_out.vehicle))
    _, first = np.unique(held_out.vehicle[shuffled], return_index=True)
    one_each = rng.permutation(shuffled[first])
    previous, half = held_out.previous[one_each], len(one_each) // 2
    real = motion_features(motion(held_out.waypoints[one_each], previous))
    scale = real.std(axis=0)
    if half < 2 or not (scale > 0).all():
        raise InputError("the held-out sources have too few vehicles for a test; add tracks of held-out sources")
    actual, full, rates = real / scale, {}, {}
    for name, source in [*sources.items(), ("held-out", None)]:
        tests, told = [], []
        for _ in range(TEST_DRAWS):
            drawn = None if source is None else drawn_again(source, previous, rng)
            features = actual if drawn is None else motion_features(motion(drawn, previous)) / scale
            tests.append(permutation_test(features[half : 2 * half], actual[:half], rng))
            repeats = TEST_REPEATS // TEST_DRAWS
            told.append([rejection_rate(features, actual, size, repeats, rng) for size in TEST_SIZES])
        full[name] = (float(np.mean([test[0] for test in tests])), float(np.mean([test[1] for test in tests])))
        rates[name] = tuple(None if None in column else float(np.mean(column)) for column in zip(*told, strict=True))
    return TwoSample(len(one_each), full, rates)
