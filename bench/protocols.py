"""Speed of each protocol on nuScenes-sized samples: 30 objects, 6 steps."""

import argparse
import time

import numpy as np

from benchmark.planning import Command
from benchmark.protocols import PROTOCOLS
from benchmark.truth import SampleTruth


def random_truth(rng: np.random.Generator, index: int, objects: int) -> SampleTruth:
    boxes = np.empty((objects, 7, 5))
    start, step = rng.uniform(-50, 50, (objects, 1, 2)), rng.normal(0, 2, (objects, 1, 2))
    boxes[..., :2] = start + step * np.arange(7)[None, :, None]
    boxes[..., 2:4] = rng.uniform([3.5, 1.6], [6.0, 2.2], (objects, 1, 2))
    boxes[..., 4] = rng.uniform(-np.pi, np.pi, (objects, 1))
    annotated = rng.random((objects, 7)) < 0.9
    future = np.column_stack([np.zeros(6), 4.0 * np.arange(1, 7), np.full(6, np.pi / 2)])
    return SampleTruth(
        scene=f"scene-{index // 40:04d}",
        sample_token=str(index),
        index=index % 40,
        timestamp_us=index,
        lidar_pose=np.zeros(3),
        lidar_ahead_m=0.94,
        ego_future=future,
        ego_future_valid=np.ones(6, dtype=np.bool_),
        command=Command.STRAIGHT,
        instances=tuple(f"{index}-{row}" for row in range(objects)),
        categories=("vehicle.car",) * objects,
        boxes=boxes,
        annotated=annotated,
        has_points=annotated,
        has_lidar_points=annotated,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=6019)
    parser.add_argument("--objects", type=int, default=30)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    truths = [random_truth(rng, index, options.objects) for index in range(options.samples)]
    plans = np.cumsum(rng.normal([0.0, 4.0], [0.3, 1.0], (options.samples, 6, 2)), axis=1)
    for name, protocol in PROTOCOLS.items():
        started = time.perf_counter()
        outcomes = protocol.evaluate(truths, plans)
        seconds = time.perf_counter() - started
        share = outcomes.collision.any(axis=1).mean()
        print(f"{name:15s} {seconds:6.2f} s  {options.samples / seconds:9.0f} samples/s  {share:.1%} collide")


if __name__ == "__main__":
    main()
