"""Time of the trajectory denoiser on one core: per network call and per planning step.

Run as ``OMP_NUM_THREADS=1 python bench/denoiser.py``. Processor time is what other work on the machine disturbs least.
"""

import time
from collections.abc import Callable

import numpy as np
import torch

from generation.diffusion.bank import sample_actions
from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, load_denoiser
from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser
from generation.diffusion.prior import SamplerSettings, Samples, TrajectoryPrior, diversify

BATCH = 256
PREVIOUS = np.array([-4.0, 0.0, 0.0])
SMALL_TRANSFORMER = DenoiserConfig(
    feature_dim=64, heads=4, layers=3, feedforward_dim=192, history_tokens=0, preconditioned=True
)
"""What the packaged network is an alternative to."""


def timed(work: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Smallest processor and wall seconds of several runs, after one to warm up."""
    work()
    processor, wall = [], []
    for _ in range(repeats):
        started = (time.process_time(), time.perf_counter())
        work()
        processor.append(time.process_time() - started[0])
        wall.append(time.perf_counter() - started[1])
    return min(processor), min(wall)


def denoise_call(denoiser: TrajectoryDenoiser) -> Callable[[], object]:
    noisy = torch.from_numpy(np.random.default_rng(0).standard_normal((BATCH, 16, 3)).astype(np.float32))

    def call() -> object:
        with torch.inference_mode():
            return denoiser(noisy, torch.tensor([4.0]))

    return call


def full_process(denoiser: TrajectoryDenoiser, calls: int) -> Callable[[], object]:
    return lambda: sample_actions(denoiser, BATCH, calls, np.random.default_rng(0))


def first_batch(source: Samples) -> Callable[[], object]:
    prior = TrajectoryPrior.load(None, SamplerSettings(samples=source))
    return lambda: prior.sample(BATCH, PREVIOUS, np.random.default_rng(0))


def planning_step(prior: TrajectoryPrior) -> Callable[[], object]:
    """Initial batch and the five rounds of refinement, without physics and scoring."""

    def step() -> object:
        rng = np.random.default_rng(0)
        candidates = diversify(prior.sample(BATCH, PREVIOUS, rng), rng)
        for level in (5, 4, 3, 2, 1):
            candidates = prior.mutate(candidates, level, PREVIOUS, rng)
        return candidates

    return step


def main() -> None:
    torch.set_num_threads(1)
    prior, packaged = TrajectoryPrior.load(), load_denoiser(PACKAGED_WEIGHTS)
    rows: list[tuple[str, Callable[[], object], int]] = [
        ("denoise call, packaged", denoise_call(packaged), 50),
        ("denoise call, small transformer", denoise_call(TrajectoryDenoiser(SMALL_TRANSFORMER).eval()), 20),
        ("denoise call, reference size", denoise_call(TrajectoryDenoiser().eval()), 2),
        ("full process, 100 calls, packaged", full_process(packaged, 100), 3),
        *((f"first batch, {source.value}", first_batch(source), 10) for source in Samples),
        ("planning step, packaged", planning_step(prior), 5),
    ]
    for calls in (1, 2, None):
        name = "reference's calls per round" if calls is None else f"{calls} call(s) per round"
        rows.append(
            (
                f"planning step, {name}",
                planning_step(TrajectoryPrior.load(None, SamplerSettings(mutation_steps=calls))),
                5,
            )
        )
    print(f"batch {BATCH}, one thread; smallest of several runs")
    for name, work, repeats in rows:
        processor, wall = timed(work, repeats)
        print(f"{name:48s} {1e3 * processor:8.1f} ms processor {1e3 * wall:8.1f} ms wall")


if __name__ == "__main__":
    main()
