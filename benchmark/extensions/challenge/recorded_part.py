"""Parts of an entry that must equal the recording (times, ego, sensors, map, ego inputs), and its matched objects.

Tokens may be new, objects may be moved or added.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from benchmark.errors import InputError
from benchmark.extensions.challenge.rules import UnchangedRules
from benchmark.geometry import Floats, transform_matrix
from benchmark.interactions.tracks import Integers
from benchmark.planning import CameraView, Observation
from benchmark.records.challenge import RefusalReason
from benchmark.report.words import pluralise
from benchmark.road_map import RoadMap
from benchmark.scene import Camera, Scene

FARTHEST_M: Final = 30.0
"""Objects that begin further from one another, or half as far and are of other kinds, are not the same."""
_ANOTHER_KIND_M: Final = 15.0
_SAME_KIND: Final = 2
"""Weight of a shared position if the category is the same, too; otherwise one."""


@dataclass(frozen=True, slots=True)
class CommonKeyframes:
    """Common keyframes of an entry and its recording: (C,) numbers in the entry, (C,) numbers in the recording."""

    here: Integers
    there: Integers

    @classmethod
    def common(cls, entry: Scene, recorded: Scene) -> "CommonKeyframes":
        """Those with the same time stamps."""
        mine, theirs = entry.timestamps_us[entry.keyframes], recorded.timestamps_us[recorded.keyframes]
        _, here, there = np.intersect1d(mine, theirs, return_indices=True)
        return cls(here, there)


@dataclass(frozen=True, slots=True)
class Counterparts:
    """Objects of an entry matched to its recording's; ``pairs`` are (entry, recording), sorted by the former."""

    pairs: tuple[tuple[int, int], ...]
    added: tuple[int, ...]
    removed: tuple[int, ...]


def match_objects(entry: Scene, recorded: Scene, common: CommonKeyframes) -> Counterparts:
    """Match objects, each once: by instance token, else by places in common, else by where they begin."""
    matches: dict[int, int] = {}
    known = {name: index for index, name in enumerate(recorded.agents.ids)}
    for index, name in enumerate(entry.agents.ids):
        if name in known:
            matches[index] = known[name]
    _match_by_places(entry, recorded, common, matches)
    _match_by_start(entry, recorded, common, matches)
    matched = set(matches.values())
    return Counterparts(
        pairs=tuple(sorted(matches.items())),
        added=tuple(index for index in range(len(entry.agents)) if index not in matches),
        removed=tuple(index for index in range(len(recorded.agents)) if index not in matched),
    )


def _match_by_places(entry: Scene, recorded: Scene, common: CommonKeyframes, matches: dict[int, int]) -> None:
    """Pair objects that are at the same place at the same time, most such places first."""
    matched = set(matches.values())
    places: dict[tuple[int, bytes], list[int]] = {}
    for index in range(len(recorded.agents)):
        if index in matched:
            continue
        at = common.there[recorded.annotations.valid[index, common.there]]
        for keyframe, place in zip(at.tolist(), recorded.annotations.position[index, at], strict=True):
            places.setdefault((keyframe, place.tobytes()), []).append(index)
    counts: Counter[tuple[int, int]] = Counter()
    for index in range(len(entry.agents)):
        if index in matches:
            continue
        there_too = entry.annotations.valid[index, common.here]
        mine = entry.annotations.position[index, common.here[there_too]]
        for keyframe, place in zip(common.there[there_too].tolist(), mine, strict=True):
            for other in places.get((keyframe, place.tobytes()), ()):
                same = entry.agents.categories[index] == recorded.agents.categories[other]
                counts[index, other] += _SAME_KIND if same else 1
    for (index, other), _ in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        if index not in matches and other not in matched:
            matches[index] = other
            matched.add(other)


