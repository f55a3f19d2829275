"""Figures in reading order, and attack success against the realism of adversaries by generator setting and planner."""

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmark.metrics.attacks import can_count_attacks, compute_attack_rates, has_adversaries, has_severity
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.rates import Rate
from benchmark.metrics.split_reference_drivers import collect_split_reference_drivers
from benchmark.metrics.transfer import TransferMatrix
from benchmark.records.run import RunRecord
from benchmark.records.scene_assessment import FeatureRealism
from benchmark.records.scene_pages import ScenePages
from benchmark.report.canvas import sanitise_name
from benchmark.report.plots import PlotTheme, new_figure, render_for_pages
from benchmark.report.words import format_split
from leaderboard.figures.charts import MARKERS, label_below, planner_name, run_figures
from leaderboard.figures.heat_map import draw_heat_maps, draw_lift_maps
from leaderboard.figures.refinement import refinement_figures
from leaderboard.frame.rows import sort_for_tables, split_sort_key
from leaderboard.frame.runs import DataSetRuns
from leaderboard.page.sections import NamedFigure
from leaderboard.tables.transfer import build_frame_matrices, name_lift, name_transfer

NAME: Final = "attack-realism"
TITLE: Final = "Attributable attack success against realism"
REALISM_AXIS: Final = "realism of the worst feature"
VALIDITY_AXIS: Final = "scenes whose adversaries have no fault (%)"
_WIDTH, _HEIGHT, _LINE, _LEGEND_LINE, _LEGEND_COLUMNS = 5.7, 3.3, 0.145, 0.21, 3
"""Inches; of two panels the figure is 1.4 times as wide."""
_LETTERS_PER_INCH: Final = 15.5
_APART: Final = 0.013
"""Planners of one setting stand this part of the axis beside one another, so that their intervals can be told."""


@dataclass(frozen=True, slots=True)
class GeneratorSetting:
    """One setting of a generator: the adversarial scenes of one split of one data set.

    `worst` is the worst feature, ``None`` without a comparison with recordings; `without_fault` the share of scenes
    whose adversaries have no fault; `success` the attributable attack success on each planner, of scenes.
    """

    data_name: str
    split: str
    worst: FeatureRealism | None
    without_fault: Rate
    success: tuple[tuple[RunRecord, Rate], ...]


def list_generator_settings(records: Sequence[RunRecord]) -> list[GeneratorSetting]:
    """Settings, by data set and split, that say whether the careful human survives and how severe plans are."""
    records_by_split: dict[tuple[str, str], list[RunRecord]] = {}
    for record in sort_for_tables(list(filter(can_count_attacks, records))):
        records_by_split.setdefault((record.run.data.name, record.run.split), []).append(record)
    settings = []
    for (data_name, split), runs in sorted(
        records_by_split.items(), key=lambda item: (item[0][0], split_sort_key(item[0][1]))
    ):
        reference_drivers = collect_split_reference_drivers(runs).get(split)
        rates = [(run, compute_attack_rates(run).scenes["attributable"]) for run in runs]
        success = tuple((run, rate) for run, rate in rates if rate.value is not None)
        if reference_drivers is not None and success:
            realism = next((run.run.realism for run in runs if run.run.realism is not None), None)
            worst = None if realism is None else realism.headline
            settings.append(GeneratorSetting(data_name, split, worst, reference_drivers.without_fault, success))
    return settings


def attack_figures(frame: DataSetRuns) -> tuple[NamedFigure, ...]:
    """The figure of a data set, beside settings of others, or none if none of its own can be drawn."""
    settings = list_generator_settings(frame.against or frame.given)
    if not any(setting.data_name == frame.data_name for setting in settings):
        return ()
    return (NamedFigure(NAME, TITLE, *render_for_pages(partial(_draw_figure, frame.data_name, settings))),)


