"""Rules of an adversary that knows motion only: the road, and where a careful human copes."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.constants import FRAME_HZ
from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.careful_driver import CarefulDriverCheck
from generation.extensions.reactive_adversary.rules import AdversaryRules, include_ego, rasterise_road
from generation.extensions.reactive_adversary.safe_endings import SurroundingTracks
from generation.extensions.reactive_adversary.settings import EgoPrediction
from tests.generation.extensions.reactive_adversary.loops import knowing, loop, policy_of, road
from tests.hand_made import Car

FRAME = 24
MOTION_ONLY = knowing(EgoPrediction.MOTION_ONLY)


def drive(x: float, y: float, speed: float, yaw: float = 0.0, frames: int = 37) -> Floats:
    """(F, 3) straight on at a steady speed."""
    travel = speed * np.arange(frames) / FRAME_HZ
    return np.column_stack([x + travel * np.cos(yaw), y + travel * np.sin(yaw), np.full(frames, yaw)])


def rules_of(scene: Scene, now: Floats) -> AdversaryRules:
    careful = CarefulDriverCheck.of(scene, 0, FRAME, 8.0)
    return AdversaryRules.of(scene, rasterise_road(scene), [careful], 0, now)


def off_road(scene: Scene, poses: Floats) -> Bools:
    size = np.broadcast_to(scene.agents.size[0, :2], (len(poses), 2))
    corners = box_corners(np.column_stack([poses[:, :2], size, poses[:, 2]]))
    return np.asarray((~scene.road_map.is_drivable(corners)).any(axis=1))


def test_corners_stay_on_the_road_or_return_to_it_within_three_seconds() -> None:
    scene = road()
    along, leaving = drive(90.0, 198.25, 8.0), drive(90.0, 198.25, 8.0, yaw=-0.6)
    assert not off_road(scene, along).any() and off_road(scene, leaving).any()
    columns = np.stack([along, leaving]).transpose(2, 0, 1)
    assert rules_of(scene, along[0]).are_on_road(columns).tolist() == [True, False]
    outside = rules_of(scene, leaving[-1])
    assert outside.are_on_road(columns[:, :, :30]).tolist() == [True, True]
    assert outside.are_on_road(columns).tolist() == [True, False]
    assert outside.are_on_road(columns[:, :, ::-1]).tolist() == [True, True]


def test_who_is_off_the_road_for_less_time_is_better_and_then_who_is_nearer_to_it() -> None:
    scene = road()
    starts = (drive(90.0, 198.25, 8.0), drive(90.0, 198.25, 8.0, yaw=-0.4), drive(90.0, 180.0, 8.0, yaw=0.1))
    motions = np.stack([*starts, drive(90.0, 180.0, 8.0)]).transpose(2, 0, 1)
    measured = rules_of(scene, starts[0][0]).measure_off_road(motions)
    assert measured[0] == 0.0 and (np.diff(measured) > 0.0).all()
    assert np.floor(measured[2]) == np.floor(measured[3]) == 13.0


def test_an_ending_is_found_that_stays_on_the_road() -> None:
    """Going on at its speed leaves the road; of the brakes the first that do not are taken."""
    scene = road(Car(90.0, 198.25, 8.0), seconds=12.0)
    around = SurroundingTracks.of(scene, 0, FRAME, int(scene.timestamps_us[0]))
    leaving = drive(150.0, 198.25, 8.0, yaw=-0.12)
    rules = rules_of(scene, leaving[0])
    usual, kept = around.find_ending(leaving[None], 12), around.find_ending(leaving[None], 12, rules.are_on_road)
    assert usual is not None and kept is not None
    assert off_road(scene, usual[1]).any() and not off_road(scene, kept[1]).any()
    assert around.find_ending(drive(150.0, 198.25, 8.0, yaw=-1.2)[None], 12, rules.are_on_road) is None


def test_who_hits_a_careful_human_is_not_fair_and_whom_others_hit_may_not_be_met() -> None:
    scene = road(Car(90.0, 198.25, 8.0), seconds=9.0)
    front = float(scene.ego.boxes[FRAME, 0]) + 2.0
    shut, ahead, beside = (drive(front + 4.0, 198.25, 0.5), drive(front + 25.0, 198.25, 3.0), drive(front, 201.75, 8.0))
    rules = rules_of(scene, ahead[0])
    motions = np.stack([shut, ahead, beside])
    assert rules.are_fair(motions).tolist() == [False, True, True]
    doomed = replace(rules, careful=(replace(rules.careful[0], lost=True),))
    assert doomed.are_fair(motions).tolist() == [False, False, True]


def test_the_ego_is_one_of_those_to_keep_clear_of() -> None:
    scene = road(Car(90.0, 198.25, 8.0), seconds=9.0)
    around = SurroundingTracks.of(scene, 0, FRAME, int(scene.timestamps_us[0]))
    into, frames = drive(float(scene.ego.boxes[FRAME, 0]) + 20.0, 198.25, 0.0), len(around.frame_seconds)
    poses = np.repeat(into[:1], frames, axis=0)
    assert around.compute_clear_seconds(poses) == np.inf
    with_ego = include_ego(around, scene, FRAME)
    boxes = np.column_stack([poses[:, :2], np.broadcast_to(scene.agents.size[0, :2], (frames, 2)), poses[:, 2]])
    first = int(np.argmax(boxes_overlap(boxes, scene.ego.boxes[FRAME:])))
    assert with_ego.compute_clear_seconds(poses) == pytest.approx(first / FRAME_HZ, abs=0.15)


@pytest.mark.parametrize("ego_speed", [5.0, 12.0])
def test_it_never_leaves_the_road(ego_speed: float) -> None:
    scene = road(Car(62.0, 194.75, 9.0), Car(120.0, 201.75, 9.0, np.pi), seconds=9.0)

    def ego(seconds: float) -> Floats:
        return np.array([50.0 + ego_speed * seconds, 198.25, 4.084, 1.85, 0.0])

    track, _, _ = loop(scene, policy_of(scene, MOTION_ONLY), ego)
    assert not off_road(scene, track.poses).any() and len(track.replanned) >= 5


def test_where_no_motion_is_fair_it_keeps_clear_of_the_ego(monkeypatch: pytest.MonkeyPatch) -> None:
    """A faster car in the next lane: it may go on, and then never meets the ego, or brake, and is never met either."""
    monkeypatch.setattr(AdversaryRules, "are_fair", lambda _, center: np.zeros(len(center), np.bool_))
    scene = road(Car(62.0, 194.75, 9.0), Car(30.0, 205.25, 5.0), seconds=9.0)
    track, _, _ = loop(scene, policy_of(scene, MOTION_ONLY))
    assert all(each.braked for each in track.replanned) and len(track.replanned) >= 5
    ego = scene.ego.boxes[track.start : track.start + len(track.poses)]
    size = np.broadcast_to(scene.agents.size[0, :2], (len(track.poses), 2))
    assert not boxes_overlap(np.column_stack([track.poses[:, :2], size, track.poses[:, 2]]), ego).any()


def test_other_adversaries_have_no_rules() -> None:
    assert policy_of(road()).road is None and policy_of(road(), MOTION_ONLY).road is not None