def _match_by_start(entry: Scene, recorded: Scene, common: CommonKeyframes, matches: dict[int, int]) -> None:
    """Pair what is left by distance at the first keyframe of both, together the least."""
    matched = set(matches.values())
    mine = [index for index in range(len(entry.agents)) if index not in matches]
    theirs = [index for index in range(len(recorded.agents)) if index not in matched]
    if not mine or not theirs:
        return
    costs = np.array([[_match_cost(entry, index, recorded, other, common) for other in theirs] for index in mine])
    for row, column in zip(*linear_sum_assignment(costs), strict=True):
        if costs[row, column] < FARTHEST_M:
            matches[mine[row]] = theirs[column]


def _match_cost(entry: Scene, index: int, recorded: Scene, other: int, common: CommonKeyframes) -> float:
    valid = entry.annotations.valid[index, common.here] & recorded.annotations.valid[other, common.there]
    if not valid.any():
        return FARTHEST_M
    at = int(np.argmax(valid))
    offset: Floats = (
        entry.annotations.position[index, common.here[at], :2]
        - recorded.annotations.position[other, common.there[at], :2]
    )
    another = entry.agents.categories[index] != recorded.agents.categories[other]
    return min(float(np.hypot(*offset)) + (_ANOTHER_KIND_M if another else 0.0), FARTHEST_M)


_BETWEEN_M: Final = 1e-3
"""How far the ego may be from a straight line between keyframes where an entry has no sweeps."""
_DERIVED_M_S: Final = 0.5
"""How far motions may differ of which one is measured and one derived from poses."""
_DERIVED_RAD_S: Final = 0.1
_INTRINSIC: Final = 1e-9
"""Share by which scaled intrinsics may differ."""
_LAYERS: Final = ("ped_crossings", "walkways", "road_segments", "stop_lines", "carparks", "road_blocks")


def require_comparable(entry: Scene, recorded: Scene, common: CommonKeyframes) -> None:
    """Refuse scenes that share no keyframe, since they cannot be compared."""
    if not len(common.here):
        raise InputError(
            f"no keyframe of {entry.name} is at a time of its recording {recorded.name}: the entry was made from other "
            "recordings, or its times were shifted; give its own recordings with --base"
        )


def check_times(entry: Scene, recorded: Scene, common: CommonKeyframes) -> Iterator[RefusalReason]:
    """Whether the keyframes are those of the recording."""
    mine, theirs = len(entry.keyframes), len(recorded.keyframes)
    if mine == theirs == len(common.here):
        return
    if mine != theirs:
        sentence = f"has {pluralise(mine, 'keyframe')}, its recording has {theirs}"
    else:
        times = entry.timestamps_us[entry.keyframes] - recorded.timestamps_us[recorded.keyframes]
        first = int(np.argmax(times != 0))
        sentence = (
            f"has {pluralise(theirs - len(common.here), 'keyframe')} at another time than the recording, first "
            f"keyframe {first}, by {abs(int(times[first])) * 1e-3:.3g} ms"
        )
    yield RefusalReason(rule="unchanged.times", sentence=sentence)


def check_ego(entry: Scene, recorded: Scene, common: CommonKeyframes, rules: UnchangedRules) -> Iterator[RefusalReason]:
    """Whether the ego is where it was recorded, at keyframes and between them."""
    mine, theirs = entry.keyframes[common.here], recorded.keyframes[common.there]
    moved = np.abs(entry.ego.position[mine] - recorded.ego.position[theirs]).max(axis=1)
    turned = np.abs(entry.ego.rotation[mine] - recorded.ego.rotation[theirs]).max(axis=1)
    wrong = (moved > rules.position_m) | (turned > rules.rotation)
    if wrong.any():
        at = int(np.argmax(wrong))
        yield RefusalReason(
            rule="unchanged.position_m" if moved[at] > rules.position_m else "unchanged.rotation",
            sentence=f"moves the ego at {pluralise(int(wrong.sum()), 'keyframe')}, first at keyframe "
            f"{common.here[at]}, by up to {_metres(float(moved.max()))}",
        )
    elif np.array_equal(entry.timestamps_us, recorded.timestamps_us):
        off = np.abs(entry.ego.position - recorded.ego.position).max(axis=1)
        straight = np.abs(entry.ego.position - _interpolate_ego(entry)).max(axis=1)
        between = np.minimum(off, straight) > max(rules.position_m, _BETWEEN_M)
        if between.any():
            at = int(np.argmax(between))
            yield RefusalReason(
                rule="unchanged.position_m",
                sentence=f"moves the ego between keyframes, first at {entry.seconds[at]:.2f} s, by "
                f"{_metres(float(off[at]))}",
            )


