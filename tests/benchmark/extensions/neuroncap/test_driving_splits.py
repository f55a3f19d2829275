"""Splits that NeuroNCAP's engine drives through: kept, repeated and grouped as any are, by family and by run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.closed_loop.engines import list_engines, make_backend
from benchmark.closed_loop.episodes import run_episode
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.simulation_state import NeuroncapBackend
from benchmark.records.drive_schema import OFFICIAL, OWN
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches
from benchmark.runs.driving import DriveSettings
from benchmark.runs.rescoring_drives import rescore_drives
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.closed_loop.staged import Peeking, staged
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import Straight
from tests.benchmark.runs import test_driving as any_world
from tests.benchmark.runs import test_driving_together as any_world_together
from tests.benchmark.runs.test_driving import driven
from tests.hand_made import scene_on_straight_road

PAPER = NeuroncapSwitches.named("neuroncap@paper")
NEURONCAP = DriveSettings("neuroncap@paper", NeuroncapBackend(PAPER))


def test_every_engine_has_rides() -> None:
    assert [type(make_backend(engine)).__name__ for engine in list_engines()] == [
        "DefaultBackend",
        "NeuroncapBackend",
        "NeuroncapBackend",
    ]


def test_the_engine_is_part_of_the_key_of_a_drive(tmp_path: Path) -> None:
    planner = Straight()
    driven(tmp_path, planner)
    calls = planner.calls
    driven(tmp_path, planner, NEURONCAP)
    assert planner.calls > calls and len(list(tmp_path.rglob("drive.json"))) == 2


def test_a_scenario_that_draws_nothing_is_driven_once(tmp_path: Path) -> None:
    any_world.test_a_scenario_that_draws_nothing_is_driven_once(NEURONCAP, tmp_path)


def test_a_drive_is_repeated_without_its_planner(tmp_path: Path) -> None:
    any_world.test_a_drive_is_repeated_without_its_planner(NEURONCAP, tmp_path)


def test_a_record_is_scored_anew_without_its_planner(tmp_path: Path) -> None:
    any_world.test_a_record_is_scored_anew_without_its_planner(NEURONCAP, tmp_path)


def test_the_grouping_changes_no_byte(tmp_path: Path) -> None:
    any_world_together.test_the_grouping_changes_no_byte(NEURONCAP, tmp_path)


def test_a_planner_that_fails_takes_nobody_with_it() -> None:
    any_world_together.test_a_planner_that_fails_takes_nobody_with_it(NEURONCAP.maker)


def test_runs_of_scenarios_are_grouped_too(tmp_path: Path) -> None:
    scene = scene_on_straight_road(seconds=13.0)
    data = FakeData({scene.name: scene})
    settings = DriveSettings("neuroncap@paper", NeuroncapBackend(PAPER, OWN), scenarios=OWN, runs=2)
    for together in (1, 4):
        any_world_together.driven(tmp_path / str(together), replace(settings, together=together), data=data)
    assert bytes_below(tmp_path / "1") == bytes_below(tmp_path / "4")


def test_scenarios_are_driven_by_family_and_by_run(tmp_path: Path) -> None:
    scene = scene_on_straight_road(seconds=13.0)
    data = FakeData({scene.name: scene})
    drawing = replace(NEURONCAP, maker=NeuroncapBackend(PAPER, OWN), scenarios=OWN, runs=3)
    record = driven(tmp_path, Straight(), drawing, data)
    units = [(row.family, row.run) for row in record.rows]
    assert units == [(family, run) for family in ("stationary", "frontal", "side") for run in range(3)]
    assert record.facts.runs == 3 and len({row.ticks.time_us[0] for row in record.rows[:3]}) > 1
    columns = record.summary.columns
    of_families = [columns[f"collision_{family}"].value or 0.0 for family in ("stationary", "frontal", "side")]
    assert columns["collision"].value == pytest.approx(np.mean(of_families))
    # Eight metres a second straight on is what the recorded ego does: everybody is met.
    assert columns["collision_stationary"].value == 1.0
    before, planner = bytes_below(tmp_path), Straight()
    assert len(driven(tmp_path, planner, replace(drawing, runs=1), data).rows) == 3
    driven(tmp_path, planner, drawing, data)
    # Who asks for fewer runs loses none.
    assert planner.calls == 0
    assert bytes_below(tmp_path) == before and rescore_drives(record.directory, data).rows == record.rows
    assert record.facts.measured.world == "neuroncap@paper, own scenarios"


def test_scenes_without_scenarios_are_a_sentence(tmp_path: Path) -> None:
    for which in (OWN, OFFICIAL):
        settings = replace(NEURONCAP, maker=NeuroncapBackend(PAPER, which), scenarios=which)
        with pytest.raises(InputError, match=f"has {which} scenarios"):
            driven(tmp_path, Straight(), settings)


def test_a_planner_sees_who_is_put_in_and_nobody_who_is_gone() -> None:
    scene = scene_on_straight_road(seconds=13.0)
    planner = Peeking(speed=8.0)
    run_episode(replace(staged(scene, NeuroncapBackend(PAPER, OWN)), family="frontal"), planner)
    for revealed in planner.revealed:
        here = revealed.agents.valid[:, -1]
        assert here.sum() <= 1
    assert any(revealed.agents.valid[:, -1].any() for revealed in planner.revealed)
