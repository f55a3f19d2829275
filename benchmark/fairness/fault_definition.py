"""Thresholds, verdicts and reasons of ``fault@1`` (docs/fault.md), and the tracks that it takes."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

import numpy as np

from benchmark.geometry import Floats, boxes_overlap, wrap_angle
from benchmark.records.fault import FaultReason as FaultReason
from benchmark.records.fault import FaultVerdict as FaultVerdict

STILL_M_S: Final = 0.3
"""Below it a box stands: annotation at 2 Hz jitters by a few centimetres."""
SETTLED_S: Final = 3.0
"""After it a place is one's own."""
WINDOW_S: Final = 5.0
"""How far back an entry is looked for."""
REVERSING_S: Final = 1.0
REACTION_S: Final = 0.75
HARD_M_S2: Final = 6.0
FAIR_M_S2: Final = 3.4
EDGE_M: Final = 0.3
"""An intrusion begins this far beyond the line."""
SAME_RAD: Final = np.deg2rad(45.0)
ONCOMING_RAD: Final = np.deg2rad(135.0)
TURN_RAD: Final = np.deg2rad(30.0)
ARM_M: Final = 15.0
STOP_REACH_M: Final = 10.0
RING_M: Final = 200.0
RING_SPREAD: Final = (0.7, 1.3)
MAP_REACH_M: Final = 5.0
LANES_M: Final = 100.0
"""Lanes farther away are not looked at."""
SLACK: Final = 1e-9
"""Of every comparison, towards the side that an exact tie falls to."""


class UserKind(StrEnum):
    """Kinds of road user that rules tell apart."""

    VEHICLE = "vehicle"
    PERSON = "person"
    OBJECT = "object"

    @classmethod
    def of(cls, category: str) -> Self:
        """The kind of a nuScenes category."""
        if category.startswith("human.") or category == "animal":
            return cls("person")
        return cls("object" if category.startswith(("movable_object.", "static_object.")) else "vehicle")


@dataclass(frozen=True, slots=True)
class RoadUser:
    """One user up to the contact: (N, 3) x, y of its box centre and yaw of its body; (N,) speed along it, m/s.

    Attributes:
        category: nuScenes category.
        length_m: Of the box.
        width_m: Of the box.
        pose: Global frame, metres and radians.
        speed: Negative backwards.
    """

    category: str
    length_m: float
    width_m: float
    pose: Floats
    speed: Floats

    @classmethod
    def resampled(
        cls,
        category: str,
        size_m: tuple[float, float],
        times_s: Floats,
        pose: Floats,
        grid_s: Floats,
        speed: Floats | None = None,
    ) -> Self:
        """A user from (M,) times on a grid of (N,): positions linear, yaw by the shorter way.

        Without speeds they are central differences of the positions on the grid, along the yaw.
        """
        columns = np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])])
        placed = np.column_stack([np.interp(grid_s, times_s, column) for column in columns.T])
        if speed is not None:
            along = np.interp(grid_s, times_s, speed)
        elif len(grid_s) > 1:
            velocity = np.gradient(placed[:, :2], grid_s, axis=0)
            along = velocity[:, 0] * np.cos(placed[:, 2]) + velocity[:, 1] * np.sin(placed[:, 2])
        else:
            along = np.zeros(1)
        return cls(category, *size_m, placed, np.asarray(along))

    def boxes(self, wider_m: float = 0.0) -> Floats:
        """(N, 5) boxes, wider by so much on both sides."""
        return self.box_at(self.pose, wider_m)

    def box_at(self, pose: Floats, wider_m: float = 0.0) -> Floats:
        """(..., 5) boxes at (..., 3) poses."""
        size = np.broadcast_to([self.length_m, self.width_m + 2 * wider_m], (*pose.shape[:-1], 2))
        return np.concatenate([pose[..., :2], size, pose[..., 2:]], axis=-1)


@dataclass(frozen=True, slots=True)
class ContactTracks:
    """Tracks of ego and other on one grid of (N,) seconds, 0.1 s apart, that ends at the contact.

    Raises:
        ValueError: If times do not increase, lengths differ, or a value is not finite or a size not positive.
    """

    times_s: Floats
    ego: RoadUser
    other: RoadUser

    def __post_init__(self) -> None:
        count = len(self.times_s)
        if not count or not np.isfinite(self.times_s).all() or (np.diff(self.times_s) <= 0.0).any():
            raise ValueError("times of a contact must be finite and increase; give one sample or more")
        for name, user in (("ego", self.ego), ("other", self.other)):
            if user.pose.shape != (count, 3) or user.speed.shape != (count,):
                raise ValueError(f"the {name} must have a pose (x, y, yaw) and a speed at each of {count} times")
            sizes = np.array([user.length_m, user.width_m])
            if not all(np.isfinite(values).all() for values in (user.pose, user.speed, sizes)) or (sizes <= 0).any():
                raise ValueError(f"poses, speeds and sizes of the {name} must be finite, and sizes positive")

    def to_first_touch(self) -> "ContactTracks":
        """The same up to the first sample of the unbroken overlap at the end; all of it where there is none."""
        touching = boxes_overlap(self.ego.boxes(), self.other.boxes())
        apart = np.flatnonzero(~touching)
        last = int(apart[-1]) + 1 if len(apart) else 0
        return self if last >= len(touching) - 1 else self._first(last + 1)

    def _first(self, count: int) -> "ContactTracks":
        users = (
            RoadUser(user.category, user.length_m, user.width_m, user.pose[:count], user.speed[:count])
            for user in (self.ego, self.other)
        )
        return ContactTracks(self.times_s[:count], *users)


@dataclass(frozen=True, slots=True)
class UserFacts:
    """What a verdict used of one user, and of the map only that; seconds count back from the contact.

    Attributes:
        entry_s: How long before the contact it came into the other's way; ``None`` if it always was there.
        time_left_s: Time that the other had then; infinite if it always was there.
        time_was: ``fair``, ``hard`` (only hard braking would have done) or ``short``.
        home: ``lane``, ``against`` (oncoming) or ``off`` (beside all lanes); ``None`` where no rule asked.
        left_home: Whether the contact is outside of it.
        junction_lane: The lane that it took through the junction, with its ``turn_rad``, left positive.
        sign: ``give``, ``light`` or ``None``.
        ends_here: Whether its road ends at the junction (the stem of a T).
    """

    entry_s: float | None
    time_left_s: float
    time_was: str
    home: str | None = None
    left_home: bool | None = None
    junction_lane: str | None = None
    turn_rad: float | None = None
    sign: str | None = None
    ends_here: bool = False


@dataclass(frozen=True, slots=True)
class FaultAttribution:
    """Verdict on a contact, the reason, the place of the contact (2,) in metres, and the facts of both."""

    verdict: FaultVerdict
    reason: FaultReason
    point: Floats
    ego: UserFacts
    other: UserFacts


def angle_between(first: Floats | float, second: Floats | float) -> Floats:
    """Angles of directions, 0 to pi."""
    return np.abs(wrap_angle(np.asarray(first) - np.asarray(second)))
