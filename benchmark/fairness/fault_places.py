"""The place of a user on the road: its home, whether the contact is outside of it, its lane through a junction."""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Final

import numpy as np
import shapely
from shapely.geometry import MultiPolygon

from benchmark.fairness.fault_definition import (
    EDGE_M,
    MAP_REACH_M,
    ONCOMING_RAD,
    SAME_RAD,
    SLACK,
    TURN_RAD,
    FaultReason,
    RoadUser,
    UserFacts,
    UserKind,
    angle_between,
)
from benchmark.fairness.fault_roads import FaultRoads, LanePlaces
from benchmark.fairness.fault_timing import ContactGeometry, TimeLeft, first_unbroken
from benchmark.geometry import Bools, Floats, box_corners, to_local
from benchmark.road_map import Handedness

_ANGLE_M: Final = 2.0
"""Metres of offset that a radian counts as where lanes compete for a user."""


class HomeKind(StrEnum):
    """What a user was on when it could settle: a lane of its direction, one of the other, or none."""

    LANE = "lane"
    AGAINST = "against"
    OFF = "off"


@dataclass(frozen=True, slots=True)
class Home:
    """Kind of home, the sample that says so, and the lanes of the region of ``lane``."""

    kind: HomeKind
    sample: int
    region: tuple[int, ...] = ()


class ContactSite:
    """The roads around a contact point."""

    def __init__(self, roads: FaultRoads, handedness: Handedness, point: Floats) -> None:
        self.roads, self.handedness, self._point = roads, handedness, point[None]

    @cached_property
    def _places(self) -> LanePlaces:
        return self.roads.locate(self._point, self.roads.near(self._point, MAP_REACH_M))

    @cached_property
    def outside_m(self) -> dict[int, float]:
        """How far it is outside the strips of lanes in reach, by lane."""
        return dict(zip(self._places.lanes.tolist(), self._places.outside[0].tolist(), strict=True))

    @property
    def is_off_map(self) -> bool:
        """Whether no lane is in reach."""
        return bool(min(self.outside_m.values(), default=np.inf) > MAP_REACH_M + SLACK)

    def is_near(self, lane: int) -> bool:
        """Whether the contact is in a lane's strip or at its edge."""
        return bool(self.outside_m.get(lane, np.inf) <= EDGE_M + SLACK)

    @cached_property
    def is_near_ring(self) -> bool:
        """Whether it is in a lane of a roundabout."""
        near = np.array([lane for lane in self.outside_m if self.is_near(lane)], np.int64)
        return bool(self.roads.are_rings(near, self.handedness).any())

    def has_lane_along(self, yaw_rad: float) -> bool:
        """Whether it is in the strip of a lane of such a direction."""
        along = angle_between(self._places.heading[0], yaw_rad) <= SAME_RAD + SLACK
        return bool((along & (self._places.outside[0] <= SLACK)).any())


