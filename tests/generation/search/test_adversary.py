from dataclasses import replace

import numpy as np
import pytest

from benchmark.dynamics.bicycle import DriverLimits, MotionModel, compute_rear_axle, find_broken_limit
from benchmark.errors import InputError
from benchmark.geometry import Floats, boxes_overlap, to_local, wrap_angle
from benchmark.machine.storage import canonical_json
from generation.search.adversary import SearchOutcome, compute_scene_identity, search_vehicles
from generation.search.hyperparameters import HyperParameters
from generation.search.planning import AdversaryPlanning
from generation.search.recorded_motion import find_log_replay_contacts, is_in_canvas
from generation.search.verify import DiscardReason
from tests.generation.search.driving_prior import DrivingPrior, unchanged
from tests.generation.search.one_vehicle import attempt
from tests.hand_made import Car, scene_on_straight_road

HYPER = HyperParameters(candidates=48)
CARS = (Car(62.0, 194.75, 9.0), Car(90.0, 198.25, 8.0), Car(120.0, 201.75, 9.0, np.pi))


def run(*cars: Car, hyper: HyperParameters = HYPER, seed: int = 0, seconds: float = 9.0) -> SearchOutcome:
    scene = scene_on_straight_road(cars or CARS, seconds=seconds)
    return attempt(scene, 0, seed, hyper, DrivingPrior(), diversify=unchanged)


@pytest.fixture(scope="module")
def kept() -> SearchOutcome:
    results = (run(seed=seed) for seed in range(6))
    return next(result for result in results if result.kept)


def test_a_kept_scene_is_clear_of_everything_and_drivable(kept: SearchOutcome) -> None:
    scene, start = kept.scene, kept.attempt.launch_frame
    assert scene is not None
    assert start is not None
    assert len(kept.poses) == len(scene.timestamps_us) - start
    boxes = scene.agents.boxes
    assert not boxes_overlap(boxes[0], scene.ego.boxes).any()
    assert not boxes_overlap(boxes[0], boxes[1:]).any()
    assert not find_log_replay_contacts(scene).any()
    assert find_broken_limit(boxes[0, start:], DriverLimits()) is None
    assert scene.adversaries == (kept.attempt.agent,)


def test_an_adversary_challenges_more_than_its_recording(kept: SearchOutcome) -> None:
    recorded = scene_on_straight_road(CARS, seconds=9.0)
    gap = np.linalg.norm(recorded.agents.position[0, :, :2] - recorded.ego.boxes[:, :2], axis=1).min()
    assert kept.scene is not None
    driven = np.linalg.norm(kept.scene.agents.position[0, :, :2] - kept.scene.ego.boxes[:, :2], axis=1).min()
    assert driven < gap
    assert kept.attempt.challenge > 0.0
    assert kept.attempt.closest_approach is not None
    assert kept.attempt.closest_approach.gap_m < HYPER.close_gap_m


def test_no_jump_at_the_hand_over_and_at_replanning(kept: SearchOutcome) -> None:
    assert kept.scene is not None
    position = kept.scene.agents.position[0, :, :2]
    speed = np.hypot(*np.diff(position, axis=0).T) * 12
    assert np.abs(np.diff(speed)).max() < 5.0 / 12 * 1.1
    assert np.abs(np.diff(kept.scene.agents.yaw[0])).max() < 0.9 / 12 * 1.1
    recorded = scene_on_straight_road(CARS, seconds=9.0)
    start = kept.attempt.launch_frame
    np.testing.assert_array_equal(position[:start], recorded.agents.position[0, :start, :2])
    # The others stay as recorded.
    np.testing.assert_array_equal(kept.scene.agents.position[1:], recorded.agents.position[1:])
    np.testing.assert_array_equal(kept.scene.ego.position, recorded.ego.position)


