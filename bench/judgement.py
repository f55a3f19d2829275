"""Speed of judging scenes: reference drivers, severity and realism of a split of 150 scenes, and last chances apart.

Run as ``OMP_NUM_THREADS=1 python bench/judgement.py``. Processor time. Scenes are those of the embedded town; in each,
the first car that moves 5 m or more stands for the adversary, which costs what one costs.
"""

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.fairness.encounter import severity_of
from benchmark.fairness.features import recorded_runs, runs_of
from benchmark.fairness.realism import realism_of
from benchmark.fairness.road_edge import RoadEdge
from benchmark.fairness.validity import faults_of
from benchmark.interactions.solvability import SceneLadder
from benchmark.interactions.tracks import Tracks
from benchmark.scene import Scene
from generation.sources.town import town_scene

SPLIT = 150
LIMIT_S = 60.0
"""What a split may take without last chances."""
CHANCE_LIMIT_S = 2.0
"""What the last chance of a scene may take."""
CATEGORY = "vehicle.car"
Found = TypeVar("Found")


def adversary_of(scene: Scene) -> int:
    """The first car that moves 5 m or more."""
    moved = np.ptp(scene.agents.position[..., :2], axis=1).max(axis=-1)
    cars = [row for row, name in enumerate(scene.agents.categories) if name == CATEGORY and moved[row] >= 5.0]
    return cars[0]


class Clock:
    """Processor seconds by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def timed(self, name: str, call: Callable[..., Found], *arguments: Any) -> Found:
        """Run and time."""
        started = time.process_time()
        found = call(*arguments)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - started
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--last-chances", type=int, default=5)
    options = parser.parse_args()
    clock = Clock()
    adversaries, recorded = {}, {}
    chances: list[float] = []
    objects: list[int] = []
    for number in range(options.scenes):
        scene = town_scene("val", number)
        tracks, agent = Tracks.of_scene(scene), adversary_of(scene)
        objects.append(len(tracks))
        area = scene.road_map.drivable_area
        ladder = clock.timed("drivers", SceneLadder.of, tracks, agent, None, area)
        clock.timed("severity", severity_of, tracks, agent)
        road = RoadEdge(area)
        of_agent, of_all = partial(runs_of, road=road), partial(recorded_runs, road=road)
        adversaries[scene.name] = clock.timed("realism", of_agent, tracks, scene.keyframes, agent)
        recorded[scene.name] = clock.timed("realism", of_all, tracks, scene.keyframes, CATEGORY)
        clock.timed("validity", faults_of, tracks, agent, slice(None), scene.road_map)
        if len(chances) < options.last_chances:
            started = time.process_time()
            if ladder.last_chance.evaluated:
                chances.append(time.process_time() - started)
    clock.timed("divergences", realism_of, adversaries, recorded)
    print(f"{options.scenes} scenes of {np.mean(objects):.0f} objects on average; processor time of one core")
    for name, seconds in clock.seconds.items():
        print(f"{name}: {1e3 * seconds / options.scenes:.0f} ms a scene")
    total = sum(clock.seconds.values()) * SPLIT / options.scenes
    print(f"{SPLIT} scenes: {total:.1f} s, allowed {LIMIT_S:.0f}")
    if chances:
        print(f"last chance: {np.mean(chances):.2f} s a scene that has one, at most {max(chances):.2f}")
    if total > LIMIT_S or max(chances, default=0.0) > CHANCE_LIMIT_S:
        raise SystemExit("too slow")


if __name__ == "__main__":
    main()
