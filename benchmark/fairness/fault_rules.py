"""The rules of ``fault@1`` in their order (docs/fault.md): one function each, the first that applies decides.

A rule is asked about an ordered pair: is the first user, ``u``, to blame beside ``w``, or how else does it end? It is
asked both ways round, so that it cannot know an ego; where it blames both, they share.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.fairness.fault_definition import (
    EDGE_M,
    HARD_M_S2,
    LANES_M,
    ONCOMING_RAD,
    REACTION_S,
    SAME_RAD,
    SLACK,
    STILL_M_S,
    ContactTracks,
    FaultAttribution,
    FaultReason,
    FaultVerdict,
    UserKind,
    angle_between,
)
from benchmark.fairness.fault_places import ContactSite, HomeKind, Party
from benchmark.fairness.fault_roads import FaultRoads
from benchmark.fairness.fault_timing import ContactGeometry, first_unbroken
from benchmark.road_map import Handedness

_NO_ROADS: Final = FaultRoads([])


@dataclass(frozen=True, slots=True)
class Ruling:
    """Which of the two users are to blame, by number: one, both or, where it is unclear, none; and why."""

    blamed: frozenset[int]
    reason: FaultReason

    @property
    def verdict(self) -> FaultVerdict:
        """Of a contact in which the ego is the first user."""
        if len(self.blamed) == 1:
            return (FaultVerdict.EGO, FaultVerdict.OTHER)[min(self.blamed)]
        return FaultVerdict.SHARED if self.blamed else FaultVerdict.UNCLEAR


def attribute_fault(tracks: ContactTracks, roads: FaultRoads | None, handedness: Handedness) -> FaultAttribution:
    """Whose fault a contact is, by ``fault@1``.

    Args:
        tracks: Both users on a 0.1 s grid that ends at the contact or shortly after; 3 s or more where they exist.
        roads: Of the place, in the frame of the tracks; ``None`` without a map.
        handedness: Side that traffic keeps to.

    Returns:
        Verdict, reason, contact point and facts. The users exchanged give the exchanged verdict.
    """
    ruling, first, second = rule_on_contact(tracks, roads, handedness)
    return FaultAttribution(ruling.verdict, ruling.reason, first.contact.point, first.facts(), second.facts())


def rule_on_contact(
    tracks: ContactTracks, roads: FaultRoads | None, handedness: Handedness
) -> tuple[Ruling, Party, Party]:
    """The first rule that applies, and both users, whose facts can be asked; arguments as of `attribute_fault`."""
    contact = ContactGeometry(tracks.to_first_touch())
    site = ContactSite(roads or _NO_ROADS, handedness, contact.point)
    first, second = (Party(contact, number, site) for number in (0, 1))
    ruling = next(ruling for rule in RULES if (ruling := ask_both_ways(rule, first, second)) is not None)
    return ruling, first, second


def ask_both_ways(rule: "Rule", first: Party, second: Party) -> Ruling | None:
    """What a rule says of two users in either order, together."""
    one, other = rule(first, second), rule(second, first)
    if one is None or other is None or one == other:
        return one or other
    return Ruling(one.blamed | other.blamed, min(one.reason, other.reason, key=[*FaultReason].index))


def blame(user: Party, reason: FaultReason) -> Ruling:
    """N: this user, whatever the time."""
    return Ruling(frozenset({user.number}), reason)


def share(reason: FaultReason) -> Ruling:
    """Both users."""
    return Ruling(frozenset({0, 1}), reason)


def leave_open(reason: FaultReason) -> Ruling:
    """Unclear."""
    return Ruling(frozenset(), reason)


def judge_priority(u: Party, w: Party, reason: FaultReason) -> Ruling:
    """Y: ``u`` had to give way. Priority is given, not taken: who had fair time, or is out of its own place, shares."""
    return share(reason) if u.time_left.is_fair or w.left_home else blame(u, reason)


def judge_change(u: Party, w: Party, reason: FaultReason) -> Ruling:
    """C: ``u`` changed its place in the same direction; who had fair time should have kept a distance."""
    if not u.time_left.is_hard:
        return blame(u, reason)
    if u.time_left.is_fair and w.is_behind:
        return blame(w, FaultReason.REAR_END)
    return share(reason)


def judge_object(u: Party, w: Party) -> Ruling | None:
    """1. Who runs into an object; an object and who stands: unclear."""
    if w.kind is not UserKind.OBJECT:
        return None
    if u.kind is UserKind.OBJECT or u.stands:
        return leave_open(FaultReason.STANDING)
    return blame(u, FaultReason.OBJECT)


def judge_standing(u: Party, w: Party) -> Ruling | None:
    """2. Who runs into somebody that stands."""
    if not w.stands:
        return None
    return leave_open(FaultReason.STANDING) if u.stands else blame(u, FaultReason.STANDING)


def judge_reversing(u: Party, w: Party) -> Ruling | None:
    """3. A vehicle that drives backwards."""
    return blame(u, FaultReason.REVERSING) if u.is_vehicle and u.reverses else None


def judge_person(u: Party, w: Party) -> Ruling | None:
    """4. A person ``u`` and a vehicle ``w``, by the person's place."""
    if u.kind is not UserKind.PERSON:
        return None
    if w.kind is UserKind.PERSON:
        return leave_open(FaultReason.NO_RULE)
    roads = u.roads
    if u.is_on(roads.crossings, -1):
        return _judge_crossing_person(u, w)
    if u.is_on(roads.walkways, -1) or u.is_off_given(roads.drivable_area, -1):
        return blame(w, FaultReason.WALKWAY_PERSON)
    if w.was_still:
        return blame(w, FaultReason.ROAD_PERSON)
    if u.time_left.is_fair:
        return blame(w, FaultReason.ROAD_PERSON)
    if roads.drivable_area is None:
        return leave_open(FaultReason.NO_MAP)
    return share(FaultReason.ROAD_PERSON) if u.time_left.is_hard else blame(u, FaultReason.ROAD_PERSON)


