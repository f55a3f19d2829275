"""Time of one sample with the miniatures on this machine: six images loaded, resized, and a plan made of them.

Run as ``python bench/miniatures.py``, with ``--model``, ``--scenes`` to choose. Processor time divided by the threads
that ``OMP_NUM_THREADS`` allows (one if it is not set), which other work on the machine disturbs least, and wall time.
The first two samples of a scene are not counted. The aim is 150 ms a sample on two cores.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch

from adapters.checkpoints.loading import planner_of
from adapters.models import miniature, miniatures
from benchmark.datasets.roots import open_data
from benchmark.machine.workspace import cache_root
from benchmark.planning import SceneInfo
from generation.sources.mini import TownSettings, build_town

AIM_MS = 150.0
WARM_UP = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    known = [name for name, small in miniatures().items() if small.packaged.is_file()]
    parser.add_argument("--model", action="append", choices=known)
    parser.add_argument("--scenes", type=int, default=1)
    chosen = parser.parse_args()
    torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))
    town = TownSettings()
    data = open_data(build_town(cache_root() / town.folder_name("mini"), town, workers=1), name="mini")
    for name in chosen.model or known:
        planner = planner_of(miniature(name), device="cpu")
        processor_s, wall_s, samples = 0.0, 0.0, 0
        for scene_name in data.scene_names("val")[: chosen.scenes]:
            scene = data.scene(scene_name)
            planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
            for observation in data.observations(scene_name):
                before = time.process_time(), time.perf_counter()
                planner.plan(observation)
                if observation.index >= WARM_UP:
                    processor_s += time.process_time() - before[0]
                    wall_s += time.perf_counter() - before[1]
                    samples += 1
        threads = torch.get_num_threads()
        processor_ms, wall_ms = (1000 * seconds / samples for seconds in (processor_s / threads, wall_s))
        verdict = "within" if processor_ms <= AIM_MS else "OVER"
        print(
            f"{name}: {processor_ms:.0f} ms of processor, {wall_ms:.0f} ms of wall time a sample, {threads} thread(s), "
            f"{samples} samples; {verdict} {AIM_MS:.0f} ms"
        )


if __name__ == "__main__":
    main()
