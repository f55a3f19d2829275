"""What a traffic session tells at its start, checked: the tracks of all, and of the ego only what is past.

``docs/extensions/alpasim.md``. All values are as they were sent, in single precision; poses are of box centres in the
session's local frame.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.constants import CATEGORIES
from benchmark.datasets.scenarionet_tracks import name_vehicle
from benchmark.extensions.alpasim.poses import SECOND_US, Poses, decode_trajectory
from benchmark.extensions.alpasim.sessions import CallRefusedError
from benchmark.geometry import Floats, yaw_of_quaternion
from benchmark.untrusted.files import to_one_line

EGO: Final = "EGO"
MOST_OBJECTS: Final = 1000
MOST_OBJECT_SECONDS: Final = 30_000
LONGEST_S: Final = 600.0
_SIZES_M: Final = (0.05, 60.0)
_FARTHEST_M: Final = 1e6
_LONGEST_NAME: Final = 200
_CATEGORY_OF_CLASS: Final[Mapping[str, str]] = {
    "automobile": "vehicle.car",
    "heavy_truck": "vehicle.truck",
    "bus": "vehicle.bus.rigid",
    "trailer": "vehicle.trailer",
    "motorcycle": "vehicle.motorcycle",
    "cyclist": "vehicle.bicycle",
    "rider": "vehicle.bicycle",
    "person": "human.pedestrian.adult",
    "stroller": "human.pedestrian.stroller",
    "animal": "animal",
}
_VEHICLE_M: Final = (2.5, 1.2)
"""Length and width from which something without a class is a vehicle with four wheels."""
_CYCLE_M: Final = 1.2


@dataclass(frozen=True, slots=True)
class LoggedTrack:
    """One road user: its box (3,), length, width and height in metres, and P poses of the box centre."""

    uuid: str
    category: str
    size: Floats
    poses: Poses

    def covers(self, time_us: int) -> bool:
        """Whether its log has a time."""
        times = self.poses.times_us
        return bool(times[0] <= time_us <= times[-1])

    def at(self, time_us: int) -> tuple[Floats, Floats]:
        """Position and quaternion at a time, the nearest end outside the log; as sent where there is a pose."""
        times, position, rotation = self.poses.times_us, self.poses.position, self.poses.rotation
        place = int(np.searchsorted(times, time_us))
        if place == len(times) or times[place] == time_us or not place:
            place = min(place, len(times) - 1)
            return position[place], rotation[place]
        share = (time_us - times[place - 1]) / (times[place] - times[place - 1])
        first, second = rotation[place - 1], rotation[place]
        second = second if first @ second >= 0.0 else -second
        turned = first + share * (second - first)
        between = position[place - 1] + share * (position[place] - position[place - 1])
        return between, turned / np.linalg.norm(turned)

    def resample(self, times_us: Any) -> tuple[Floats, Floats]:
        """(T, 3) positions and (T,) headings at (T,) times; outside the log its nearest end."""
        seconds, wanted = ((times - self.poses.times_us[0]) / SECOND_US for times in (self.poses.times_us, times_us))
        columns = (*self.poses.position.T, np.unwrap(yaw_of_quaternion(self.poses.rotation)))
        *position, yaw = (np.interp(wanted, seconds, column) for column in columns)
        return np.stack(position, axis=-1), yaw


@dataclass(frozen=True, slots=True)
class SessionLog:
    """A session's start. ``ego`` has the poses up to the hand-over alone: what comes later is never looked at."""

    scene_id: str
    seed: int
    handover_us: int
    ego: LoggedTrack
    others: tuple[LoggedTrack, ...]

    @property
    def first_us(self) -> int:
        """When the ego's log begins, or that of any other that begins earlier."""
        return min(int(track.poses.times_us[0]) for track in (self.ego, *self.others))

    @property
    def last_us(self) -> int:
        """When the last log of the others ends; the hand-over where there is nobody."""
        return max([self.handover_us, *(int(track.poses.times_us[-1]) for track in self.others)])