def _judge_crossing_person(u: Party, w: Party) -> Ruling:
    """The vehicle must come ready to stop; the person must not step out too late."""
    window = range(u.contact.window, len(u.pose))
    stepped = first_unbroken(np.array([u.is_on(u.roads.crossings, sample) for sample in window])) or 0
    speed = float(w.speed[window[stepped]])
    if stepped == 0 or speed <= STILL_M_S + SLACK:
        return blame(w, FaultReason.CROSSING_PERSON)
    seconds = u.contact.driven_m(w.number, window[stepped]) / speed
    in_time = seconds >= REACTION_S + speed / (2 * HARD_M_S2) - SLACK
    return blame(w, FaultReason.CROSSING_PERSON) if in_time else share(FaultReason.CROSSING_PERSON)


def judge_off_road(u: Party, w: Party) -> Ruling | None:
    """5. A vehicle that left the drivable area beside a lane; a map that ends is no verge."""
    surface, settled = u.roads.drivable_area, u.contact.settled
    if not u.is_vehicle or not u.is_off_given(surface, -1) or not u.is_on(surface, settled):
        return None
    place = u.pose[-1:, :2]
    places = u.roads.locate(place, u.roads.near(place, LANES_M))
    if not len(places.lanes) or places.beyond[0, int(places.outside[0].argmin())]:
        return None
    return blame(u, FaultReason.OFF_ROAD)


def judge_rear_end(u: Party, w: Party) -> Ruling | None:
    """6. Who runs into somebody ahead and had fair time."""
    return blame(u, FaultReason.REAR_END) if u.is_behind and w.time_left.is_fair else None