def _interpolate_ego(scene: Scene) -> Floats:
    """(T, 3) the ego if it went straight from keyframe to keyframe."""
    at = scene.seconds[scene.keyframes]
    return np.column_stack([np.interp(scene.seconds, at, axis) for axis in scene.ego.position[scene.keyframes].T])


def check_sensors(
    entry: Scene,
    recorded: Scene,
    common: CommonKeyframes,
    views: tuple[Mapping[str, Sequence[CameraView]], Mapping[str, Sequence[CameraView]]],
    rules: UnchangedRules,
    *,
    required: bool,
) -> Iterator[RefusalReason]:
    """Check that lidar and cameras are mounted, calibrated, timed and posed as recorded; one reason a camera at most.

    ``views`` are of the entry and of the recording, by camera, one a keyframe; all must be there only if ``required``.
    """
    if _largest_difference(entry.lidar.translation, recorded.lidar.translation) > rules.position_m or (
        _largest_difference(entry.lidar.rotation, recorded.lidar.rotation) > rules.rotation
    ):
        yield RefusalReason(rule="unchanged.position_m", sentence="moves LIDAR_TOP, the origin of plans")
    mine, theirs = views
    if required and (missing := sorted(set(theirs) - set(mine))):
        yield RefusalReason(rule="images.required", sentence=f"has no {', '.join(missing)}")
    if further := sorted(set(mine) - set(theirs)) if theirs else []:
        yield RefusalReason(rule="images.required", sentence=f"has {', '.join(further)}, which the recording lacks")
    for name in (camera for camera in mine if camera in theirs):
        if len(mine[name]) != len(entry.keyframes) or len(theirs[name]) != len(recorded.keyframes):
            if required:
                yield RefusalReason(rule="images.required", sentence=f"lacks {name} at some keyframes")
            continue
        for here, there in zip(common.here.tolist(), common.there.tolist(), strict=True):
            fault = _find_view_fault(mine[name][here], theirs[name][there], recorded, there, rules)
            if fault:
                yield RefusalReason(
                    rule="unchanged.position_m", sentence=f"{fault} of {name}, first at keyframe {here}"
                )
                break


def _find_view_fault(mine: CameraView, theirs: CameraView, recorded: Scene, there: int, rules: UnchangedRules) -> str:
    """Fault of a camera at one keyframe; empty if there is none."""
    scaled = theirs.camera.resized(mine.camera.width, mine.camera.height)
    if _calibration_differs(mine.camera, scaled, rules):
        return "alters the calibration"
    frame = int(recorded.keyframes[there])
    if mine.timestamp_us not in (theirs.timestamp_us, int(recorded.timestamps_us[frame])):
        return "alters the time"
    # A picture has the ego pose of its exposure, or of the keyframe if it was rendered.
    poses = (theirs.global_T_ego, _pose(recorded, frame))
    most = max(rules.position_m, 1e-9)
    return "" if any(_largest_difference(mine.global_T_ego, pose) <= most for pose in poses) else "alters the ego pose"


def _calibration_differs(mine: Camera, theirs: Camera, rules: UnchangedRules) -> bool:
    return (
        _largest_difference(mine.translation, theirs.translation) > rules.position_m
        or _largest_difference(mine.rotation, theirs.rotation) > rules.rotation
        or bool((np.abs(mine.intrinsic - theirs.intrinsic) > _INTRINSIC * np.abs(theirs.intrinsic)).any())
    )