class Party:
    """One of two users of a contact, with all that rules ask about it; each answer is worked out once."""

    def __init__(self, contact: ContactGeometry, number: int, site: ContactSite) -> None:
        self.contact, self.number, self.site = contact, number, site
        self.roads, self.handedness = site.roads, site.handedness
        self.user: RoadUser = contact.users[number]
        self.kind: UserKind = contact.kinds[number]
        self.pose, self.speed = self.user.pose, self.user.speed
        self.yaw_at_contact = float(contact.poses[number][2])

    @property
    def stands(self) -> bool:
        """Whether it stood since it could settle."""
        return self.contact.stands(self.number)

    @property
    def was_still(self) -> bool:
        """Whether it stood at some time since."""
        return self.contact.was_still(self.number)

    @property
    def reverses(self) -> bool:
        """Whether it drove backwards."""
        return self.contact.reverses(self.number)

    @property
    def is_behind(self) -> bool:
        """Whether it runs into the rear of the other."""
        return self.contact.is_behind(self.number)

    @property
    def time_left(self) -> TimeLeft:
        """Time that the other had when this one came into its way."""
        return self.contact.time_left(self.number)

    @property
    def is_vehicle(self) -> bool:
        """Whether it is neither a person nor an object."""
        return self.kind is UserKind.VEHICLE

    def is_on(self, surface: MultiPolygon | None, sample: int) -> bool:
        """Whether its centre is on a surface at a sample; on none that is not given."""
        return surface is not None and bool(shapely.intersects_xy(surface, *self.pose[sample, :2]))

    def is_off_given(self, surface: MultiPolygon | None, sample: int) -> bool:
        """Whether its centre is off a surface that is given."""
        return surface is not None and not self.is_on(surface, sample)

    @cached_property
    def home(self) -> Home:
        """Where it belongs; see docs/fault.md, "Words"."""
        contact = self.contact
        for sample in range(contact.settled, contact.window - 1, -1):
            point = self.pose[sample : sample + 1, :2]
            places = self.roads.locate(point, self.roads.near(point, 0.0))
            inside = np.flatnonzero(places.in_strip[0])
            angle = angle_between(places.heading[0, inside], self.pose[sample, 2])
            with_it, against = angle <= SAME_RAD + SLACK, angle >= ONCOMING_RAD - SLACK
            if with_it.any():
                cost = np.abs(places.offset[0, inside]) + _ANGLE_M * angle
                best = inside[int(np.where(with_it, cost, np.inf).argmin())]
                reach = contact.driven_m(self.number, sample) + self.user.length_m
                region = self.roads.reach_ahead(int(places.lanes[best]), float(places.station[0, best]), reach)
                return Home(HomeKind.LANE, sample, tuple(region))
            if against.any():
                return Home(HomeKind.AGAINST, sample)
            if not len(inside):
                return Home(HomeKind.OFF, sample)
        return Home(HomeKind.OFF, contact.settled)

    @cached_property
    def left_home(self) -> bool:
        """Whether the contact is outside of its home."""
        return bool(self._is_outside_home(self.contact.point[None])[0])

    def _is_outside_home(self, points: Floats) -> Bools:
        """(Q,) which points are more than the edge outside of its home."""
        if self.home.kind is HomeKind.AGAINST:
            return np.ones(len(points), np.bool_)
        if self.home.kind is HomeKind.LANE:
            return np.asarray(self.roads.locate(points, self.home.region).outside.min(axis=1) > EDGE_M + SLACK)
        places = self.roads.locate(points, self.roads.near(points, 0.0))
        return np.asarray(places.outside.min(axis=1, initial=np.inf) < -EDGE_M - SLACK)

    @cached_property
    def left_home_at(self) -> float:
        """Sample from which on a corner of it was outside of its home; minus infinite where it never had one."""
        if self.home.kind is HomeKind.AGAINST:
            return -np.inf
        corners = box_corners(self.user.boxes()[self.contact.window :])
        outside = self._is_outside_home(corners.reshape(-1, 2)).reshape(-1, 4).any(axis=1)
        first = first_unbroken(outside)
        return float(self.contact.times[-1 if first is None else self.contact.window + first])

    def _beside_region(self, point: Floats) -> tuple[float, float]:
        """Offset from the nearest centre line of its region, metres to the left, and the direction there."""
        places = self.roads.locate(point[None], self.home.region)
        nearest = int((places.distance[0] <= places.distance.min() + SLACK).argmax())
        return float(places.offset[0, nearest]), float(places.heading[0, nearest])

    @cached_property
    def shift_m(self) -> float:
        """How far it moved across its lane since it could settle."""
        before, after = (self._beside_region(self.pose[sample, :2])[0] for sample in (self.contact.settled, -1))
        return abs(after - before)

    @cached_property
    def slant_rad(self) -> float:
        """Angle of its body at the contact to its home."""
        if self.home.kind is HomeKind.LANE:
            home = self._beside_region(self.contact.poses[self.number][:2])[1]
        else:
            home = float(self.pose[self.contact.settled, 2])
        return float(angle_between(self.yaw_at_contact, home))

    @cached_property
    def junction_lane(self) -> int | None:
        """The lane that it takes through a junction, J; see docs/fault.md, "Words"."""
        pose, ahead = self.pose[self.contact.settled :][::-1], self.user.length_m / 2
        front = pose[0] + ahead * np.array([np.cos(pose[0, 2]), np.sin(pose[0, 2]), 0.0])
        lane = self._choose_junction_lane(np.stack([pose[0], front]))
        return self._choose_junction_lane(pose[1:]) if lane is None else lane

    def _choose_junction_lane(self, poses: Floats) -> int | None:
        """The junction lane of its direction at the first of (Q, 3) poses that has one."""
        lanes = self.roads.near(poses[:, :2], 0.0)
        lanes = lanes[self.roads.is_junction[lanes]]
        places = self.roads.locate(poses[:, :2], lanes)
        angle = angle_between(places.heading, poses[:, 2:])
        fits = places.in_strip & (angle <= SAME_RAD + SLACK)
        rows = np.flatnonzero(fits.any(axis=1))
        if not len(rows):
            return None
        row = rows[0]
        cost = np.abs(places.offset[row]) + _ANGLE_M * angle[row] + EDGE_M * self.roads.turns[lanes]
        cost = np.where(fits[row], cost, np.inf)
        equal = np.flatnonzero(cost <= cost.min() + SLACK)
        return int(lanes[equal[np.abs(self.roads.turn[lanes[equal]]).argmin()]])

    @property
    def turn_rad(self) -> float:
        """Turn of its junction lane, left positive; without one it goes straight."""
        return 0.0 if self.junction_lane is None else float(self.roads.turn[self.junction_lane])

    @property
    def turns(self) -> bool:
        """Whether its junction lane turns."""
        return self.junction_lane is not None and bool(self.roads.turns[self.junction_lane])

    @property
    def turns_far(self) -> bool:
        """Whether it turns across oncoming traffic."""
        return self.turns and self.turn_rad * self.handedness.far_turn > 0.0

    @property
    def approach_rad(self) -> float:
        """Direction from which it came to the junction."""
        if self.junction_lane is None:
            return float(self.pose[self.contact.settled, 2])
        return float(self.roads.begin_heading[self.junction_lane])

    @cached_property
    def is_from_stem(self) -> bool:
        """Whether its road ends at the junction."""
        return self.junction_lane is not None and self.roads.is_stem(self.junction_lane)

    @cached_property
    def sign(self) -> str | None:
        """``give``, ``light`` or ``None``."""
        return None if self.junction_lane is None else self.roads.find_sign(self.junction_lane)

    @cached_property
    def ring_arrival_s(self) -> float:
        """Time since which it is on a roundabout: infinite if it is not, minus infinite if it always was."""
        points = self.pose[self.contact.window :, :2]
        lanes = self.roads.near(points, 0.0)
        lanes = lanes[self.roads.are_rings(lanes, self.handedness)]
        first = first_unbroken(self.roads.locate(points, lanes).in_strip.any(axis=1))
        if first is None:
            return np.inf
        return -np.inf if first == 0 else float(self.contact.times[self.contact.window + first])

    def started_behind(self, other: "Party") -> bool:
        """Whether it was wholly behind the other when it could settle."""
        sample = self.contact.settled
        ahead = float(to_local(self.pose[sample, :2], other.pose[sample])[0])
        return ahead + (self.user.length_m + other.user.length_m) / 2 <= SLACK

    @cached_property
    def was_at_the_side(self) -> bool:
        """Whether it came from a car park, from off the road, or had stood."""
        parked = self.is_on(self.roads.carparks, self.contact.settled)
        return parked or self.is_off_given(self.roads.drivable_area, self.contact.settled) or self.was_still

    def out_reason(self) -> FaultReason:
        """What it did by leaving its home; the first that fits."""
        if self.home.kind is HomeKind.OFF and self.was_at_the_side:
            return FaultReason.PULL_OUT
        if self.slant_rad >= ONCOMING_RAD - SLACK:
            return FaultReason.U_TURN
        if self.slant_rad >= TURN_RAD - SLACK and not self.contact.same:
            return FaultReason.TURN_ACROSS
        if self.contact.same:
            return FaultReason.CUT_IN if self._other_is_behind else FaultReason.LANE_CHANGE
        return FaultReason.WRONG_SIDE

    @property
    def _other_is_behind(self) -> bool:
        return self.contact.is_behind(1 - self.number)

    def facts(self) -> UserFacts:
        """What rules have asked about it."""
        left, times, asked = self.time_left, self.contact.times, self.__dict__
        always = left.entry == self.contact.window
        lane = self.junction_lane if "junction_lane" in asked else None
        return UserFacts(
            entry_s=None if always else float(times[-1] - times[left.entry]),
            time_left_s=left.seconds,
            time_was="fair" if left.is_fair else "hard" if left.is_hard else "short",
            home=str(self.home.kind) if "home" in asked else None,
            left_home=self.left_home if "left_home" in asked else None,
            junction_lane=None if lane is None else self.roads.lanes[lane].identifier,
            turn_rad=None if lane is None else self.turn_rad,
            sign=asked.get("sign"),
            ends_here=asked.get("is_from_stem", False),
        )
