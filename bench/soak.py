"""Two hundred scenes evaluated and two hundred drives without images in one process: does anything pile up?

Run as ``python bench/soak.py``, with ``--data ROOT`` on recordings of one's own. The scenes of a data set, 20 where it
is made here, come again and again, each time for another record. Memory at the end must be within 10 % of that after 20
scenes, and no file descriptor, thread or child may be left; otherwise the exit code is 1. The figures:
``docs/studies/large-data-sets.md``.
"""

import argparse
import gc
import os
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.processes import children, resident_mb
from benchmark import api
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.datasets.roots import DataSet, open_data
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.planning import Planner
from benchmark.runs.driving import DriveSettings, drive_split
from benchmark.scene import Scene
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import Car, scene_on_straight_road

FIRST: Final = 20
"""Scenes after which everything has been opened and cached that will be."""
MOST_TIMES: Final = 1.1


@dataclass(frozen=True, slots=True)
class ProcessResources:
    """What a process holds.

    Attributes:
        memory_mb: Resident.
        descriptors: What open file descriptors lead to, by number.
        threads: Names of Python's threads, and how many the system counts.
        children: Processes that it began and that are still there.
    """

    memory_mb: float
    descriptors: dict[int, str]
    threads: tuple[int, tuple[str, ...]]
    children: list[int]

    @classmethod
    def now(cls) -> "ProcessResources":
        """What this process holds, after everything that nobody holds was given back."""
        gc.collect()
        open_files = {}
        for path in Path("/proc/self/fd").iterdir():
            # The listing's own is gone by now.
            with suppress(OSError):
                open_files[int(path.name)] = str(path.readlink())
        names = tuple(sorted(thread.name for thread in threading.enumerate()))
        threads = (len(list(Path("/proc/self/task").iterdir())), names)
        return cls(resident_mb(os.getpid()), open_files, threads, children(os.getpid()))

    def left(self, before: "ProcessResources") -> list[str]:
        """What is there that was not before, as sentences."""
        # Numbers are given again; what they lead to tells.
        new = sorted(self.descriptors.values())
        for descriptor in before.descriptors.values():
            with suppress(ValueError):
                new.remove(descriptor)
        sentences = [f"{len(new)} file descriptors are left: {', '.join(new[:4])}"] if new else []
        if self.threads[0] > before.threads[0]:
            sentences.append(f"{self.threads[0] - before.threads[0]} threads are left: {', '.join(self.threads[1])}")
        more = sorted(set(self.children) - set(before.children))
        return [*sentences, *([f"children are left: {more}"] if more else [])]


Work = Callable[[DataSet, Planner, Path], int]
"""Give a planner some scenes; how many they were."""


def evaluate_all(data: DataSet, planner: Planner, out: Path) -> int:
    """Evaluate every scene of a data set anew."""
    return len(evaluate(data, "val", planner, out, EvalSettings(fresh=True)).run.scenes)


def drive_all(data: DataSet, planner: Planner, out: Path) -> int:
    """Drive every scene of a data set anew, without images."""
    settings = DriveSettings("default", DefaultBackend("idm"), "idm", fresh=True)
    return len(drive_split(data, "val", planner, out, settings).rows)


def soak(what: str, work: Work, data: DataSet, scenes: int, folder: Path) -> tuple[str, list[str]]:
    """Do one kind of work until so many scenes are done.

    Args:
        what: It is, for people.
        work: The work.
        data: Its scenes come again until there were enough, each time for another record.
        scenes: At least so many.
        folder: To write to.

    Returns:
        A row of the table, and what piled up.
    """
    planner, before = api.load_planner("constant-velocity")(), ProcessResources.now()
    done, rounds, early = 0, 0, None
    while done < scenes:
        done += work(data, planner, folder / f"{rounds}")
        rounds += 1
        if early is None and done >= FIRST:
            early = ProcessResources.now()
    end = ProcessResources.now()
    early = early or end
    faults, times = end.left(before), end.memory_mb / early.memory_mb
    if times > MOST_TIMES:
        faults.append(f"{end.memory_mb:.0f} MB at the end, {early.memory_mb:.0f} MB after {FIRST} scenes")
    held = f"{len(end.descriptors)} | {end.threads[0]} | {len(end.children)}"
    row = f"| {what} | {done} | {early.memory_mb:.0f} | {end.memory_mb:.0f} | {times:.2f} | {held} |"
    return row, [f"{what}: {fault}" for fault in faults]


def make_data(folder: Path, scenes: int) -> DataSet:
    """A data set of so many short scenes without images."""

    def scene(number: int) -> Scene:
        cars = (Car(60.0 + number % 7, 194.75, 9.0), Car(100.0, 201.75, 8.0, 3.14), Car(90.0, 198.25, 8.0))
        return scene_on_straight_road(cars, seconds=8.0, name=f"scene-{number + 1:04d}")

    write_root(folder, list(map(scene, range(scenes))), version="v1.0-mini", renderer=None, frames="keyframes")
    return open_data(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--data", type=Path, help="a data set in nuScenes format, its split val; made by default")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        data = make_data(folder / "road", FIRST) if options.data is None else open_data(options.data)
        print("| work in one process | scenes | MB after 20 | MB at the end | ratio "
              "| descriptors | threads | children |")  # fmt: skip
        print("|---|--:|--:|--:|--:|--:|--:|--:|")
        faults = []
        for what, work in (("evaluated", evaluate_all), ("driven without images", drive_all)):
            row, leaks = soak(what, work, data, options.scenes, folder / work.__name__)
            print(row, flush=True)
            faults += leaks
    print(*faults, sep="\n", file=sys.stderr)
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
