"""Plans of drives are compared where the ego still is where it was recorded, with 3 s of recording ahead."""

from pathlib import Path

import numpy as np
import pytest

from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.records.drive_schema import EpisodeRow
from benchmark.runs.drive_rows import NEAR_M, NEAR_M_S, NEAR_RAD, compare_drive
from benchmark.runs.driving import DriveSettings, drive_split
from benchmark.runs.rescoring_drives import rescore_drives
from benchmark.scene import Scene
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Straight
from tests.benchmark.untrusted.running import Sideways


@pytest.fixture
def driven(tmp_path: Path) -> tuple[Scene, EpisodeRow]:
    """A planner that drives as the recorded car does, straight at 8 m/s."""
    data = town_of_two()
    row = drive_split(data, "val", Straight(), tmp_path, DriveSettings("default", DefaultBackend())).rows[0]
    return data.scene(row.scene), row


def test_plans_that_drive_as_recorded_are_all_compared_but_the_last(driven: tuple[Scene, EpisodeRow]) -> None:
    scene, row = driven
    found = compare_drive(scene, row)
    end_us = int(scene.timestamps_us[-1])
    assert len(found.plan) == sum(time_us + 3_000_000 <= end_us for time_us in row.ticks.time_us[: len(row.plans)]) > 3
    assert np.abs(found.plan - found.recorded).max() < 0.05


@pytest.mark.parametrize(("column", "by"), [(0, NEAR_M), (1, NEAR_M), (2, NEAR_RAD), (3, NEAR_M_S)])
def test_an_instant_at_which_the_ego_is_elsewhere_is_not(
    driven: tuple[Scene, EpisodeRow], column: int, by: float
) -> None:
    scene, row = driven
    ego = [list(state) for state in row.ticks.ego]
    ego[1][column] += 1.1 * by
    moved = row.model_copy(update={"ticks": row.ticks.model_copy(update={"ego": ego})})
    assert len(compare_drive(scene, moved).plan) == len(compare_drive(scene, row).plan) - 1


def test_a_drive_without_a_plan_has_none(driven: tuple[Scene, EpisodeRow]) -> None:
    scene, row = driven
    assert compare_drive(scene, row.model_copy(update={"plans": []})).plan.shape == (0, 6, 2)


def test_finished_drives_keep_what_was_compared_and_scored_anew_they_say_the_same(tmp_path: Path) -> None:
    data = town_of_two()
    settings = DriveSettings("default", DefaultBackend())
    first = drive_split(data, "val", Sideways(), tmp_path, settings)
    again = drive_split(data, "val", Sideways(), tmp_path, settings)
    assert again.facts.caveats == first.facts.caveats == rescore_drives(first.directory, data).facts.caveats
