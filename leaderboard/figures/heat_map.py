"""Transfer between planners as pictures: who else fails (column) the scenes that a planner fails (row)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from benchmark.errors import InputError
from benchmark.machine.storage import write_bytes
from benchmark.metrics.rates import Estimate, Rate
from benchmark.metrics.transfer import TransferMatrix
from benchmark.records.run import NATIVE
from benchmark.report.canvas import sanitise_name
from benchmark.report.cells import UNDEFINED, format_interval, format_number
from benchmark.report.plots import FORMATS, LIGHT, PlotTheme, new_figure, render_figure, render_for_pages
from leaderboard.tables.transfer import format_planner_names

COLOURS: Final = "cividis"
"""Looks the same with and without colour-blindness, and its lightness alone tells the order."""
AROUND_CHANCE: Final = "PuOr_r"
"""Purple below chance, white as by chance, orange above it: hues that no colour-blindness mixes up."""
_MOST_LIFT: Final = 4.0
"""From there on, and from its inverse on, the colour is the last one."""
_CELL_INCHES, _CHARACTER_INCHES, _CAPTION_INCHES, _LINE_INCHES = 0.85, 0.09, 2.6, 0.15
_HATCH = "#9a9a9a"


@dataclass(frozen=True, slots=True)
class HeatMapCell:
    """A cell of a picture."""

    text: str
    below: str
    colour: tuple[float, ...]
    bold: bool = False


HeatMapCells = list[list[HeatMapCell | None]]
"""Rows of cells; ``None`` is hatched."""


def write_heat_map(matrix: TransferMatrix, path: Path) -> None:
    """Write the picture of a transfer matrix into a ``.png`` or ``.svg`` file.

    Raises:
        InputError: If the file has another ending or cannot be written.
    """
    _write(draw_heat_map, matrix, path)


def write_lift_map(matrix: TransferMatrix, path: Path) -> None:
    """`write_heat_map` of the lift and φ of every two planners."""
    _write(draw_lift_map, matrix, path)


def draw_heat_map(matrix: TransferMatrix, suffix: str, theme: PlotTheme = LIGHT) -> bytes:
    """Picture of shares, counts and failure rates, deterministic to the byte; cells without a number are hatched."""
    return render_figure(partial(_draw_shares, matrix), suffix, theme)


def draw_heat_maps(matrix: TransferMatrix) -> tuple[bytes, bytes, Callable[[], bytes]]:
    """`draw_heat_map` as `render_for_pages` draws it."""
    return render_for_pages(partial(_draw_shares, matrix))


def draw_lift_map(matrix: TransferMatrix, suffix: str, theme: PlotTheme = LIGHT) -> bytes:
    """Picture of lift (above the diagonal) and φ (below), with intervals; colours are the distance from chance."""
    return render_figure(partial(_draw_lift, matrix), suffix, theme)


def draw_lift_maps(matrix: TransferMatrix) -> tuple[bytes, bytes, Callable[[], bytes]]:
    """The same of `draw_lift_map`."""
    return render_for_pages(partial(_draw_lift, matrix))


def _write(draw: Callable[[TransferMatrix, str], bytes], matrix: TransferMatrix, path: Path) -> None:
    if path.suffix not in FORMATS:
        raise InputError(f"cannot draw {path}: name a file that ends in {' or '.join(FORMATS)}")
    write_bytes(path, draw(matrix, path.suffix))


def choose_text_colour(background: Sequence[float]) -> str:
    """Black or white, whichever has more contrast (WCAG), 4.5 at least, with a background of red, green, blue, 0..1."""
    luminance = compute_relative_luminance(background)
    return "white" if 1.05 / (luminance + 0.05) > (luminance + 0.05) / 0.05 else "black"


def compute_relative_luminance(colour: Sequence[float]) -> float:
    """Relative luminance of an sRGB colour, 0..1 (WCAG 2)."""
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in colour[:3]]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def build_share_cells(matrix: TransferMatrix) -> HeatMapCells:
    """Cells of `draw_heat_map`: a row a surrogate, and one of the failure rates over all scenes."""
    return [
        *(
            [None if row == column else _build_share_cell(rate) for column, rate in enumerate(rates)]
            for row, rates in enumerate(matrix.cells)
        ),
        [_build_share_cell(rate) for rate in matrix.base_rates],
    ]


def build_lift_cells(matrix: TransferMatrix) -> HeatMapCells:
    """Cells of `draw_lift_map`: lift above the diagonal, φ below it; bold where the interval leaves chance out."""
    count = len(matrix.planners)
    squares: HeatMapCells = [[None] * count for _ in range(count)]
    for agreement in matrix.agreements:
        first, second = sorted(matrix.planners.index(name) for name in agreement.planners)
        lift, phi = Estimate(agreement.lift, agreement.lift_low, agreement.lift_high), agreement.phi
        squares[first][second] = _build_chance_cell(lift, 1.0, "{}×", 0.5 + _lift_colour(lift.value))
        squares[second][first] = _build_chance_cell(phi, 0.0, "φ {}", 0.5 + 0.5 * (phi.value or 0.0))
    return squares


def _build_share_cell(rate: Rate) -> HeatMapCell | None:
    if rate.value is None:
        return None
    counts = f"{round(rate.numerator)}/{rate.denominator}"
    return HeatMapCell(f"{100 * rate.value:.0f} %", counts, mpl.colormaps[COLOURS](rate.value)[:3])


def _build_chance_cell(estimate: Estimate, chance: float, form: str, shade: float) -> HeatMapCell | None:
    if estimate.value is None:
        return None
    ends = format_interval(estimate.low, estimate.high, digits=2)
    excludes_chance = (
        estimate.low is not None and estimate.high is not None and not estimate.low <= chance <= estimate.high
    )
    text = form.format(format_number(estimate.value, 2))
    return HeatMapCell(
        text, "" if ends == UNDEFINED else ends, mpl.colormaps[AROUND_CHANCE](shade)[:3], bold=excludes_chance
    )


def _lift_colour(lift: float | None) -> float:
    """Colour from -0.5 to 0.5: the logarithm, so that half and double are equally far from chance."""
    if not lift:
        return -0.5
    return max(-0.5, min(0.5, 0.5 * math.log(lift) / math.log(_MOST_LIFT)))


def _draw_shares(matrix: TransferMatrix, theme: PlotTheme) -> Figure:
    caption = (
        f"{_describe_matrix(matrix)}.\nRow: surrogate. Column: victim.\n"
        "Cell: share of the surrogate's failed\nscenes that the victim fails too.\nHatched: undefined."
    )
    failed = [f"fails {round(cells[own].numerator)}" for own, cells in enumerate(matrix.cells)]
    return _draw_figure(matrix, build_share_cells(matrix), failed, caption, theme)


def _draw_lift(matrix: TransferMatrix, theme: PlotTheme) -> Figure:
    caption = (
        f"{_describe_matrix(matrix)}.\nAbove the diagonal: lift, how many times\nmore often both fail than by chance "
        "(1).\nBelow: φ, correlation of verdicts (0).\nOrange: more than chance; purple: less.\nSmall: 95 % interval; "
        "bold: beyond chance.\nHatched: undefined."
    )
    rates = [rate.value for rate in matrix.base_rates]
    failed = ["" if rate is None else f"fails {100 * rate:.0f} %" for rate in rates]
    return _draw_figure(matrix, build_lift_cells(matrix), failed, caption, theme)


def _describe_matrix(matrix: TransferMatrix) -> str:
    judge = "own protocols" if matrix.protocol == NATIVE else f"protocol {sanitise_name(matrix.protocol)}"
    subject = "Contacts with the adversary" if matrix.adversary_only else "Failures"
    return f"{subject}\non {sanitise_name(matrix.split)}, {judge}"


def _draw_figure(
    matrix: TransferMatrix, squares: HeatMapCells, of_rows: Sequence[str], caption: str, theme: PlotTheme
) -> Figure:
    """Squares with the planners' names at the left and above; a row beyond the planners stands apart."""
    count = len(matrix.planners)
    # The last row is set apart: it is not a surrogate.
    rows = [*range(count), *(row + 0.4 for row in range(count, len(squares)))]
    names = [sanitise_name(name) for name in format_planner_names(matrix)]
    longest, lines = max(len(name) for name in names), caption.count("\n") + 1
    figure, axes = _create_canvas(count, rows[-1] + 1.0, longest_name=longest, caption_lines=lines)
    for row, cells in zip(rows, squares, strict=True):
        for column, square in enumerate(cells):
            _draw_cell(axes, column, row, square, theme)
    labels = [f"{name}\n{row_label}" for name, row_label in zip(names, of_rows, strict=True)]
    axes.set_xlim(-0.5, count - 0.5)
    axes.set_ylim(rows[-1] + 0.5, -0.5)
    axes.set_xticks(range(count), names, rotation=40, ha="left", rotation_mode="anchor", parse_math=False)
    axes.set_yticks(rows, [*labels, "all scenes"][: len(rows)], parse_math=False)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    figure.text(0.1 / figure.get_figwidth(), 0.995, caption, va="top", fontsize="small", parse_math=False)
    return figure