def _pose(scene: Scene, frame: int) -> Floats:
    return transform_matrix(scene.ego.rotation[frame], scene.ego.position[frame])


def check_map(entry: RoadMap, recorded: RoadMap, rules: UnchangedRules) -> Iterator[RefusalReason]:
    """Whether the map around the ego is that of the recording: its surfaces and lanes."""
    wrong = []
    if entry.location != recorded.location:
        wrong.append(f"location ({entry.location}, not {recorded.location})")
    if _area(entry.drivable_area, recorded.drivable_area) > rules.map_m2:
        wrong.append("drivable area")
    for layer in _LAYERS:
        mine, theirs = getattr(entry, layer), getattr(recorded, layer)
        if set(mine) != set(theirs) or any(_area(mine[name], theirs[name]) > rules.map_m2 for name in mine):
            wrong.append(layer.replace("_", " "))
    if set(entry.lanes) != set(recorded.lanes) or any(
        not np.array_equal(lane.centerline, recorded.lanes[name].centerline)
        or lane.successors != recorded.lanes[name].successors
        for name, lane in entry.lanes.items()
    ):
        wrong.append("lanes")
    if len(entry.dividers) != len(recorded.dividers) or any(
        not np.array_equal(mine.line, theirs.line)
        for mine, theirs in zip(entry.dividers, recorded.dividers, strict=True)
    ):
        wrong.append("dividers")
    if entry.intersections != recorded.intersections:
        wrong.append("junctions")
    if wrong:
        yield RefusalReason(rule="unchanged.map_m2", sentence=f"alters the map around the ego: {', '.join(wrong)}")


def _area(first: shapely.Geometry, second: shapely.Geometry) -> float:
    if first.equals_exact(second, 0.0):
        return 0.0
    return float(shapely.make_valid(first).symmetric_difference(shapely.make_valid(second)).area)


def check_planner_inputs(
    entry: Sequence[Observation], recorded: Sequence[Observation], common: CommonKeyframes, rules: UnchangedRules
) -> Iterator[RefusalReason]:
    """Check that planners receive the same ego inputs: motion from the CAN bus, past poses, command."""
    for here, there in zip(common.here.tolist(), common.there.tolist(), strict=True):
        mine, theirs = entry[here], recorded[there]
        wrong = _find_motion_differences(mine, theirs, rules)
        if mine.command != theirs.command:
            wrong.append("command")
        if wrong:
            yield RefusalReason(
                rule="unchanged.motion",
                sentence=f"alters the ego's {', '.join(wrong)} given to planners, first at keyframe {here} (CAN bus)",
            )
            return


def _find_motion_differences(mine: Observation, theirs: Observation, rules: UnchangedRules) -> list[str]:
    if mine.ego.source == theirs.ego.source:
        names = [
            field.name for field in fields(mine.ego) if field.name not in ("pose", "position", "rotation", "source")
        ]
        pairs = {name: (getattr(mine.ego, name), getattr(theirs.ego, name), rules.motion) for name in names}
    else:
        pairs = {
            "velocity": (mine.ego.velocity, theirs.ego.velocity, _DERIVED_M_S),
            "yaw_rate": (mine.ego.yaw_rate, theirs.ego.yaw_rate, _DERIVED_RAD_S),
        }
    return [
        name.replace("_", " ") for name, (first, other, most) in pairs.items() if not _is_within(first, other, most)
    ]


def _is_within(first: Any, second: Any, most: float) -> bool:
    if first is None or second is None:
        return first is second
    return _largest_difference(first, second) <= most


def _largest_difference(first: ArrayLike, second: ArrayLike) -> float:
    """Largest difference of two arrays of the same shape."""
    return float(np.abs(np.asarray(first, np.float64) - np.asarray(second, np.float64)).max(initial=0.0))


def _metres(distance: float) -> str:
    return f"{distance:.3g} m"
