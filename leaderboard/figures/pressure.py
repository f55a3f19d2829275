"""Rate and severity of failures over the budgets of an adversary that drives, a line a planner, with intervals."""

import textwrap
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmark.metrics.rates import Rate
from benchmark.records.drives import DriveRecord
from benchmark.report.canvas import sanitise_name
from benchmark.report.plots import PlotTheme, new_figure, render_for_pages
from leaderboard.figures.charts import label_below, planner_style
from leaderboard.frame.rows import name_cell
from leaderboard.page.sections import NamedFigure
from leaderboard.tables.pressure import DrivePressure, group_by_pressure, name_pressure

PANELS: Final = (
    ("attributable", "attributable failures, % of drives", True),
    ("survives_cc", "careful human survives, %", True),
    ("impact_speed", "impact, m/s", False),
)
"""Column of a record's summary, words at its axis, and whether it is a share."""
_PANEL, _HEIGHT, _LINE, _LEGEND_LINE, _LEGEND_COLUMNS = 2.7, 2.9, 0.16, 0.21, 3
"""Inches."""
_LETTERS_PER_INCH: Final = 15.0
_APART: Final = 0.08
"""Of the way from budget to budget: planners stand beside one another, so that their intervals can be told."""

Budget = tuple[float, int, int]


def pressure_figures(records: Sequence[DriveRecord]) -> tuple[NamedFigure, ...]:
    """A figure of every adversary that was given several budgets, in the order of the tables."""
    figures = []
    for number, (title, rows) in enumerate(group_by_pressure(records)):
        drawn = render_for_pages(partial(draw_pressure_figure, title, rows))
        figures.append(NamedFigure(name_pressure(number), title, *drawn))
    return tuple(figures)


def draw_pressure_figure(title: str, rows: Sequence[DrivePressure], theme: PlotTheme) -> Figure:
    """One figure of planners against budgets: a panel for each of `PANELS`."""
    strength = {pressure.budget: pressure.candidates for pressure in rows}
    budgets = sorted(strength, key=lambda budget: (strength[budget], budget))
    planners = {pressure.row.name: pressure.row.record.facts.planner for pressure in rows}
    style = {name: planner_style(place, theme) for place, name in enumerate(planners)}
    width = _PANEL * len(PANELS)
    words = textwrap.wrap(" ".join(map(sanitise_name, title.split())), int(_LETTERS_PER_INCH * width))
    below = _LEGEND_LINE * -(-len(planners) // _LEGEND_COLUMNS) + 0.15
    above = _LINE * len(words) + 0.12
    figure = new_figure(width, _HEIGHT + below + above)
    for axes, (column, axis_label, share) in zip(figure.subplots(1, len(PANELS)), PANELS, strict=True):
        _style_axes(axes, axis_label, budgets, theme)
        for place, (name, look) in enumerate(style.items()):
            beside = _APART * (place - 0.5 * (len(planners) - 1))
            rates = {pressure.budget: pressure.row.rates.get(column) for pressure in rows if pressure.row.name == name}
            _draw_line(axes, [rates.get(budget) for budget in budgets], beside, look, 100.0 if share else 1.0)
        # The limit of the other axis is known once all are drawn.
        axes.set_ylim(*((-4.0, 104.0) if share else (0.0, None)))
    height = figure.get_figheight()
    figure.tight_layout(rect=(0, below / height, 1, 1 - above / height))
    figure.text(0.02, 1 - 0.06 / height, "\n".join(words), va="top", fontsize=9.0, parse_math=False)
    lines = [mpl.lines.Line2D([], [], **look) for look in style.values()]
    names = [sanitise_name(name_cell(name, facts).text) for name, facts in planners.items()]
    columns = min(_LEGEND_COLUMNS, len(planners))
    label_below(figure, lines, names, columns, bbox_to_anchor=(0.5, 0.02 / height))
    return figure


def _style_axes(axes: Axes, axis_label: str, budgets: Sequence[Budget], theme: PlotTheme) -> None:
    axes.set_ylabel(axis_label)
    axes.set_xlabel("batches x candidates, every", color=theme.faint)
    axes.set_xticks(range(len(budgets)), [f"{1 + rounds} x {count}\n{every:g} s" for every, rounds, count in budgets])
    axes.tick_params(axis="x", labelsize=8.0)
    axes.set_xlim(-0.5, len(budgets) - 0.5)
    axes.grid(axis="y", color=theme.rule, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_line(axes: Axes, rates: Sequence[Rate | None], beside: float, look: dict[str, Any], scale: float) -> None:
    """A planner's numbers at all budgets, with their intervals; undefined ones leave a gap."""
    places = [place + beside for place in range(len(rates))]
    values = [float("nan") if rate is None or rate.value is None else scale * rate.value for rate in rates]
    for place, rate in zip(places, rates, strict=True):
        if rate is not None and rate.low is not None and rate.high is not None:
            ends = [scale * rate.low, scale * rate.high]
            axes.plot([place, place], ends, color=look["color"], linewidth=1.2, alpha=0.5, zorder=2)
    axes.plot(places, values, **look, zorder=3)
