"""What a process of its own costs a planner, beside what the harness does for a sample anyway.

Run ``python bench/supervision.py [ROOT] [--split SPLIT] [--scenes N] [--repeats N]``; without a root on the embedded
data set. Two planners that compute nothing, one that looks at nothing and one that loads all pictures, plan and are
judged scene by scene, here and in a process of their own in turn. Of each scene the quickest of all repeats counts, so
that what else the machine does is left out. Printed are the harness' own time for a sample, what supervision adds, and
the ratio; processor time counts both processes.
"""

import argparse
import os
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.registry import planner_factory
from benchmark import api
from benchmark.machine.workers import single_threaded
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.protocols import STANDARD
from benchmark.runs.scene_work import Run, work_here

STANDS: Final = np.zeros((6, 2))
MOST: Final = 0.05
"""What supervision may cost of the harness' own time."""


class Blind:
    """Looks at nothing and stands."""

    name = "blind"

    def reset(self, scene: SceneInfo) -> None:
        """Nothing is remembered."""

    def plan(self, observation: Observation) -> Plan:
        """Stand."""
        return Plan(STANDS, PlanFrame.EGO)


class Looking(Blind):
    """Loads all pictures and stands."""

    name = "looking"

    def plan(self, observation: Observation) -> Plan:
        """Look, and stand."""
        for view in observation.views.values():
            view.load()
        return super().plan(observation)


@dataclass(frozen=True)
class Cost:
    """What one scene took."""

    wall_s: float
    cpu_s: float


def measured(run: Run, data: Any, planner: Any, scene: str, process: int | None) -> Cost:
    """Plan and judge a scene."""
    before, begun = cpu_s(process), time.perf_counter()
    work_here(run, data, planner, scene)
    return Cost(time.perf_counter() - begun, cpu_s(process) - before)


def cpu_s(process: int | None) -> float:
    """Processor time of this process, and of another one."""
    own = time.process_time()
    if process is None:
        return own
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return own + (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def planners_process() -> int | None:
    """The planner's process: the child of this process' child."""
    own = os.getpid()
    for _ in range(2):
        found = [
            int(child)
            for task in Path(f"/proc/{own}/task").glob("*/children")
            for child in task.read_text().split()
            if "guardian" in Path(f"/proc/{child}/cmdline").read_text()
        ]
        if not found:
            return None
        own = found[-1]
    return own


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", nargs="?", default="mini")
    parser.add_argument("--split", default="val")
    parser.add_argument("--scenes", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=9)
    options = parser.parse_args()
    single_threaded()
    data = api.open_data(options.root)
    scenes = data.scene_names(options.split)[: options.scenes]
    samples = sum(len(data.truth(name)) for name in scenes)
    with tempfile.TemporaryDirectory() as folder:
        for made in (Blind, Looking):
            factory = planner_factory(f"bench.supervision:{made.__name__}")
            run = Run(Path(folder) / made.name, data.fingerprint(), options.split, factory.facts, STANDARD, fresh=True)
            planners = {"here": made(), "there": factory()}
            costs: dict[str, dict[str, list[Cost]]] = defaultdict(lambda: defaultdict(list))
            for repeat in range(options.repeats + 1):
                for scene in scenes:
                    for where, planner in planners.items():
                        process = planners_process() if where == "there" else None
                        cost = measured(run, data, planner, scene, process)
                        if repeat:
                            costs[where][scene].append(cost)
            for kind in ("wall_s", "cpu_s"):
                own, with_process = (
                    1e3 / samples * sum(min(getattr(each, kind) for each in found) for found in costs[where].values())
                    for where in ("here", "there")
                )
                ratio = with_process / own - 1.0
                print(
                    f"{options.root} {made.name:8} {kind.removesuffix('_s'):4}: harness {own:7.2f} ms a sample, in a "
                    f"process of its own {with_process:7.2f} ms, {100 * ratio:+.1f} % "
                    f"({'within' if ratio <= MOST else 'over'} {100 * MOST:g} %)"
                )


if __name__ == "__main__":
    main()
