"""An ego that goes where a planner drove it, and the way back to what the town's driver would have done.

From each key frame the way back is that of `generation.sources.town.off_path`: offsets aside and along the path that
fade as quintics, at the heading of the motion. Along the path the first of these counts that a driver can drive, that
touches none as all move in the scene, and that ends on the road: as the town's driver drives at the same places, which
needs no knowledge of when that was, with room to a vehicle ahead; back to where that driver is at the same time, sooner
and sooner; and to a stop, harder and harder.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME, PLAN_STEPS
from benchmark.dynamics.bicycle import DriverLimits, find_broken_limit
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_local, wrap_angle
from benchmark.planning import Command
from benchmark.records.drive_schema import EpisodeRow
from generation.sources.rig import build_default_lidar
from generation.sources.town.curves import interpolate_grid
from generation.sources.town.off_path import PlannedEgo, compute_curvature, compute_offset_poses, evaluate_quintic
from generation.sources.town.paths import EGO_BODY, STATION_M, compute_body_boxes
from generation.sources.town.speed import FRAMES
from generation.sources.town.world import ParticipantTrack, TownWorld

_KEYFRAME_US: Final = round(1e6 * FRAMES_PER_KEYFRAME / FRAME_HZ)
LEAST_KEYFRAMES: Final = 4
"""A drive that was over sooner shows nothing."""
_SAME_PLACE_M: Final = 0.01
_SEARCH_M: Final = 40.0
_FURTHEST_ASIDE_M: Final = 3.0
_FURTHEST_TURNED_RAD: Final = 0.6
_FURTHEST_ALONG_M: Final = 20.0
_SOONEST_BACK_S: Final = 2.5
_HASTE_MPS: Final = 2.0
_PEAK: Final = 1.875
"""Steepest slope of a quintic from one value to another, of the mean one."""
_BACK_ASIDE_S: Final = 3.0
_LEAST_ASIDE_M: Final = 12.0
_QUICKER: Final = (1.0, 0.6, 0.4)
_SAME_STATION_M: Final = 0.5
_SOONEST_SPEED_S: Final = 2.0
_GENTLY_MPS2: Final = 1.5
_ROOM_M: Final = 1.5
_ROOM_S: Final = 0.6
_BRAKING_MPS2: Final = (1.5, 3.0, 4.5)
_HORIZON: Final = PLAN_STEPS * FRAMES_PER_KEYFRAME
_FORESEEN: Final = 5 * FRAME_HZ + 1
_ROAD_FROM: Final = _HORIZON * 2 // 3
_GAP_M: Final = 0.1


@dataclass(frozen=True, slots=True)
class PlannerDrive:
    """Drive of a planner: (K, 3) rear-axle poses and (K,) speeds, m/s, at the key frames until it was over."""

    planner: str
    poses: Floats
    speeds: Floats
    commands: tuple[Command, ...]

    @classmethod
    def of_row(cls, planner: str, row: EpisodeRow) -> "PlannerDrive":
        """A drive of a record; it must have been planned at the town's key frames."""
        ticks = row.ticks
        at_keyframes = np.diff(ticks.time_us[: len(ticks.command)]) == _KEYFRAME_US
        if not at_keyframes.all():
            raise InputError(f"the drive of {row.scene} was not planned every half second; repeat it with this version")
        states = np.array(ticks.ego[: len(ticks.command)]).reshape(-1, 7)
        return cls(planner, states[:, :3], states[:, 3], tuple(map(Command, ticks.command)))

    def __len__(self) -> int:
        return len(self.poses)

    def rear(self) -> Floats:
        """(FRAMES, 3) rear-axle poses at 12 Hz: cubic between key frames, held after the last."""
        yaw = np.unwrap(self.poses[:, 2])
        knots = np.column_stack([self.poses[:, :2], yaw])
        seconds = FRAMES_PER_KEYFRAME / FRAME_HZ
        rates = np.gradient(yaw, seconds) if len(yaw) > 1 else np.zeros(1)
        slopes = np.column_stack([self.speeds * np.cos(yaw), self.speeds * np.sin(yaw), rates]) * seconds
        where = np.minimum(np.arange(FRAMES) / FRAMES_PER_KEYFRAME, len(knots) - 1)
        base = np.minimum(where.astype(np.int64), max(len(knots) - 2, 0))
        after = np.minimum(base + 1, len(knots) - 1)
        u = (where - base)[:, None]
        return np.asarray(
            (1 + 2 * u) * (1 - u) ** 2 * knots[base]
            + u * (1 - u) ** 2 * slopes[base]
            + u**2 * (3 - 2 * u) * knots[after]
            + u**2 * (u - 1) * slopes[after]
        )


