"""Tables of diagnoses: counts, shares and intervals from records, and what is said where there are none."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from adapters.planners.idm import IntelligentDriver
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.records.row_schema import CAUSES, DiagnosisRow
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import SceneFacts
from benchmark.report.table import Table
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.diagnosis import diagnosis_tables
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Straight
from tests.leaderboard.csv_rows import csv_rows


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """Drives on at 8 m/s and so into the slow leader of the second scene; gives no forecasts."""
    return evaluate(town_of_two(slow_leader=True), "adv", Straight(), tmp_path_factory.mktemp("straight"))


def rows_of(table: Table) -> list[dict[str, str]]:
    return csv_rows(table.csv())


def tables_of(*records: RunRecord) -> dict[str, Table]:
    return {table.name: table for table in diagnosis_tables(DataSetRuns("town", records))}


def diagnosed_as(record: RunRecord, *reasons: tuple[str, str]) -> RunRecord:
    """The colliding samples get these causes and reasons in turn."""
    rows, turn = [], 0
    for row in record.rows:
        if row.diagnosis is not None:
            cause, reason = reasons[turn % len(reasons)]
            turn += 1
            found = DiagnosisRow.model_validate({**row.diagnosis.model_dump(), "cause": cause, "reason": reason})
            row = row.model_copy(update={"diagnosis": found})
        rows.append(row)
    return replace(record, rows=tuple(rows))


def named(record: RunRecord, planner: str) -> RunRecord:
    facts = record.run.planner.model_copy(update={"name": planner})
    return replace(record, run=record.run.model_copy(update={"planner": facts}))


def with_manoeuvres(record: RunRecord, manoeuvres: Mapping[str, str | None]) -> RunRecord:
    facts = {name: SceneFacts(source=name, manoeuvre=kind) for name, kind in manoeuvres.items()}
    return replace(record, run=record.run.model_copy(update={"scene_facts": facts}))


def counted(record: RunRecord) -> list[bool]:
    return [any(row.outcomes["exact"].collision or ()) for row in record.rows if row.outcomes["exact"].counted]


def test_without_forecasts_every_collision_is_not_attributable(straight: RunRecord) -> None:
    tables = tables_of(straight)
    # Without labels there is no table by manoeuvre.
    assert list(tables) == ["diagnosis", "diagnosis-cases"]
    (row,) = rows_of(tables["diagnosis"])
    collisions = counted(straight)
    assert sum(collisions) > 1
    assert (row["planner"], row["split"]) == ("straight", "adv")
    assert (row["samples"], row["colliding"]) == (str(len(collisions)), str(sum(collisions)))
    assert [row[cause] for cause in CAUSES] == ["0.0", "0.0", "0.0", "100.0"]


def test_shares_are_those_of_the_colliding_samples(straight: RunRecord) -> None:
    clear, hits, unseen = reasons = [
        ("misforecast", "plan clear of forecast"), ("misplanned", "plan hits forecast"), ("unseen", "no forecast near")
    ]  # fmt: skip
    collisions = sum(counted(straight))
    tables = tables_of(diagnosed_as(straight, *reasons))
    (row,) = rows_of(tables["diagnosis"])
    for turn, (cause, _) in enumerate(reasons):
        expected = sum(each % 3 == turn for each in range(collisions)) / collisions
        assert float(row[cause]) == pytest.approx(100 * expected, abs=0.05)
    assert sum(float(row[cause]) for cause in CAUSES) == pytest.approx(100.0, abs=0.15)
    cases = rows_of(tables["diagnosis-cases"])
    assert [(case["cause"], case["case"]) for case in cases] == [unseen, clear, hits]
    assert sum(int(case["samples"]) for case in cases) == collisions


def test_by_manoeuvre_the_collision_rate_stands_beside_the_causes(straight: RunRecord) -> None:
    record = with_manoeuvres(straight, {"scene-9901": "leading", "scene-9902": "braking-ahead"})
    both = [record, named(record, "another")]
    rows = rows_of(tables_of(*both)["diagnosis-manoeuvres"])
    assert [(row["manoeuvre"], row["planner"]) for row in rows] == [
        *product(("braking-ahead", "leading"), ("another", "straight"))
    ]
    assert tables_of(*both[::-1]) == tables_of(*both)
    second = [row for row in straight.rows if row.scene == "scene-9902" and row.outcomes["exact"].counted]
    colliding = sum(any(row.outcomes["exact"].collision or ()) for row in second)
    assert float(rows[0]["col. 3s"]) == pytest.approx(100 * colliding / len(second), abs=0.005)
    assert (rows[0]["scenes"], rows[0]["colliding"], rows[0]["not attributable"]) == ("1", str(colliding), "100.0")
    # No collision is no share of a cause, and one scene has no interval.
    assert (rows[2]["col. 3s"], rows[2]["colliding"], rows[2]["95 %"]) == ("0.00", "0", "")
    assert [rows[2][cause] for cause in CAUSES] == ["", "", "", ""]


def test_frequent_manoeuvres_come_first_and_scenes_without_one_are_left_out(straight: RunRecord) -> None:
    record = with_manoeuvres(straight, {"scene-9901": None, "scene-9902": "blocking"})
    (row,) = rows_of(tables_of(record)["diagnosis-manoeuvres"])
    assert (row["manoeuvre"], row["scenes"]) == ("blocking", "1")
    same = with_manoeuvres(straight, {"scene-9901": "oncoming", "scene-9902": "oncoming"})
    (row,) = rows_of(tables_of(same)["diagnosis-manoeuvres"])
    assert (row["scenes"], row["samples"]) == ("2", str(len(counted(straight))))


def test_a_record_from_before_diagnoses_is_named_and_not_counted(straight: RunRecord) -> None:
    old = replace(straight, rows=tuple(row.model_copy(update={"diagnosis": None}) for row in straight.rows))
    (table,) = diagnosis_tables(DataSetRuns("town", [old]))
    assert table.rows == ()
    assert "straight on adv: no diagnoses in this record; run challenger-bench rescore." in table.notes
    part = replace(straight, run=straight.run.model_copy(update={"scenes_in_split": 9}))
    both = tables_of(named(old, "old"), part)["diagnosis"]
    assert [row["planner"] for row in rows_of(both)] == ["straight"]
    assert "straight on adv: 2 of 9 scenes of the split." in both.notes


def test_verdicts_of_an_earlier_exact_are_marked(straight: RunRecord) -> None:
    versions = {**straight.run.protocols, "exact": 0}
    old = replace(straight, run=straight.run.model_copy(update={"protocols": versions}))
    table = tables_of(old)["diagnosis"]
    assert [row["planner"] for row in rows_of(table)] == ["straight ‡"]
    assert any(note.startswith("‡ straight on adv: scored by version 0 of protocol exact, now") for note in table.notes)


def test_only_what_exact_judged_is_diagnosed(straight: RunRecord, tmp_path: Path) -> None:
    other = evaluate(town_of_two(), "val", Straight(), tmp_path, EvalSettings(protocols=("uniad",)))
    assert diagnosis_tables(DataSetRuns("town", [other])) == []
    assert diagnosis_tables(DataSetRuns("town", [])) == []
    assert [row["split"] for row in rows_of(tables_of(other, straight)["diagnosis"])] == ["adv"]


def test_a_planner_with_forecasts_is_attributed_from_end_to_end(tmp_path: Path) -> None:
    record = evaluate(town_of_two(slow_leader=True), "adv", IntelligentDriver(), tmp_path)
    for row in record.rows:
        assert row.plan is not None and row.plan.forecasts is not None
        assert (row.diagnosis is None) == (not any(row.outcomes["exact"].collision or ()))
        assert row.diagnosis is None or row.diagnosis.cause != "not attributable"
    (cells,) = rows_of(tables_of(record)["diagnosis"])
    assert cells["planner"] == "idm †"
