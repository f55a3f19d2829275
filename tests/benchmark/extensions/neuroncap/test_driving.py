"""NeuroNCAP's engine drives as any engine does; what is its own is its score, its motion, its command, its runs."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.planners.log_replay import LogReplay
from benchmark.closed_loop.engines import list_engines, make_backend
from benchmark.closed_loop.episodes import run_episode
from benchmark.closed_loop.planner_calls import FailureReason
from benchmark.closed_loop.scoring import score_episode
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.simulation_state import NeuroncapBackend
from benchmark.planning import Command
from benchmark.records.drive_schema import OFFICIAL, OWN
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches
from benchmark.runs.driving import DriveSettings
from benchmark.runs.rescoring_drives import rescore_drives
from tests.benchmark.cli import test_drive_trouble as any_command
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.closed_loop import test_episodes as any_engine
from tests.benchmark.closed_loop import test_observation_builder as any_engine_seen
from tests.benchmark.closed_loop.staged import Peeking, Watching, staged
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import Straight
from tests.benchmark.runs import test_driving as any_world
from tests.benchmark.runs import test_driving_together as any_world_together
from tests.benchmark.runs.test_driving import driven
from tests.hand_made import Car, scene_on_straight_road

PAPER = NeuroncapSwitches.named("neuroncap@paper")
CODE = NeuroncapBackend(NeuroncapSwitches.named("neuroncap@code"))
SETTINGS = DriveSettings("neuroncap@paper", NeuroncapBackend(PAPER))
LONG = scene_on_straight_road(seconds=13.0)


@pytest.mark.parametrize(("fault", "reason", "says"), {row[1]: row for row in any_engine.FAULTS}.values())
def test_a_planner_that_fails_ends_the_drive_with_its_reason(fault: str, reason: FailureReason, says: str) -> None:
    any_engine.test_a_planner_that_fails_ends_the_drive_with_its_reason(CODE, fault, reason, says)


@pytest.mark.parametrize(
    "test",
    [
        any_engine.test_six_identical_points_are_a_plan_to_stand,
        any_engine.test_the_first_contact_ends_the_drive,
        any_engine.test_scenes_that_are_too_short_are_refused_before_anybody_plans,
        lambda maker: any_engine_seen.test_nothing_of_the_recordings_future_can_be_reached(maker, False),
        any_world_together.test_a_planner_that_fails_takes_nobody_with_it,
    ],
)
def test_what_holds_of_any_engine_holds_of_this(test: Callable[[Any], None]) -> None:
    test(CODE)


@pytest.mark.parametrize(
    "test",
    [
        any_world.test_a_scenario_that_draws_nothing_is_driven_once,
        any_world.test_a_drive_is_repeated_without_its_planner,
        any_world.test_a_record_is_scored_anew_without_its_planner,
    ],
)
def test_what_holds_of_any_drive_of_a_split_holds_of_this(test: Callable[[Any, Path], None], tmp_path: Path) -> None:
    test(SETTINGS, tmp_path)


@pytest.mark.path
def test_the_command_prints_a_table_of_its_own(tmp_path: Path) -> None:
    source = any_command.road(tmp_path / "road")
    more = ("--engine", "neuroncap@paper", "--runs", "7", "--model", "stop", "--no-baselines")
    done = any_command.driving(source, tmp_path / "out", *more)
    assert done.code == 0 and "engine neuroncap@paper" in done.out and "NNS" in done.out
    (record,) = tmp_path.rglob("*neuroncap*/stop/drives.jsonl")
    assert len(record.read_text().splitlines()) == 1


def test_who_fails_is_counted_and_scored_nowhere(tmp_path: Path) -> None:
    source = any_command.road(tmp_path / "road")
    trouble = ("Poisoned", "unusable plan", "neuroncap@code")
    any_command.test_who_fails_is_counted_and_scored_nowhere(source, tmp_path / "out", *trouble)


@pytest.mark.path
def test_the_score_is_that_of_the_engine() -> None:
    free = scene_on_straight_road((), ego_speed=8.0, seconds=10.0)
    found = run_episode(staged(free, CODE), Watching(speed=8.0))
    assert found.neuroncap is not None and found.neuroncap.score == 5.0
    blocked = scene_on_straight_road((Car(90.0, 198.25, 0.0),), ego_speed=8.0, seconds=10.0)
    blocked = replace(blocked, adversaries=(blocked.agents.ids[0],))
    hit = run_episode(staged(blocked, CODE), Watching(speed=8.0)).neuroncap
    assert hit is not None and hit.score is not None and hit.score < 0.2
    assert hit.reference_speed == pytest.approx(8.0, abs=0.05) and hit.impact_speed == pytest.approx(8.0, abs=0.05)
    # Its drives have no other formula.
    found = run_episode(staged(free, NeuroncapBackend(PAPER)), LogReplay())
    scores = score_episode(free, found)
    assert found.neuroncap is not None and scores.nuplan is None and scores.hd is None
    with pytest.raises(InputError, match="four seconds on"):
        run_episode(staged(scene_on_straight_road((), seconds=4.0), CODE), Watching())


def test_a_planner_sees_the_engines_motion_and_command() -> None:
    seen = any_engine_seen.seen_by(Watching(speed=8.0), scene_on_straight_road((), ego_speed=8.0, seconds=6.0), CODE)
    row = seen[-1].ego.can_motion
    assert row is not None and row[5] == pytest.approx(9.8) and row[0] == pytest.approx(8.0, abs=0.3)
    assert all(each.command is Command.STRAIGHT for each in seen)


def test_a_planner_sees_who_is_put_in_and_nobody_who_is_gone() -> None:
    planner = Peeking(speed=8.0)
    run_episode(replace(staged(LONG, NeuroncapBackend(PAPER, OWN)), family="frontal"), planner)
    here = [int(revealed.agents.valid[:, -1].sum()) for revealed in planner.revealed]
    assert max(here) == 1


def test_the_engine_is_part_of_the_key_of_a_drive(tmp_path: Path) -> None:
    makers = [type(make_backend(engine)).__name__ for engine in list_engines()]
    assert makers == ["DefaultBackend", "NeuroncapBackend", "NeuroncapBackend"]
    planner = Straight()
    driven(tmp_path, planner)
    calls = planner.calls
    driven(tmp_path, planner, SETTINGS)
    assert planner.calls > calls and len(list(tmp_path.rglob("drive.json"))) == 2


def test_scenarios_are_driven_by_family_and_by_run_and_grouped(tmp_path: Path) -> None:
    data = FakeData({LONG.name: LONG})
    drawing = replace(SETTINGS, maker=NeuroncapBackend(PAPER, OWN), scenarios=OWN, runs=2)
    record = driven(tmp_path / "1", Straight(), drawing, data)
    units = [(row.family, row.run) for row in record.rows]
    assert units == [(family, run) for family in ("stationary", "frontal", "side") for run in range(2)]
    assert record.facts.runs == 2 and len({row.ticks.time_us[0] for row in record.rows[:2]}) > 1
    columns = record.summary.columns
    of_families = [columns[f"collision_{family}"].value or 0.0 for family in ("stationary", "frontal", "side")]
    assert columns["collision"].value == pytest.approx(np.mean(of_families))
    # Eight metres a second straight on is what the recorded ego does: everybody is met.
    assert columns["collision_stationary"].value == 1.0
    before, planner = bytes_below(tmp_path / "1"), Straight()
    driven(tmp_path / "4", Straight(), replace(drawing, together=4), data)
    assert bytes_below(tmp_path / "4") == before
    assert len(driven(tmp_path / "1", planner, replace(drawing, runs=1), data).rows) == 3
    driven(tmp_path / "1", planner, drawing, data)
    # Who asks for fewer runs loses none.
    assert planner.calls == 0
    assert bytes_below(tmp_path / "1") == before and rescore_drives(record.directory, data).rows == record.rows
    assert record.facts.measured.world == "neuroncap@paper, own scenarios"


def test_scenes_without_scenarios_are_a_sentence(tmp_path: Path) -> None:
    for which in (OWN, OFFICIAL):
        settings = replace(SETTINGS, maker=NeuroncapBackend(PAPER, which), scenarios=which)
        with pytest.raises(InputError, match=f"has {which} scenarios"):
            driven(tmp_path, Straight(), settings)