def explain_missing_figure(data_name: str, records: Sequence[RunRecord]) -> str | None:
    """Reason why there is no figure of a data set that has adversaries, in a sentence; ``None`` where there is one."""
    own = [record for record in records if record.run.data.name == data_name and has_adversaries(record)]
    if not own or any(setting.data_name == data_name for setting in list_generator_settings(own)):
        return None
    if not any(map(has_severity, own)):
        return "No figure of attack success against realism: no record has the severity of its plans."
    return "No figure of attack success against realism: the avoidability of no scene was assessed."


def _draw_figure(data_name: str, settings: Sequence[GeneratorSetting], theme: PlotTheme) -> Figure:
    kinds: list[tuple[str, Callable[[GeneratorSetting], _AxisPoint | None]]] = [
        (REALISM_AXIS, _place_by_realism),
        (VALIDITY_AXIS, _place_by_validity),
    ]
    panels = [(head, place) for head, place in kinds if any(place(setting) for setting in settings)]
    planners = {run.planner: run for setting in settings for run, _ in setting.success}
    style: dict[str, dict[str, Any]] = {
        name: {"color": theme.planner(at), "marker": MARKERS[at % len(MARKERS)], "markersize": 6, "linestyle": "none"}
        for at, name in enumerate(planners)
    }
    width = _WIDTH * (1.4 if len(panels) > 1 else 1.0)
    words = [
        line for text in _describe_settings(settings) for line in textwrap.wrap(text, int(_LETTERS_PER_INCH * width))
    ]
    below = _LINE * len(words) + _LEGEND_LINE * -(-len(planners) // _LEGEND_COLUMNS) + 0.2
    figure = new_figure(width, _HEIGHT + below)
    panel_axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (head, place) in zip(panel_axes, panels, strict=True):
        _style_axes(axes, head, theme)
        for number, setting in enumerate(settings, 1):
            at = place(setting)
            if at is not None:
                _draw_setting(axes, setting, number, at, style, theme, own=setting.data_name == data_name)
    panel_axes[0].set_ylabel("attributable success, % of the scenes")
    panel_axes[0].set_ylim(-3, 108)
    figure.tight_layout(rect=(0, below / figure.get_figheight(), 1, 0.94))
    _write_caption(figure, f"{sanitise_name(data_name)}: attributable attack success against realism", words, theme)
    lines = [mpl.lines.Line2D([], [], **look) for look in style.values()]
    above = (0.5, (_LINE * len(words) + 0.08) / figure.get_figheight())
    names = [planner_name(run) for run in planners.values()]
    label_below(figure, lines, names, min(_LEGEND_COLUMNS, len(planners)), bbox_to_anchor=above)
    return figure


def _style_axes(axes: Axes, head: str, theme: PlotTheme) -> None:
    axes.set_xlabel(head)
    axes.set_xlim((-0.02, 1.02) if head == REALISM_AXIS else (-2, 102))
    axes.grid(color=theme.rule, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _write_caption(figure: Figure, heading: str, words: Sequence[str], theme: PlotTheme) -> None:
    height = figure.get_figheight()
    plain: dict[str, Any] = {"parse_math": False}
    figure.text(0.02, 0.08 / height, "\n".join(words), va="bottom", fontsize=8.5, color=theme.faint, **plain)
    figure.text(0.5, 1 - 0.06 / height, heading, ha="center", va="top", fontsize=10.5, **plain)


@dataclass(frozen=True, slots=True)
class _AxisPoint:
    at: float
    low: float | None
    high: float | None


def _place_by_realism(setting: GeneratorSetting) -> _AxisPoint | None:
    if setting.worst is None:
        return None
    low, high = setting.worst.interval or (None, None)
    return _AxisPoint(setting.worst.realism, low, high)


def _place_by_validity(setting: GeneratorSetting) -> _AxisPoint | None:
    """Place by validity, only where there is no realism: the two axes are not comparable."""
    rate = setting.without_fault
    if setting.worst is not None or rate.value is None:
        return None
    ends = (None if end is None else 100 * end for end in (rate.low, rate.high))
    return _AxisPoint(100 * rate.value, *ends)


def _draw_setting(
    axes: Axes,
    setting: GeneratorSetting,
    number: int,
    place: _AxisPoint,
    style: Mapping[str, dict[str, Any]],
    theme: PlotTheme,
    *,
    own: bool,
) -> None:
    """Points of one setting at its line, with their intervals; those of other data sets are hollow."""
    axes.axvline(place.at, color=theme.rule, linewidth=1.0, zorder=1)
    axes.annotate(
        str(number),
        (place.at, 104),
        ha="center",
        va="center",
        fontsize="small",
        color=theme.ink if own else theme.faint,
    )
    if place.low is not None and place.high is not None:
        axes.plot([place.low, place.high], [101, 101], color=theme.faint, linewidth=1.2, zorder=1)
    left, right = axes.get_xlim()
    order = list(style)
    for run, rate in setting.success:
        look, value = style[run.planner], 100 * (rate.value or 0.0)
        at = place.at + _APART * (right - left) * (order.index(run.planner) - 0.5 * (len(order) - 1))
        if rate.low is not None and rate.high is not None:
            ends = [100 * rate.low, 100 * rate.high]
            axes.plot([at, at], ends, color=look["color"], linewidth=1.2, alpha=0.5, zorder=2)
        face = look["color"] if own else theme.paper
        axes.plot(at, value, **look, markerfacecolor=face, zorder=3)


def _describe_settings(settings: Sequence[GeneratorSetting]) -> list[str]:
    """Sentences on the numbers of settings and on the axes."""
    sentences = []
    for number, setting in enumerate(settings, 1):
        name = sanitise_name(format_split(setting.split, setting.data_name))
        worst = "" if setting.worst is None else f"; worst: {setting.worst.name.replace('_', ' ')}"
        sentences.append(f"{number}: {name}{worst}")
    if any(setting.worst is None for setting in settings):
        sentences.append(
            "Adversaries that were not compared with recordings, as in our own town, have no realism; the share "
            "of scenes whose adversaries have no validity fault is a weaker measure."
        )
    halves = [setting.worst.realism_of_halves for setting in settings if setting.worst is not None]
    known = [half for half in halves if half is not None]
    if known:
        ends = f"{min(known):.2f}" if min(known) == max(known) else f"{min(known):.2f} to {max(known):.2f}"
        sentences.append(f"Two halves of the recordings reach {ends} on the same feature: more than this is noise.")
    return sentences


RUN_FIGURES: Final[tuple[Callable[[DataSetRuns], Iterable[NamedFigure]], ...]] = (run_figures, attack_figures)


def matrix_figures(frame: DataSetRuns) -> list[NamedFigure]:
    """Pictures of the matrices of transfer among the first tables, each with the name of its table.

    Where it is known who is an adversary, contacts with bystanders say nothing of attacks: under ``exact`` there is one
    picture of lift and φ a split.
    """
    name = frame.data_name
    judge_matrices = [(judge, _build_matrices(frame, judge, split)) for split in frame.splits for judge in frame.judges]
    shares = [(name_transfer(name, matrix), draw_heat_maps(matrix)) for _, some in judge_matrices for matrix in some]
    of_lift = [some[-1] for judge, some in judge_matrices if judge == EXACT and some]
    lifts = [(name_lift(name, matrix), draw_lift_maps(matrix)) for matrix in of_lift]
    return [NamedFigure(stem, title, *drawn) for (stem, title), drawn in [*shares, *lifts]]


def _build_matrices(frame: DataSetRuns, judge: str, split: str) -> list[TransferMatrix]:
    return frame.once(build_frame_matrices, judge, split)[0]


def data_set_figures(frame: DataSetRuns, sheets: ScenePages) -> list[NamedFigure]:
    """All other figures of one data set."""
    return [*(figure for draw in RUN_FIGURES for figure in draw(frame)), *refinement_figures(frame.data_name, sheets)]


def missing_figures(frame: DataSetRuns) -> list[str]:
    """Sentences on figures that records do not give."""
    missing = explain_missing_figure(frame.data_name, frame.given)
    return [] if missing is None else [missing]
