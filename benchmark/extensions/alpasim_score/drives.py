"""AlpaSim's scene score of a drive of ours: what its log would hold, the road, and both rule sets."""

from typing import Final

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from benchmark.closed_loop.default_engine import PRIMING_STEPS
from benchmark.closed_loop.episodes import Episode
from benchmark.closed_loop.fault_attribution import load_scored_road
from benchmark.closed_loop.world_state import compute_ego_boxes
from benchmark.extensions.alpasim_score.bodies import build_bodies
from benchmark.extensions.alpasim_score.scene_score import (
    RULE_SETS,
    LoggedDrive,
    RuleSet,
    SceneScore,
    measure_drive,
    score_drive,
)
from benchmark.geometry import Bools, Floats
from benchmark.machine.identity_cache import IdentityCache
from benchmark.pdm.road_polygons import SLIT_M
from benchmark.scene import Scene

EDGE_M: Final = 1e-3
"""July's rules have a car off the road where it is nearer to the edge than this."""


def score_by_alpasim(scene: Scene, drive: Episode) -> dict[str, dict[str, float | None]]:
    """Parts of the score by rule set, of a drive that did not fail; nothing of drives that AlpaSim has no score of.

    Whether the road was left is ``None`` without a map. A drive that has NeuroNCAP's own scores has no other.
    """
    if drive.neuroncap is not None:
        return {}
    log = log_drive(scene, drive)
    measures = measure_drive(log)
    if measures is None:
        return {}
    scores = {rules.name: score_drive(measures, rules, find_off_road(scene, log.ego, rules)) for rules in RULE_SETS}
    return {name: _list_parts(score) for name, score in scores.items() if score is not None}


def log_drive(scene: Scene, drive: Episode) -> LoggedDrive:
    """What AlpaSim would have logged of a drive, and its recording; times after the recording's end are left out.

    Of a drive around an encounter both begin a second before it, and the recording ends with the window.
    """
    motion, window = drive.motion, drive.window
    driven = min(drive.primed, len(motion.ticks)) - 1
    first = int(motion.ticks[max(driven - PRIMING_STEPS, 0)])
    start_us = scene.timestamps_us[0] if window is None else motion.times_us[first]
    end_us = scene.timestamps_us[-1 if window is None else scene.keyframes[window.end]]
    over_us = scene.timestamps_us[scene.keyframes[-1 if window is None else window.end]]
    recorded = (scene.timestamps_us >= start_us) & (scene.timestamps_us <= end_us)
    kept = slice(first, int(np.searchsorted(motion.times_us, end_us, side="right")))
    return LoggedDrive(
        times_us=motion.times_us[kept],
        ego=compute_ego_boxes(motion.ego[kept]),
        others=motion.boxes(scene.agents.size)[:, kept],
        present=motion.present[:, kept],
        recorded_us=scene.timestamps_us[recorded],
        recorded=scene.ego.boxes[recorded, :2],
        scored_from_us=int(motion.times_us[motion.ticks[driven]]),
        # AlpaSim goes on after a contact, and its log ends where the scene does.
        ends_us=int(motion.times_us[kept][-1] if drive.touch is None else over_us),
        cut=drive.touch is not None,
    )


def find_off_road(scene: Scene, ego: Floats, rules: RuleSet) -> Bools | None:
    """(T,) whether the body of (T, 5) boxes is off the road; ``None`` without a map.

    September's rule for maps of surfaces: they do not cover it. July's: its body touches the edge and lanes do not
    cover it, so that a car wholly beyond the edge is on the road.
    """
    surface, edge, lanes = _load_road(scene)
    if surface.is_empty:
        return None
    bodies = build_bodies(ego)
    if not rules.whole_way:
        return ~np.asarray(shapely.covers(surface, bodies), np.bool_)
    return np.asarray(shapely.dwithin(edge, bodies, EDGE_M) & ~shapely.covers(lanes, bodies), np.bool_)


def _join_road(scene: Scene) -> tuple[BaseGeometry, BaseGeometry, BaseGeometry]:
    """The drivable surface, without the slits between its parts, its edge, and all lanes."""
    _, road = load_scored_road(scene)
    # Outlines of others may cross themselves.
    drivable, lanes = (shapely.union_all([part.buffer(0.0) for part in parts]) for parts in (road.drivable, road.lanes))
    surface = drivable.buffer(SLIT_M, join_style="mitre").buffer(-SLIT_M, join_style="mitre")
    found = surface, surface.boundary, lanes
    for geometry in found:
        shapely.prepare(geometry)
    return found


_load_road: Final = IdentityCache[Scene, tuple[BaseGeometry, BaseGeometry, BaseGeometry]](_join_road, kept=4)


def _list_parts(score: SceneScore) -> dict[str, float | None]:
    return {
        "score": score.score,
        "progress": score.progress_score,
        "front": float(score.front),
        "rear": float(score.rear),
        "lateral": float(score.lateral),
        "off_road": None if score.off_road is None else float(score.off_road),
        "corridor": float(score.corridor),
        "km": score.driven_m / 1000.0,
    }
