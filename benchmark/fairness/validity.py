"""Validity rates: counts of adversaries whose written track breaks a rule of driving, road or arithmetic.

``docs/realism.md``, "Validity rates". Unlike the divergences they need no recordings to compare with.
"""

from typing import Final

import numpy as np
import shapely

from benchmark.dynamics.bicycle import DriverLimits, find_broken_limit
from benchmark.geometry import Bools, Floats, box_corners, box_gap, boxes_overlap, wrap_angle
from benchmark.interactions.tracks import ContinuousTracks, Integers
from benchmark.records.scene_assessment import TRACK_DEFECT_NAMES, StoredTrackDefects
from benchmark.road_map import RoadMap

OFF_ROAD_M: Final = 0.3
AGAINST_RAD: Final = np.pi / 2
AGAINST_S: Final = 1.0
HOVERING_M: Final = 0.5
HOVERING_S: Final = 0.5
TELEPORT_M: Final = 0.2
TELEPORT_M_S2: Final = 10.0
TELEPORT_RAD: Final = np.deg2rad(30.0)


NO_MAP: Final = "no map"
NO_TRACK: Final = "the generated 12 Hz track is not in the data set"
_NEEDS_MAP: Final = ("off_road", "against_traffic")


def find_track_defects(
    tracks: ContinuousTracks,
    agent: int,
    frames: slice | Integers,
    road_map: RoadMap | None = None,
    *,
    at_keyframes: bool = False,
    rounded_m: float = 0.0,
) -> StoredTrackDefects:
    """Look for faults of an adversary.

    Args:
        tracks: All agents, 12 Hz, as generated: what a reader of a data set gets is linear between 2 Hz keyframes, and
            its corners there break every limit.
        frames: Its adversarial stretch; frames at which it is not there do not count.
        at_keyframes: Whether nothing is known between the frames: then limits and jumps are not asked, and of the
            others only what the keyframes show is found.
        rounded_m: How far each position may be from where it was generated (`find_broken_limit`).
    """
    there = np.arange(len(tracks.seconds))[frames]
    there = there[tracks.valid[agent, there]]
    seconds, boxes = tracks.seconds[there], tracks.agents[agent, there]
    others, present = _collect_others(tracks, agent, there)
    touching, near = _find_near(boxes, others, present)
    ego = len(others) - 1
    values = {
        "beyond_limits": None
        if at_keyframes
        else find_broken_limit(boxes, DriverLimits(), rounded_m=rounded_m) is not None,
        "off_road": None if road_map is None else bool(_find_off_road(boxes, road_map).any()),
        "contact": bool(np.delete(touching, ego, axis=0).any()),
        "against_traffic": None
        if road_map is None
        else _lasts_longer_than((find_lane_turns(boxes, road_map)[0] > AGAINST_RAD)[None], seconds, AGAINST_S),
        "hovering": _lasts_longer_than(near, seconds, HOVERING_S),
        "teleport": None if at_keyframes else bool(find_teleports(seconds, boxes).any()),
    }
    unknown = {name: NO_MAP if name in _NEEDS_MAP else NO_TRACK for name in TRACK_DEFECT_NAMES if values[name] is None}
    return StoredTrackDefects(**values, unknown=unknown)


def find_teleports(seconds: Floats, boxes: Floats) -> Bools:
    """(F - 1,) steps between frames that no car could make.

    It moves further than at the speed before and 10 m/s^2 more, and 0.2 m, or turns by more than 30 degrees.
    """
    step, span = np.hypot(*np.diff(boxes[:, :2], axis=0).T), np.diff(seconds)
    speed = np.concatenate([step[:1], step[:-1]]) / np.concatenate([span[:1], span[:-1]])
    far = step > (speed + TELEPORT_M_S2 * span) * span + TELEPORT_M
    return np.asarray(far | (np.abs(wrap_angle(np.diff(boxes[:, 4]))) > TELEPORT_RAD))


def _collect_others(tracks: ContinuousTracks, agent: int, frames: Integers) -> tuple[Floats, Bools]:
    """All others, the recorded ego as the last one."""
    others = np.concatenate([np.delete(tracks.agents, agent, axis=0)[:, frames], tracks.ego[frames][None]])
    present = np.delete(tracks.valid, agent, axis=0)[:, frames]
    return others, np.concatenate([present, np.ones((1, present.shape[1]), np.bool_)])


def _find_near(boxes: Floats, others: Floats, present: Bools) -> tuple[Bools, Bools]:
    """(M, F) whether each touches the boxes, and whether it is within 0.5 m of them."""
    away = np.hypot(others[..., 0] - boxes[:, 0], others[..., 1] - boxes[:, 1])
    outer = 0.5 * (np.hypot(others[..., 2], others[..., 3]) + np.hypot(boxes[:, 2], boxes[:, 3]))
    row, frame = np.nonzero(present & (away <= outer + HOVERING_M))
    touching, near = np.zeros(present.shape, np.bool_), np.zeros(present.shape, np.bool_)
    touching[row, frame] = boxes_overlap(boxes[frame], others[row, frame])
    near[row, frame] = box_gap(boxes[frame], others[row, frame]) < HOVERING_M
    return touching, near


def _lasts_longer_than(flags: Bools, seconds: Floats, longer_than: float) -> bool:
    """Whether any row of (M, F) flags stays up for longer than so many seconds."""
    for row in flags[flags.any(axis=1)]:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8))).reshape(-1, 2)
        if (seconds[edges[:, 1] - 1] - seconds[edges[:, 0]] > longer_than).any():
            return True
    return False


def _find_off_road(boxes: Floats, road_map: RoadMap) -> Bools:
    corners = shapely.points(box_corners(boxes))
    area = road_map.drivable_area
    shapely.prepare(area)
    return np.asarray(~shapely.dwithin(area, corners, OFF_ROAD_M).all(axis=-1))


def find_lane_turns(boxes: Floats, road_map: RoadMap) -> tuple[Floats, Floats]:
    """(F,) smallest and (F,) largest angle between the heading and lanes below the centre, [0, pi]; NaN for none."""
    turns: Floats = np.full((2, len(boxes)), np.nan)
    for lane in road_map.lanes.values():
        if lane.polygon is None:
            continue
        inside = np.flatnonzero(shapely.contains_xy(lane.polygon, boxes[:, 0], boxes[:, 1]))
        if not len(inside):
            continue
        turn = np.abs(wrap_angle(boxes[inside, 4] - _compute_directions(lane.centerline, boxes[inside, :2])))
        turns[0, inside] = np.fmin(turns[0, inside], turn)
        turns[1, inside] = np.fmax(turns[1, inside], turn)
    return turns[0], turns[1]


def _compute_directions(line: Floats, points: Floats) -> Floats:
    """(P,) heading of the segment of a polyline that is nearest to each point."""
    start, step = line[:-1], np.diff(line, axis=0)
    squared = np.maximum((step**2).sum(axis=1), 1e-12)
    share = np.clip(((points[:, None] - start) * step).sum(axis=-1) / squared, 0.0, 1.0)
    miss = points[:, None] - (start + share[..., None] * step)
    nearest = step[(miss**2).sum(axis=-1).argmin(axis=1)]
    return np.asarray(np.arctan2(nearest[:, 1], nearest[:, 0]))
