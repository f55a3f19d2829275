"""Edits of recorded and lane paths: as small as they can be, driven by a car, and pressing without a contact."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import DriverLimits, find_broken_limit
from benchmark.geometry import Floats, boxes_overlap
from benchmark.road_map import Lane
from benchmark.scene import Scene
from generation.extensions.effect.driving import RetimedTrack, compute_recorded_stations
from generation.extensions.effect.paths import LaneGraph, VehiclePath, list_lane_paths, list_recorded_paths
from generation.extensions.effect.pressure import LEAST_PRESSURE, EgoPlans, count_levels
from generation.extensions.effect.retiming import Retiming, iterate_retimings
from generation.search.candidates import ExclusionReason, find_exclusion_reason
from generation.search.hyperparameters import HyperParameters
from generation.search.threat_settings import CandidateProposal
from generation.search.verify import measure_off_road, verify
from tests.hand_made import Car, scene_on_straight_road, straight_road

RETIMED = HyperParameters(proposal=CandidateProposal.RETIMED, shortest_drive_frames=36)
REROUTED = replace(RETIMED, proposal=CandidateProposal.REROUTED)


def first_track(scene: Scene, hyper: HyperParameters) -> RetimedTrack:
    return next(Retiming(scene, 0, hyper).find_tracks())


def boxes_of(scene: Scene, track: RetimedTrack) -> Floats:
    size = np.broadcast_to(scene.agents.size[0, :2], (len(track.poses), 2))
    return np.column_stack([track.poses[:, :2], size, track.poses[:, 2]])


@pytest.fixture(scope="module")
def leader() -> tuple[Scene, RetimedTrack]:
    """A leader 12 m ahead at the ego's speed."""
    scene = scene_on_straight_road((Car(68.0, 198.25, 8.0),), seconds=9.0)
    return scene, first_track(scene, RETIMED)


def test_a_leader_dawdles_on_its_path_and_the_recorded_ego_still_passes(leader: tuple[Scene, RetimedTrack]) -> None:
    scene, track = leader
    boxes = boxes_of(scene, track)
    assert len(boxes) == len(scene.timestamps_us) - track.start
    np.testing.assert_allclose(boxes[0, :2], scene.agents.position[0, track.start, :2], atol=1e-6)
    assert np.abs(boxes[:, 1] - 198.25).max() < 0.2
    assert boxes[-1, 0] < scene.agents.position[0, -1, 0] - 1.0
    assert not boxes_overlap(boxes, scene.ego.boxes[track.start :]).any()
    assert find_broken_limit(boxes, DriverLimits()) is None
    speed = np.diff(boxes[:, 0]) * FRAME_HZ
    assert -4.4 <= (np.diff(speed) * FRAME_HZ).min() < -0.1
    assert EgoPlans.of(scene).measure_pressure(boxes[None], track.start)[0] >= LEAST_PRESSURE


def test_an_edit_is_as_weak_as_its_level_of_pressure_allows(leader: tuple[Scene, RetimedTrack]) -> None:
    scene, track = leader
    level = count_levels(track.edit.pressure)
    for weaker in Retiming(scene, 0, RETIMED).drive(track.edit, [0.9, 0.94]):
        assert weaker is None or count_levels(weaker.edit.pressure) < level


def test_who_never_meets_the_ego_has_no_edit() -> None:
    scene = scene_on_straight_road((Car(60.0, 205.25, 8.0, np.pi),), seconds=9.0)
    assert list(iterate_retimings(scene, 0, RETIMED)) == []


def test_a_parked_car_pulls_out_from_standing_within_two_metres_per_second_squared() -> None:
    scene = scene_on_straight_road((Car(100.0, 194.5, 0.0),), seconds=9.0)
    assert list(iterate_retimings(scene, 0, RETIMED)) == []
    track = first_track(scene, REROUTED)
    boxes = boxes_of(scene, track)
    speed = np.hypot(*np.diff(boxes[:, :2], axis=0).T) * FRAME_HZ
    assert speed[0] < 0.2 and speed.max() > 1.0
    assert (np.diff(speed) * FRAME_HZ).max() < 2.2
    assert find_broken_limit(boxes, DriverLimits()) is None
    assert not boxes_overlap(boxes, scene.ego.boxes[track.start :]).any()


