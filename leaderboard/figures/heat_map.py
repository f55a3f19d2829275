"""The transfer matrix as a picture: who else fails (column) the scenes that a planner fails (row)."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from benchmark.drawing.lettering import drawable
from benchmark.drawing.plots import FORMATS, LIGHT, Theme, for_pages, new_figure, picture
from benchmark.errors import InputError
from benchmark.machine.storage import write_bytes
from benchmark.metrics.rates import Rate
from benchmark.metrics.transfer import TransferMatrix
from benchmark.records.run import NATIVE
from benchmark.report.cells import UNDEFINED
from leaderboard.tables.transfer import planner_names

COLOURS: Final = "cividis"
"""Looks the same with and without colour-blindness, and its lightness alone tells the order."""
_CELL_INCHES, _CHARACTER_INCHES, _CAPTION_INCHES = 0.85, 0.09, 1.1
_HATCH = "#9a9a9a"


def write_heat_map(matrix: TransferMatrix, path: Path) -> None:
    """Write the picture of a transfer matrix.

    Args:
        matrix: From `benchmark.metrics.transfer.transfer`.
        path: A ``.png`` or ``.svg`` file.

    Raises:
        InputError: If the file has another ending or cannot be written.
    """
    if path.suffix not in FORMATS:
        raise InputError(f"cannot draw {path}: name a file that ends in {' or '.join(FORMATS)}")
    write_bytes(path, heat_map(matrix, path.suffix))


def heat_map(matrix: TransferMatrix, suffix: str, theme: Theme = LIGHT) -> bytes:
    """The picture's bytes: the same matrix, the same bytes.

    Args:
        matrix: From `benchmark.metrics.transfer.transfer`.
        suffix: ``.png`` or ``.svg``.
        theme: Colours around the cells.

    Returns:
        Share and counts in every cell, and the victims' failure rates over all scenes below; cells without a number,
        and the diagonal, are hatched.
    """
    return picture(partial(_figure, matrix), suffix, theme)


def heat_maps(matrix: TransferMatrix) -> tuple[bytes, bytes, bytes]:
    """`heat_map` as a site shows it: PNG and SVG for light pages, SVG for dark ones."""
    return for_pages(partial(_figure, matrix))


def text_colour(background: Sequence[float]) -> str:
    """Black or white, whichever stands out more (WCAG contrast).

    Args:
        background: Red, green, blue, 0..1.

    Returns:
        A colour whose contrast with the background is at least 4.5.
    """
    luminance = relative_luminance(background)
    return "white" if 1.05 / (luminance + 0.05) > (luminance + 0.05) / 0.05 else "black"


def relative_luminance(colour: Sequence[float]) -> float:
    """Relative luminance of an sRGB colour, 0..1 (WCAG 2)."""
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in colour[:3]]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _figure(matrix: TransferMatrix, theme: Theme) -> Figure:
    count = len(matrix.planners)
    # The last row stands apart: it is no surrogate.
    base_row = count + 0.4
    names = [drawable(name) for name in planner_names(matrix)]
    figure, axes = _canvas(count, base_row + 1.0, longest_name=max(len(name) for name in names))
    for row, cells in enumerate(matrix.cells):
        for column, rate in enumerate(cells):
            _draw_cell(axes, column, row, None if row == column else rate, theme)
    for column, rate in enumerate(matrix.base_rates):
        _draw_cell(axes, column, base_row, rate, theme)
    failed = [round(cells[own].numerator) for own, cells in enumerate(matrix.cells)]
    surrogates = [f"{name}\nfails {number}" for name, number in zip(names, failed)]
    axes.set_xlim(-0.5, count - 0.5)
    axes.set_ylim(base_row + 0.5, -0.5)
    axes.set_xticks(range(count), names, rotation=40, ha="left", rotation_mode="anchor", parse_math=False)
    axes.set_yticks([*range(count), base_row], [*surrogates, "all scenes"], parse_math=False)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    judge = "own protocols" if matrix.protocol == NATIVE else f"protocol {drawable(matrix.protocol)}"
    caption = (
        f"Failures on {drawable(matrix.split)}, {judge}.\nRow: surrogate. Column: victim.\n"
        "Cell: share of the surrogate's failed\nscenes that the victim fails too.\nHatched: undefined."
    )
    figure.text(0.1 / figure.get_figwidth(), 0.995, caption, va="top", fontsize="small", parse_math=False)
    return figure


def _canvas(columns: float, rows: float, *, longest_name: int) -> tuple[Figure, Axes]:
    """A figure around square cells, with room for names of so many characters at the left and, slanted, above."""
    name = _CHARACTER_INCHES * longest_name
    left, above = max(0.25 + name, 1.1), max(0.3 + 0.66 * name, _CAPTION_INCHES)
    width, height = columns * _CELL_INCHES, rows * _CELL_INCHES
    size = (left + max(width + 0.78 * name, _CAPTION_INCHES), above + height + 0.1)
    figure = new_figure(*size)
    return figure, figure.add_axes((left / size[0], 0.1 / size[1], width / size[0], height / size[1]))


def _draw_cell(axes: Axes, column: float, row: float, rate: Rate | None, theme: Theme) -> None:
    """One square: a share with its counts, or hatched."""
    corner = (column - 0.5, row - 0.5)
    if rate is None or rate.value is None:
        axes.add_patch(Rectangle(corner, 1, 1, facecolor=theme.empty, edgecolor=_HATCH, hatch="///", linewidth=0))
        axes.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=theme.paper, linewidth=1.5))
        box = {"facecolor": theme.empty, "edgecolor": "none", "pad": 2.0}
        axes.text(column, row, UNDEFINED, ha="center", va="center", bbox=box)
        return
    colour = mpl.colormaps[COLOURS](rate.value)
    axes.add_patch(Rectangle(corner, 1, 1, facecolor=colour, edgecolor=theme.paper, linewidth=1.5))
    style: dict[str, Any] = {"ha": "center", "color": text_colour(colour[:3])}
    axes.text(column, row + 0.02, f"{100 * rate.value:.0f} %", va="bottom", **style)
    axes.text(column, row + 0.06, f"{round(rate.numerator)}/{rate.denominator}", va="top", fontsize="small", **style)