def test_same_content_same_track_and_another_seed_another_one(kept: SearchOutcome) -> None:
    again, other = run(seed=kept.attempt.seed), run(seed=kept.attempt.seed + 100)
    np.testing.assert_array_equal(again.poses, kept.poses)
    assert canonical_json(again.attempt.as_json()) == canonical_json(kept.attempt.as_json())
    assert not np.array_equal(other.poses[:100], kept.poses[: len(other.poses[:100])])


def test_the_seed_depends_on_content_not_on_objects() -> None:
    scene = scene_on_straight_road(CARS)
    assert compute_scene_identity(scene) == compute_scene_identity(scene_on_straight_road(CARS))
    position = scene.agents.position.copy()
    position[1, 3, 0] += 1e-9
    assert compute_scene_identity(
        replace(scene, agents=replace(scene.agents, position=position))
    ) != compute_scene_identity(scene)


def test_far_vehicles_are_never_launched() -> None:
    result = run(Car(150.0, 194.75, 9.0))
    assert result.attempt.discard == DiscardReason.NEVER_LAUNCHED
    assert result.poses.shape == (0, 3)
    canonical_json(result.attempt.as_json())


def test_a_scene_in_which_the_ego_already_collides_is_left_alone() -> None:
    assert run(CARS[0], Car(51.5, 198.25, 8.0)).attempt.discard == DiscardReason.ORIGINAL_COLLIDES


def test_planning_ends_where_the_adversary_leaves_the_area_without_another_try() -> None:
    result = run(Car(88.0, 205.25, 16.0, np.pi), hyper=replace(HYPER, tries=3), seconds=14.0)
    assert (result.attempt.discard, result.attempt.tries) == (DiscardReason.LEAVES_AREA, 1)
    start = result.attempt.launch_frame
    assert start is not None and result.finding is not None
    assert len(result.poses) < 14 * 12 - start - HYPER.horizon
    scene = scene_on_straight_road((Car(88.0, 205.25, 16.0, np.pi),), seconds=14.0)
    inside = is_in_canvas(scene, result.poses[:, :2], HYPER.half_extent_m, first=start)
    assert result.finding.frame == start + int(np.argmin(inside))
    assert not inside[-1] and inside[: -HYPER.horizon].all()


def test_contact_is_looked_for_at_the_frames_that_are_executed() -> None:
    """Right behind a car that drives away there is room from the frame after the planning frame on, and not before."""
    scene, frame = scene_on_straight_road((Car(60.0, 205.25, 0.0), Car(90.0, 194.75, 12.0)), seconds=9.0), 20
    planning = AdversaryPlanning(scene, 0, frame, HYPER, unchanged, MotionModel.si(), np.random.default_rng(0), {})
    behind = scene.agents.position[1, frame + 1, :2] - [0.5 * (4.6 + 4.6) + 0.1, 0.0]
    assert planning._touched(frame, np.array([[*behind, 0.0]])) is None
    assert planning._touched(frame, np.array([[*(behind + [0.2, 0.0]), 0.0]])) == scene.agents.ids[1]


def test_the_diffusion_model_is_told_where_the_vehicle_was_half_a_second_ago() -> None:
    class Listening(DrivingPrior):
        def sample(self, count: int, previous: Floats, rng: np.random.Generator) -> Floats:
            told.append(previous)
            return super().sample(count, previous, rng)

    told: list[Floats] = []
    scene = scene_on_straight_road(CARS, seconds=9.0)
    result = attempt(scene, 0, 0, replace(HYPER, tries=1), Listening(), diversify=unchanged)
    assert result.attempt.launch_frame is not None and len(told) > 2
    length = float(scene.agents.size[0, 0])
    recorded = np.column_stack([scene.agents.position[0, :, :2], scene.agents.yaw[0]])
    driven = compute_rear_axle(np.concatenate([recorded[: result.attempt.launch_frame], result.poses]), length)
    for number, previous in enumerate(told):
        now, ago = (
            driven[result.attempt.launch_frame + 12 * number],
            driven[result.attempt.launch_frame + 12 * number - 6],
        )
        np.testing.assert_allclose(previous, [*to_local(ago[:2], now), wrap_angle(ago[2] - now[2])], atol=1e-9)


