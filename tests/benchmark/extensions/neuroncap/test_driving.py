"""NeuroNCAP's engine drives as any engine does; what is its own is its score, its motion and its command."""

from dataclasses import replace

import pytest

from adapters.planners.log_replay import LogReplay
from benchmark.closed_loop.episodes import run_episode
from benchmark.closed_loop.planner_calls import FailureReason
from benchmark.closed_loop.scoring import score_episode
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.simulation_state import NeuroncapBackend
from benchmark.planning import Command
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches
from tests.benchmark.closed_loop import test_episodes as any_engine
from tests.benchmark.closed_loop import test_observation_builder as any_engine_seen
from tests.benchmark.closed_loop.staged import Watching, staged
from tests.hand_made import Car, scene_on_straight_road

NEURONCAP = NeuroncapBackend(NeuroncapSwitches.named("neuroncap@code"))


@pytest.mark.parametrize(("fault", "reason", "says"), any_engine.FAULTS)
def test_a_planner_that_fails_ends_the_drive_with_its_reason(fault: str, reason: FailureReason, says: str) -> None:
    any_engine.test_a_planner_that_fails_ends_the_drive_with_its_reason(NEURONCAP, fault, reason, says)


def test_six_identical_points_are_a_plan_to_stand() -> None:
    any_engine.test_six_identical_points_are_a_plan_to_stand(NEURONCAP)


def test_the_first_contact_ends_the_drive() -> None:
    any_engine.test_the_first_contact_ends_the_drive(NEURONCAP)


def test_nothing_of_the_recordings_future_can_be_reached() -> None:
    any_engine_seen.test_nothing_of_the_recordings_future_can_be_reached(NEURONCAP, False)


def test_scenes_that_are_too_short_are_refused_before_anybody_plans() -> None:
    any_engine.test_scenes_that_are_too_short_are_refused_before_anybody_plans(NEURONCAP)
    with pytest.raises(InputError, match="four seconds on"):
        run_episode(staged(scene_on_straight_road((), seconds=4.0), NEURONCAP), Watching())


def test_neuroncaps_score_is_that_of_the_engine() -> None:
    free = run_episode(staged(scene_on_straight_road((), seconds=10.0), NEURONCAP), Watching(speed=8.0))
    assert free.neuroncap is not None and free.neuroncap.score == 5.0
    blocked = scene_on_straight_road((Car(90.0, 198.25, 0.0),), ego_speed=8.0, seconds=10.0)
    blocked = replace(blocked, adversaries=(blocked.agents.ids[0],))
    hit = run_episode(staged(blocked, NEURONCAP), Watching(speed=8.0)).neuroncap
    assert hit is not None and hit.score is not None and hit.score < 0.2
    assert hit.reference_speed == pytest.approx(8.0, abs=0.05) and hit.impact_speed == pytest.approx(8.0, abs=0.05)


def test_neuroncaps_planner_sees_its_engines_motion_and_command() -> None:
    scene = scene_on_straight_road((), ego_speed=8.0, seconds=6.0)
    seen = any_engine_seen.seen_by(Watching(speed=8.0), scene, NEURONCAP)
    row = seen[-1].ego.can_motion
    assert row is not None and row[5] == pytest.approx(9.8) and row[0] == pytest.approx(8.0, abs=0.3)
    assert all(each.command is Command.STRAIGHT for each in seen)


def test_neuroncaps_drives_have_no_other_formula() -> None:
    free = scene_on_straight_road((), ego_speed=8.0, seconds=10.0)
    found = run_episode(staged(free, NeuroncapBackend(NeuroncapSwitches.named("neuroncap@paper"))), LogReplay())
    scores = score_episode(free, found)
    assert found.neuroncap is not None and scores.nuplan is None and scores.hd is None