def read_session(request: Any) -> SessionLog:
    """A ``TrafficSessionRequest``, checked; raises `CallRefusedError` with a sentence for what makes no sense."""
    tracks = request.logged_object_trajectories
    if len(tracks) > MOST_OBJECTS + 1:
        raise _refuse(f"there are {len(tracks)} objects, more than {MOST_OBJECTS}")
    handover_us = min(request.handover_time_us, 1 << 62)
    names = [track.object_id for track in tracks]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise _refuse(f"object {_show(twice[0])} is there more than once")
    if EGO not in names:
        raise _refuse(f"there is no track of {EGO}")
    others = tuple(_read_track(track) for track in tracks if track.object_id != EGO)
    log = SessionLog(
        to_one_line(request.scene_id, _LONGEST_NAME),
        request.random_seed,
        handover_us,
        _read_ego(tracks[names.index(EGO)], handover_us),
        others,
    )
    span_s = (log.last_us - log.first_us) / SECOND_US
    if span_s > LONGEST_S or span_s * len(others) > MOST_OBJECT_SECONDS:
        raise _refuse(
            f"{len(others)} objects over {span_s:.0f} s are too many; send at most {LONGEST_S:.0f} s, and "
            f"{MOST_OBJECT_SECONDS} s of all objects together"
        )
    return log


def _read_ego(track: Any, handover_us: int) -> LoggedTrack:
    poses = decode_trajectory(track.trajectory)
    order = np.argsort(poses.times_us, kind="stable")
    order = order[poses.times_us[order] <= handover_us]
    past = Poses(poses.times_us[order], poses.position[order], poses.rotation[order])
    if not len(past):
        raise _refuse(f"{EGO} has no pose up to the hand-over at {handover_us} us")
    return _check_track(track, past)


def _read_track(track: Any) -> LoggedTrack:
    return _check_track(track, decode_trajectory(track.trajectory))


def _check_track(track: Any, poses: Poses) -> LoggedTrack:
    name = track.object_id
    if not 0 < len(name) <= _LONGEST_NAME:
        raise _refuse(f"an object_id has {len(name)} characters; 1 to {_LONGEST_NAME} are right")
    size = np.array([track.aabb.size_x, track.aabb.size_y, track.aabb.size_z])
    if not (np.isfinite(size).all() and _SIZES_M[0] <= size.min() and size.max() <= _SIZES_M[1]):
        raise _refuse(f"object {_show(name)} has the size {size.tolist()}; {_SIZES_M[0]} to {_SIZES_M[1]:g} m is right")
    require_poses(poses, f"object {_show(name)}")
    return LoggedTrack(name, find_category(track.label_class, size), size, poses)


def require_poses(poses: Poses, what: str) -> None:
    """Refuse no poses, times that do not rise, NaN, places beyond any road, rotations that are none."""
    if not len(poses):
        raise _refuse(f"{what} has no poses")
    if not (np.diff(poses.times_us) > 0).all():
        raise _refuse(f"the times of {what} do not rise")
    if not (np.isfinite(poses.position).all() and np.abs(poses.position).max() <= _FARTHEST_M):
        raise _refuse(f"{what} has a position that is NaN, or farther away than {_FARTHEST_M:g} m")
    if not poses.are_unit:
        raise _refuse(f"{what} has a rotation that is not a unit quaternion")


def find_category(label: str, size: Sequence[float] | Floats) -> str:
    """NuScenes' category of a class of AlpaSim's, or of a body where the class is unknown."""
    if label in CATEGORIES:
        return label
    if label in _CATEGORY_OF_CLASS:
        return _CATEGORY_OF_CLASS[label]
    length, width = float(size[0]), float(size[1])
    if length >= _VEHICLE_M[0] and width >= _VEHICLE_M[1]:
        return name_vehicle(length)
    return "vehicle.bicycle" if length >= _CYCLE_M else "human.pedestrian.adult"


def _refuse(sentence: str) -> CallRefusedError:
    return CallRefusedError("INVALID_ARGUMENT", sentence)


def _show(name: str) -> str:
    return to_one_line(name, 60) or "without a name"
