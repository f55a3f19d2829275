"""A contact without its road: where it is, who strikes whom, and how much time one had when the other came in.

Two users by index; nothing here knows which of them is the ego.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from benchmark.fairness.fault_definition import (
    EDGE_M,
    FAIR_M_S2,
    HARD_M_S2,
    ONCOMING_RAD,
    REACTION_S,
    REVERSING_S,
    SAME_RAD,
    SETTLED_S,
    SLACK,
    STILL_M_S,
    WINDOW_S,
    ContactTracks,
    UserKind,
    angle_between,
)
from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap, poses_between, to_local

_HALVINGS: Final = 12
_AT_ONCE: Final = 6
_SAMPLES_AT_ONCE: Final = 12


@dataclass(frozen=True, slots=True)
class TimeLeft:
    """Time that one had when another came into its way: the sample of entry, seconds, closing speed then, m/s."""

    entry: int
    seconds: float
    closing_m_s: float

    def is_enough(self, braking_m_s2: float) -> bool:
        """Whether reaction and such braking would have done; who is slower than the other needs no braking."""
        return self.seconds >= REACTION_S + max(self.closing_m_s, 0.0) / (2 * braking_m_s2) - SLACK

    @property
    def is_fair(self) -> bool:
        """Whether nobody had to brake abruptly."""
        return self.is_enough(FAIR_M_S2)

    @property
    def is_hard(self) -> bool:
        """Whether hard braking would have done."""
        return self.is_enough(HARD_M_S2)


class ContactGeometry:
    """The contact of two users, from their tracks to it; ``users`` are in the order that they were given."""

    def __init__(self, tracks: ContactTracks) -> None:
        self.times = tracks.times_s
        self.users = (tracks.ego, tracks.other)
        self.kinds = tuple(UserKind.of(user.category) for user in self.users)
        self.boxes = tuple(user.boxes() for user in self.users)
        self.settled = self.first_since(SETTLED_S)
        self.window = self.first_since(WINDOW_S)
        self.poses, self.point = self._find_contact()
        angle = float(angle_between(self.poses[0][2], self.poses[1][2]))
        self.same, self.oncoming = angle <= SAME_RAD + SLACK, angle >= ONCOMING_RAD - SLACK
        self._left: dict[int, TimeLeft] = {}

    def first_since(self, before_s: float) -> int:
        """First sample at or after so many seconds before the contact."""
        return int(np.searchsorted(self.times, self.times[-1] - before_s - SLACK))

    def _find_contact(self) -> tuple[tuple[Floats, Floats], Floats]:
        """Poses at the first overlap between the last two samples, and the contact point."""
        poses = tuple(user.pose[-1] for user in self.users)
        if len(self.times) > 1:
            share = np.array(self._halve_to_touch())
            poses = tuple(poses_between(user.pose[-2], user.pose[-1], share) for user in self.users)
        shapes = [
            shapely.polygons(box_corners(user.box_at(pose))) for user, pose in zip(self.users, poses, strict=True)
        ]
        shared = shapely.intersection(*shapes)
        if shapely.is_empty(shared):
            shared = shapely.shortest_line(*shapes)
        return poses, shapely.get_coordinates(shapely.centroid(shared))[0]

    def _halve_to_touch(self) -> float:
        """Share of the last step at which boxes touch: twelve halvings, six at a time from all that they may ask."""
        low, size = 0.0, 1.0
        parts = 2**_AT_ONCE
        for _ in range(_HALVINGS // _AT_ONCE):
            shares = low + size * np.arange(1, parts) / parts
            one, other = (user.box_at(poses_between(user.pose[-2], user.pose[-1], shares)) for user in self.users)
            touching = boxes_overlap(one, other)
            below, above = 0, parts
            while above - below > 1:
                middle = (below + above) // 2
                below, above = (below, middle) if touching[middle - 1] else (middle, above)
            low, size = low + size * below / parts, size / parts
        return low + size

    def contact_ahead(self, user: int) -> float:
        """Forward coordinate of the contact point in a user's frame, metres from its centre."""
        return float(to_local(self.point, self.poses[user])[0])

    def strikes_with_front(self, user: int) -> bool:
        """Whether a user touches with the front of its box."""
        return self.contact_ahead(user) >= self.users[user].length_m / 2 - EDGE_M - SLACK

    def is_behind(self, user: int) -> bool:
        """Whether a user runs with its front into the rear quarter of the other, in the same direction."""
        other = 1 - user
        in_rear = self.contact_ahead(other) <= -self.users[other].length_m / 4 + SLACK
        return self.same and in_rear and self.strikes_with_front(user)

    def stands(self, user: int) -> bool:
        """Whether a user stood all the time since it could settle."""
        return bool((np.abs(self.users[user].speed[self.settled :]) < STILL_M_S).all())

    def was_still(self, user: int) -> bool:
        """Whether a user stood at some time since."""
        return bool((np.abs(self.users[user].speed[self.settled :]) < STILL_M_S).any())

    def reverses(self, user: int) -> bool:
        """Whether a user drove backwards in the last second."""
        return float(self.users[user].speed[self.first_since(REVERSING_S) :].mean()) < -STILL_M_S

    def driven_m(self, user: int, since: int) -> float:
        """Way of a user from a sample to the contact."""
        return float(np.hypot(*np.diff(self.users[user].pose[since:, :2], axis=0).T).sum())

    def time_left(self, user: int) -> TimeLeft:
        """Time that the other had when a user came into its way: T(user -> other)."""
        if user not in self._left:
            self._left[user] = self._measure_time_left(user)
        return self._left[user]

    def _measure_time_left(self, user: int) -> TimeLeft:
        """See `time_left`; docs/fault.md, "Words"."""
        came, other = self.users[user], self.users[1 - user]
        entry = self._find_entry(user)
        along = np.maximum(0.0, came.speed * np.cos(came.pose[:, 2] - other.pose[:, 2]))
        recent = self.times[-1] - self.times[entry] < SETTLED_S - SLACK
        closing = float(other.speed[entry] - (along[entry:].min() if recent else along[entry]))
        if entry == self.window:
            return TimeLeft(entry, np.inf, closing)
        rate = (other.speed - along)[entry:]
        gap = float((0.5 * (rate[1:] + rate[:-1]) * np.diff(self.times[entry:])).sum())
        ahead_m = to_local(box_corners(self.boxes[user][entry]), other.pose[entry])[:, 0].min()
        vehicles = self.kinds == (UserKind.VEHICLE, UserKind.VEHICLE)
        if gap <= 0.0 or ahead_m < other.length_m / 2 - SLACK:
            return TimeLeft(entry, 0.0, closing)
        if vehicles and not self.strikes_with_front(1 - user):
            return TimeLeft(entry, 0.0, closing)
        return TimeLeft(entry, np.inf if closing <= STILL_M_S + SLACK else gap / closing, closing)

    def _find_entry(self, user: int) -> int:
        """Earliest sample of the window from which on a user is in the corridor of the other, without a break."""
        boxes, wide = self.boxes[user][self.window :], self.users[1 - user].boxes(EDGE_M)[self.window :]
        corners = box_corners(wide)
        # Few came in long ago: the last samples are looked at first.
        for end in range(len(boxes), 0, -_SAMPLES_AT_ONCE):
            begin = max(0, end - _SAMPLES_AT_ONCE)
            later = np.arange(begin, len(boxes)) >= np.arange(begin, end)[:, None]
            meets = (boxes_overlap(boxes[begin:end, None], wide[None, begin:]) & later).any(axis=1)
            for sample in range(min(end, len(boxes) - 1) - 1, begin - 1, -1):
                if not meets[sample - begin] and not _meets_between(boxes[sample], corners[sample:]):
                    return self.window + sample + 1
        return self.window


def _meets_between(box: Floats, corners: Floats) -> bool:
    """Whether a box meets what another sweeps from sample to sample, (K, 4, 2) corners."""
    pieces = np.concatenate([corners[:-1], corners[1:]], axis=1)
    center, reach = box[:2], 0.5 * np.hypot(box[2], box[3])
    near = ((pieces.min(axis=1) <= center + reach) & (pieces.max(axis=1) >= center - reach)).all(axis=1)
    hulls = shapely.convex_hull(shapely.multipoints(pieces[near]))
    return bool(shapely.intersects(shapely.polygons(box_corners(box)), hulls).any())


def first_unbroken(inside: Bools) -> int | None:
    """First index of the unbroken run of ``True`` at the end; ``None`` if the last one is not."""
    if not inside[-1]:
        return None
    outside = np.flatnonzero(~inside)
    return int(outside[-1]) + 1 if len(outside) else 0