def test_the_same_scene_gives_the_same_edits(leader: tuple[Scene, RetimedTrack]) -> None:
    again = first_track(scene_on_straight_road((Car(68.0, 198.25, 8.0),), seconds=9.0), RETIMED)
    assert (again.start, again.edit.law) == (leader[1].start, leader[1].edit.law)
    np.testing.assert_array_equal(again.poses, leader[1].poses)


def test_a_recorded_path_goes_on_along_the_lane() -> None:
    scene = scene_on_straight_road((Car(60.0, 194.75, 8.0),), seconds=4.0)
    (path,) = list_recorded_paths(scene, 0, 12, LaneGraph(scene.road_map))
    assert path.kind == "recorded"
    assert path.points[-1, 0] > 60.0 + 8.0 * 4.0 + 60.0
    assert np.abs(path.points[:, 1] - 194.75).max() < 0.3


def test_lane_paths_join_lanes_of_the_same_way_alone() -> None:
    scene = scene_on_straight_road((Car(60.0, 194.75, 8.0),), seconds=4.0)
    ends = {
        round(float(path.points[-1, 1]), 2) for path in list_lane_paths(scene, 0, 12, 8.0, LaneGraph(scene.road_map))
    }
    assert ends == {194.75, 198.25}


def test_routes_branch_and_end() -> None:
    lanes = straight_road().lanes
    first = np.array([[0.0, 0.0], [20.0, 0.0]])
    lanes = {
        "a": Lane("a", first, None, ("b", "c", "gone"), (), False),
        "b": Lane("b", first + [20.0, 0.0], None, ("a",), ("a",), False),
        "c": Lane("c", np.array([[20.0, 0.0], [30.0, 10.0]]), None, (), ("a",), False),
    }
    graph = LaneGraph(replace(straight_road(), lanes=lanes))
    routes = graph.list_routes("a", 5.0, 100.0)
    assert sorted(tuple(route[-1]) for route in routes) == [(30.0, 10.0), (40.0, 0.0)]
    assert all(tuple(route[0]) == (5.0, 0.0) for route in routes)


def test_a_path_too_tight_or_too_short_for_a_car_is_none() -> None:
    assert VehiclePath.of("lane", np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])) is None
    assert VehiclePath.of("lane", np.array([[0.0, 0.0], [1.0, 0.0]])) is None
    assert VehiclePath.of("lane", np.zeros((5, 2))) is None


def test_a_pedestrian_crosses_earlier_on_request() -> None:
    """She would cross 2 s behind the ego; now she is nearer."""
    walking = Car(104.0, 188.8, 1.0, np.pi / 2, "human.pedestrian.adult", (0.6, 0.7, 1.7))
    scene = scene_on_straight_road((walking,), seconds=11.0)
    assert find_exclusion_reason(scene, 0, RETIMED) is ExclusionReason.NOT_FOUR_WHEELED
    hyper = replace(RETIMED, vulnerable=True)
    assert find_exclusion_reason(scene, 0, hyper) is None
    assert find_exclusion_reason(scene, 0, replace(hyper, proposal=CandidateProposal.REROUTED)) is not None
    track = first_track(scene, hyper)
    boxes = boxes_of(scene, track)
    assert boxes[-1, 1] > scene.agents.position[0, -1, 1] + 0.5
    assert np.hypot(*np.diff(boxes[:, :2], axis=0).T).max() * FRAME_HZ < 1.3
    assert EgoPlans.of(scene).measure_pressure(boxes[None], track.start)[0] >= LEAST_PRESSURE


SWERVED = replace(RETIMED, proposal=CandidateProposal.SWERVED)


