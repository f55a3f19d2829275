"""Scores of drives on a straight road, where everything can be said by hand."""

from dataclasses import replace

import pytest

from adapters.planners.log_replay import LogReplay
from adapters.planners.stop import Stop
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import Episode, run_episode
from benchmark.closed_loop.scoring import (
    EpisodeScores,
    RouteProgress,
    compute_no_collision,
    nuplan_score,
    score_episode,
)
from benchmark.interactions.contacts import EGO_MASS_KG, mass_kg
from benchmark.planning import Planner
from benchmark.records.drive_schema import NuplanTerms
from benchmark.scene import Scene
from tests.benchmark.closed_loop.staged import Watching, staged
from tests.hand_made import Car, scene_on_straight_road

FREE = scene_on_straight_road((), ego_speed=8.0, seconds=10.0)


def scored(scene: Scene, planner: Planner, agents: str = "replay") -> tuple[Episode, EpisodeScores]:
    found = run_episode(staged(scene, DefaultBackend(agents)), planner)
    return found, score_episode(scene, found)


def terms(scores: EpisodeScores) -> NuplanTerms:
    assert scores.nuplan is not None
    return scores.nuplan


def test_a_free_road_driven_as_recorded_has_everything() -> None:
    _, scores = scored(FREE, LogReplay())
    assert scores.contact is None and scores.progress.share == pytest.approx(1.0, abs=0.01)
    assert scores.progress.metres == pytest.approx(scores.progress.recorded_m, abs=0.01)
    found = terms(scores)
    assert (found.nc, found.dac, found.mp, found.ddc, found.ttc, found.c) == (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    assert found.p == pytest.approx(1.0, abs=0.01) and found.score == pytest.approx(1.0, abs=0.01)
    assert scores.hd is not None and scores.hd.score == pytest.approx(1.0) and found.least_ttc_s is None


def test_whoever_stands_has_no_contact_and_no_score_and_brakes_without_comfort() -> None:
    _, scores = scored(FREE, Stop())
    found = terms(scores)
    assert found.nc == 1.0 and found.mp == 0.0 and found.score == 0.0
    assert scores.comfortable == 0.0 and found.c == 0.0
    assert scores.progress.share is not None and scores.progress.share < 0.15
    assert scores.hd is not None and scores.hd.plans > 0.8 and scores.hd.score < 0.3


def test_driving_into_somebody_who_stands_is_ones_own_fault() -> None:
    scene = scene_on_straight_road((Car(95.0, 198.25, 0.0),), ego_speed=8.0, seconds=12.0)
    found, scores = scored(scene, Watching(speed=8.0))
    contact = scores.contact
    assert contact is not None and contact.kind == "stopped_track" and contact.at_fault and not contact.adversary
    assert contact.impact_speed == pytest.approx(8.0, abs=0.05)
    share = mass_kg("vehicle.car") / (mass_kg("vehicle.car") + EGO_MASS_KG)
    assert contact.delta_v_ego == pytest.approx(8.0 * share, abs=0.05)
    # Driving begins after a second of priming at x = 58.
    assert contact.seconds == pytest.approx((95 - 2.3 - 3.432 - 58) / 8.0, abs=0.06)
    assert terms(scores).nc == 0.0 and terms(scores).ttc == 0.0 and terms(scores).score == 0.0
    assert terms(scores).least_ttc_s == pytest.approx(0.1, abs=0.11)
    assert scores.progress.metres == pytest.approx(8.0 * contact.seconds, abs=1.0)
    assert found.touch is not None
    named = score_episode(replace(scene, adversaries=(scene.agents.ids[0],)), found).contact
    assert named is not None and named.adversary and named.agent == scene.agents.ids[0]


def test_being_hit_from_behind_is_not() -> None:
    scene = scene_on_straight_road((Car(20.0, 198.25, 12.0),), ego_speed=8.0, seconds=12.0)
    _, scores = scored(scene, Watching(speed=6.0))
    contact = scores.contact
    assert contact is not None and contact.kind == "rear" and not contact.at_fault
    assert contact.impact_speed == pytest.approx(6.0, abs=0.2)
    assert terms(scores).nc == 1.0 and terms(scores).score > 0.0


def test_a_thing_costs_half() -> None:
    barrier = Car(95.0, 198.25, 0.0, category="movable_object.barrier", size=(2.0, 1.0, 1.0))
    _, scores = scored(scene_on_straight_road((barrier,), ego_speed=8.0, seconds=12.0), Watching(speed=8.0))
    assert scores.contact is not None and scores.contact.at_fault and compute_no_collision(scores.contact) == 0.5


def test_leaving_the_road_is_seen_with_a_tolerance() -> None:
    slow_right, right = Watching(speed=8.0, left=-0.2), Watching(speed=8.0, left=-0.8)
    _, scores = scored(FREE, right)
    found = terms(scores)
    assert found.dac == 0.0 and found.off_road_s is not None and found.score == 0.0
    # The outer edge of the road is 5.25 m to the right of the ego's middle.
    far, _ = scored(FREE, slow_right)
    edge = far.motion.ego[:, 1].min()
    assert (edge - 0.925 < 193.0 - 0.3) == (terms(score_episode(FREE, far)).dac == 0.0)


def test_driving_against_the_traffic_is_the_wrong_way() -> None:
    _, scores = scored(scene_on_straight_road((), ego_speed=8.0, seconds=14.0), Watching(speed=8.0, left=0.35))
    assert terms(scores).ddc < 1.0


def test_a_near_miss_costs_ttc_only_where_somebody_is_ahead() -> None:
    beside = scene_on_straight_road((Car(50.0, 194.75, 8.0),), ego_speed=8.0, seconds=8.0)
    assert terms(scored(beside, LogReplay())[1]).ttc == 1.0
    close = scene_on_straight_road((Car(70.0, 198.25, 5.0),), ego_speed=8.0, seconds=4.5)
    found = terms(scored(close, Watching(speed=8.0))[1])
    assert found.least_ttc_s is not None and found.ttc == float(found.least_ttc_s > 0.95)


def test_without_lanes_there_are_no_scores_of_the_road() -> None:
    bare = replace(FREE, road_map=replace(FREE.road_map, lanes={}))
    _, scores = scored(bare, LogReplay())
    assert scores.nuplan is None and scores.hd is None and scores.progress.share == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("metres", "recorded", "expected"),
    [(10.0, 20.0, 0.5), (30.0, 20.0, 1.0), (-3.0, 20.0, 0.0), (-1.0, 20.0, 0.1), (0.0, 0.5, 1.0), (4.0, 1.0, 1.0)],
)
def test_progress_is_compared_as_in_nuplan(metres: float, recorded: float, expected: float) -> None:
    assert RouteProgress(metres, recorded, 100.0).relative_to_recorded == pytest.approx(expected)


def test_the_score_is_the_formula_and_a_route_that_hardly_moves_has_no_share() -> None:
    assert nuplan_score((0.5, 1.0, 1.0, 0.5), (0.6, 1.0, 0.0)) == pytest.approx(0.25 * (5 * 0.6 + 5) / 12)
    assert nuplan_score((1.0, 1.0, 1.0, 1.0), (1.0, 1.0, None)) == 1.0
    assert RouteProgress(0.0, 0.0, 1.0).share is None and RouteProgress(-5.0, 1.0, 50.0).share == 0.0
