"""Figure of multi-round refinement at one planning frame: candidates and scores of every round on the map."""

import math
import textwrap
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from benchmark.errors import InputError
from benchmark.records.scene_pages import (
    ROUNDS_FILE,
    RefinementTrace,
    ScenePage,
    ScenePages,
    StoredScenePage,
    TraceFrame,
    TraceRound,
)
from benchmark.report.canvas import sanitise_name
from benchmark.report.plots import LIGHT, PlotTheme, Sketch, new_figure, render_figure, render_for_pages
from leaderboard.figures.refinement_map import MapView, compute_view, draw_candidates, draw_road, draw_traffic
from leaderboard.page.sections import NamedFigure

SCENES_OF_A_SPLIT: Final = 3
"""Figures of one split: the first traced scenes by name."""
MOST_PANELS: Final = 9
"""Of more rounds, so many are drawn, evenly spread, the first and the last among them."""
LEAST_SCORE, MOST_SCORE = 0.01, 1e4
"""Ends of the scale at most. Scores below hardly differ by more than the random start, none is above; they are drawn
as the ends."""
_COLUMNS: Final = 3
_PANEL_WIDTH, _PANEL_HEIGHT, _GAP, _TITLE = 2.95, 2.1, 0.12, 0.3
_ABOVE, _LEFT, _BESIDE, _LINE = 0.42, 0.12, 3.1, 0.18
"""Inches."""
_LETTERS_PER_INCH: Final = 12.5
_HALF_STRIP: Final = 0.31
"""Half the width of a round's strip, in rounds."""


def refinement_figures(data_name: str, sheets: ScenePages) -> tuple[NamedFigure, ...]:
    """Figures of at most `SCENES_OF_A_SPLIT` scenes of each split traced by `challenger-bench sheets --rounds`."""
    figures, drawn = [], dict.fromkeys((split for _, split, _ in sheets.scenes), 0)
    for (data, split, scene), stored in sorted(sheets.scenes.items()):
        if data != data_name or drawn[split] == SCENES_OF_A_SPLIT:
            continue
        sketch = _build_sketch(stored)
        if sketch is not None:
            drawn[split] += 1
            title = f"Rounds of refinement, split {split}, {scene}"
            figures.append(NamedFigure(f"refinement-{split}-{scene}", title, *render_for_pages(sketch)))
    return tuple(figures)


def draw_refinement(
    stored: StoredScenePage, suffix: str, *, frame: int | None = None, theme: PlotTheme = LIGHT
) -> bytes | None:
    """One planning frame of a scene: a panel a round on the map, and the scores of all rounds beside them.

    ``None`` without a trace or a search at that frame, by default `find_most_improved_frame`.
    """
    sketch = _build_sketch(stored, frame)
    return None if sketch is None else render_figure(sketch, suffix, theme)


def _build_sketch(stored: StoredScenePage, frame: int | None = None) -> Sketch | None:
    if stored.rounds is None:
        return None
    at = find_most_improved_frame(stored.rounds) if frame is None else _find_frame(stored.rounds, frame)
    if at is None:
        return None
    _require_complete_trace(stored, at)
    view = compute_view(stored.sheet, stored.rounds.agent, at, _PANEL_WIDTH / _PANEL_HEIGHT)
    return partial(_draw_figure, stored.sheet, stored.rounds, at, view)


def find_most_improved_frame(rounds: RefinementTrace) -> TraceFrame | None:
    """The frame whose best score falls most from first to last round, the first of equals, if any has scores."""
    best: tuple[float, TraceFrame] | None = None
    for frame in rounds.frames:
        ends = [_find_best_score(entry) for entry in frame.rounds[:1] + frame.rounds[-1:]]
        if not ends or ends[0] is None or ends[-1] is None:
            continue
        if best is None or ends[0] - ends[-1] > best[0]:
            best = (ends[0] - ends[-1], frame)
    return None if best is None else best[1]


def quartiles(scores: Sequence[float], searched: int) -> tuple[float, float, float] | None:
    """Lower quartile, median and upper quartile of a round's scores, each one of them; `searched` is their number.

    Of more than were kept, the better half of the kept are the best ones and the others a sample of the rest, which
    counts for those left out.
    """
    if not scores:
        return None
    order = np.sort(np.array(scores, dtype=np.float64))
    weight = np.ones(len(order))
    half = len(order) // 2
    if searched > len(order) > half:
        weight[half:] = (searched - half) / (len(order) - half)
    share = np.cumsum(weight) / weight.sum()
    lower, middle, upper = (float(order[np.searchsorted(share, part - 1e-9)]) for part in (0.25, 0.5, 0.75))
    return lower, middle, upper