def judge_no_map(u: Party, w: Party) -> Ruling | None:
    """7. The map has no lane here."""
    return leave_open(FaultReason.NO_MAP) if u.site.is_off_map else None


def judge_roundabout(u: Party, w: Party) -> Ruling | None:
    """8, ring. Who enters a roundabout later."""
    if not _is_in_junction(u, w) or not u.site.is_near_ring or w.ring_arrival_s == np.inf:
        return None
    if not u.ring_arrival_s - w.ring_arrival_s >= REACTION_S - SLACK:  # two that always were there: not a number
        return None
    return judge_priority(u, w, FaultReason.ROUNDABOUT)


def judge_opposing_turn(u: Party, w: Party) -> Ruling | None:
    """8, opposing. Who turns across oncoming traffic."""
    if not _is_in_junction(u, w) or _approach_angle(u, w) < ONCOMING_RAD - SLACK or not u.turns_far:
        return None
    return leave_open(FaultReason.CROSSING) if w.turns_far else judge_priority(u, w, FaultReason.TURN_ACROSS)


def judge_merge(u: Party, w: Party) -> Ruling | None:
    """8, same approach. Of two lanes that run together, the one that bends towards the other."""
    if not _is_in_junction(u, w) or _approach_angle(u, w) > SAME_RAD + SLACK:
        return None
    own, others, roads = u.junction_lane, w.junction_lane, u.roads
    if own is None or others is None or own == others or u.turns or w.turns:
        return None
    if not set(roads.successors[own]) & set(roads.successors[others]):
        return None
    bends = [roads.bend_m(lane) > roads.width[lane] / 2 + SLACK for lane in (own, others)]
    if bends[0] == bends[1]:
        return share(FaultReason.MERGE)
    return judge_priority(u, w, FaultReason.MERGE) if bends[0] else None


def judge_turn_from_beside(u: Party, w: Party) -> Ruling | None:
    """8, same approach. Who turns across somebody that goes straight on beside it."""
    if not _is_in_junction(u, w) or _approach_angle(u, w) > SAME_RAD + SLACK:
        return None
    beside = u.turns and not w.turns and not w.left_home and not w.is_behind
    return blame(u, FaultReason.TURN_ACROSS) if beside else None


def judge_crossing(u: Party, w: Party) -> Ruling | None:
    """8, crossing. Signs, then the road that ends; lights and right before left cannot be known."""
    angle = _approach_angle(u, w) if _is_in_junction(u, w) else 0.0
    if not SAME_RAD + SLACK < angle < ONCOMING_RAD - SLACK or u.left_home or w.left_home:
        return None
    if "light" in (u.sign, w.sign) or (u.sign and w.sign):
        return leave_open(FaultReason.CROSSING)
    if u.sign or w.sign:
        return judge_priority(u, w, FaultReason.CROSSING_PRIORITY) if u.sign else None
    if (u.is_from_stem and not w.turns) or (w.is_from_stem and not u.turns):
        return judge_priority(u, w, FaultReason.CROSSING_PRIORITY) if u.is_from_stem else None
    return leave_open(FaultReason.CROSSING)


def _is_in_junction(u: Party, w: Party) -> bool:
    """Whether both were in lanes, and the contact is near a lane by which one of them crosses or leaves a junction."""
    if u.home.kind is not HomeKind.LANE or w.home.kind is not HomeKind.LANE:
        return False
    lanes = {user.junction_lane for user in (u, w)} - {None}
    if u.contact.same:
        lanes |= {successor for lane in [*lanes] if lane is not None for successor in u.roads.successors[lane]}
    return any(lane is not None and u.site.is_near(lane) for lane in lanes) or u.site.is_near_ring


def _approach_angle(u: Party, w: Party) -> float:
    return float(angle_between(u.approach_rad, w.approach_rad))


