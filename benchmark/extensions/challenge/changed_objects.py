"""Objects of a scene against the recording, and changed vehicles: on the drivable area, clear of others and the ego."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from benchmark.datasets.sample_truth import compute_planar_lidar_poses
from benchmark.extensions.challenge.recorded_part import CommonKeyframes, Counterparts
from benchmark.extensions.challenge.rules import ChallengeRules, GapRules, RoadRules
from benchmark.geometry import Bools, Floats, box_corners, box_gap, yaw_of_quaternion
from benchmark.interactions.tracks import Integers
from benchmark.protocols.exact import interpolate_footprints, interpolate_object_boxes
from benchmark.records.challenge import RefusalReason
from benchmark.report.words import pluralise
from benchmark.road_map import RoadMap
from benchmark.scene import Annotations, Scene

_FAR_M: Final = 60.0
"""Distance beyond which other road users are not measured."""


@dataclass(frozen=True, slots=True)
class Nearness:
    """Nearest approach to another object, ``None`` for the ego; `gap_m` is 0 in contact, `depth_m` without."""

    gap_m: float
    seconds: float
    depth_m: float
    other: int | None


def check_drivable_area(boxes: Floats, seconds: Floats, road_map: RoadMap, rules: RoadRules) -> Iterator[RefusalReason]:
    """Reason why a changed vehicle leaves the drivable area, at most one; (F, 5) boxes at (F,) seconds."""
    area = road_map.drivable_area
    shapely.prepare(area)
    corners = box_corners(boxes)
    centre_off, corner_off = ~road_map.is_drivable(boxes[:, :2]), ~road_map.is_drivable(corners).all(axis=-1)
    for rule, off, most, part in (
        ("centre_off_share", centre_off, rules.centre_off_share, "its centre"),
        ("corner_off_share", corner_off, rules.corner_off_share, "a corner"),
    ):
        if off.mean() > most:
            yield RefusalReason(
                rule=f"road.{rule}",
                sentence=f"leaves the drivable area with {part} for {100 * off.mean():.0f} % of the time, first at "
                f"{seconds[np.argmax(off)]:.1f} s; {100 * most:g} % are allowed",
            )
            return
    for rule, points, most_m, part in (
        ("centre_off_m", boxes[:, None, :2], rules.centre_off_m, "its centre"),
        ("corner_off_m", corners, rules.corner_off_m, "a corner"),
    ):
        away = shapely.distance(area, shapely.points(points)).max(axis=-1)
        if away.max() > most_m:
            yield RefusalReason(
                rule=f"road.{rule}",
                sentence=f"is with {part} {away.max():.3g} m off the drivable area at "
                f"{seconds[np.argmax(away)]:.1f} s; {most_m:g} m are allowed",
            )
            return


def find_nearest_object(scene: Scene, agent: int, frames: Integers) -> Nearness | None:
    """Object other than the ego that comes nearest to a vehicle; ``None`` where there is none within 60 m."""
    boxes = scene.agents.boxes[:, frames]
    present = scene.agents.valid[:, frames] & scene.agents.valid[agent, frames]
    present[agent] = False
    away = np.hypot(boxes[..., 0] - boxes[agent, :, 0], boxes[..., 1] - boxes[agent, :, 1])
    other, frame = np.nonzero(present & (away < _FAR_M))
    if not len(other):
        return None
    return _find_nearest_instant(boxes[agent, frame], boxes[other, frame], scene.seconds[frames[frame]], other)


def find_nearest_ego(scene: Scene, agent: int, first_keyframe: int) -> Nearness | None:
    """Nearest approach of recorded ego and vehicle, by the rectangles and instants of the protocol ``exact``.

    ``None`` if the vehicle is never there from ``first_keyframe``, the first one that is changed.
    """
    notes = scene.annotations
    heading = yaw_of_quaternion(notes.rotation[agent])[:, None]
    track = np.concatenate([notes.position[agent, :, :2], notes.size[agent, :, :2], heading], axis=-1)
    boxes, present = interpolate_object_boxes(track[None], notes.valid[agent][None])
    pose = compute_planar_lidar_poses(scene)
    ego = interpolate_footprints(pose[:-1], pose[1:]).reshape(-1, 5)
    per_keyframe = len(ego) // max(len(pose) - 1, 1)
    at = np.arange(max(first_keyframe - 1, 0) * per_keyframe, len(ego))
    at = at[present[0, at]]
    if not len(at):
        return None
    keyframes = np.arange(1, len(ego) + 1) / per_keyframe
    seconds = np.interp(keyframes, np.arange(len(pose)), scene.seconds[scene.keyframes])
    return _find_nearest_instant(boxes[0, at], ego[at], seconds[at], None)


def check_gap(found: Nearness | None, scene: Scene, rules: GapRules) -> RefusalReason | None:
    """Reason why an object or the ego is nearer than the rules allow, or ``None``."""
    if found is None:
        return None
    if found.other is None:
        other_name, rule, least, touches = "the recorded ego", "gaps.ego_m", rules.ego_m, "hits"
    else:
        agents = scene.agents
        other_name = f"{agents.categories[found.other]} {agents.ids[found.other][:12]}"
        rule, least, touches = "gaps.others_m", rules.others_m, "touches"
    if found.depth_m > rules.rounded_m:
        return RefusalReason(rule=rule, sentence=f"{touches} {other_name}, at {found.seconds:.1f} s")
    if found.gap_m < least - rules.rounded_m:
        sentence = f"comes within {found.gap_m:.2f} m of {other_name}, at {found.seconds:.1f} s; {least:g} m are needed"
        return RefusalReason(rule=rule, sentence=sentence)
    return None


def _find_nearest_instant(mine: Floats, others: Floats, seconds: Floats, indices: Integers | None) -> Nearness:
    """The instant at which two of them are nearest: deepest in one another, else least apart."""
    gap = box_gap(mine, others)
    touching: Bools = gap <= 0.0
    depth = np.zeros(len(gap))
    if touching.any():
        depth[touching] = _penetration_depth(mine[touching], others[touching])
    at = int(np.argmax(depth)) if touching.any() else int(np.argmin(gap))
    return Nearness(float(gap[at]), float(seconds[at]), float(depth[at]), None if indices is None else int(indices[at]))


def _penetration_depth(first: Floats, second: Floats) -> Floats:
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


_COUNTS: Final = ("visibility", "num_lidar_pts", "num_radar_pts")
_WORDS: Final = {
    "attribute": "attribute",
    "visibility": "visibility",
    "num_lidar_pts": "lidar points",
    "num_radar_pts": "radar points",
}
_NAMED: Final = 3
"""Objects that a sentence names."""


@dataclass(frozen=True, slots=True)
class ChangedObject:
    """Object that at (C,) common keyframes is elsewhere, or in one scene alone; (C,) distance, 0 where not in both."""

    agent: int
    recorded: int
    at: Bools
    distance: Floats

    @property
    def first(self) -> int:
        """Number of the first common keyframe at which it differs."""
        return int(np.argmax(self.at))

    @property
    def farthest_m(self) -> float:
        """Largest distance from where it was recorded."""
        return float(self.distance.max(initial=0.0))


def find_changed_objects(
    entry: Scene, recorded: Scene, known: Counterparts, common: CommonKeyframes, rules: ChallengeRules
) -> list[ChangedObject]:
    """Objects of both scenes that move otherwise: named adversaries of the entry first, then by distance."""
    changed_objects = []
    mine, theirs = entry.annotations, recorded.annotations
    for agent, other in known.pairs:
        here, there = mine.valid[agent, common.here], theirs.valid[other, common.there]
        offset = mine.position[agent, common.here] - theirs.position[other, common.there]
        turn = mine.rotation[agent, common.here] - theirs.rotation[other, common.there]
        off = np.abs(offset).max(axis=1) > rules.unchanged.position_m
        off |= np.abs(turn).max(axis=1) > rules.unchanged.rotation
        at = (here != there) | (here & there & off)
        if at.any():
            changed_objects.append(
                ChangedObject(agent, other, at, np.where(here & there, np.hypot(*offset[:, :2].T), 0.0))
            )
    named = {entry.agents.ids.index(name) for name in entry.adversaries if name in entry.agents.ids}
    return sorted(
        changed_objects, key=lambda changed_object: (changed_object.agent not in named, -changed_object.farthest_m)
    )


def check_changed_objects(
    entry: Scene,
    recorded: Scene,
    known: Counterparts,
    found: Sequence[ChangedObject],
    common: CommonKeyframes,
    rules: ChallengeRules,
) -> Iterator[RefusalReason]:
    """Check that few enough vehicles differ, none is missing or made up, and the entry names those that differ."""
    for indices, scene, complaint in (
        (known.removed, recorded, "leaves out"),
        (known.added, entry, "adds, which the recording lacks:"),
    ):
        if indices:
            yield RefusalReason(
                rule="changed.most",
                sentence=f"{complaint} {_join_names([_name_object(scene, agent) for agent in indices])}",
            )
    if len(found) > rules.changed.most:
        beyond = found[rules.changed.most :]
        listed = _join_names([_describe_move(entry, agent, common) for agent in beyond])
        yield RefusalReason(
            rule="changed.most",
            sentence=f"changes {pluralise(len(found), 'object')} and may change {rules.changed.most}; also: {listed}",
        )
    if len(found) < rules.changed.least:
        yield RefusalReason(
            rule="changed.least",
            sentence=f"changes {pluralise(len(found), 'vehicle')} of the recording and must change "
            f"{rules.changed.least}",
        )
    if entry.adversaries:
        changed = {entry.agents.ids[agent.agent] for agent in found}
        if wrong := [name for name in entry.adversaries if name not in changed]:
            yield RefusalReason(
                rule="changed.least",
                sentence=f"names {wrong[0][:12]} as its adversary, which moves as recorded",
            )
        elif len(found) <= rules.changed.most and (unnamed := sorted(changed - set(entry.adversaries))):
            yield RefusalReason(rule="changed.most", sentence=f"changes {unnamed[0][:12]}, not named as an adversary")


def check_labels(
    entry: Scene,
    recorded: Scene,
    known: Counterparts,
    found: Sequence[ChangedObject],
    common: CommonKeyframes,
    rules: ChallengeRules,
) -> Iterator[RefusalReason]:
    """Check that category, size, attributes, visibility and points are as recorded.

    Where a changed vehicle is elsewhere, its entry decides on its looks and number of points. One point it must have,
    since protocols leave out objects that no sensor could have seen.
    """
    # A track may leave the recorded one just after a keyframe whose attribute already changes.
    elsewhere = {
        changed_object.agent: changed_object.at | np.append(changed_object.at[1:], False) for changed_object in found
    }
    wrong: dict[str, list[str]] = {}
    for agent, other in known.pairs:
        name = _name_object(entry, agent)
        if entry.agents.categories[agent] != recorded.agents.categories[other]:
            was = recorded.agents.categories[other]
            wrong.setdefault("changed.categories", []).append(f"the category of {name}, recorded as {was}")
        both = entry.annotations.valid[agent, common.here] & recorded.annotations.valid[other, common.there]
        here, there = common.here[both], common.there[both]
        size = np.abs(entry.annotations.size[agent, here] - recorded.annotations.size[other, there])
        if size.max(initial=0.0) > rules.unchanged.position_m or _changes_size(entry.annotations, agent, elsewhere):
            wrong.setdefault("unchanged.position_m", []).append(f"the size of {name}")
        if rules.unchanged.points:
            free = elsewhere[agent][both] if agent in elsewhere else np.zeros(len(here), np.bool_)
            for field in _find_label_differences(entry, recorded, (agent, here[~free]), (other, there[~free])):
                wrong.setdefault("unchanged.points", []).append(f"the {_WORDS[field]} of {name}")
    for rule, listed in wrong.items():
        yield RefusalReason(rule=rule, sentence=f"alters {_join_names(listed)}")
    for changed_object in found:
        at = common.here[changed_object.at & entry.annotations.valid[changed_object.agent, common.here]]
        if (entry.annotations.num_lidar_pts[changed_object.agent, at] < 1).any():
            yield RefusalReason(
                rule="unchanged.points",
                sentence=f"has no lidar point on {_name_object(entry, changed_object.agent)} where it is "
                "changed, so that protocols leave it out",
            )


def _changes_size(notes: Annotations, agent: int, elsewhere: dict[int, Bools]) -> bool:
    """Whether the size of a changed vehicle varies within the entry."""
    if agent not in elsewhere:
        return False
    size = notes.size[agent, notes.valid[agent]]
    return bool((size != size[0]).any())


def _find_label_differences(
    entry: Scene, recorded: Scene, mine: tuple[int, Integers], theirs: tuple[int, Integers]
) -> Iterator[str]:
    """Fields of annotations that differ somewhere."""
    notes, other = entry.annotations, recorded.annotations
    if (notes.attribute[mine] != other.attribute[theirs]).any():
        yield "attribute"
    # A recording without visibility has no point counts either; rewritten data sets store a visibility there.
    has_visibility = other.visibility[theirs] != 0
    for field in _COUNTS:
        values, recorded_values = getattr(notes, field)[mine], getattr(other, field)[theirs]
        if (values != recorded_values)[has_visibility].any():
            yield field


def check_changed_vehicle(
    entry: Scene, recorded: Scene, each: ChangedObject, common: CommonKeyframes, rules: ChallengeRules
) -> Iterator[RefusalReason]:
    """Check that a changed vehicle is of a permitted kind, begins where it was recorded, and is there to the end."""
    name = _name_object(entry, each.agent)
    if entry.agents.categories[each.agent] not in rules.changed.categories:
        yield RefusalReason(rule="changed.categories", sentence=f"changes {name}, which no entry may")
    mine, theirs = entry.annotations, recorded.annotations
    valid, was = mine.valid[each.agent], theirs.valid[each.recorded]
    if not valid.any():
        return
    first = int(np.argmax(valid[common.here]))
    if was.any() and int(np.argmax(valid)) != int(common.here[np.argmax(was[common.there])]):
        yield RefusalReason(
            rule="changed.start_m",
            sentence=f"starts {name} at keyframe {int(np.argmax(valid))}; the recording starts it at keyframe "
            f"{int(np.argmax(was))}",
        )
    elif each.distance[first] > rules.changed.start_m:
        yield RefusalReason(
            rule="changed.start_m",
            sentence=f"starts {name} {each.distance[first]:.3g} m from its recorded position; "
            f"{rules.changed.start_m:g} m are allowed",
        )
    start = int(common.here[each.first])
    if rules.changed.to_the_end and not valid[start:].all():
        absent_from = start + int(np.argmin(valid[start:]))
        yield RefusalReason(rule="changed.to_the_end", sentence=f"lets {name} be gone at keyframe {absent_from}")


def _describe_move(entry: Scene, changed_object: ChangedObject, common: CommonKeyframes) -> str:
    how = f"by up to {changed_object.farthest_m:.3g} m" if changed_object.farthest_m else "in time or heading"
    return f"{_name_object(entry, changed_object.agent)} {how} from keyframe {common.here[changed_object.first]} on"


def _name_object(scene: Scene, agent: int) -> str:
    """How a sentence names an object."""
    return f"{scene.agents.categories[agent]} {scene.agents.ids[agent][:12]}"


def _join_names(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return "; ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