def plan_ways_back(world: TownWorld, planned: PlannedEgo, driven: PlannerDrive) -> Floats:
    """Way of a good driver from each key frame; ``planned`` is the ego as the town's driver would drive.

    (K, 6, 2) global positions of the lidar origin at the plan's steps; NaN where no way was found, and beyond the end
    of the scene.
    """
    begin = interpolate_grid(planned.path.rear, planned.stations[:1])[0]
    if np.hypot(*(begin - driven.poses[0])[:2]) > _SAME_PLACE_M:
        raise InputError(
            "the drives belong to another town: their ego starts elsewhere; give the seed (and --crossing) of the town "
            "that was driven in"
        )
    ways = np.full((len(driven), PLAN_STEPS, 2), np.nan)
    ahead_m = float(build_default_lidar().translation[0])
    for keyframe in range(len(driven)):
        first = keyframe * FRAMES_PER_KEYFRAME
        rear = _plan_way_back(world, planned, driven.poses[keyframe], float(driven.speeds[keyframe]), first)
        if rear is not None:
            steps = rear[FRAMES_PER_KEYFRAME::FRAMES_PER_KEYFRAME][:PLAN_STEPS]
            lidar = steps[:, :2] + ahead_m * np.column_stack([np.cos(steps[:, 2]), np.sin(steps[:, 2])])
            ways[keyframe, : len(lidar)] = lidar
    return ways


@dataclass(frozen=True, slots=True)
class _PathDeviation:
    """Place of the ego seen from the planned drive: along the path, to the left of it, heading and speed against it."""

    metres: float
    aside_m: float
    turned_rad: float
    speed_mps: float


def _plan_way_back(world: TownWorld, planned: PlannedEgo, pose: Floats, speed: float, first: int) -> Floats | None:
    """(N, 3) rear-axle poses at 12 Hz from a frame on, as far as the scene goes, 3 s at most."""
    metres = planned.stations * STATION_M
    count = min(FRAMES - first, _FORESEEN)
    if count <= FRAMES_PER_KEYFRAME:
        return None
    away = _compute_deviation(planned, pose, speed, float(metres[first]))
    if away is None:
        return None
    others = TownWorld(world.town, tracks=[_cut_track(track, first, count) for track in world.tracks])
    going_on = _approach_town_speed(metres, first, count, away)
    # With room ahead: a driver who would only just avoid contact has to do something else.
    roomy = others.is_free(
        _compute_boxes(planned, going_on + _ROOM_M + _ROOM_S * np.gradient(going_on) * FRAME_HZ, away)
    )
    count = min(count, _HORIZON + 1)
    others = TownWorld(world.town, tracks=[_cut_track(track, first, count) for track in world.tracks])
    ways = _approach_schedule(metres[first : first + count], away)
    for way in (going_on[:count], *ways) if roomy else ways:
        rear = _compute_rear(planned, way, away)
        boxes = compute_body_boxes(rear, EGO_BODY)
        free = others.is_free(boxes, gap_m=_GAP_M) and others.is_on_road(boxes[_ROAD_FROM:])
        if free and find_broken_limit(boxes, DriverLimits()) is None:
            return rear
    return None


def _compute_deviation(planned: PlannedEgo, pose: Floats, speed: float, expected_m: float) -> _PathDeviation | None:
    """``None`` where it has gone astray."""
    first = max(int((expected_m - _SEARCH_M) / STATION_M), 0)
    near = planned.path.rear[first : first + int(2 * _SEARCH_M / STATION_M) + 1]
    station = first + int(np.argmin(np.hypot(near[:, 0] - pose[0], near[:, 1] - pose[1])))
    # The foot of the perpendicular, from the nearest station: once more for bends.
    station_on_path = float(station)
    for _ in range(2):
        path_pose = interpolate_grid(planned.path.rear, np.array([station_on_path]))[0]
        along, aside = to_local(pose[:2], path_pose)
        station_on_path += float(along) / STATION_M
    path_pose = interpolate_grid(planned.path.rear, np.array([station_on_path]))[0]
    _, aside = to_local(pose[:2], path_pose)
    turned = float(wrap_angle(np.array(pose[2] - path_pose[2])))
    curvature = float(compute_curvature(planned.path, np.array([station_on_path]))[0])
    astray = abs(float(aside)) > _FURTHEST_ASIDE_M or abs(turned) > _FURTHEST_TURNED_RAD
    if astray or abs(station_on_path * STATION_M - expected_m) > _FURTHEST_ALONG_M:
        return None
    along_mps = speed * np.cos(turned) / max(1 - curvature * float(aside), 0.5)
    return _PathDeviation(station_on_path * STATION_M, float(aside), turned, float(along_mps))


