"""The paper's numbers beside ours: only beside the same model under the same protocol."""

import dataclasses
from pathlib import Path

import pytest

from benchmark.published import TABLE_1
from benchmark.records.run import RunRecord
from benchmark.report.cells import UNDEFINED
from benchmark.report.table import Table
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.collision import collision_table
from leaderboard.tables.published import published_quality_table
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made

SCENES = {"s0": [HIT, CLEAN], "s1": [CLEAN, CLEAN]}


def run(planner: str, native: str | None, split: str = "adv") -> RunRecord:
    return hand_made(planner, SCENES, split=split, protocols=("exact", "uniad", "vad"), native=native)


def paper_of(table: Table, planner: str) -> tuple[str, ...]:
    (row,) = [row for row in table.rows if row[0] == planner]
    return row[table.columns.index("paper 1s") :]


def test_the_papers_row_stands_beside_the_model_of_that_name_under_its_protocol() -> None:
    runs = DataSetRuns("d", [run("uniad", "uniad"), run("vad-mini", "vad"), run("idm", None)])
    table, of_uniad = collision_table(runs, "native"), collision_table(runs, "uniad")
    assert paper_of(table, "uniad") == ("0.80", "4.10", "6.96", "3.95")
    assert paper_of(table, "idm") == paper_of(table, "vad-mini") == (UNDEFINED,) * 4
    assert table.groups[-1] == ("paper, collision rate in %, own protocol", 4)
    assert table.sources and any("No published row is shown for vad-mini:" in note for note in table.notes)
    assert paper_of(of_uniad, "uniad")[3] == "3.95"
    assert not any(note.startswith("No published row") for note in of_uniad.notes)


@pytest.mark.parametrize("protocol", ["exact", "vad"])
def test_under_another_protocol_nothing_stands_beside(protocol: str) -> None:
    table = collision_table(DataSetRuns("d", [run("uniad", "uniad")]), protocol)
    assert not any(column.startswith("paper") for column in table.columns) and table.sources == ()


@pytest.mark.parametrize("name", ["uniad-mini", "uniad-unoptimised", "vad-tiny", "mine"])
def test_a_variant_is_not_the_model(name: str) -> None:
    table = collision_table(DataSetRuns("d", [run(name, "vad" if "vad" in name else "uniad")]), "native")
    assert "paper 1s" not in table.columns
    said = [note for note in table.notes if note.startswith("No published row")]
    assert any(name in note for note in said) == (name != "mine")


def test_a_planner_says_itself_what_the_paper_calls_it_and_that_it_is_a_miniature() -> None:
    def said(record: RunRecord, **facts: str | bool) -> RunRecord:
        planner = record.run.planner.model_copy(update=facts)
        return dataclasses.replace(record, run=record.run.model_copy(update={"planner": planner}))

    ours, small = said(run("my-uniad", "uniad"), published_as="UniAD"), said(run("vad", "vad"), miniature=True)
    table = collision_table(DataSetRuns("d", [ours, small]), "native")
    assert paper_of(table, "my-uniad")[3] == "3.95" and paper_of(table, "vad §") == (UNDEFINED,) * 4
    assert any("No published row is shown for vad:" in note for note in table.notes)


def test_every_published_row_finds_its_place() -> None:
    splits = {"nuScenes-val": "val", "nuScenes-val-R": "val-r", "Adv-nuSc": "adv"}
    for row in TABLE_1:
        name, protocol = row.model.lower(), row.protocol
        record = hand_made(name, SCENES, split=splits[row.data_set], protocols=(protocol,), native=protocol)
        assert paper_of(collision_table(DataSetRuns("d", [record]), "native"), name)[:4] == row.percent


def test_published_values_of_quality_are_those_of_the_paper() -> None:
    source = Path(__file__).parents[4] / "shared" / "paper" / "challenger.tex"
    if not source.is_file():
        pytest.skip("the paper is not here")
    text = source.read_text()
    for name, consistency, imaging in published_quality_table().rows:
        assert any(line.split()[:1] == [name] and consistency in line and imaging in line for line in text.splitlines())
