"""Tables of video quality keep what every table keeps: facts behind numbers, JSON, LaTeX, the width of a terminal."""

import pytest

from benchmark.report.table import Table
from leaderboard.extensions.quality.tables import quality_tables
from tests.leaderboard.extensions.quality.test_tables import made
from tests.leaderboard.tables import test_table_facts as any_table
from tests.leaderboard.tables.test_terminal import fits, shows_its_cells


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> list[Table]:
    folder = tmp_path_factory.mktemp("quality")
    return quality_tables([made(folder, split) for split in ("val", "adv")])


def test_every_number_is_that_of_its_cell(tables: list[Table]) -> None:
    assert [table.name for table in tables] == ["quality-boxes"]
    for table in tables:
        any_table.check(table)


def test_every_number_is_in_one_group_and_heads_differ(tables: list[Table]) -> None:
    any_table.test_every_number_is_in_one_group_and_heads_differ(tables)


def test_json_reads_back_and_latex_is_balanced(tables: list[Table]) -> None:
    any_table.test_json_of_every_table_reads_back(tables)
    any_table.test_latex_is_balanced_and_every_line_has_all_columns(tables)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_table_is_wider_than_the_terminal(tables: list[Table], width: int) -> None:
    for table in tables:
        fits(table, width)
        shows_its_cells(table)
