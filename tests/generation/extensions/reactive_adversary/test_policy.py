from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmark.closed_loop.agent_policy import TrafficSnapshot, check_policy
from benchmark.errors import InputError
from benchmark.geometry import Floats, boxes_overlap
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.machine.storage import content_seed
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.adversary_maker import find_handover_frame, get_vehicles
from generation.extensions.reactive_adversary.policy import ReactiveAdversary
from generation.extensions.reactive_adversary.settings import AdversarySettings, EgoPrediction
from generation.search.adversary import ALGORITHM_VERSION, compute_scene_identity
from generation.search.planning import AdversaryPlanning
from generation.search.proposals import run_searches
from tests.generation.extensions.reactive_adversary.loops import (
    CARS,
    HYPER,
    SETTINGS,
    knowing,
    loop,
    policy_of,
    rides,
    road,
)
from tests.generation.search.driving_prior import DrivingPrior, unchanged
from tests.hand_made import Car


def open_loop(scene: Scene, agent: int, start: int, run: int) -> Floats:
    """(F, 3) what open loop plans for a vehicle from a frame on."""
    content = (compute_scene_identity(scene), scene.agents.ids[agent], run, HYPER.fingerprint, DrivingPrior.fingerprint)
    rng = np.random.default_rng(content_seed(*content, ALGORITHM_VERSION, 0))
    stages = {"physics": 0.0, "scoring": 0.0}
    planning = AdversaryPlanning(scene, agent, start, HYPER, unchanged, HYPER.motion_model(), rng, stages)
    (driven,), _ = run_searches([planning.run()], DrivingPrior())
    return driven.poses


@pytest.mark.parametrize(("agent", "start", "run"), [(0, 12, 0), (0, 17, 3), (1, 30, 1)])
def test_told_the_recorded_future_it_is_the_adversary_of_open_loop(agent: int, start: int, run: int) -> None:
    scene = road()
    expected = open_loop(scene, agent, start, run)
    policy = policy_of(scene, knowing(EgoPrediction.RECORDING), agent, start, run)
    track, boxes, _ = loop(scene, policy)
    assert len(expected) > 48
    assert not any(each.braked for each in track.replanned)
    count = min(len(track.poses), len(expected))
    assert count >= len(expected) - 12
    np.testing.assert_allclose(track.poses[:count], expected[:count], atol=1e-6)
    # What the engine is given is what a reader of the adversarial scene is given.
    made = scene.with_adversary(agent, slice(start, start + len(expected)), expected)
    first = float(scene.seconds[scene.keyframes[2]])
    known = first + 0.05 * np.arange(1, len(boxes) + 1)
    known = known[known <= scene.seconds[start + count - 1]]
    replayed, _ = ContinuousTracks.of_scene(made).agents_at(known)
    np.testing.assert_allclose(boxes[: len(known), agent], replayed[agent], atol=2e-6)


def test_it_keeps_the_contract_of_policies() -> None:
    scene = road(seconds=6.0)
    policy = policy_of(scene)
    start = int(scene.timestamps_us[scene.keyframes[2]])
    ego = scene.ego.boxes[int(scene.keyframes[2])]
    boxes = scene.agents.boxes[:, int(scene.keyframes[2])]
    check_policy(policy, TrafficSnapshot(start, ego, 8.0, boxes, np.ones(3, np.bool_), np.zeros((3, 2))), steps=12)


@pytest.mark.parametrize(("run", "ego_speed"), [(0, 0.0), (1, 4.0), (2, 13.0)])
def test_nobody_but_the_ego_is_ever_touched(run: int, ego_speed: float) -> None:
    cars = (
        Car(60.0, 194.75, 9.0), Car(72.0, 198.25, 8.0), Car(47.0, 194.75, 9.5), Car(85.0, 194.75, 6.0),
        Car(150.0, 201.75, 9.0, np.pi), Car(128.0, 205.25, 7.0, np.pi),
    )  # fmt: skip
    scene = road(*cars, seconds=8.0)

    def ego(seconds: float) -> Floats:
        return np.array([51.4 + ego_speed * seconds, 198.25, 4.084, 1.73, 0.0])

    track, boxes, present = loop(scene, policy_of(scene, run=run), ego)
    assert len(track.replanned) >= 5
    others = present[:, 1:]
    hit = boxes_overlap(boxes[:, :1], boxes[:, 1:]) & others
    assert not hit.any()


