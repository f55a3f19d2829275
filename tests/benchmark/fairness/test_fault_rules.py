"""Fault attribution: each rule once on a plain road, what decides it, and values exactly at a threshold."""

import numpy as np
import pytest
from shapely.geometry import box

from benchmark.fairness.fault_definition import ContactTracks, RoadUser
from benchmark.fairness.fault_rules import RULES, attribute_fault
from benchmark.road_map import Handedness
from tests.benchmark.fairness.made_roads import (
    BARRIER,
    CAR,
    EAST,
    FAST,
    PERSON,
    WEST,
    attribute,
    drifting,
    said,
    straight,
    straight_road,
    t_junction,
    times,
)

ROAD = straight_road()
AHEAD = straight(CAR, (4.0, EAST), 0.0, 5.0)
"""In its lane; whoever ends at 0, 0 with the same yaw touches its rear."""


def behind(speed_m_s: float = 10.0) -> RoadUser:
    return straight(CAR, (0.2, EAST), 0.0, speed_m_s)


def test_the_table_has_its_rules_in_order() -> None:
    names = [rule.__name__ for rule in RULES]
    assert names.index("judge_rear_end") < names.index("judge_no_map") < names.index("judge_left_home")
    assert names[0] == "judge_object" and names[-1] == "find_no_rule"


def test_objects_and_who_stands() -> None:
    barrier, standing = straight(BARRIER, (2.9, EAST), 0.0, 0.0), straight(CAR, (4.0, EAST), 0.0, 0.0)
    assert said(behind(), barrier, ROAD) == "ego object"
    assert said(straight(CAR, (0.2, EAST), 0.0, 0.0), barrier, ROAD) == "unclear standing"
    assert said(barrier, straight(BARRIER, (3.0, EAST), 0.0, 0.0), ROAD) == "unclear standing"
    assert said(behind(), standing, ROAD) == "ego standing"
    assert said(straight(CAR, (0.2, EAST), 0.0, 0.0), standing, ROAD) == "unclear standing"


@pytest.mark.parametrize(("speed", "stands"), [(0.29, True), (0.3, False)])
def test_standing_begins_below_its_threshold(speed: float, stands: bool) -> None:
    slow = straight(CAR, (4.0, EAST), 0.0, speed)
    assert (said(behind(), slow, ROAD) == "ego standing") is stands


def test_who_reverses() -> None:
    backwards = straight(CAR, (3.8, EAST), 0.0, -2.0)
    assert said(behind(3.0), backwards, ROAD) == "other reversing"
    assert said(straight(CAR, (0.2, EAST), np.pi, -2.0), backwards, ROAD) == "shared reversing"


def test_a_rear_end_is_the_follower_s_with_and_without_a_map() -> None:
    assert said(behind(), AHEAD, ROAD) == said(behind(), AHEAD, None) == "ego rear-end"
    crossing = straight(CAR, (0.2, EAST + 1.0), np.pi / 2, 5.0)
    assert said(crossing, AHEAD, None) == "unclear no-map"


@pytest.mark.parametrize(
    ("since_s", "verdict"),
    [(0.6, "other cut-in"), (2.3, "shared cut-in"), (3.8, "ego rear-end"), (5.0, "ego rear-end")],
)
def test_a_cut_in_is_judged_by_the_time_it_leaves(since_s: float, verdict: str) -> None:
    # Closing at 8 m/s: 0.75 s and 8/12 s with hard braking, 0.75 s and 8/6.8 s with fair braking.
    cutting = drifting(straight(CAR, (4.0, EAST), 0.0, 8.0), EAST - FAST, since_s)
    assert said(straight(CAR, (0.2, EAST), 0.0, 16.0), cutting, ROAD) == verdict


def test_a_lane_change_into_a_neighbour_and_a_sideswipe() -> None:
    beside = straight(CAR, (0.0, EAST), 0.0, 10.0)
    assert said(beside, drifting(straight(CAR, (0.0, EAST - 1.95), 0.0, 10.0), 1.5, 2.0), ROAD) == "other lane-change"
    left = straight(CAR, (0.0, EAST - 0.8), 0.0, 10.0)
    assert said(left, straight(CAR, (0.0, FAST + 0.75), 0.0, 10.0), ROAD) == "shared sideswipe"


@pytest.mark.parametrize(("over_m", "verdict"), [(0.3, "shared sideswipe"), (0.32, "shared lane-change")])
def test_the_edge_itself_is_inside(over_m: float, verdict: str) -> None:
    # Side by side all the time, so that there is no entry to be judged: only whether the other is out of its lane.
    other = straight(CAR, (0.0, -3.5 + over_m - 1.0), 0.0, 10.0)
    ego = straight(CAR, (0.0, -3.5 + over_m + 1.0), 0.0, 10.0)
    assert said(ego, other, ROAD) == verdict


def test_the_wrong_side_and_a_u_turn() -> None:
    keeps = straight(CAR, (0.0, WEST), np.pi, 10.0)
    assert said(drifting(straight(CAR, (-3.9, WEST), 0.0, 10.0), 3.5, 2.0), keeps, ROAD) == "ego wrong-side"
    against = straight(CAR, (-3.9, WEST), 0.0, 10.0)
    assert said(against, keeps, ROAD) == "ego wrong-side"


