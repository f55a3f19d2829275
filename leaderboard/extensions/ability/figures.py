"""Pictures of a fit: a Wright map of planners and scenes on one scale, and curves of the most telling scenes."""

from functools import partial
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmark.geometry import Floats
from benchmark.report.canvas import sanitise_name
from benchmark.report.plots import PlotTheme, new_figure, render_for_pages
from leaderboard.extensions.ability.fit import AbilityFit
from leaderboard.extensions.ability.likelihood import ScoreItem, compute_expected_score
from leaderboard.extensions.ability.next_scenes import compute_information
from leaderboard.frame.rows import mark_planner_name
from leaderboard.page.sections import NamedFigure

CURVES: Final = 5
"""Scenes whose curves are drawn."""
_BINS: Final = 0.25
"""Width of a stack of scenes on the ability scale."""
_REACH: Final = 4.0
"""Farthest difficulty or ability that is drawn; what lies beyond stands at the edge."""


def ability_figures(fit: AbilityFit) -> list[NamedFigure]:
    """The Wright map and the curves; the map alone shows planners where nothing is said of single scenes."""
    name = f"{fit.split}-{fit.loop}-{fit.kind}" + ("" if not fit.world else f"-{sanitise_name(fit.world)}")
    drawn = [
        (f"wright-{name}", f"Planners and scenes on one scale, {fit.measured.words}", partial(_draw_wright_map, fit))
    ]
    if fit.scenes[0].difficulty is not None:
        title = f"Curves of the most telling scenes, {fit.measured.words}"
        drawn.append((f"curves-{name}", title, partial(_draw_curves, fit)))
    return [NamedFigure(name, title, *render_for_pages(sketch)) for name, title, sketch in drawn]


def _draw_wright_map(fit: AbilityFit, theme: PlotTheme) -> Figure:
    planners = sorted(fit.planners, key=lambda each: each.ability)
    placed = [scene for scene in fit.scenes if scene.difficulty is not None]
    places = np.clip([scene.difficulty or 0.0 for scene in placed], -_REACH, _REACH)
    bins = np.floor(places / _BINS).astype(int)
    stacks = np.array([int((bins[:at] == own).sum()) for at, own in enumerate(bins)])
    tallest = int(stacks.max(initial=0)) + 1
    heights = 0.4 + 0.23 * len(planners), 0.35 + 0.11 * min(tallest, 20) if placed else 0.0
    figure = new_figure(6.4, 1.0 + sum(heights))
    panels = figure.subplots(2, 1, sharex=True, height_ratios=heights) if placed else [figure.subplots()]
    upper = panels[0]
    for row, planner in enumerate(planners):
        colour = theme.faint if planner.reference else theme.planner(0)
        ends = np.clip([planner.low, planner.high], -_REACH, _REACH)
        upper.plot(ends, [row, row], color=colour, linewidth=1.4)
        upper.plot(np.clip(planner.ability, -_REACH, _REACH), row, "o", color=colour, markersize=5)
    names = [mark_planner_name(each.name, privileged=False, miniature=each.miniature) for each in planners]
    upper.set_yticks(range(len(planners)), [sanitise_name(name) for name in names], parse_math=False)
    upper.set_ylim(-0.7, len(planners) - 0.3)
    upper.set_title("ability of planners, 95 % intervals (grey: references)", fontsize="medium")
    if placed:
        extreme = np.array([scene.passed in (0, scene.ran) for scene in placed])
        at = (bins + 0.5) * _BINS
        size = 4.0 if tallest <= 20 else 80.0 / tallest
        panels[1].plot(at[~extreme], stacks[~extreme] + 0.5, "o", color=theme.contact, markersize=size)
        panels[1].plot(at[extreme], stacks[extreme] + 0.5, "o", color=theme.contact, mfc="none", markersize=size)
        panels[1].set_ylim(0, tallest + 0.5)
        panels[1].set_yticks([])
        panels[1].set_title(
            "difficulty of scenes, a dot each (hollow: all planners alike)", fontsize="medium", parse_math=False
        )
    for axes in panels:
        _trim(axes, theme)
    panels[-1].set_xlabel("ability, above the mean of these planners")
    _finish(figure, fit)
    return figure


def find_telling_scenes(fit: AbilityFit, count: int = CURVES) -> list[int]:
    """Places of the scenes with most information, on average over the planners."""
    total = np.zeros(len(fit.scenes))
    for ability in fit.draw("theta").T:
        total += compute_information(fit, ability)
    return [int(at) for at in np.argsort(-total, kind="stable")[:count]]


def compute_curve(fit: AbilityFit, scene: int, ability: Floats) -> Floats:
    """Expected outcome of a scene at (G,) abilities on the scale of the planners, mean over the draws."""
    theta = ability + fit.draw("theta").mean(axis=1)[:, None]
    alpha = np.exp(fit.draw("log_alpha")[:, scene, None])
    if fit.kind == "contact":
        return np.asarray((1.0 / (1.0 + np.exp(-alpha * (theta - fit.draw("beta")[:, scene, None])))).mean(axis=0))
    item = ScoreItem(*(fit.draw(name)[:, scene, None] for name in ScoreItem._fields))
    return np.asarray(compute_expected_score(alpha * theta, item).mean(axis=0))


def _draw_curves(fit: AbilityFit, theme: PlotTheme) -> Figure:
    chosen, values = find_telling_scenes(fit), fit.matrix.values
    abilities = np.clip([planner.ability for planner in fit.planners], -_REACH, _REACH)
    grid = np.linspace(min(-2.5, abilities.min() - 0.5), max(2.5, abilities.max() + 0.5), 61)
    figure = new_figure(1.0 + 1.75 * len(chosen), 2.7)
    panels = figure.subplots(1, len(chosen), sharey=True, squeeze=False)[0]
    for axes, scene in zip(panels, chosen):
        axes.plot(grid, compute_curve(fit, scene, grid), color=theme.ink, linewidth=1.4)
        axes.plot(abilities, values[:, scene], "o", color=theme.planner(0), markersize=4, alpha=0.7)
        axes.set_title(sanitise_name(fit.scenes[scene].scene), fontsize="small", parse_math=False)
        axes.set_ylim(-0.06, 1.06)
        _trim(axes, theme)
    panels[0].set_ylabel("safe" if fit.kind == "contact" else "score")
    panels[len(panels) // 2].set_xlabel("ability; dots: planners")
    _finish(figure, fit)
    return figure


def _trim(axes: Axes, theme: PlotTheme) -> None:
    axes.grid(axis="x", color=theme.rule, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _finish(figure: Figure, fit: AbilityFit) -> None:
    figure.tight_layout(rect=(0, 0, 1, 1.0 - 0.3 / figure.get_figheight()))
    heading = f"{sanitise_name(fit.data)} {sanitise_name(fit.split)}: {fit.kind}, {fit.loop} loop"
    figure.text(0.5, 0.99, heading, ha="center", va="top", fontsize=10.5, parse_math=False)
