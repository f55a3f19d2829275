"""Speed of each protocol on nuScenes-sized samples (30 objects, 6 steps), beside slow versions and the official code.

The slow versions (`tests/benchmark/protocols/slow_protocols.py`) draw every raster and build every polygon, as the
official code does; they run on fewer samples and must come to the same verdicts. What the official code itself needs
was measured on a machine of this kind and is quoted.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.datasets.roads_around import RoadsAround, RoadSurfaces
from benchmark.geometry import Floats
from benchmark.planning import Command
from benchmark.protocols import PROTOCOLS
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.truth import SampleTruth
from tests.benchmark.protocols import slow_further_protocols as further
from tests.benchmark.protocols import slow_protocols as slow

LIMIT_S = 15.0
"""What all of them together may take for 6,019 samples."""
OFFICIAL_S_PER_1000 = {"uniad": 150.0, "vad": 96.0, "sparsedrive": 135.0, "diffusiondrive": 132.0}
CATEGORIES = ("vehicle.car", "vehicle.car", "vehicle.truck", "human.pedestrian.adult", "movable_object.barrier")


def exact_steps(truth: SampleTruth, plan: Floats) -> list[bool]:
    return [bool(step.any()) for step in slow.slow_exact(truth, plan).reshape(6, 5)]


SLOW: dict[str, Callable[[SampleTruth, Floats], list[bool]]] = {
    "exact": exact_steps,
    "uniad": lambda truth, plan: slow.slow_uniad(truth, plan).collision,
    "vad": lambda truth, plan: slow.slow_vad(truth, plan).collision,
    "vad-23": lambda truth, plan: slow.slow_vad(truth, plan, slow.COUNTED_BY_VAD_23).collision,
    "sparsedrive": lambda truth, plan: slow.slow_sparsedrive(truth, plan).collision,
    "diffusiondrive": lambda truth, plan: slow.slow_sparsedrive(truth, plan).collision,
    "stp3": lambda truth, plan: further.slow_stp3(truth, plan).steps["collision"],
    "bev-planner": lambda truth, plan: further.slow_bev_planner(truth, plan).steps["collision"],
    "omnidrive": lambda truth, plan: further.slow_omnidrive(truth, plan).steps["collision"],
    "agent-driver": lambda truth, plan: slow.slow_uniad(truth, plan).collision,
}
"""Of those that latch, mirror or share flags with others there is no slow version of their own."""


def roads(rng: np.random.Generator, scenes: int) -> list[RoadSurfaces]:
    """For each scene a road with crossings and islands, some thousand metres of edges."""
    found = []
    for _ in range(scenes):
        width = rng.uniform(6.0, 9.0)
        across = [shapely.box(x, -150.0, x + 2 * width, 150.0) for x in rng.uniform(-150.0, 150.0, 3)]
        islands = [shapely.Point(x, 0.0).buffer(1.5) for x in rng.uniform(-150.0, 150.0, 6)]
        road = shapely.union_all([shapely.box(-200.0, -width, 200.0, width), *across])
        surface = as_multipolygon(road.difference(shapely.union_all(islands)))
        segments = {str(number): polygon for number, polygon in enumerate(surface.geoms)}
        found.append(RoadSurfaces(RoadMap("made-up", surface, road_segments=segments)))
    return found


def random_truth(
    rng: np.random.Generator, index: int, objects: int, surfaces: RoadSurfaces | None = None
) -> SampleTruth:
    boxes = np.empty((objects, 7, 5))
    start, step = rng.uniform(-50, 50, (objects, 1, 2)), rng.normal(0, 2, (objects, 1, 2))
    boxes[..., :2] = start + step * np.arange(7)[None, :, None]
    boxes[..., 2:4] = rng.uniform([3.5, 1.6], [6.0, 2.2], (objects, 1, 2))
    boxes[..., 4] = rng.uniform(-np.pi, np.pi, (objects, 1))
    annotated = rng.random((objects, 7)) < 0.9
    future = np.column_stack([np.zeros(6), 4.0 * np.arange(1, 7), np.full(6, np.pi / 2)])
    axle = np.array([rng.uniform(-90, 90), 0.0, 0.0])
    poses: Floats = np.tile(axle, (7, 1))
    poses[:, 0] += 4.0 * np.arange(7)
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
        categories=tuple(CATEGORIES[row % len(CATEGORIES)] for row in range(objects)),
        boxes=boxes,
        annotated=annotated,
        has_points=annotated,
        has_lidar_points=annotated,
        axle_poses=poses,
        roads=None if surfaces is None else RoadsAround(surfaces, axle),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=6019)
    parser.add_argument("--objects", type=int, default=30)
    parser.add_argument("--slow-samples", type=int, default=60)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    around = roads(rng, options.samples // 40 + 1)
    truths = [random_truth(rng, index, options.objects, around[index // 40]) for index in range(options.samples)]
    plans = np.cumsum(rng.normal([0.0, 4.0], [0.3, 1.0], (options.samples, 6, 2)), axis=1)
    few = min(options.slow_samples, options.samples)
    print(
        f"{options.samples:,} samples of {options.objects} objects; slow versions on {few}; processor time of one core"
    )
    total = 0.0
    for name, protocol in PROTOCOLS.items():
        started = time.process_time()
        outcomes = protocol.evaluate(truths, plans)
        seconds = time.process_time() - started
        total += seconds
        rate = f"{name:20s} {seconds:6.2f} s  {options.samples / seconds:9.0f} samples/s"
        if name not in SLOW:
            print(rate, flush=True)
            continue
        started = time.process_time()
        verdicts = [SLOW[name](truth, plan) for truth, plan in zip(truths[:few], plans[:few])]
        slow_per_1000 = (time.process_time() - started) / few * 1000
        if verdicts != outcomes.collision[:few].tolist():
            raise SystemExit(f"{name}: the slow version comes to other verdicts")
        per_1000 = seconds / options.samples * 1000
        official = OFFICIAL_S_PER_1000.get(name)
        beside = f", official {official:5.0f} s ({official / per_1000:6.0f} x)" if official else ""
        print(
            f"{rate}  per 1,000: {per_1000:6.3f} s, slow {slow_per_1000:6.2f} s "
            f"({slow_per_1000 / per_1000:5.0f} x){beside}",
            flush=True,
        )
    allowed = LIMIT_S * options.samples / 6019
    print(f"all together {total:.2f} s, allowed {allowed:.2f} s")
    if total > allowed:
        raise SystemExit("too slow")


if __name__ == "__main__":
    main()