def _find_frame(rounds: RefinementTrace, frame: int) -> TraceFrame | None:
    matching = (trace_frame for trace_frame in rounds.frames if trace_frame.frame == frame)
    return next(
        (trace_frame for trace_frame in matching if any(entry.candidates for entry in trace_frame.rounds)), None
    )


def _require_complete_trace(stored: StoredScenePage, at: TraceFrame) -> None:
    chosen = at.rounds[at.chosen_round] if 0 <= at.chosen_round < len(at.rounds) else None
    is_complete = (
        chosen is not None and 0 <= at.chosen < len(chosen.candidates) and 0 <= at.frame < len(stored.sheet.ego.x_m)
    )
    if not is_complete or any(
        len(entry.candidates) != len(entry.scores) or not entry.candidates for entry in at.rounds
    ):
        raise InputError(
            f"{stored.directory / ROUNDS_FILE} is inconsistent at frame {at.frame}; delete it and run "
            "challenger-bench sheets --rounds again"
        )


def _find_best_score(entry: TraceRound) -> float | None:
    return min((score for score in entry.scores if score is not None), default=None)


def _draw_figure(sheet: ScenePage, rounds: RefinementTrace, at: TraceFrame, view: MapView, theme: PlotTheme) -> Figure:
    round_numbers = _choose_rounds(len(at.rounds))
    columns, lines = min(len(round_numbers), _COLUMNS), -(-len(round_numbers) // _COLUMNS)
    width = _LEFT + columns * (_PANEL_WIDTH + _GAP) + _BESIDE
    tall = lines * (_PANEL_HEIGHT + _TITLE)
    words = textwrap.wrap(_describe_rounds(rounds, at, theme), int(_LETTERS_PER_INCH * (width - 2 * _LEFT)))
    below = max(_LINE * len(words) + 0.2, 0.5)
    height = _ABOVE + tall + below
    figure = new_figure(width, height)

    def placed(left: float, bottom: float, wide: float, high: float) -> Axes:
        return figure.add_axes((left / width, bottom / height, wide / width, high / height))

    scale, colours = _build_scale(at), _colours(theme)
    for place, number in enumerate(round_numbers):
        row, column = divmod(place, columns)
        bottom = below + tall - (row + 1) * (_PANEL_HEIGHT + _TITLE)
        axes = placed(_LEFT + column * (_PANEL_WIDTH + _GAP), bottom, _PANEL_WIDTH, _PANEL_HEIGHT)
        draw_road(axes, sheet, view, theme.ground)
        draw_candidates(axes, at, number, view, scale, colours, theme)
        draw_traffic(axes, sheet, rounds.agent, at.frame, view, theme)
        _style_panel(axes, at, number, view, _count_searched(rounds), theme)
    beside = width - _BESIDE
    # The colour bar is next to the strips and shares their axis.
    _draw_bar(placed(width - 0.35, below, 0.15, tall - _TITLE), scale, colours)
    _draw_scores(
        placed(beside + 0.75, below, _BESIDE - 1.15, tall - _TITLE), at, scale, colours, _count_searched(rounds), theme
    )
    style: dict[str, Any] = {"ha": "left", "parse_math": False}
    heading = f"{sanitise_name(sheet.scene)} at {_find_seconds(sheet, at.frame):.1f} s: rounds of refinement"
    figure.text(_LEFT / width, 1 - 0.08 / height, heading, va="top", fontsize=12, **style)
    figure.text(_LEFT / width, 0.07 / height, "\n".join(words), va="bottom", fontsize=9, color=theme.faint, **style)
    return figure


def _choose_rounds(count: int) -> list[int]:
    if count <= MOST_PANELS:
        return list(range(count))
    return [int(place) for place in np.linspace(0, count - 1, MOST_PANELS).round()]


def _build_scale(at: TraceFrame) -> LogNorm:
    known = [_clip_score(score) for entry in at.rounds for score in entry.scores if score is not None]
    least = min(min(known, default=LEAST_SCORE), 0.1 * MOST_SCORE)
    return LogNorm(least, max(max(known, default=1.0), 10 * least), clip=True)


def _clip_score(score: float) -> float:
    return min(max(score, LEAST_SCORE), MOST_SCORE)


def _ticks(scale: LogNorm) -> list[float]:
    least, most = float(scale.vmin or LEAST_SCORE), float(scale.vmax or 1.0)
    steps = (1, 2, 5) if most < 1000 * least else (1,)
    powers = range(math.floor(math.log10(least)), math.ceil(math.log10(most)) + 1)
    return [tick for power in powers for step in steps if least <= (tick := step * 10.0**power) <= most]


def _colours(theme: PlotTheme) -> Colormap:
    # The end nearest to the road's lightness would be invisible on it.
    ends = (1.0, 0.2) if theme.dark else (0.0, 0.93)
    return ListedColormap(colormaps["viridis"](np.linspace(*ends, 256)))


def _style_panel(axes: Axes, at: TraceFrame, number: int, view: MapView, searched: int, theme: PlotTheme) -> None:
    entry, best = at.rounds[number], _find_best_score(at.rounds[number])
    name = "first batch" if number == 0 else f"round {number}"
    score = "no finite score" if best is None else f"best {best:.2f}"
    of_all = f" of {searched}" if searched >= max(entry.collision_free, 1) else ""
    title = f"{name}: {score}, {entry.collision_free}{of_all} free"
    axes.set_title(title, fontsize=9, loc="left", pad=3, fontweight="bold" if number == at.chosen_round else "normal")
    axes.set_xlim(view.left, view.right)
    axes.set_ylim(view.bottom, view.top)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_color(theme.ink if number == at.chosen_round else theme.rule)
        side.set_linewidth(1.6 if number == at.chosen_round else 0.8)
    if number == 0:
        length = 10.0 if view.right - view.left < 70 else 20.0
        left, bottom = view.left + 0.03 * (view.right - view.left), view.bottom + 0.05 * (view.top - view.bottom)
        axes.plot([left, left + length], [bottom, bottom], color=theme.ink, linewidth=2.0, zorder=8)
        axes.text(left + length / 2, bottom, f"{length:g} m", ha="center", va="bottom", fontsize=9, zorder=8)


def _draw_scores(
    axes: Axes, at: TraceFrame, scale: LogNorm, colours: Colormap, searched: int, theme: PlotTheme
) -> None:
    """A strip a round; places side by side follow from the order of the scores, not from chance."""
    for number, entry in enumerate(at.rounds):
        known = sorted(_clip_score(score) for score in entry.scores if score is not None)
        beside = number + _HALF_STRIP * (np.arange(len(known)) * 0.618034 % 1.0 * 2.0 - 1.0)
        axes.scatter(
            beside, known, s=9, c=[colours(scale(score)) for score in known], linewidths=0, zorder=2, clip_on=False
        )
        quartile_values = quartiles(known, searched)
        if quartile_values is not None:
            axes.plot(
                [number, number], [quartile_values[0], quartile_values[2]], color=theme.ink, linewidth=3.0, zorder=3
            )
            axes.plot(
                number,
                quartile_values[1],
                "o",
                color=theme.paper,
                markeredgecolor=theme.ink,
                markersize=6,
                zorder=4,
                clip_on=False,
            )
    chosen = at.rounds[at.chosen_round].scores
    score = chosen[at.chosen] if at.chosen < len(chosen) else None
    if score is not None:
        place = (at.chosen_round, _clip_score(score))
        axes.plot(
            *place, marker="*", markersize=14, color=theme.paper, markeredgecolor=theme.ink, zorder=5, clip_on=False
        )
    axes.set_yscale("log")
    axes.set_ylim(scale.vmin, scale.vmax)
    axes.set_xlim(-0.6, len(at.rounds) - 0.4)
    axes.set_xticks(range(len(at.rounds)) if len(at.rounds) <= 12 else [0, len(at.rounds) - 1])
    axes.yaxis.set_major_locator(FixedLocator(_ticks(scale)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(_score_text))
    axes.grid(axis="y", color=theme.rule, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("round", fontsize=9)
    axes.set_title("score, lower is better", fontsize=9, loc="left", pad=3)


def _draw_bar(axes: Axes, scale: LogNorm, colours: Colormap) -> None:
    bar = Colorbar(axes, ScalarMappable(scale, colours), ticks=[])
    bar.ax.yaxis.set_minor_locator(NullLocator())


def _describe_rounds(rounds: RefinementTrace, at: TraceFrame, theme: PlotTheme) -> str:
    drawn, searched = max(len(entry.candidates) for entry in at.rounds), _count_searched(rounds)
    drawn_note = "" if drawn >= searched else f" ({drawn} of {searched} are drawn, half of them the best)"
    seconds = (max(len(line) for entry in at.rounds for line in entry.candidates) - 1) / 2
    better = "brighter" if theme.dark else "darker"
    return (
        "A: adversary, E: ego, dashed: path of the ego, star: executed. Lines: the adversary's centre over "
        f"{seconds:g} s{drawn_note}; the {better}, the better. Scores are compared over all rounds together; beside: "
        "each candidate, median and quartiles. Free: candidates without contact in the part that would be executed."
    )


def _find_seconds(sheet: ScenePage, frame: int) -> float:
    return (sheet.timestamps_us[frame] - sheet.timestamps_us[0]) / 1e6


def _count_searched(rounds: RefinementTrace) -> int:
    count = rounds.search.get("candidates", 0)
    return count if isinstance(count, int) else 0


def _score_text(score: float, _: int | None = None) -> str:
    return f"≤ {score:g}" if score <= LEAST_SCORE else f"{score:g}"
