"""The figure of pressure: the numbers of its table, the same bytes each time, and none without several budgets."""

from pathlib import Path

import numpy as np
import pytest

from benchmark.report.plots import LIGHT
from leaderboard.build import build_leaderboard_files
from leaderboard.figures.pressure import PANELS, draw_pressure_figure, pressure_figures
from leaderboard.frame.results import read_results
from leaderboard.tables.pressure import group_by_pressure, pressure_tables
from tests.benchmark.records.test_drives import written
from tests.leaderboard.tables.test_pressure import HURT, SURVIVED, drives, measured, records


def test_a_line_has_the_numbers_of_the_table_the_weakest_first(tmp_path: Path) -> None:
    made = records(tmp_path)
    ((title, rows),) = group_by_pressure(made)
    (table,) = pressure_tables(made)
    panels = draw_pressure_figure(title, rows, LIGHT).get_axes()
    columns = ("attributable %", "careful survives %", "impact m/s")
    for (_, said, _), column, axes in zip(PANELS, columns, panels, strict=True):
        assert axes.get_ylabel() == said
        assert [each.get_text() for each in axes.get_xticklabels()] == ["1 x 32\n1 s", "6 x 256\n1 s"]
        # Intervals are drawn first, the planner's line last.
        drawn = np.asarray(axes.get_lines()[-1].get_ydata(), float).tolist()
        shown = [float(line[table.columns.index(column)]) for line in table.rows]
        assert drawn == pytest.approx(shown, abs=0.05)


def test_a_budget_that_a_planner_did_not_meet_is_a_gap(tmp_path: Path) -> None:
    other = {"name": "other $x$ & <y>", "privileged": False}
    more = written(tmp_path / "more", *drives(SURVIVED, HURT), measured=measured(rounds=1), planner=other)
    made = [*records(tmp_path), more]
    ((title, rows),) = group_by_pressure(made)
    figure = draw_pressure_figure(title, rows, LIGHT)
    drawn = [np.asarray(line.get_ydata(), float) for line in figure.get_axes()[0].get_lines()]
    missing = [np.isnan(each).tolist() for each in drawn if len(each) == 3]
    assert sorted(missing) == [[False, True, False], [True, False, True]]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["made", "other $x$ & <y>"]


def test_same_bytes_and_its_place_in_the_leaderboard(tmp_path: Path) -> None:
    made = records(tmp_path)
    (figure,) = pressure_figures(made)
    assert (figure,) == pressure_figures(made)
    assert not pressure_figures(made[:1])
    files = build_leaderboard_files(read_results([], drives=made), figures=True)
    (name,) = [name for name in files if name.endswith("drives-pressure.png")]
    assert files[name] == figure.png and f"({name.replace('.png', '.svg')})" in files["README.md"].decode()
