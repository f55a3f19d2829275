"""How many six-view frames a second the schematic renderer draws, with one process and with several.

Run as ``python bench/rendering.py``; ``--help`` lists the options.
"""

import argparse
import functools
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.datasets.scenarionet import read_scenarionet
from benchmark.machine.workers import map_ordered
from benchmark.scene import Scene
from generation.render.schematic import SchematicRenderer
from generation.sources.town import town_scene


def load(source: str) -> Scene:
    return read_scenarionet(Path(source)) if source.endswith(".pkl") else town_scene("val", int(source))


def render_part(frames: range, *, source: str, width: int, height: int) -> tuple[int, float, float]:
    """Render some frames and give their number, the seconds and the processor seconds, without reading the scene."""
    scene = load(source)
    start, start_cpu = time.perf_counter(), time.process_time()
    count = sum(1 for _ in SchematicRenderer(width, height).render(scene, frames))
    return count, time.perf_counter() - start, time.process_time() - start_cpu


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="0", help="number of a town scene, or a ScenarioNet .pkl file")
    parser.add_argument("--frames", type=int, default=120, help="frames per process")
    parser.add_argument("--size", type=int, nargs=2, default=(448, 256), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--processes", type=int, nargs="+", default=(1, 2))
    given = parser.parse_args()
    width, height = given.size
    count = len(load(given.scene).timestamps_us)
    for processes in given.processes:
        starts = [(index * count // processes) % max(count - given.frames, 1) for index in range(processes)]
        parts = [range(start, min(start + given.frames, count)) for start in starts]
        work = functools.partial(render_part, source=given.scene, width=width, height=height)
        results = list(map_ordered(work, parts, workers=processes, label="rendering"))
        rate = sum(frames / seconds for frames, seconds, _ in results)
        share = sum(frames for frames, _, _ in results) / sum(cpu for _, _, cpu in results)
        print(
            f"{processes} process(es), {width}x{height}: {rate:.1f} six-view frames/s; "
            f"{share:.1f} a processor second, which other work on the machine changes less"
        )


if __name__ == "__main__":
    main()
