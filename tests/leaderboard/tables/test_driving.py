"""The table of driving scores: numbers from records, marks, and what it must not be taken for."""

from dataclasses import replace

import pytest

from benchmark.evaluation import EvalSettings, evaluate
from benchmark.pdm.definition import VERSION
from benchmark.records.run import RunRecord
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.collision import run_tables
from leaderboard.tables.contents import build_data_set_tables
from leaderboard.tables.driving import driving_table
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Straight
from tests.leaderboard.csv_rows import csv_rows


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """Drives on at 8 m/s and so into the slow leader of the second scene."""
    out = tmp_path_factory.mktemp("runs")
    return evaluate(town_of_two(slow_leader=True), "val", Straight(), out, EvalSettings(protocols=("exact",)))


def without_driving(record: RunRecord) -> RunRecord:
    return replace(record, summary=record.summary.model_copy(update={"driving": None}))


def test_a_row_holds_means_shares_filtered_scores_and_counts(record: RunRecord) -> None:
    table = driving_table(DataSetRuns("town", [record]))
    (row,) = csv_rows(table.csv())
    summary = record.summary.driving
    assert summary is not None and len(table.rows) == 1
    cells = dict(zip(table.columns, table.cells[0])) if table.cells else {}
    for head, column in {"score": "score", "NC": "nc", "HC": "hc", "filtered NC": "filtered_nc"}.items():
        cell, rate = cells[head], summary.columns[column]["mean"]
        assert (
            cell is not None and cell.value == pytest.approx(100 * (rate.value or 0.0)) and cell.n == rate.denominator
        )
        assert cell.protocol == "nuscenes-pdm" and cell.unit == "%"
    share = cells["NC = 1"]
    assert share is not None and share.value == pytest.approx(100 * (summary.columns["nc"]["ones"].value or 0.0))
    assert share.value is not None and 0.0 < share.value < 100.0
    assert any(value == "20" for value in row.values())


def test_it_says_what_it_is_not_and_never_borrows_the_name_of_the_score(record: RunRecord) -> None:
    table = driving_table(DataSetRuns("town", [record]))
    for text in (table.plain(), table.plain(wide=True), table.markdown(), table.latex(), table.csv()):
        assert "EPDMS" not in text and "PDMS" not in text
    for words in ("no traffic lights", "3 s", "recorded path", "its numbers "):
        assert words in " ".join(table.markdown().split())
    assert "nuscenes-pdm" in table.plain() and "filtered" not in table.plain()


def test_runs_without_scores_and_of_earlier_versions_are_named(record: RunRecord) -> None:
    driving = record.summary.driving
    assert driving is not None
    older = driving.model_copy(update={"version": VERSION - 1})
    stale = replace(record, summary=record.summary.model_copy(update={"driving": older}))
    table = driving_table(DataSetRuns("town", [stale]))
    assert "‡" in table.rows[0][0] and f"now {VERSION}; run challenger-bench rescore" in table.markdown()
    table = driving_table(DataSetRuns("town", [without_driving(record)]))
    assert table.rows == () and "no driving scores; challenger-bench rescore" in table.markdown()


def test_it_stands_where_it_is_asked_for_and_where_there_are_scores(record: RunRecord) -> None:
    assert [table.name for table in run_tables("town", [record], ("pdm", "exact"))] == ["pdm", "collision-exact"]
    assert [table.name for table in run_tables("town", [record])] == ["collision-exact"]
    for run, there in ((record, True), (without_driving(record), False)):
        front = build_data_set_tables(DataSetRuns("town", [run])).front
        assert ("pdm" in [table.name for table in front]) is there
