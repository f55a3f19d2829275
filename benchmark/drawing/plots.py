"""Plots by matplotlib: the same numbers give the same bytes, whatever settings the user has."""

import io
import struct
import warnings
from collections.abc import Callable
from typing import Final

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

FORMATS: Final = (".png", ".svg")
_DPI = 120


def picture(draw: Callable[[], Figure], suffix: str) -> bytes:
    """A figure's bytes, whatever settings of matplotlib the user has.

    Args:
        draw: Makes the figure (`new_figure`).
        suffix: One of `FORMATS`.

    Returns:
        PNG or SVG.
    """
    # Without a fixed salt the identifiers inside an SVG are random; the rest undoes a user's own matplotlibrc.
    settings = {**mpl.rcParamsDefault, "svg.hashsalt": "challenger-bench", "font.family": ["DejaVu Sans"]}
    settings.pop("backend", None)
    stream = io.BytesIO()
    with warnings.catch_warnings(), mpl.rc_context(settings):
        # A name in a script that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph")
        figure = draw()
        if suffix == ".png":
            figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})
        else:
            figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def png_size(picture: bytes) -> tuple[int, int]:
    """(width, height) of a PNG, pixels; zeros for what is none."""
    if not picture.startswith(b"\x89PNG"):
        return 0, 0
    width, height = struct.unpack(">II", picture[16:24])
    return width, height


def new_figure(width_inches: float, height_inches: float) -> Figure:
    """An empty figure that needs no window."""
    figure = Figure(figsize=(width_inches, height_inches))
    FigureCanvasAgg(figure)
    return figure
