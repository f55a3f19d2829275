"""The paper's chart of runtime: which share of the time goes into each component, ours beside the published one."""

from collections.abc import Mapping
from functools import partial
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from benchmark.published import RUNTIME_S
from benchmark.records.scene_pages import ScenePages, SplitPage
from benchmark.report.canvas import sanitise_name
from benchmark.report.plots import PlotTheme, new_figure, render_for_pages
from benchmark.report.words import format_title
from leaderboard.page.sections import NamedFigure
from leaderboard.paper.appendix import COMPONENTS

_SMALLEST_LABEL: Final = 0.03
"""Shares below are too thin for a number inside; the legend has it."""


def runtime_charts(data_name: str, sheets: ScenePages) -> tuple[NamedFigure, ...]:
    """A chart for each split, by its name, of a data set whose generation was timed."""
    figures = []
    for (name, split), sheet in sorted(sheets.splits.items()):
        shares = compute_runtime_shares(sheet)
        if name == data_name and shares:
            drawn = render_for_pages(partial(_draw_figure, format_title(data_name, split), shares))
            figures.append(NamedFigure(f"runtime-{split}", f"Runtime composition, split {split}", *drawn))
    return tuple(figures)


def compute_runtime_shares(sheet: SplitPage) -> dict[str, float]:
    """Share of each component in the time of one attempt and one rendered scene; empty where nothing was timed."""
    if sheet.runtime is None:
        return {}
    stages = (*RUNTIME_S, *sorted(set(sheet.runtime.total_s) - set(RUNTIME_S)))
    seconds_by_stage = {stage: sheet.runtime.each_s(stage) or 0.0 for stage in stages}
    total = sum(seconds_by_stage.values())
    return {stage: seconds / total for stage, seconds in seconds_by_stage.items()} if total else {}


def _draw_figure(title: str, shares: Mapping[str, float], theme: PlotTheme) -> Figure:
    total = sum(RUNTIME_S.values())
    published = {stage: seconds / total for stage, seconds in RUNTIME_S.items()}
    stages = list(dict.fromkeys((*published, *shares)))
    colours = {stage: theme.planner(place) for place, stage in enumerate(stages)}
    figure = new_figure(5.7, 3.4)
    left, right = figure.subplots(1, 2)
    _draw_pie(left, shares, colours, theme, "here")
    _draw_pie(right, published, colours, theme, "paper")
    names = [
        f"{COMPONENTS.get(stage, stage.capitalize())}: {_format_percent(shares.get(stage))} here, "
        f"{_format_percent(published.get(stage))} paper"
        for stage in stages
    ]
    patches = [Patch(color=colours[stage]) for stage in stages]
    figure.tight_layout(rect=(0, 0.28, 1, 0.9))
    figure.legend(patches, names, loc="lower center", ncols=1, frameon=False, fontsize="small")
    figure.text(0.5, 0.98, f"{sanitise_name(title)}: runtime composition", ha="center", va="top", parse_math=False)
    return figure


def _draw_pie(
    axes: Axes, shares: Mapping[str, float], colours: Mapping[str, str], theme: PlotTheme, title: str
) -> None:
    drawn = {stage: share for stage, share in shares.items() if share > 0}
    axes.pie(
        list(drawn.values()),
        colors=[colours[stage] for stage in drawn],
        labels=[_format_percent(share) if share >= _SMALLEST_LABEL else "" for share in drawn.values()],
        labeldistance=1.1,
        startangle=90,
        counterclock=False,
        wedgeprops={"edgecolor": theme.paper, "linewidth": 1.0},
        textprops={"fontsize": "small"},
    )
    axes.set_title(title, fontsize="medium")


def _format_percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.1f} %"