def test_it_meets_the_ego_where_it_is_and_not_where_it_was_recorded() -> None:
    """An ego that crawls is left behind by a replayed car; one that is planned anew stays with it."""
    scene = road(Car(62.0, 194.75, 9.0), seconds=10.0)

    def crawling(seconds: float) -> Floats:
        return np.array([51.4 + 8.0 * min(seconds, 1.5) + 2.0 * max(seconds - 1.5, 0.0), 198.25, 4.084, 1.73, 0.0])

    recorded = float(scene.agents.position[0, -1, 0]) - crawling(float(scene.seconds[-1]))[0]
    _, boxes, _ = loop(scene, policy_of(scene), crawling)
    assert boxes[-1, 0, 0] - crawling(float(scene.seconds[-1]))[0] < 0.5 * recorded


def test_the_same_seed_is_the_same_track_and_what_it_knows_matters() -> None:
    scene = road(seconds=6.0)
    tracks = [
        loop(scene, policy_of(scene, knowing(knows), run=run))[0].poses
        for knows, run in (
            (EgoPrediction.MOTION, 0),
            (EgoPrediction.MOTION, 0),
            (EgoPrediction.MOTION, 1),
            (EgoPrediction.NOTHING, 0),
        )
    ]
    np.testing.assert_array_equal(tracks[0], tracks[1])
    assert np.abs(tracks[0] - tracks[2]).max() > 0.1
    assert np.abs(tracks[0] - tracks[3]).max() > 0.1


def test_others_who_answer_are_not_touched_either() -> None:
    scene = road(Car(62.0, 194.75, 9.0), Car(75.0, 198.25, 8.0), Car(40.0, 194.75, 11.0), seconds=7.0)
    maker = rides(replace(SETTINGS, others="idm"))
    course = maker.course(scene, 0)
    policy = course.policy
    assert isinstance(policy, ReactiveAdversary)
    memory, moved = policy.init(course.start_us, 0)
    time, agent = course.start_us, policy.agent
    ego = ContinuousTracks.of_scene(scene).ego_at(np.array([1.0]))[0]
    while time < course.end_us:
        moment = TrafficSnapshot(time, ego, 8.0, moved.boxes[-1], moved.present[-1], moved.velocity)
        memory, moved = policy.act(memory, moment, 0)
        others = moved.present[-1] & (np.arange(3) != agent)
        assert not (boxes_overlap(moved.boxes[-1, agent][None], moved.boxes[-1]) & others).any()
        time += 100_000
        ego = ego + np.array([0.8, 0.0, 0.0, 0.0, 0.0])
    assert len(policy.adversary(memory).replanned) >= 3


def test_how_often_it_is_planned_anew_is_kept() -> None:
    scene = road(seconds=6.0)
    for every in (6, 24):
        track, _, _ = loop(scene, policy_of(scene, replace(SETTINGS, every_frames=every)))
        frames = [each.frame for each in track.replanned]
        assert frames == list(range(12, frames[-1] + 1, every))
        assert len(track.poses) == frames[-1] + min(every, len(scene.timestamps_us) - 1 - frames[-1]) - 12 + 1