_IN_ORDER: Final = (
    FaultReason.PULL_OUT, FaultReason.U_TURN, FaultReason.TURN_ACROSS, FaultReason.WRONG_SIDE, FaultReason.CUT_IN,
    FaultReason.LANE_CHANGE,
)  # fmt: skip
"""Of two that are both out of their homes, the reason that comes first is named."""


def judge_left_home(u: Party, w: Party) -> Ruling | None:
    """9, one of two. Who is out of its place, by what it did there."""
    if not u.left_home or w.left_home:
        return None
    reason = u.out_reason()
    if u.home.kind is HomeKind.OFF and reason is not FaultReason.PULL_OUT and u.roads.drivable_area is None:
        return leave_open(FaultReason.NO_LANE)
    if reason in (FaultReason.CUT_IN, FaultReason.LANE_CHANGE):
        return judge_change(u, w, reason)
    return blame(u, reason) if reason is FaultReason.WRONG_SIDE else judge_priority(u, w, reason)


def judge_both_left_home(u: Party, w: Party) -> Ruling | None:
    """9, both. Who came later into a place that was taken; else both."""
    if not (u.left_home and w.left_home):
        return None
    if u.contact.same and (_came_later(u, w) or _came_later(w, u)):
        return blame(u, u.out_reason()) if _came_later(u, w) else None
    return share(min(u.out_reason(), w.out_reason(), key=_IN_ORDER.index))


def _came_later(u: Party, w: Party) -> bool:
    later = u.left_home_at > w.left_home_at and u.left_home_at >= w.left_home_at + REACTION_S - SLACK
    return later and u.site.has_lane_along(w.yaw_at_contact)


def judge_same_lane(u: Party, w: Party) -> Ruling | None:
    """10. Two in one lane: who moved over, overtook, or else followed."""
    if not _share_lane(u, w):
        return None
    if w.is_behind and _shifted_more(u, w):
        return judge_priority(u, w, FaultReason.PULL_OUT) if u.was_still else judge_change(u, w, FaultReason.CUT_IN)
    if u.is_behind and not _shifted_more(w, u):
        return blame(u, FaultReason.REAR_END)
    if u.is_behind or w.is_behind:
        return None
    if u.started_behind(w):
        overtaking = FaultReason.OVERTAKING
        return share(overtaking) if _shifted_more(w, u) else blame(u, overtaking)
    if w.started_behind(u):
        return None
    if _shifted_more(u, w) or _shifted_more(w, u):
        return blame(u, FaultReason.LANE_CHANGE) if _shifted_more(u, w) else None
    return share(FaultReason.SIDESWIPE)


def _share_lane(u: Party, w: Party) -> bool:
    """Whether both keep their places in one direction, and the contact is near a lane of both."""
    if u.left_home or w.left_home or not u.contact.same:
        return False
    return any(u.site.is_near(lane) for lane in set(u.home.region) & set(w.home.region))


def _shifted_more(u: Party, w: Party) -> bool:
    return u.shift_m > w.shift_m + EDGE_M + SLACK


def judge_sideswipe(u: Party, w: Party) -> Ruling | None:
    """11. Two that keep their places, side by side or head on."""
    kept = not u.left_home and not w.left_home
    return share(FaultReason.SIDESWIPE) if kept and (u.contact.same or u.contact.oncoming) else None


def find_no_rule(u: Party, w: Party) -> Ruling:
    """12. All else."""
    return leave_open(FaultReason.NO_RULE)


Rule = Callable[[Party, Party], Ruling | None]
RULES: Final[tuple[Rule, ...]] = (
    judge_object,
    judge_standing,
    judge_reversing,
    judge_person,
    judge_off_road,
    judge_rear_end,
    judge_no_map,
    judge_roundabout,
    judge_opposing_turn,
    judge_merge,
    judge_turn_from_beside,
    judge_crossing,
    judge_left_home,
    judge_both_left_home,
    judge_same_lane,
    judge_sideswipe,
    find_no_rule,
)
"""The table: rules in the order in which they are asked."""
