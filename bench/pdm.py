"""Speed of the driving scores (`nuscenes-pdm`) with the town's map, as a ratio to the slow version.

Run as ``OMP_NUM_THREADS=1 python bench/pdm.py``. Processor time. Scenes of 40 samples with 30 objects around them drive
through the embedded town; what is timed is all that `eval` and `rescore` do for the scores of a scene, from the scene
and its plans to the verdicts that are stored. The slow version (`tests/benchmark/pdm/slow_pdm.py`) judges a few of the
plans and must come to the same verdicts.
"""

import argparse
import sys
import time
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.pdm.judging import DrivenPlan, judge_scene
from benchmark.pdm.motion import headed
from benchmark.pdm.recording import RecordedScene
from benchmark.planning import Plan, PlanFrame
from benchmark.scene import Annotations, Scene
from generation.sources.town import town_scene
from tests.benchmark.pdm.cases import slow_objects
from tests.benchmark.pdm.slow_pdm import SlowSample, slow_progress, slow_verdict

LIMIT_S = 45.0
"""What 6,019 samples of 30 objects may take."""
TOWN_SCENES = 6
MARGIN_M = 120.0
"""The map of a scene reaches this far around its path, as in `benchmark.datasets.nuscenes`."""
CATEGORIES = ("vehicle.car", "vehicle.car", "vehicle.truck", "human.pedestrian.adult", "movable_object.barrier")


def busy(scene: Scene, rng: np.random.Generator, objects: int) -> Scene:
    """A scene of the town with other objects: so many, all the time, near the car's path."""
    count = len(scene.keyframes)
    path = scene.ego.pose[scene.keyframes]
    start = path[rng.integers(count, size=objects), :2] + rng.uniform(-40, 40, (objects, 2))
    yaw, speed = rng.uniform(-np.pi, np.pi, objects), rng.choice([0.0, 3.0, 8.0], objects)
    along = (speed[:, None] * scene.seconds[scene.keyframes])[..., None]
    position = np.zeros((objects, count, 3))
    position[..., :2] = start[:, None] + (along % 60.0) * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)[:, None]
    size = np.broadcast_to(rng.uniform([3.5, 1.6, 1.5], [6.0, 2.2, 2.0], (objects, 1, 3)), position.shape)
    shape = (objects, count)
    annotations = Annotations(
        position=position,
        rotation=quaternion_from_yaw(np.repeat(yaw[:, None], count, axis=1)),
        size=size,
        valid=rng.random(shape) < 0.95,
        attribute=np.full(shape, ""),
        visibility=np.full(shape, 4),
        num_lidar_pts=np.ones(shape, np.int64),
        num_radar_pts=np.zeros(shape, np.int64),
    )
    categories = tuple(CATEGORIES[row % len(CATEGORIES)] for row in range(objects))
    low, high = scene.ego.position[:, :2].min(axis=0) - MARGIN_M, scene.ego.position[:, :2].max(axis=0) + MARGIN_M
    road_map = scene.road_map.near((float(low[0]), float(low[1]), float(high[0]), float(high[1])))
    return replace(
        scene, annotations=annotations, agents=replace(scene.agents, categories=categories), road_map=road_map
    )


def plans_of(recorded: RecordedScene, rng: np.random.Generator) -> list[Plan]:
    """Plans that wander off the recorded speed, for every key frame."""
    step = np.maximum(recorded.motion[:, 3], 1.0) / 2
    along = rng.normal(step[:, None], 0.8, (len(step), 6))
    waypoints = np.cumsum(np.stack([along, rng.normal(0, 0.15, along.shape)], axis=-1), axis=1)
    return [Plan(each, PlanFrame.EGO) for each in waypoints]


def slow_seconds(scene: Scene, plans: Sequence[Plan], fast: Sequence[DrivenPlan | None], few: int) -> float:
    """Processor time of the slow version a plan, after it came to the same verdicts."""
    recorded, lidar_ahead_m = RecordedScene(scene), float(scene.lidar.translation[0])
    samples = np.flatnonzero(recorded.complete)[3 : 3 + few]
    futures, frames = recorded.recorded_plans(samples), recorded.key_frames(samples)
    seconds = 0.0
    for place, sample in enumerate(samples.tolist()):
        now: Floats = np.append(recorded.motion[sample], np.zeros(3))
        past = recorded.motion[sample - 3 : sample + 1]
        started = time.process_time()
        around = SlowSample(now, past, slow_objects(frames, place), recorded.road, recorded.route)
        verdict = slow_verdict(headed(plans[sample], lidar_ahead_m), around)
        ep = slow_progress(verdict, slow_verdict(futures[place], around))
        seconds += time.process_time() - started
        found = fast[sample]
        assert found is not None
        for name in ("nc", "dac", "ddc", "ttc", "lk", "hc"):
            if getattr(found, name) != getattr(verdict, name):
                raise SystemExit(f"sample {sample}: {name} is {getattr(found, name)}, slowly {getattr(verdict, name)}")
        if abs(found.ep - ep) > 1e-5:
            raise SystemExit(f"sample {sample}: ep is {found.ep}, slowly {ep}")
    return seconds / len(samples)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=6019)
    parser.add_argument("--objects", type=int, default=30)
    parser.add_argument("--slow-samples", type=int, default=8)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    towns = [town_scene("val", number) for number in range(TOWN_SCENES)]
    done, seconds, slow, number = 0, 0.0, 0.0, 0
    while done < options.samples:
        scene = busy(towns[number % TOWN_SCENES], rng, options.objects)
        plans = plans_of(RecordedScene(scene), rng)
        started = time.process_time()
        verdicts = judge_scene(scene, plans)
        seconds += time.process_time() - started
        if number == 0:
            slow = slow_seconds(scene, plans, verdicts, options.slow_samples)
        # Samples without 3 s of recording after them cost nothing and do not count.
        done += sum(verdict is not None for verdict in verdicts)
        number += 1
    tracemalloc.start()
    judge_scene(scene, plans)
    peak = tracemalloc.get_traced_memory()[1]
    fast = seconds / done
    print(f"{done:,} samples of {options.objects} objects in {number} scenes; processor time of one core")
    print(f"nuscenes-pdm {seconds:.1f} s, {1 / fast:.0f} samples/s; slow {slow:.3f} s a sample ({slow / fast:.0f} x)")
    print(f"at most {peak / 1e6:.0f} MB at a time for a scene of {len(plans)} samples")
    allowed = LIMIT_S * done / 6019
    print(f"allowed {allowed:.1f} s")
    if seconds > allowed:
        raise SystemExit("too slow")


if __name__ == "__main__":
    main()
