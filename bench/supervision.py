"""What a process of its own costs a planner, beside what the harness does for a sample anyway.

Run ``python bench/supervision.py [ROOT] [--split SPLIT] [--scenes N] [--rounds N]``; without a root on the embedded
data set. Two planners that compute nothing, one that looks at nothing and one that loads all pictures, plan and are
judged scene by scene, here and in a process of their own in turn. Of what happens between two questions the quickest of
all rounds counts, so that what else the machine does is left out. Printed are the harness' own time for a sample, the
same with a process of its own, and the ratio: on the wall, in processor time of both processes, and of this one alone.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from adapters.planners.stop import Stop
from adapters.registry import planner_factory
from bench.processes import command_line, descendants
from benchmark import api
from benchmark.machine.workers import single_threaded
from benchmark.planning import Observation, Plan
from benchmark.protocols import STANDARD
from benchmark.runs.plan_rows import plan_scene
from benchmark.runs.scene_reading import SceneReading
from benchmark.runs.scene_work import EvaluationJob, judge_scene

MOST: Final = 0.05
"""What supervision may cost of the harness' own time."""


class Blind(Stop):
    """Looks at nothing and stands."""

    name = "blind"


class Looking(Stop):
    """Loads all pictures and stands."""

    name = "looking"

    def plan(self, observation: Observation) -> Plan:
        """Look, and stand."""
        for view in observation.views.values():
            view.load()
        return super().plan(observation)


Clocks = tuple[float, ...]
"""Seconds of each of `CLOCKS` at one moment."""
CLOCKS: Final = ("wall", "both processes", "`eval`")


def clocks(process: int | None) -> Clocks:
    """Time on the wall, processor time of this process and another one, and of this process alone."""
    own = time.process_time()
    # Linux has the clock of another process under this number, to the nanosecond.
    other = 0.0 if process is None else time.clock_gettime(~process << 3 | 2)
    return time.perf_counter(), own + other, own


class SceneTimer:
    """One scene planned and judged again and again, here and in a process of its own in turn, in pieces.

    A piece is what happens between two questions: the harness reads, packs, waits, judges a row. Of every piece the
    quickest of all rounds counts, by every clock: a piece lasts milliseconds, so that most rounds have it undisturbed
    however much the machine does, which is not so of a scene.
    """

    def __init__(self, run: EvaluationJob, data: Any, name: str) -> None:
        self.run, self.data, self.name = run, data, name
        self._pieces: dict[str, list[NDArray[np.float64]]] = {"here": [], "there": []}
        self.judging: Clocks = ()
        self._asked: list[Clocks] = []
        self._process: int | None = None

    def work(self, where: str, planner: Any) -> None:
        """Plan and judge it once."""
        plan = type(planner).plan

        def asked(observation: Observation) -> Plan:
            self._asked.append(clocks(self._process))
            answer: Plan = plan(planner, observation)
            return answer

        planner.plan = asked
        reading = SceneReading(self.data, self.name)
        self._process = planners_process() if where == "there" else None
        self._asked = [clocks(self._process)]
        planned = plan_scene(planner, reading, self.name, self.run.directory, self.name, fresh=True)
        self._asked.append(clocks(self._process))
        judge_scene(self.run, reading, planned)
        self._asked.append(clocks(self._process))
        *pieces, judging = np.diff(np.array(self._asked), axis=0)
        self._pieces[where].append(np.stack(pieces))
        if where == "here":
            # The same rows are judged by the same code wherever they were planned.
            self.judging = tuple(judging if not self.judging else np.minimum(self.judging, judging))

    def quickest(self, where: str) -> NDArray[np.float64]:
        """(len(CLOCKS),) seconds of planning the scene: the quickest of each piece, together."""
        return np.min(self._pieces[where][1:], axis=0).sum(axis=0)


def planners_process() -> int | None:
    """The planner's process: the child of this process' child."""
    processes = [process for process in descendants(os.getpid()) if "reaper" in command_line(process)]
    return processes[-1] if len(processes) > 1 else None


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", nargs="?", default="mini")
    parser.add_argument("--split", default="val")
    parser.add_argument("--scenes", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--planner", choices=("Blind", "Looking"), action="append")
    options = parser.parse_args()
    single_threaded()
    data = api.open_data(options.root)
    names = data.scene_names(options.split)[: options.scenes]
    samples = sum(len(data.truth(name)) for name in names)
    with tempfile.TemporaryDirectory() as folder:
        for made in (Blind, Looking):
            if options.planner and made.__name__ not in options.planner:
                continue
            factory = planner_factory(f"bench.supervision:{made.__name__}")
            run = EvaluationJob(
                Path(folder) / made.name, data.fingerprint(), options.split, factory.facts, STANDARD, fresh=True
            )
            scenes, there = [SceneTimer(run, data, name) for name in names], factory()
            # Pages of code and of pictures are read, and the process is there, before the first round that counts.
            for number in range(options.rounds + 1):
                for scene in scenes:
                    turns: list[tuple[str, Any]] = [("here", made()), ("there", there)]
                    for where, planner in turns if number % 2 else reversed(turns):
                        scene.work(where, planner)
            there.close()
            print(f"{options.root}, {made.name}, {samples} samples, load {os.getloadavg()[0]:.1f}, ms a sample:")
            for place, clock in enumerate(CLOCKS):
                judged = sum(scene.judging[place] for scene in scenes)
                here, supervised = (
                    1e3 / samples * (sum(scene.quickest(where)[place] for scene in scenes) + judged)
                    for where in ("here", "there")
                )
                ratio = supervised / here - 1.0
                verdict = "within" if ratio <= MOST else "over"
                print(
                    f"  {clock:14}: harness {here:6.3f} (judging {1e3 * judged / samples:6.3f}), with a process of its "
                    f"own {supervised:6.3f}, {100 * ratio:+.1f} % ({verdict} {100 * MOST:g} %)"
                )


if __name__ == "__main__":
    main()
