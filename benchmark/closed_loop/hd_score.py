"""HUGSIM's HD-Score as a formula, with terms of our own; the number is not HUGSIM's.

Mean over planning instants of NC DAC (5 TTC + 2 C) / 7, times the route completed. The terms judge the plan of each
instant, in the world as it was driven, and are those of `benchmark.pdm` (docs/pdm.md): 3 s, polygons, comfort with its
history. Where the drive ends, all agents stay as they are for 3 s more, as HUGSIM keeps its last list of objects.
"""

from typing import Final

import numpy as np

from benchmark.closed_loop.driven_scene import driven_scene, with_the_end_held
from benchmark.closed_loop.driving import Drive
from benchmark.closed_loop.route import Route
from benchmark.constants import PLAN_STEPS
from benchmark.pdm.judging import judge_scene
from benchmark.planning import Plan
from benchmark.records.drive_schema import HdScore
from benchmark.scene import Scene

NOT_HUGSIM: Final = "HD-Score's formula with our terms; not HUGSIM's number"
COMPLETE_AT: Final = 0.9
"""Of the recorded poses, from which on the route is complete."""


def hd_score(scene: Scene, route: Route, drive: Drive) -> HdScore | None:
    """Score a drive that did not fail; ``None`` where the map has no road or no lanes."""
    driven = with_the_end_held(driven_scene(scene, route, drive.motion), PLAN_STEPS)
    first = int(np.searchsorted(scene.timestamps_us[scene.keyframes], drive.motion.times_us[0]))
    plans: list[Plan | None] = [None] * len(driven.keyframes)
    for tick in range(drive.primed - 1, len(drive.plans)):
        plans[first + tick] = drive.plans[tick]
    judged = [found for found in judge_scene(driven, plans) if found is not None]
    if not judged:
        return None
    terms = [each.nc * each.dac * (5 * each.ttc + 2 * (1.0 if each.hc is None else each.hc)) / 7 for each in judged]
    mean, completed = float(np.mean(terms)), completed_share(scene, drive, first)
    return HdScore(score=mean * completed, plans=mean, completed=completed)


def completed_share(scene: Scene, drive: Drive, first: int) -> float:
    """The farthest recorded pose that the ego came nearest to, among those from the first driven instant on.

    ``first`` is the keyframe of the first planning instant.
    """
    start = first + drive.primed - 1
    recorded = scene.ego.pose[scene.keyframes[start:], :2]
    driven = drive.motion.ego[drive.motion.ticks[drive.primed - 1 :], :2]
    nearest = np.hypot(*(driven[:, None] - recorded[None]).transpose(2, 0, 1)).argmin(axis=1)
    return float(min(1.0, (nearest.max() + 1) / (COMPLETE_AT * len(recorded))))
