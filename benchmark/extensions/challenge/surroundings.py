"""A changed vehicle among everybody else: on the drivable area, clear of others, and of the recorded ego.

Everything is looked at as a reader of the entry sees it, linear between keyframes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from benchmark.datasets.sample_truth import planar_lidar_poses
from benchmark.extensions.challenge.rules import Gaps, Road
from benchmark.geometry import Bools, Floats, box_corners, box_gap, yaw_of_quaternion
from benchmark.interactions.tracks import Integers
from benchmark.protocols.exact import footprints_between, object_boxes
from benchmark.records.challenge import Reason
from benchmark.road_map import RoadMap
from benchmark.scene import Scene

_FAR_M: Final = 60.0
"""Whoever is further away is not measured."""


@dataclass(frozen=True, slots=True)
class Nearness:
    """Nearest approach of a vehicle to another object.

    Attributes:
        gap_m: Least distance of the rectangles, 0 in contact.
        seconds: Time of it.
        depth_m: Greatest penetration of the rectangles; 0 without contact.
        other: Index of the other object; ``None`` for the ego.
    """

    gap_m: float
    seconds: float
    depth_m: float
    other: int | None


def off_road(boxes: Floats, seconds: Floats, road_map: RoadMap, rules: Road) -> Iterator[Reason]:
    """Reason why a changed vehicle leaves the drivable area, at most one; (F, 5) boxes at (F,) seconds."""
    area = road_map.drivable_area
    shapely.prepare(area)
    corners = box_corners(boxes)
    centre_off, corner_off = ~road_map.is_drivable(boxes[:, :2]), ~road_map.is_drivable(corners).all(axis=-1)
    for rule, off, most, what in (
        ("centre_off_share", centre_off, rules.centre_off_share, "its centre"),
        ("corner_off_share", corner_off, rules.corner_off_share, "a corner"),
    ):
        if off.mean() > most:
            yield Reason(
                rule=f"road.{rule}",
                sentence=f"leaves the drivable area with {what} for {100 * off.mean():.0f} % of the time, first at "
                f"{seconds[np.argmax(off)]:.1f} s; {100 * most:g} % are allowed",
            )
            return
    for rule, points, most_m, what in (
        ("centre_off_m", boxes[:, None, :2], rules.centre_off_m, "its centre"),
        ("corner_off_m", corners, rules.corner_off_m, "a corner"),
    ):
        away = shapely.distance(area, shapely.points(points)).max(axis=-1)
        if away.max() > most_m:
            yield Reason(
                rule=f"road.{rule}",
                sentence=f"is with {what} {away.max():.3g} m off the drivable area at "
                f"{seconds[np.argmax(away)]:.1f} s; {most_m:g} m are allowed",
            )
            return


def nearest_other(scene: Scene, agent: int, frames: Integers) -> Nearness | None:
    """Object other than the ego that comes nearest to a vehicle; ``None`` where there is none within 60 m."""
    boxes = scene.agents.boxes[:, frames]
    present = scene.agents.valid[:, frames] & scene.agents.valid[agent, frames]
    present[agent] = False
    away = np.hypot(boxes[..., 0] - boxes[agent, :, 0], boxes[..., 1] - boxes[agent, :, 1])
    other, frame = np.nonzero(present & (away < _FAR_M))
    if not len(other):
        return None
    return _least(boxes[agent, frame], boxes[other, frame], scene.seconds[frames[frame]], other)


def nearest_ego(scene: Scene, agent: int, first_keyframe: int) -> Nearness | None:
    """Nearest approach of recorded ego and vehicle, by the rectangles and instants of the protocol ``exact``.

    ``None`` if the vehicle is never there from ``first_keyframe``, the first one at which it is changed.
    """
    notes = scene.annotations
    heading = yaw_of_quaternion(notes.rotation[agent])[:, None]
    track = np.concatenate([notes.position[agent, :, :2], notes.size[agent, :, :2], heading], axis=-1)
    boxes, present = object_boxes(track[None], notes.valid[agent][None])
    pose = planar_lidar_poses(scene)
    ego = footprints_between(pose[:-1], pose[1:]).reshape(-1, 5)
    per_keyframe = len(ego) // max(len(pose) - 1, 1)
    at = np.arange(max(first_keyframe - 1, 0) * per_keyframe, len(ego))
    at = at[present[0, at]]
    if not len(at):
        return None
    keyframes = np.arange(1, len(ego) + 1) / per_keyframe
    seconds = np.interp(keyframes, np.arange(len(pose)), scene.seconds[scene.keyframes])
    return _least(boxes[0, at], ego[at], seconds[at], None)


def too_near(found: Nearness | None, scene: Scene, rules: Gaps) -> Reason | None:
    """Reason why an object or the ego is nearer than the rules allow, or ``None``."""
    if found is None:
        return None
    if found.other is None:
        who, rule, least, touches = "the recorded ego, which does not pass", "gaps.ego_m", rules.ego_m, "hits"
    else:
        agents = scene.agents
        who = f"{agents.categories[found.other]} {agents.ids[found.other][:12]}"
        rule, least, touches = "gaps.others_m", rules.others_m, "touches"
    if found.depth_m > rules.rounded_m:
        return Reason(rule=rule, sentence=f"{touches} {who}, at {found.seconds:.1f} s")
    if found.gap_m < least - rules.rounded_m:
        said = f"comes within {found.gap_m:.2f} m of {who}, at {found.seconds:.1f} s; {least:g} m are needed"
        return Reason(rule=rule, sentence=said)
    return None


def _least(mine: Floats, others: Floats, seconds: Floats, who: Integers | None) -> Nearness:
    """The instant at which two of them are nearest: deepest in one another, else least apart."""
    gap = box_gap(mine, others)
    touching: Bools = gap <= 0.0
    depth = np.zeros(len(gap))
    if touching.any():
        depth[touching] = _depth(mine[touching], others[touching])
    at = int(np.argmax(depth)) if touching.any() else int(np.argmin(gap))
    return Nearness(float(gap[at]), float(seconds[at]), float(depth[at]), None if who is None else int(who[at]))


def _depth(first: Floats, second: Floats) -> Floats:
    """(P,) least way to part pairs of boxes that overlap, along an edge normal of either, metres."""
    offset = second[:, :2] - first[:, :2]
    turn = second[:, 4] - first[:, 4]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    depth = np.full(len(first), np.inf)
    for own, other in ((first, second), (second, first)):
        ahead = np.column_stack([np.cos(own[:, 4]), np.sin(own[:, 4])])
        aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        for normal, reach in (
            (ahead, own[:, 2] + other[:, 2] * cos + other[:, 3] * sin),
            (aside, own[:, 3] + other[:, 2] * sin + other[:, 3] * cos),
        ):
            depth = np.minimum(depth, 0.5 * reach - np.abs((offset * normal).sum(axis=1)))
    return depth