def _create_canvas(columns: float, rows: float, *, longest_name: int, caption_lines: int) -> tuple[Figure, Axes]:
    """A figure around square cells, with room for names of so many characters at the left and, slanted, above."""
    name = _CHARACTER_INCHES * longest_name
    left = max(0.25 + name, 1.1)
    # The first slanted name may reach below the caption.
    beneath = min(0.66 * name, 0.84 * max(_CAPTION_INCHES - left - 0.33, 0.0))
    above = max(0.3 + 0.66 * name, 0.35 + _LINE_INCHES * caption_lines + beneath)
    width, height = columns * _CELL_INCHES, rows * _CELL_INCHES
    size = (max(left + width + 0.78 * name, 0.2 + _CAPTION_INCHES), above + height + 0.1)
    figure = new_figure(*size)
    return figure, figure.add_axes((left / size[0], 0.1 / size[1], width / size[0], height / size[1]))


def _draw_cell(axes: Axes, column: float, row: float, square: HeatMapCell | None, theme: PlotTheme) -> None:
    """One cell, hatched where it has no number."""
    corner = (column - 0.5, row - 0.5)
    if square is None:
        axes.add_patch(Rectangle(corner, 1, 1, facecolor=theme.empty, edgecolor=_HATCH, hatch="///", linewidth=0))
        axes.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=theme.paper, linewidth=1.5))
        box = {"facecolor": theme.empty, "edgecolor": "none", "pad": 2.0}
        axes.text(column, row, UNDEFINED, ha="center", va="center", bbox=box)
        return
    axes.add_patch(Rectangle(corner, 1, 1, facecolor=square.colour, edgecolor=theme.paper, linewidth=1.5))
    style: dict[str, Any] = {"ha": "center", "color": choose_text_colour(square.colour)}
    weight = "bold" if square.bold else "normal"
    axes.text(column, row + (0.02 if square.below else 0.1), square.text, va="bottom", weight=weight, **style)
    if square.below:
        small = "x-small" if len(square.below) > 10 else "small"
        axes.text(column, row + 0.06, square.below, va="top", fontsize=small, **style)
