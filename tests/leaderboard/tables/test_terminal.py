"""What tables look like in a terminal, and the mark of miniatures in every form of every table."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import pytest

from adapters.models import baselines, miniatures
from benchmark.records.planner_versions import label_versions
from benchmark.records.run import RunRecord
from benchmark.report.cells import MINIATURE_MARK, RANKS_NOTHING
from benchmark.report.table import Table, format_tables
from leaderboard.frame.rows import FEW_NOTE, MINIATURE_NOTE
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.collision import run_tables
from leaderboard.tables.contents import build_data_set_tables
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made
from tests.leaderboard.made_up import study
from tests.leaderboard.tables.test_table_facts import every_table, explained, records

LONG = "the-planner-of-somebody-who-likes-long-names-and-says-which-checkpoint-it-is"
PROTOCOLS = ("exact", "uniad", "vad")
SPLITS = {"val": {"s0": [HIT, CLEAN], "s1": [CLEAN]}, "adv": {"s0-1": [HIT, HIT], "s1-1": [CLEAN, HIT]}}


def runs(names: Sequence[str], miniature: str | None = None) -> list[RunRecord]:
    found = []
    for name, (split, scenes) in product(names, SPLITS.items()):
        record = explained(hand_made(name, scenes, split=split, protocols=PROTOCOLS, native="uniad"))
        planner = record.run.planner.model_copy(update={"miniature": name == miniature})
        found.append(replace(record, run=record.run.model_copy(update={"planner": planner})))
    return label_versions(found)


@pytest.fixture(scope="module")
def made() -> list[Table]:
    """Every table of records with long and with many names."""
    of_long = [study(LONG).table(), *build_data_set_tables(DataSetRuns("d", runs((LONG, f"{LONG}-2")))).tables]
    return [*every_table([*records(), *runs([f"{LONG}-{number}" for number in range(9)])]), *of_long]


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_table_is_wider_than_the_terminal(made: list[Table], width: int) -> None:
    assert len(made) > 40
    for table in made:
        fits(table, width)


def fits(table: Table, width: int) -> None:
    for line in table.plain(width=width).splitlines():
        assert len(line) <= width, (table.name, line)


def test_the_terminal_is_asked_for_its_width_and_is_80_where_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    table = build_data_set_tables(DataSetRuns("d", runs((LONG, "b")))).tables[0]
    monkeypatch.delenv("COLUMNS", raising=False)
    assert table.plain() == table.plain(width=80)
    monkeypatch.setenv("COLUMNS", "100")
    assert table.plain() == table.plain(width=100) != table.plain(width=80)


def test_every_cell_of_a_table_is_somewhere_in_its_blocks() -> None:
    for table in every_table(runs([f"planner-{number}" for number in range(5)])):
        shows_its_cells(table)


def shows_its_cells(table: Table) -> None:
    shown = range(len(table.columns)) if table.brief is None else table.brief.columns
    text = "".join(table.plain(width=80).split())
    for row in table.rows:
        for place in shown[table.text_columns :]:
            assert row[place].replace(" ", "") in text, (table.name, row[place])


def test_what_an_evaluation_prints_is_average_interval_l2_and_failed_scenes() -> None:
    own = {"attack-success", "effect"}
    tables = [table for table in run_tables("d", runs(("a", "b"))) if table.name not in own]
    assert tables
    for table in tables:
        heads = table.plain(width=100).splitlines()[1]
        assert "planner" in heads and "split" in heads
        for head in ("col. avg", "95 % of avg", "L2 avg", "scenes failed"):
            assert head in heads
        assert "L2 1s" not in table.plain(width=80) and "coverage" not in table.plain(width=80)
        assert "--wide shows" in table.plain(width=80)
        wide = table.plain(wide=True, width=80)
        assert "--wide" not in wide and all(head in wide.splitlines()[1] for head in table.columns)
        assert all(len(line) <= 80 for line in wide.splitlines()[2 + len(table.rows) :])


def printed(*names: str, miniature: str | None = None, verbose: bool = False, wide: bool = False) -> str:
    """What an evaluation prints of planners, in a terminal of 100 columns."""
    tables = run_tables("demo", runs(names, miniature))
    return format_tables(tables, wide=wide, verbose=verbose, width=100)


def test_the_main_table_of_the_demo_is_one_block_of_a_hundred_columns_and_notes_stand_once_below() -> None:
    names = [*baselines(), *miniatures()]
    text = printed(*names, miniature=names[-1])
    main, *_, notes = text.split("\n\n")
    lines = main.splitlines()
    assert lines[0].startswith("demo: effect of the adversary") and all(len(line) <= 100 for line in text.splitlines())
    assert sum(line.split()[0] in names for line in lines[1:]) == len(names) == 12
    assert {"difference", "split", "rank,"} <= {word for line in lines[1:4] for word in line.split()}
    assert notes.endswith("--wide shows all columns, -v explains them.")
    assert text.count(MINIATURE_NOTE) == notes.count(MINIATURE_NOTE) == notes.count(FEW_NOTE) == 1


def test_notes_are_those_that_rows_need_and_all_of_them_on_request() -> None:
    assert MINIATURE_MARK not in printed("a", "b") and MINIATURE_MARK in printed("a", "b", miniature="b")
    brief, full = printed("a"), printed("a", verbose=True)
    told = " ".join(full.split())
    for table in run_tables("demo", runs(["a"])):
        assert all(" ".join(note.split()) in told for note in table.remarks), table.name
    assert "Brackets: " in full and "Brackets: " not in brief and "-v explains" not in full
    assert "--wide" not in printed("a", wide=True) and "-v explains the columns." in printed("a", wide=True)


def test_miniatures_are_marked_in_every_form_of_every_table() -> None:
    every = build_data_set_tables(DataSetRuns("d", runs(("small", "large"), "small"))).tables
    # Those of the data alone have no rows of planners.
    tables = [table for table in every if any("small" in cell for row in table.rows for cell in row)]
    assert len(tables) > 12
    for table in tables:
        for text in (table.plain(width=4000), table.markdown(), table.latex()):
            assert RANKS_NOTHING in text and f"small {MINIATURE_MARK}" in text.replace(r"\S{}", MINIATURE_MARK), (
                table.name
            )
            assert f"large {MINIATURE_MARK}" not in text.replace(r"\S{}", MINIATURE_MARK)
        rows = list(csv.DictReader(io.StringIO(table.csv())))
        facts = json.loads(json.dumps(table.as_json()))
        assert len(rows) == len(facts["miniatures"]) == len(table.rows)
        for row, miniature, cells in zip(rows, facts["miniatures"], table.rows, strict=True):
            assert miniature == any("small" in cell for cell in cells)
            assert row["miniature"] == (RANKS_NOTHING if miniature else "")


def test_where_no_miniature_ran_there_is_no_mark_and_an_ablation_with_one_says_so() -> None:
    for table in build_data_set_tables(DataSetRuns("d", runs(("small", "large")))).tables:
        assert RANKS_NOTHING not in table.markdown() and "miniature" not in table.csv()
        assert json.loads(json.dumps(table.as_json()))["miniatures"] == []
    plain = study("small")
    marked = plain.model_copy(update={"planner": plain.planner.model_copy(update={"miniature": True})})
    for report, said in ((marked, True), (plain, False)):
        assert (RANKS_NOTHING in " ".join(report.table().plain().split())) is said
