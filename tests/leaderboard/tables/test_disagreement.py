"""The disagreement table: every count from rows alone, and no cause where the record has none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.evaluation import evaluate
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.records.run import RunRecord, load_record
from benchmark.report.cells import UNDEFINED
from benchmark.report.table import Table
from leaderboard.tables.disagreement import disagreement_table
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Failing, Straight
from tests.leaderboard.csv_rows import csv_rows


class TowardsTheOncomingLane:
    """Drifts left, close to a car that comes on."""

    name = "drifting"

    def reset(self, scene: SceneInfo) -> None:
        pass

    def plan(self, observation: Observation) -> Plan:
        ahead = 4.0 * np.arange(1, 7)
        return Plan(np.column_stack([ahead, np.full(6, 1.8)]), PlanFrame.EGO)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[RunRecord]:
    out = tmp_path_factory.mktemp("runs")
    data = town_of_two(slow_leader=True)
    return [evaluate(data, "val", planner, out) for planner in (Straight(), TowardsTheOncomingLane(), Failing())]


def rows_of(table: Table) -> list[dict[str, str]]:
    return csv_rows(table.csv())


def test_one_row_for_each_planner_and_protocol_but_exact_from_rows_alone(runs: list[RunRecord]) -> None:
    table = disagreement_table("fake", "val", runs)
    rows = rows_of(table)
    assert len(rows) == 3 * 5
    assert {row["protocol"] for row in rows} == {"uniad", "vad", "vad-23", "sparsedrive", "diffusiondrive"}
    assert [row["planner"] for row in rows] == sorted(row["planner"] for row in rows)
    assert disagreement_table("fake", "val", [load_record(record.directory) for record in runs][::-1]) == table


def test_counts_add_up(runs: list[RunRecord]) -> None:
    rows = rows_of(disagreement_table("fake", "val", runs))
    assert any(row["misses"][0] != "0" or row["false alarms"][0] != "0" for row in rows)
    for row in rows:
        misses, false_alarms = (int(row[head].split()[0]) for head in ("misses", "false alarms"))
        causes = {head: int(count) for head, count in row.items() if ": " in head}
        assert sum(count for head, count in causes.items() if head.startswith("miss")) == misses
        assert sum(count for head, count in causes.items() if head.startswith("false")) == false_alarms
        assert int(row["exact +"]) - misses == int(row["official +"]) - false_alarms


def test_records_of_other_splits_or_without_exact_do_not_appear(runs: list[RunRecord], tmp_path: Path) -> None:
    assert disagreement_table("fake", "adv", runs).rows == ()
    assert disagreement_table("other", "val", runs).rows == ()
    protocols = {name: version for name, version in runs[0].run.protocols.items() if name != "exact"}
    without = replace(runs[0], run=runs[0].run.model_copy(update={"protocols": protocols}))
    assert disagreement_table("fake", "val", [without]).rows == ()


def test_a_record_that_says_no_causes_shows_none_and_names_itself(runs: list[RunRecord]) -> None:
    old = replace(runs[0], rows=tuple(row.model_copy(update={"disagreements": {}}) for row in runs[0].rows))
    same, table = disagreement_table("fake", "val", runs), disagreement_table("fake", "val", [old, *runs[1:]])
    assert len(same.notes) + 1 == len(table.notes)
    unknown = [row for row in table.rows if UNDEFINED in row]
    assert unknown and all(row[0] == runs[0].planner for row in unknown)
    for row, known in zip(table.rows, same.rows):
        assert row[:7] == known[:7] and row[-3:] == known[-3:]


def test_failed_samples_are_not_compared(runs: list[RunRecord]) -> None:
    rows = {(row["planner"], row["protocol"]): row for row in rows_of(disagreement_table("fake", "val", runs))}
    failed = runs[2].summary.failed
    assert failed > 0
    assert int(rows["failing", "uniad"]["samples"]) <= int(rows["straight", "uniad"]["samples"])
    planned = [row for row in runs[2].rows if row.status == "ok" and row.complete]
    assert int(rows["failing", "vad"]["samples"]) == len(planned)


def test_failures_missing_scenes_and_earlier_versions_are_said(runs: list[RunRecord]) -> None:
    table = disagreement_table("fake", "val", runs)
    assert any(note.startswith("failing on val: 2 samples failed. The rates cover") for note in table.notes)
    assert not any("‡" in cell for row in table.rows for cell in row)
    run = runs[0].run
    update = {"protocols": {**run.protocols, "vad": 0}, "scenes_in_split": 9}
    old = replace(runs[0], run=run.model_copy(update=update))
    table = disagreement_table("fake", "val", [old])
    assert [row[1] for row in table.rows if row[1].startswith("vad")] == ["vad ‡", "vad-23"]
    assert any("‡ straight on val: scored by version 0 of protocol vad, now" in note for note in table.notes)
    assert "straight on val: 2 of 9 scenes of the split." in table.notes