def test_a_vehicle_that_comes_late_begins_where_it_is() -> None:
    scene = road(seconds=8.0)
    valid = scene.agents.valid.copy()
    valid[0, :40] = False
    late = replace(scene, agents=replace(scene.agents, valid=valid), adversaries=(scene.agents.ids[0],))
    assert find_handover_frame(late, 0, int(late.timestamps_us[12]), HYPER) >= 40
    start = 40
    track, _, present = loop(late, policy_of(late, start=start))
    np.testing.assert_allclose(track.poses[0, :2], late.agents.position[0, start, :2], atol=1e-6)
    rows = np.flatnonzero(present[:, 0])
    assert late.seconds[12] + 0.05 * (rows[0] + 1) == pytest.approx(late.seconds[start], abs=0.05)


def test_runs_take_vehicles_in_turn_and_an_adversarial_scene_has_its_own() -> None:
    scene = road()
    assert set(get_vehicles(scene, HYPER)) <= set(range(len(CARS)))
    known = replace(scene, adversaries=(scene.agents.ids[2],))
    assert get_vehicles(known, HYPER) == (2,)


def test_bad_settings_are_sentences_and_names_tell_them_apart() -> None:
    wrongs: tuple[dict[str, Any], ...] = (
        {"every_s": 0.0}, {"every_s": 3.1}, {"every_s": float("nan")}, {"knows": "recording"},
    )  # fmt: skip
    for wrong in wrongs:
        with pytest.raises(InputError, match=r"--adversary-(every|knows)"):
            AdversarySettings.of(**wrong)
    with pytest.raises(InputError, match="other road users"):
        AdversarySettings.of(others="adversary")
    different: tuple[dict[str, Any], ...] = (
        {}, {"knows": "plan"}, {"every_s": 0.5}, {"others": "idm"}, {"rounds": 1}, {"candidates": 9},
    )  # fmt: skip
    facts = [AdversarySettings.of(**each).facts("p") for each in different]
    assert all(a != b for at, a in enumerate(facts) for b in facts[:at])


def test_an_ego_that_drives_as_recorded_meets_the_track_that_the_scene_was_made_with() -> None:
    """One that does not is met by the search, from where the adversary is by then."""
    scene = road(Car(62.0, 194.75, 9.0), seconds=8.0)
    made = replace(scene, adversaries=(scene.agents.ids[0],))
    recorded = np.column_stack([made.agents.position[0, :, :2], made.agents.yaw[0]])
    track, _, _ = loop(made, policy_of(made))
    np.testing.assert_allclose(track.poses, recorded[12 : 12 + len(track.poses)], atol=1e-6)
    assert not any(each.braked or each.score is not None for each in track.replanned)

    def crawling(seconds: float) -> Floats:
        return np.array([51.4 + 8.0 * min(seconds, 2.5) + 2.0 * max(seconds - 2.5, 0.0), 198.25, 4.084, 1.73, 0.0])

    left, _, _ = loop(made, policy_of(made), crawling)
    searched = [each.frame for each in left.replanned if each.score is not None]
    assert searched and min(searched) > 24
    kept = searched[0] - 12 + 1
    np.testing.assert_allclose(left.poses[:kept], recorded[12 : 12 + kept], atol=1e-6)
    assert np.hypot(*(left.poses[-1] - recorded[12 + len(left.poses) - 1])[:2]) > 5.0


def test_it_stays_on_that_track_for_an_ego_that_would_run_into_it() -> None:
    """A car that stops in the ego's lane, for one that was recorded slowing down and does not slow down."""
    scene = road(Car(110.0, 198.25, 0.0), seconds=8.0, ego_speed=5.0)
    made = replace(scene, adversaries=(scene.agents.ids[0],))

    def faster(seconds: float) -> Floats:
        return np.array([51.4 + 5.0 * min(seconds, 1.5) + 8.0 * max(seconds - 1.5, 0.0), 198.25, 4.084, 1.73, 0.0])

    track, boxes, _ = loop(made, policy_of(made), faster)
    assert np.ptp(track.poses[:, :2], axis=0).max() < 0.1
    assert np.isclose(boxes[-1, 0, 0], made.agents.position[0, -1, 0], atol=0.1)
