"""Speed of closed-loop drives without images: scenes stepped together, with replayed agents and with IDM.

Run as ``OMP_NUM_THREADS=1 python bench/closed_loop.py``. Processor time of one core, over all of a step: the plan taken
in, the ego driven, the agents moved, contact looked for every 0.05 s. The scenes are those of the embedded town.
Stepped together they must come to the same bytes as one by one.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.closed_loop.courses import course_of, recorded_poses, replay_of
from benchmark.closed_loop.idm import Idm
from benchmark.closed_loop.stepping import begin, step, step_together
from benchmark.closed_loop.world import STEP_US, Course, World
from benchmark.geometry import Floats, to_local
from benchmark.scene import Scene
from generation.sources.town import town_scene

WANTED = 1000.0
"""Scene-seconds a second of one core, with replayed agents."""
STEPS = 38
"""Of a drive: 19 s."""


def futures(scene: Scene, course: Course) -> Callable[[int], Floats]:
    """The recorded places that a plan of each step is made from; looked up before the clock starts."""
    times = course.start_us + STEP_US * np.arange(STEPS + 7)
    places = recorded_poses(scene, times)[:, :2]
    return lambda number: places[number + 1 : number + 7]


def driven(courses: list[Course], ahead: list[Callable[[int], Floats]], together: int) -> tuple[float, list[World]]:
    """Processor seconds in the engine, and the worlds at the end."""
    worlds, seconds = [begin(course) for course in courses], 0.0
    for number in range(STEPS):
        plans = [to_local(place(number), world.ego.pose) for place, world in zip(ahead, worlds)]
        started = time.process_time()
        after: list[World] = []
        for first in range(0, len(courses), together):
            part = slice(first, first + together)
            if together == 1:
                after.append(step(courses[first], worlds[first], plans[first]))
            else:
                after += step_together(courses[part], worlds[part], plans[part])
        seconds += time.process_time() - started
        worlds = after
    return seconds, worlds


def with_idm(scene: Scene, course: Course) -> Course:
    replay = replay_of(scene, course.start_us, course.end_us)
    return replace(course, policy=Idm.of(replay, scene.agents.categories, scene.road_map))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=10, help="of the town")
    parser.add_argument("--times", type=int, default=10, help="each scene so many times")
    arguments = parser.parse_args()
    scenes = [town_scene("val", index) for index in range(arguments.scenes)]
    courses = [course_of(scene) for scene in scenes]
    ahead = [futures(scene, course) for scene, course in zip(scenes, courses)]
    many, far = courses * arguments.times, ahead * arguments.times
    driven(courses, ahead, 1)
    agents = np.mean([len(scene.agents) for scene in scenes])
    print(f"{len(many)} drives of {STEPS * 0.5:.0f} s, {agents:.0f} agents each")
    rates = {}
    ends: dict[int, list[World]] = {}
    for together in (1, len(many)):
        seconds, ends[together] = driven(many, far, together)
        rates[together] = len(many) * STEPS * 0.5 / seconds
        print(f"replayed agents, {together:4d} together: {rates[together]:8.0f} scene-seconds a second")
    if any(one.ego != other.ego for one, other in zip(ends[1], ends[len(many)])):
        raise SystemExit("stepped together, scenes end elsewhere than one by one")
    reacting = [with_idm(scene, course) for scene, course in zip(scenes, courses)]
    seconds, _ = driven(reacting, ahead, len(reacting))
    rate = len(reacting) * STEPS * 0.5 / seconds
    print(f"IDM agents,      {len(reacting):4d} together: {rate:8.0f} scene-seconds a second")
    if rates[len(many)] < WANTED:
        raise SystemExit(f"too slow: {WANTED:.0f} scene-seconds a second are wanted of replayed agents")


if __name__ == "__main__":
    main()
