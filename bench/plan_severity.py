"""Speed of measuring how severe plans are: what `eval` spends on a sample beside protocols and driving scores.

Run as ``OMP_NUM_THREADS=1 python bench/plan_severity.py``. Processor time. Scenes are those of the embedded town; in
each, the first car that moves 5 m or more stands for the adversary; plans drive half as fast again as the recording.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.datasets.sample_truth import truth_of_scene
from benchmark.fairness.plan_severity import plan_severities
from benchmark.geometry import Floats
from benchmark.scene import Scene
from benchmark.truth import SampleTruth
from generation.sources.town import town_scene

LIMIT_MS = 1.0
"""What a sample may take."""


def truths_of(scene: Scene) -> list[SampleTruth]:
    """The truth of every sample, with an adversary."""
    moved = np.ptp(scene.agents.position[..., :2], axis=1).max(axis=-1)
    cars = (row for row, name in enumerate(scene.agents.categories) if name == "vehicle.car" and moved[row] >= 5.0)
    adversaries = frozenset({scene.agents.ids[next(cars)]})
    tokens = [f"{scene.name} {index}" for index in range(len(scene.keyframes))]
    return [replace(truth, adversaries=adversaries) for truth in truth_of_scene(scene, tokens)]


def hurried(truths: list[SampleTruth]) -> Floats:
    """(S, 6, 2) plans that go where the recording goes, too fast, so that some touch somebody."""
    return np.array([truth.ego_future[:, :2] for truth in truths]) * 1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=10)
    scenes = [truths_of(town_scene("val", number)) for number in range(parser.parse_args().scenes)]
    plans = [hurried(truths) for truths in scenes]
    started = time.process_time()
    found = [plan_severities(truths, plan) for truths, plan in zip(scenes, plans, strict=True)]
    samples = [severity for severities in found for severity in severities]
    each_ms = 1e3 * (time.process_time() - started) / len(samples)
    objects = np.mean([len(truth.instances) for truths in scenes for truth in truths])
    touching = sum(severity.contact is not None for severity in samples)
    print(f"{len(samples)} samples of {objects:.0f} objects on average, {touching} touch somebody")
    print(f"{each_ms:.2f} ms of processor time a sample, allowed {LIMIT_MS:.0f}")
    if each_ms > LIMIT_MS:
        raise SystemExit("too slow")


if __name__ == "__main__":
    main()
