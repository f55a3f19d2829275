"""At which pressure a planner breaks: how often it fails, and how hard, over the budgets of an adversary that drives.

The same numbers as in the tables of pressure (`leaderboard.tables.pressure`), a line a planner, with their intervals.
"""

import textwrap
from collections.abc import Sequence
from functools import partial
from typing import Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmark.drawing.lettering import drawable
from benchmark.drawing.plots import DARK, LIGHT, Theme, new_figure, picture
from benchmark.records.drives import DriveRecord
from leaderboard.figures.charts import MARKERS, NamedFigure
from leaderboard.tables.pressure import Pressure, pressures
from leaderboard.tables.rows import marked

NAME: Final = "drives-pressure"
PANELS: Final = (
    ("attributable", "attributable failures, % of drives", 100.0),
    ("survives_cc", "careful human survives, %", 100.0),
    ("impact_speed", "impact, m/s", 1.0),
)
"""Column of a record's summary, words at its axis, and what its numbers are multiplied by."""
_PANEL, _HEIGHT, _LINE, _LEGEND_LINE, _LEGEND_COLUMNS = 2.7, 2.9, 0.16, 0.21, 3
"""Inches."""
_LETTERS_PER_INCH: Final = 15.0
_APART: Final = 0.08
"""Of the way from budget to budget: planners stand beside one another, so that their intervals can be told."""

Budget = tuple[float, int, int]


def pressure_figures(records: Sequence[DriveRecord]) -> tuple[NamedFigure, ...]:
    """A figure of every adversary that was given several budgets.

    Args:
        records: Any records of drives.

    Returns:
        Figures, in the order of the tables.
    """
    found = []
    for number, (title, rows) in enumerate(pressures(records)):
        draw = partial(_drawn, title, rows)
        name = NAME if not number else f"{NAME}-{number + 1}"
        found.append(NamedFigure(name, title, draw(".png", LIGHT), draw(".svg", LIGHT), draw(".svg", DARK)))
    return tuple(found)


def _drawn(title: str, rows: Sequence[Pressure], suffix: str, theme: Theme) -> bytes:
    return picture(lambda: _figure(title, rows, theme), suffix, theme)


def _figure(title: str, rows: Sequence[Pressure], theme: Theme) -> Figure:
    strength = {each.budget: each.candidates for each in rows}
    budgets = sorted(strength, key=lambda budget: (strength[budget], budget))
    planners = list(dict.fromkeys(each.name for each in rows))
    width = _PANEL * len(PANELS)
    words = textwrap.wrap(" ".join(map(drawable, title.split())), int(_LETTERS_PER_INCH * width))
    below = _LEGEND_LINE * -(-len(planners) // _LEGEND_COLUMNS) + 0.15
    above = _LINE * len(words) + 0.12
    figure = new_figure(width, _HEIGHT + below + above)
    for axes, (column, said, scale) in zip(figure.subplots(1, len(PANELS)), PANELS, strict=True):
        _frame(axes, said, budgets, theme)
        if scale > 1.0:
            axes.set_ylim(-4, 104)
        for place, name in enumerate(planners):
            beside = _APART * (place - 0.5 * (len(planners) - 1))
            own = [each for each in rows if each.name == name]
            _line(axes, own, budgets, column, scale, beside=beside, colour=theme.planner(place), marker=_marker(place))
        if scale == 1.0:
            axes.set_ylim(bottom=0.0)
    height = figure.get_figheight()
    figure.tight_layout(rect=(0, below / height, 1, 1 - above / height))
    figure.text(0.02, 1 - 0.06 / height, "\n".join(words), va="top", fontsize=9.0, parse_math=False)
    legend = figure.legend(
        [mpl.lines.Line2D([], [], color=theme.planner(at), marker=_marker(at)) for at in range(len(planners))],
        [drawable(_marked(rows, name)) for name in planners],
        loc="lower center",
        bbox_to_anchor=(0.5, 0.02 / height),
        ncols=min(_LEGEND_COLUMNS, len(planners)),
        frameon=False,
        fontsize="small",
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
    return figure


def _frame(axes: Axes, said: str, budgets: Sequence[Budget], theme: Theme) -> None:
    axes.set_ylabel(said)
    axes.set_xlabel("batches x candidates, every", color=theme.faint)
    axes.set_xticks(range(len(budgets)), [f"{1 + rounds} x {count}\n{every:g} s" for every, rounds, count in budgets])
    axes.tick_params(axis="x", labelsize=8.0)
    axes.set_xlim(-0.5, len(budgets) - 0.5)
    axes.grid(axis="y", color=theme.rule, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _line(
    axes: Axes,
    rows: Sequence[Pressure],
    budgets: Sequence[Budget],
    column: str,
    scale: float,
    *,
    beside: float,
    colour: str,
    marker: str,
) -> None:
    """A planner's numbers at the budgets that it met, with their intervals; what is undefined leaves a gap."""
    values: list[float] = [float("nan")] * len(budgets)
    for each in rows:
        rate, place = each.record.summary.columns.get(column), budgets.index(each.budget)
        if rate is None or rate.value is None:
            continue
        values[place] = scale * rate.value
        if rate.low is not None and rate.high is not None:
            ends = [scale * rate.low, scale * rate.high]
            axes.plot([place + beside] * 2, ends, color=colour, linewidth=1.2, alpha=0.5, zorder=2)
    at = [place + beside for place in range(len(budgets))]
    axes.plot(at, values, color=colour, marker=marker, markersize=5, linewidth=1.2, zorder=3)


def _marker(place: int) -> str:
    return MARKERS[place % len(MARKERS)]


def _marked(rows: Sequence[Pressure], name: str) -> str:
    planner = next(each.record.facts.planner for each in rows if each.name == name)
    return marked(name, privileged=planner.privileged, miniature=planner.miniature)
