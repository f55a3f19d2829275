"""What planners cost while they drive: noted beside records, shown, and no part of them."""

from dataclasses import replace
from pathlib import Path

from benchmark.machine.workers import LocalProcesses
from benchmark.planning import Observation, Plan
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.planner_cost import PlannerCost, cost_path, read_cost
from benchmark.records.record_costs import with_drive_cost
from benchmark.runs.driving import DriveSettings, drive_planners, drive_shard, drive_split
from benchmark.runs.units import Shard
from leaderboard.tables.runtime import drive_cost_table
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.planners import Factory, Straight
from tests.benchmark.runs.test_driving import SETTINGS, town


def noting(tmp_path: Path) -> DriveSettings:
    return replace(SETTINGS, timings=tmp_path / "timings")


def noted(tmp_path: Path, record: DriveRecord) -> PlannerCost:
    """What was noted of a record, as the leaderboard finds it."""
    found = with_drive_cost(load_drives(record.directory), [tmp_path / "drives"], lambda _: tmp_path / "timings")
    assert found.cost is not None and found == record
    return found.cost


class Slow(Straight):
    """Takes its time, and cannot plan at its third sample."""

    def plan(self, observation: Observation) -> Plan:
        if self.calls == 2:
            raise ValueError("no idea")
        return super().plan(observation)


def test_every_plan_of_a_drive_is_timed_and_the_record_stays_the_same(tmp_path: Path) -> None:
    drive_split(town(), "val", Straight(), tmp_path / "plain", SETTINGS)
    record = drive_split(town(), "val", Straight(0.01), tmp_path / "drives", noting(tmp_path))
    assert bytes_below(tmp_path / "drives") == bytes_below(tmp_path / "plain")
    cost = noted(tmp_path, record)
    assert list(cost.scenes) == ["scene-9901-0", "scene-9902-0"]
    for row, spent in zip(record.rows, cost.scenes.values(), strict=True):
        assert len(spent.latency_s) == len(row.plans)
        assert all(latency is not None and latency >= 0.01 for latency in spent.latency_s)
        assert spent.planning_s >= 0.01 * len(spent.latency_s)
        assert spent.device and spent.workers == 1
        assert spent.peak_memory_mb is None or spent.peak_memory_mb > 10.0


def test_a_plan_that_was_not_made_has_no_latency(tmp_path: Path) -> None:
    record = drive_split(town(), "val", Slow(), tmp_path / "drives", replace(noting(tmp_path), limit=1))
    (spent,) = noted(tmp_path, record).scenes.values()
    assert record.rows[0].status == "failed"
    assert len(spent.latency_s) == 3 and spent.latency_s[-1] is None and None not in spent.latency_s[:-1]


def test_processes_and_shards_note_the_same_drives(tmp_path: Path) -> None:
    whole = replace(noting(tmp_path), executor=LocalProcesses(2))
    (record,) = drive_planners(town(), "val", [Factory(Straight)], tmp_path / "drives", whole, reopen=town)
    assert {spent.workers for spent in noted(tmp_path, record).scenes.values()} == {2}
    other = replace(SETTINGS, timings=tmp_path / "other-timings")
    for number in (1, 2):
        drive_shard(town(), "val", [Factory(Straight)], tmp_path / "other", other, Shard(number, 2), reopen=town)
    (merged,) = drive_planners(town(), "val", [Factory(Straight)], tmp_path / "other", other, reopen=town)
    gathered = read_cost(cost_path(tmp_path / "other-timings", tmp_path / "other", merged.directory))
    assert gathered is not None and list(gathered.scenes) == list(noted(tmp_path, record).scenes)
    assert len(list((tmp_path / "other-timings").rglob("*.json"))) == 1


def test_the_leaderboard_shows_them(tmp_path: Path) -> None:
    record = drive_split(town(), "val", Straight(0.01), tmp_path / "drives", noting(tmp_path))
    table = drive_cost_table("fake", [replace(record, cost=noted(tmp_path, record))])
    assert table is not None
    (row,) = table.plain(wide=True).splitlines()[2:3]
    assert "straight" in row and "val, default, agents replay, sensor none" in row
    assert drive_cost_table("fake", [record]) is None
