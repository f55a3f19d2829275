from dataclasses import replace

import numpy as np

from benchmark.constants import FRAME_HZ
from generation.search.candidates import (
    MARGIN_M,
    ExclusionReason,
    compute_reach_at,
    draw_candidates,
    find_exclusion_reason,
    find_last_opportunity,
    find_launch_in_reach,
)
from generation.search.hyperparameters import HyperParameters, LaunchRule
from generation.search.recorded_ego_path import RecordedEgoPath
from generation.search.recorded_motion import is_in_canvas
from tests.hand_made import Car, scene_on_straight_road

HYPER = HyperParameters(launch=LaunchRule.REACH)
EGO_M, LANE_M, NEXT_LANE_M, OPPOSITE_M = 50.0, 198.25, 194.75, 201.75


def test_who_is_in_the_way_already_takes_over_after_its_history() -> None:
    scene = scene_on_straight_road((Car(EGO_M + 20.0, LANE_M, 8.0),), seconds=10.0)
    assert find_launch_in_reach(scene, 0, HYPER) == HYPER.history_frames
    # It has 15.7 m of room: 10 m takes it 5.7 m of falling behind, at 3.5 m/s^2 in 1.8 s.
    assert compute_reach_at(scene, 0, HYPER.history_frames, HYPER) == 2.0
    assert find_exclusion_reason(scene, 0, HYPER) is None


def test_the_farther_behind_the_later_it_is_there() -> None:
    seconds = []
    for back in (5.0, 15.0, 25.0):
        scene = scene_on_straight_road((Car(EGO_M - back, NEXT_LANE_M, 8.0),), seconds=12.0)
        seconds.append(compute_reach_at(scene, 0, 12, HYPER))
    assert seconds == sorted(seconds) and len(set(seconds)) == 3
    # From 5 m behind to 3 m ahead of the ego's front are 5 + (4.084 + 4.6)/2 + 3 m, at 2 m/s^2 in 3.51 s.
    assert seconds[0] == 4.0


def test_who_is_slower_by_far_never_gets_there() -> None:
    scene = scene_on_straight_road((Car(EGO_M - 30.0, NEXT_LANE_M, 2.0),), ego_speed=15.0, seconds=10.0)
    assert find_launch_in_reach(scene, 0, HYPER) is None
    assert find_exclusion_reason(scene, 0, HYPER) is ExclusionReason.OUT_OF_REACH
    assert np.isinf(compute_reach_at(scene, 0, 12, HYPER))


def test_an_oncoming_car_that_cannot_turn_round_is_not_tried() -> None:
    """Neither when the ego drives out of its sight, nor where only a head-on crash would bring it in the way."""
    for distance_m, seconds in ((60.0, 20.0), (100.0, 9.0), (200.0, 14.0)):
        scene = scene_on_straight_road((Car(EGO_M + distance_m, OPPOSITE_M, 8.0, np.pi),), seconds=seconds)
        assert find_launch_in_reach(scene, 0, HYPER) is None
        assert find_exclusion_reason(scene, 0, HYPER) is ExclusionReason.OUT_OF_REACH


def test_a_car_from_the_side_that_cannot_follow_stays_in_the_area() -> None:
    stands = Car(EGO_M + 35.0, 204.0, 3.0, -np.pi / 2)
    scene = scene_on_straight_road((stands,), ego_speed=4.0, seconds=9.0)
    start = find_launch_in_reach(scene, 0, HYPER)
    assert start is not None
    spot = np.repeat(scene.agents.position[0, start : start + 1, :2], len(scene.timestamps_us) - start, axis=0)
    assert is_in_canvas(scene, spot, HYPER.half_extent_m - MARGIN_M, first=start).all()


def test_off_the_road_there_is_no_way() -> None:
    scene = scene_on_straight_road((Car(EGO_M + 15.0, 215.0, 8.0),), seconds=10.0)
    assert find_launch_in_reach(scene, 0, HYPER) is None


def test_no_frame_before_the_history_and_none_too_late() -> None:
    for seconds in (5.5, 6.5, 8.0):
        scene = scene_on_straight_road((Car(EGO_M + 20.0, LANE_M, 8.0),), seconds=seconds)
        start = find_launch_in_reach(scene, 0, HYPER)
        frames = len(scene.timestamps_us)
        expected = HYPER.history_frames if HYPER.history_frames < frames - HYPER.shortest_drive_frames else None
        assert start == expected


def test_the_draw_prefers_who_is_there_soon() -> None:
    near, far = Car(EGO_M + 12.0, LANE_M, 8.0), Car(EGO_M - 25.0, NEXT_LANE_M, 9.0)
    scene = scene_on_straight_road((near, far), seconds=14.0)
    one = HyperParameters(launch=LaunchRule.REACH, candidate_limit=1)
    drawn = [draw_candidates(scene, [0, 1], one, seed)[0] for seed in range(60)]
    assert drawn.count(0) > 40 and drawn.count(1) > 0


def test_nobody_is_tried_whom_an_ego_that_does_not_react_cannot_hit() -> None:
    """An ego that drives on evenly is where the recording is; one that brakes is overrun, but only then."""
    asking = HyperParameters(launch=LaunchRule.REACH, least_overrun_m=0.3)
    car = Car(EGO_M + 20.0, LANE_M, 8.0)
    even = scene_on_straight_road((car,), seconds=10.0)
    assert find_exclusion_reason(even, 0, HYPER) is None
    assert find_exclusion_reason(even, 0, asking) is ExclusionReason.OUT_OF_REACH
    time = np.arange(120) / FRAME_HZ
    speed = np.clip(8.0 - 3.0 * (time - 3.0), 4.0, 8.0)
    position = np.column_stack([EGO_M + np.cumsum(speed) / FRAME_HZ, np.full(120, LANE_M), np.zeros(120)])
    braking = replace(even, ego=replace(even.ego, position=position))
    assert find_exclusion_reason(braking, 0, asking) is None
    # It loses 4 m/s from 3 s to 4.33 s; what was decided 3 s before is forgotten at 7.33 s, and a second counts around.
    last = find_last_opportunity(RecordedEgoPath.of(braking), asking)
    assert 7.0 * FRAME_HZ <= last <= 8.4 * FRAME_HZ
    assert find_last_opportunity(RecordedEgoPath.of(even), asking) == -1
    assert find_last_opportunity(RecordedEgoPath.of(even), HYPER) == 119
