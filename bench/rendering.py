"""How many six-view frames a second the schematic renderer draws, with one process and with several.

Run as ``python bench/rendering.py``; ``--help`` lists the options. ``--start WORKTREE`` draws the same frames in
another tree too, in turns, prints ratios of processor time, and says whether every picture has the same bytes.
"""

import argparse
import functools
import json
import os
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.datasets.scenarionet import read_scenarionet
from benchmark.machine.workers import map_ordered
from benchmark.scene import Scene
from generation.render.schematic import SchematicRenderer
from generation.sources.town import town_scene

ROOT = Path(__file__).resolve().parents[1]
TURNS = 3
PROGRAM = """
import hashlib, json, sys, time
from pathlib import Path
from benchmark.datasets.scenarionet import read_scenarionet
from generation.render.schematic import FIRST, SECOND, SchematicRenderer
from generation.sources.town import town_scene
source, width, height, count, step = sys.argv[1], *map(int, sys.argv[2:])
scene = read_scenarionet(Path(source)) if source.endswith(".pkl") else town_scene("val", int(source))
frames, found = range(0, len(scene.timestamps_us), step)[:count], []
for style in (FIRST, SECOND):
    start, seen = time.process_time(), hashlib.sha256()
    for images in SchematicRenderer(width, height, style).render(scene, frames):
        for picture in images.values():
            seen.update(picture.tobytes())
    found.append([(time.process_time() - start) / len(frames), seen.hexdigest()])
print(json.dumps(found))
"""


def load(source: str) -> Scene:
    return read_scenarionet(Path(source)) if source.endswith(".pkl") else town_scene("val", int(source))


def render_part(frames: range, *, source: str, width: int, height: int) -> tuple[int, float, float]:
    """Render some frames and give their number, the seconds and the processor seconds, without reading the scene."""
    scene = load(source)
    start, start_cpu = time.perf_counter(), time.process_time()
    count = sum(1 for _ in SchematicRenderer(width, height).render(scene, frames))
    return count, time.perf_counter() - start, time.process_time() - start_cpu


def drawn_in(tree: Path, words: list[str]) -> list[tuple[float, str]]:
    """Processor seconds for a frame, the scene made ready with them, and a hash of all pictures, in each style."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"},
        text=True,
        stdout=subprocess.PIPE,
        check=True,
    )
    return [(seconds, digest) for seconds, digest in json.loads(done.stdout)]


def compare(start: Path, source: str, size: tuple[int, int], frames: int) -> None:
    """The same frames in two trees, in turns; the least of each counts, which other work disturbs least."""
    for what, step in (("samples", 6), ("all frames", 1)):
        words = [source, *map(str, size), str(frames), str(step)]
        turns = [(drawn_in(start, words), drawn_in(ROOT, words)) for _ in range(TURNS)]
        for style, name in enumerate(("first", "second")):
            before, now = (min(turn[tree][style][0] for turn in turns) for tree in (0, 1))
            same = len({turn[tree][style][1] for turn in turns for tree in (0, 1)}) == 1
            print(
                f"{what}, {name} style: {1e3 * before:.1f} ms a frame at the start, {1e3 * now:.1f} now, ratio "
                f"{before / now:.2f}; pictures {'of the same bytes' if same else 'DIFFER'}"
            )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="0", help="number of a town scene, or a ScenarioNet .pkl file")
    parser.add_argument("--frames", type=int, default=120, help="frames per process")
    parser.add_argument("--size", type=int, nargs=2, default=(448, 256), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--processes", type=int, nargs="+", default=(1, 2))
    parser.add_argument("--start", type=Path, help="worktree of another commit, to compare with")
    given = parser.parse_args()
    width, height = given.size
    if given.start is not None:
        compare(given.start.resolve(), given.scene, (width, height), given.frames)
        return
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
