"""Plots by matplotlib: the same numbers give the same bytes, independent of user settings."""

import gc
import io
import struct
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmark.report.palette import (
    ON_DARK,
    ON_LIGHT,
    PLANNERS_ON_DARK,
    PLANNERS_ON_LIGHT,
    GroundColours,
    Rgb,
    format_hexadecimal,
)

FORMATS: Final = (".png", ".svg")
_DPI = 120
_PAGE_DPI = 96
"""Pixels of a page to an inch: at this size letters of 8.5 points are 11 pixels high."""


@dataclass(frozen=True, slots=True)
class PlotTheme:
    """Colours of a plot on a light or a dark page.

    ``faint`` letters matter less, ``rule`` lines are of a grid, ``empty`` cells have no number. Planners have colours
    by their place, which repeat. With ``dark``, what is brighter stands out more.
    """

    paper: str
    ink: str
    faint: str
    rule: str
    empty: str
    good: str
    contact: str
    ground: GroundColours
    planners: tuple[Rgb, ...]
    dark: bool = False

    def planner(self, place: int) -> str:
        """Colour of the planner at a place."""
        return format_hexadecimal(self.planners[place % len(self.planners)])

    def settings(self) -> dict[str, Any]:
        """The same as settings of matplotlib."""
        inked = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
        plain = ("figure.facecolor", "axes.facecolor", "savefig.facecolor", "savefig.edgecolor")
        return dict.fromkeys(inked, self.ink) | dict.fromkeys(plain, self.paper)


LIGHT: Final = PlotTheme(
    "#ffffff", "#1b1e21", "#444444", "#dddddd", "#f2f2f2", "#b9d3e8", "#b00020", ON_LIGHT, PLANNERS_ON_LIGHT
)
DARK: Final = PlotTheme(
    "#1a1e22", "#e4e7e9", "#b4bcc4", "#343b41", "#2a3036", "#3f5a72", "#ff5c77", ON_DARK, PLANNERS_ON_DARK, dark=True
)


Sketch = Callable[[PlotTheme], Figure]
"""Makes a figure (`new_figure`) in the colours of a page."""


def render_figure(sketch: Sketch, suffix: str, theme: PlotTheme = LIGHT) -> bytes:
    """PNG or SVG of a figure, unaffected by the user's settings of matplotlib; ``suffix`` is one of `FORMATS`."""
    return _saved(sketch, (suffix,), theme)[0]


def render_for_pages(sketch: Sketch) -> tuple[bytes, bytes, Callable[[], bytes]]:
    """A figure for pages: PNG and SVG for light ones, what draws the SVG for dark ones; bytes as of `render_figure`."""
    png, svg = _saved(sketch, (".png", ".svg"), LIGHT)
    return png, svg, partial(render_figure, sketch, ".svg", DARK)


def _saved(sketch: Sketch, suffixes: tuple[str, ...], theme: PlotTheme) -> tuple[bytes, ...]:
    """One figure in several formats: making it takes as long as saving it."""
    # Without a fixed salt the identifiers inside an SVG are random; the rest undoes a user's own matplotlibrc.
    settings: Any = {**mpl.rcParamsDefault, "svg.hashsalt": "challenger-bench", "font.family": ["DejaVu Sans"]}
    settings |= theme.settings()
    settings.pop("backend", None)
    saved = []
    with warnings.catch_warnings(), mpl.rc_context(settings):
        # A name in a script that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph")
        figure = sketch(theme)
        for suffix in suffixes:
            stream = io.BytesIO()
            if suffix == ".png":
                figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})
            else:
                figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
            saved.append(stream.getvalue())
        # Thousands of artists in reference cycles would stay in memory with those of the next figure.
        del figure
        gc.collect(1)
    return tuple(saved)


def figure_png(figure: Figure) -> bytes:
    """A figure as a PNG file without a date or a version in it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None}, pil_kwargs={"optimize": True})
    return buffer.getvalue()


def read_png_size(picture: bytes) -> tuple[int, int]:
    """(width, height) of a PNG, pixels; zeros for a file that is no PNG."""
    if not picture.startswith(b"\x89PNG"):
        return 0, 0
    width, height = struct.unpack(">II", picture[16:24])
    return width, height


def compute_page_size(picture: bytes) -> tuple[int, int]:
    """(width, height) of a PNG of `render_figure` on a page, where its letters are as large as they were meant."""
    width, height = read_png_size(picture)
    return round(width * _PAGE_DPI / _DPI), round(height * _PAGE_DPI / _DPI)


def new_figure(width_inches: float, height_inches: float) -> Figure:
    """An empty figure that needs no window."""
    figure = Figure(figsize=(width_inches, height_inches))
    FigureCanvasAgg(figure)
    return figure