def test_each_try_has_its_own_randomness_and_a_kept_one_is_the_last(kept: SearchOutcome) -> None:
    assert kept.attempt.tries in (1, 2)
    far_from_kept = replace(HYPER, candidates=8, close_gap_m=0.0)
    once, thrice = (run(hyper=replace(far_from_kept, tries=count)) for count in (1, 3))
    assert not once.kept
    assert (once.attempt.tries, thrice.attempt.tries) == (1, 3)
    assert thrice.attempt.as_json()["tries"] == 3
    assert not np.array_equal(once.poses[:24], thrice.poses[:24])


def test_boxed_in_without_a_way_out_is_discarded() -> None:
    wall = tuple(Car(68.0, y, 0.0, np.pi / 2, size=(3.4, 1.9, 1.7)) for y in (194.0, 197.4, 200.8, 204.2))
    scene = scene_on_straight_road((Car(53.0, 194.75, 9.0), *wall), ego_x=20.0, ego_speed=1.0, seconds=9.0)
    result = attempt(scene, 0, 0, HyperParameters(candidates=24, history_frames=6), DrivingPrior(), diversify=unchanged)
    assert result.attempt.discard in (
        DiscardReason.NO_SAFE_CANDIDATE,
        DiscardReason.NEVER_LAUNCHED,
        DiscardReason.HITS_OBJECT,
    )
    assert result.scene is None


def test_attempts_side_by_side_are_as_if_alone() -> None:
    scene = scene_on_straight_road(CARS, seconds=9.0)
    with pytest.raises(InputError, match="no agent 7"):
        attempt(scene, 7, 0, HYPER, DrivingPrior(), diversify=unchanged)
    alone = [attempt(scene, agent, 3, HYPER, DrivingPrior(), diversify=unchanged) for agent in (0, 1, 2)]
    vehicles = [(scene, agent) for agent in (0, 1, 2)]
    together = search_vehicles(vehicles, 3, HYPER, DrivingPrior(), diversify=unchanged)
    for one, other in zip(alone, together, strict=True):
        assert canonical_json(one.attempt.as_json()) == canonical_json(other.attempt.as_json())
        np.testing.assert_array_equal(one.poses, other.poses)
    assert set(together[0].stage_seconds) == {"sampling", "physics", "scoring", "other"}


def test_a_kept_scene_is_judged_on_its_generated_track(kept: SearchOutcome) -> None:
    (judged,) = kept.attempt.judgements
    assert (judged.adversary, judged.tracks, judged.has_map) == (kept.attempt.agent, "generated", True)
    assert judged.drivers["recorded"].survives and not judged.unsolvable
    assert judged.faults is not None and judged.faults.unknown == {} and judged.faults.beyond_limits is False
    assert judged.encounter is not None and kept.attempt.closest_approach is not None
    # One looks every 0.1 s, the other at 12 Hz.
    assert judged.encounter.least_gap_m == pytest.approx(kept.attempt.closest_approach.gap_m, abs=0.3)


def test_what_nobody_could_have_avoided_is_dropped_unless_it_is_asked_for(
    kept: SearchOutcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("generation.search.verify.is_unsolvable", lambda judgements: len(judgements) == 1)
    dropped = run(seed=kept.attempt.seed)
    assert dropped.finding is not None and dropped.finding.reason is DiscardReason.UNSOLVABLE and dropped.scene is None
    said = dropped.attempt
    assert (said.kept, said.discard, said.challenge) == (False, "unsolvable", 0.0) and said.labels is not None
    # There is another chance, and what was judged says why.
    assert said.tries == HYPER.tries and len(said.judgements) == 1
    asked = run(seed=kept.attempt.seed, hyper=replace(HYPER, solvable=False))
    assert asked.kept and asked.attempt == kept.attempt
    np.testing.assert_array_equal(asked.poses, kept.poses)