@pytest.mark.parametrize(("y", "yaw", "sign"), [(202.1, np.pi, -1.0), (195.0, 0.0, 1.0)])
def test_who_passes_swerves_towards_the_ego_and_back_at_its_recorded_pace(y: float, yaw: float, sign: float) -> None:
    """One comes towards the ego and leaves the area around it afterwards, one is overtaken by it."""
    x, speed = (150.0, 8.0) if yaw else (80.0, 3.0)
    scene = scene_on_straight_road((Car(x, y, speed, yaw),), seconds=10.0)
    track = first_track(scene, SWERVED)
    boxes, recorded = boxes_of(scene, track), scene.agents.position[0, track.start :, :2]
    moved = sign * (boxes[:, 1] - recorded[:, 1])
    assert 0.3 < moved.max() < 2.0 and moved[[0, -1]] == pytest.approx(0.0, abs=0.3)
    np.testing.assert_allclose(boxes[:, 0], recorded[:, 0], atol=1.0)
    assert not boxes_overlap(boxes, scene.ego.boxes[track.start :]).any()
    assert find_broken_limit(boxes, DriverLimits()) is None
    changed = scene.with_adversary(0, slice(track.start, len(scene.timestamps_us)), track.poses)
    assert verify(changed, 0, track.start, SWERVED, None) is None


def test_who_never_passes_does_not_swerve() -> None:
    for car in (Car(68.0, 198.25, 8.0), Car(100.0, 194.5, 0.0)):
        assert list(iterate_retimings(scene_on_straight_road((car,), seconds=9.0), 0, SWERVED)) == []


def test_a_recorded_pace_goes_on_at_its_last_speed_and_never_backwards() -> None:
    scene = scene_on_straight_road((Car(60.0, 194.75, 6.0),), seconds=4.0)
    station = compute_recorded_stations(scene, 0, 12, 60)
    np.testing.assert_allclose(np.diff(station) * FRAME_HZ, 6.0, atol=0.05)


def test_an_edit_that_hits_the_ego_when_weak_is_clear_when_strong() -> None:
    """A car beside that goes early, and in front of the ego, must be quick enough."""
    scene = scene_on_straight_road((Car(62.0, 194.75, 7.0),), seconds=10.0)
    retiming = Retiming(scene, 0, REROUTED)
    found = [track for edit in retiming.find_edits()[:6] if (track := retiming.find_weakest(edit)) is not None]
    assert found
    assert all(not boxes_overlap(boxes_of(scene, track), scene.ego.boxes[track.start :]).any() for track in found)


def test_who_runs_into_the_ego_from_behind_does_not_press_it() -> None:
    scene = scene_on_straight_road((), seconds=6.0)
    ego = scene.ego.boxes.copy()
    for ahead, pressed in ((-5.2, False), (5.2, True)):
        other = ego + [ahead, 0.0, 0.0, 0.0, 0.0]
        assert bool(EgoPlans.of(scene).measure_pressure(other[None], 0)[0] > 0.0) is pressed


def test_a_u_turn_ends_in_a_lane_of_the_other_way() -> None:
    """From the southern edge of the road to the northern lanes, 10.5 m on."""
    scene = scene_on_straight_road((Car(60.0, 194.75, 0.0),), seconds=4.0)
    paths = list(list_lane_paths(scene, 0, 12, 0.0, LaneGraph(scene.road_map)))
    (turn,) = (path for path in paths if path.kind == "turns")
    assert np.ptp(turn.headings) == pytest.approx(np.pi, abs=0.3)
    assert turn.points[-1, 1] == pytest.approx(205.25, abs=0.1)
    assert not [p for p in list_lane_paths(scene, 0, 12, 8.0, LaneGraph(scene.road_map)) if p.kind == "turns"]


def test_the_way_out_of_a_driveway_is_not_off_the_road() -> None:
    scene = scene_on_straight_road((), seconds=6.0)
    y = np.concatenate([np.linspace(186.0, 194.75, 20), np.full(40, 194.75)])
    boxes = np.column_stack([np.linspace(100, 130, 60), y, np.full(60, 4.6), np.full(60, 1.9), np.zeros(60)])
    assert measure_off_road(scene, boxes, RETIMED)[1].mean() > 0.2
    assert not measure_off_road(scene, boxes, replace(RETIMED, behaviour=True))[1].any()
    back = np.concatenate([boxes, boxes[::-1]])
    assert measure_off_road(scene, back, replace(RETIMED, behaviour=True))[1].any()