def _approach_town_speed(planned: Floats, first: int, count: int, away: _PathDeviation) -> Floats:
    """(N,) metres along the path at 12 Hz, soon at the town driver's speeds at the same places."""
    seconds = np.arange(FRAMES) / FRAME_HZ
    # Position of that driver, from the moment nearest to now.
    near = np.flatnonzero(np.abs(planned - away.metres) <= _SAME_STATION_M)
    if len(near):
        begin = float(np.clip(seconds[first], seconds[near[0]], seconds[near[-1]]))
    else:
        begin = float(np.interp(away.metres, planned, seconds))
    last_mps = float(planned[-1] - planned[-2]) * FRAME_HZ
    later = begin + np.arange(count + 1) / FRAME_HZ
    scheduled_m = np.interp(later, seconds, planned) + last_mps * np.maximum(later - seconds[-1], 0.0)
    faster = away.speed_mps - float(scheduled_m[1] - scheduled_m[0]) * FRAME_HZ
    fading_s = max(_SOONEST_SPEED_S, abs(faster) / _GENTLY_MPS2)
    more = evaluate_quintic(later - begin, 0.0, fading_s, (0.0, faster), (0.5 * faster * fading_s, 0.0))[0]
    return np.maximum.accumulate(away.metres + (scheduled_m - scheduled_m[0] + more)[:count])


def _approach_schedule(schedule: Floats, away: _PathDeviation) -> Iterator[Floats]:
    """(N,) metres along the path at 12 Hz: back to the schedule, sooner and sooner, and then to a stop."""
    seconds = np.arange(len(schedule)) / FRAME_HZ
    ahead = away.metres - float(schedule[0])
    planned_mps = float(schedule[1] - schedule[0]) * FRAME_HZ
    back_s = max(_SOONEST_BACK_S, _PEAK * abs(ahead) / _HASTE_MPS)
    for quicker in _QUICKER:
        fading = evaluate_quintic(seconds, 0.0, quicker * back_s, (ahead, away.speed_mps - planned_mps), (0.0, 0.0))[0]
        # A driver does not reverse to get back to schedule.
        yield np.maximum.accumulate(schedule + fading)
    for braking in _BRAKING_MPS2:
        until = np.minimum(seconds, away.speed_mps / braking)
        yield away.metres + away.speed_mps * until - 0.5 * braking * until**2


def _compute_rear(planned: PlannedEgo, metres: Floats, away: _PathDeviation) -> Floats:
    """(N, 3) rear-axle poses, soon back on the path."""
    return compute_offset_poses(planned.path, metres, *_fade_offset(metres, away))


def _compute_boxes(planned: PlannedEgo, metres: Floats, away: _PathDeviation) -> Floats:
    return compute_body_boxes(_compute_rear(planned, metres, away), EGO_BODY)


def _fade_offset(metres: Floats, away: _PathDeviation) -> tuple[Floats, Floats]:
    """(N,) metres to the left of the path and their slope, from where the ego is."""
    reach = max(_LEAST_ASIDE_M, _BACK_ASIDE_S * away.speed_mps)
    slope = float(np.tan(away.turned_rad))
    aside, rising = evaluate_quintic(metres, away.metres, away.metres + reach, (away.aside_m, slope), (0.0, 0.0))
    standing = metres <= away.metres
    return np.where(standing, away.aside_m, aside), np.where(standing, slope, rising)


def _cut_track(track: ParticipantTrack, first: int, count: int) -> ParticipantTrack:
    boxes = track.boxes if len(track.boxes) == 1 else track.boxes[first : first + count]
    return ParticipantTrack(track.category, track.height, boxes, track.parked)


def select_lasting_drives(rows: Sequence[EpisodeRow]) -> dict[str, EpisodeRow]:
    """Drives by scene: those that went on for a while and did not fail."""
    scenes = [row.scene for row in rows]
    twice = next((name for name in scenes if scenes.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{twice} was driven more than once; give a record with one run of each scene")
    return {row.scene: row for row in rows if row.status == "ok" and len(row.ticks.command) >= LEAST_KEYFRAMES}