def test_who_leaves_the_road_and_who_pulls_out() -> None:
    verge = RoadUser(*CAR, np.column_stack([np.linspace(-50, 0, 51), np.linspace(FAST, -7.4, 51), np.full(51, -0.1)]),
                     np.full(51, 10.0))  # fmt: skip
    beyond = straight(CAR, (0.0, -9.3), 0.0, 9.0)
    assert said(verge, beyond, ROAD) == "ego off-road"
    parked = straight_road(carparks=[box(-20, -20, 20, -7)])
    leaving = straight(CAR, (0.0, -6.0), np.pi / 2, 3.0)
    assert said(straight(CAR, (-2.9, FAST), 0.0, 10.0), leaving, parked) == "other pull-out"


@pytest.mark.parametrize(
    ("place", "speed", "verdict"),
    [
        ("crossing", 10.0, "ego crossing-person"),
        ("walkway", 10.0, "ego walkway-person"),
        ("road", 10.0, "other road-person"),
    ],
)
def test_persons_by_where_they_are(place: str, speed: float, verdict: str) -> None:
    layers = {
        "crossing": {"crossings": [box(-2, -7, 6, 7)]},
        "walkway": {"walkways": [box(-200, -12, 200, 0)]},
        "road": {},
    }[place]
    person = straight(PERSON, (2.2, EAST + 0.8), -np.pi / 2, 1.5 if place != "road" else 4.0)
    assert said(straight(CAR, (0.0, EAST), 0.0, speed), person, straight_road(**layers)) == verdict


def test_two_persons_have_no_rule_and_without_a_map_little_is_known() -> None:
    person = straight(PERSON, (2.2, EAST), -np.pi / 2, 4.0)
    assert said(person, straight(PERSON, (2.3, EAST), 0.0, 1.0), ROAD) == "unclear no-rule"
    assert said(straight(CAR, (0.0, EAST), 0.0, 10.0), person, None) == "unclear no-map"


def crossing(**signs: str | None) -> str:
    ego = straight(CAR, (-2.6, EAST), 0.0, 8.0)
    other = straight(CAR, (0.4, EAST - 1.2), 1.9, 6.0)
    path = np.array([[1.75, -40.0, np.pi / 2], [1.75, -10.0, np.pi / 2], [0.6, -2.4, 1.9]])
    station = np.array([0.0, 30.0, 37.7])
    way = np.linspace(37.7 - 30.0, 37.7, 51)
    pose = np.column_stack([np.interp(way, station, column) for column in path.T])
    return said(ego, RoadUser(*CAR, pose, other.speed), t_junction(**signs))


def test_priority_in_a_junction() -> None:
    assert crossing() == "other crossing-priority"
    assert crossing(sign="STOP_SIGN") == crossing(sign="YIELD") == "other crossing-priority"
    assert crossing(sign="TURN_STOP") == "other crossing-priority"
    assert crossing(light="TRAFFIC_LIGHT") == "unclear crossing"
    assert crossing(sign="STOP_SIGN", light="YIELD") == "unclear crossing"
    assert crossing(light="STOP_SIGN") == "ego crossing-priority"


def test_the_first_overlap_of_the_last_run_counts_and_what_follows_is_dropped() -> None:
    on = straight(CAR, (2.2, EAST), 0.0, 10.0)
    longer = [RoadUser(*CAR, np.concatenate([user.pose, user.pose[-1:]]), np.append(user.speed, user.speed[-1]))
              for user in (on, AHEAD)]  # fmt: skip
    tracks = ContactTracks(times(52), *longer)
    assert len(tracks.to_first_touch().times_s) < 52
    assert attribute_fault(tracks, ROAD, Handedness.RIGHT).verdict == "ego"


def test_one_sample_is_enough_to_be_asked() -> None:
    one, two = straight(CAR, (0.2, EAST), 0.0, 10.0, 1), straight(CAR, (4.0, EAST), 0.0, 5.0, 1)
    assert said(one, two, ROAD) == "ego rear-end"


def test_facts_say_when_each_came_in_and_how_much_time_was_left() -> None:
    cutting = drifting(straight(CAR, (4.0, EAST), 0.0, 8.0), EAST - FAST, 1.0)
    facts = attribute(straight(CAR, (0.2, EAST), 0.0, 16.0), cutting, ROAD)
    assert facts.other.entry_s == pytest.approx(0.6, abs=0.2) and facts.other.time_was == "short"
    assert facts.other.home == "lane" and facts.other.left_home and not facts.ego.left_home
    assert facts.point == pytest.approx([2.0, EAST], abs=0.3)


@pytest.mark.parametrize("wrong", ["nan", "length", "order", "empty", "size"])
def test_tracks_that_are_none_are_refused(wrong: str) -> None:
    pose, speed, when, what = AHEAD.pose.copy(), AHEAD.speed, times(), CAR
    if wrong == "nan":
        pose[3, 0] = np.nan
    elif wrong == "length":
        speed = speed[1:]
    elif wrong == "order":
        when = when[::-1]
    elif wrong == "size":
        what = ("vehicle.car", 0.0, 2.0)
    elif wrong == "empty":
        pose, speed, when = pose[:0], speed[:0], when[:0]
    with pytest.raises(ValueError, match=r"must|give"):
        ContactTracks(when, RoadUser(*what, pose, speed), AHEAD)
