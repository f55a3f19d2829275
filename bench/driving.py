"""What a drive of a miniature with the schematic sensor costs beside rendering those frames and planning on them.

Run ``python bench/driving.py [planner ...]``; processor seconds of one core. The drive may cost at most 1.5 times the
sum of the other two.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmark import api
from benchmark.closed_loop.default_engine import DefaultRides
from benchmark.closed_loop.driving import Stage, drive
from benchmark.closed_loop.scoring import score_drive
from benchmark.machine.workers import single_threaded
from benchmark.planning import SceneInfo
from benchmark.runs.redriving import can_of
from generation.render.schematic import SECOND, SchematicRenderer
from generation.render.sensor import SchematicSensor

PLANNERS = ("vad-mini", "sparsedrive-mini", "uniad-mini")


def processor_seconds(work: Callable[[], Any]) -> tuple[float, Any]:
    """How long it computes, and what came of it."""
    started = time.process_time()
    found = work()
    return time.process_time() - started, found


def main(names: tuple[str, ...], out: Path) -> None:
    """Measure each planner on the first scene of ``adv`` of the embedded data."""
    single_threaded()
    data = api.open_split(api.open_data("mini", out=out), "adv", out)
    name = data.scene_names("adv")[0]
    scene, can, seen = data.scene(name), can_of(data, name), list(data.observations(name))
    renderer = SchematicRenderer(scene.cameras[0].width, scene.cameras[0].height, style=SECOND)
    for each in names:
        planner = api.load_planner(each)()
        stage = Stage(scene, can, 0, DefaultRides(), SchematicSensor(), 600.0)
        planner.reset(SceneInfo(name, scene.road_map.location, scene.cameras))
        # The first plan of a network makes what later ones have.
        planner.plan(seen[0])
        driven_s, found = processor_seconds(lambda: drive(stage, planner))  # noqa: B023 - called at once
        scored_s, _ = processor_seconds(lambda: score_drive(scene, found))  # noqa: B023 - called at once
        ticks = len(found.plans)
        drawn_s, _ = processor_seconds(lambda: list(renderer.render(scene, scene.keyframes[:ticks].tolist())))  # noqa: B023
        planner.reset(SceneInfo(name, scene.road_map.location, scene.cameras))
        planned_s, _ = processor_seconds(lambda: [planner.plan(observation) for observation in seen[:ticks]])  # noqa: B023
        share = (driven_s + scored_s) / (drawn_s + planned_s)
        print(
            f"{each}: {ticks} plans; drive {driven_s:.2f} s, scores {scored_s:.2f} s; rendering {drawn_s:.2f} s, open "
            f"loop {planned_s:.2f} s: {share:.2f} times"
        )


if __name__ == "__main__":
    main(tuple(sys.argv[1:]) or PLANNERS, Path("challenger-out"))
