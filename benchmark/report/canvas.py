"""A picture of the ground from above: where metres fall on pixels, and lines, shapes and text, the same everywhere."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import cv2
import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmark.geometry import Floats, box_corners
from benchmark.report.palette import INK, Dash, Rgb

Picture = NDArray[np.uint8]
Anchor = Literal["left", "centre", "right"]
NAME_CHARACTERS: Final = 36
"""Longer names are cut."""
_FONTS: Final = {False: "DejaVuSans.ttf", True: "DejaVuSans-Bold.ttf"}


def write_text(
    image: Picture,
    text: str,
    at: tuple[float, float],
    *,
    size_px: int = 14,
    colour: Rgb = INK,
    bold: bool = False,
    anchor: Anchor = "left",
    plate: Rgb | None = None,
) -> None:
    """Write one line; what is outside the picture is cut off.

    ``at`` is in pixels: x of its left end, middle or right end (``anchor``), y of the middle of its small letters'
    line. A ``plate`` is a colour behind it, to be read on anything.
    """
    mask = _mask(text, size_px, bold)
    height, width = mask.shape
    left = round(at[0] - {"left": 0.0, "centre": 0.5, "right": 1.0}[anchor] * width)
    top = round(at[1] - 0.5 * height)
    if plate is not None:
        _fill(image, left - 4, top - 1, left + width + 4, top + height + 1, plate)
    x1, y1, x2, y2 = max(left, 0), max(top, 0), min(left + width, image.shape[1]), min(top + height, image.shape[0])
    if x1 >= x2 or y1 >= y2:
        return
    share = mask[y1 - top : y2 - top, x1 - left : x2 - left, None]
    area = image[y1:y2, x1:x2]
    area[:] = (area + (np.array(colour, np.float32) - area) * share + 0.5).astype(np.uint8)


def text_width(text: str, *, size_px: int = 14, bold: bool = False) -> int:
    """Width of a line in pixels."""
    return int(_mask(text, size_px, bold).shape[1])


def truncate_to_width(text: str, width_px: int, *, size_px: int = 14, bold: bool = False) -> str:
    """A line that is cut, with an ellipsis, to be no wider than asked."""
    if text_width(text, size_px=size_px, bold=bold) <= width_px:
        return text
    for length in range(len(text) - 1, 0, -1):
        if text_width(f"{text[:length]}…", size_px=size_px, bold=bold) <= width_px:
            return f"{text[:length]}…"
    return ""


def wrap_to_width(text: str, width_px: int, lines: int, *, size_px: int = 14) -> list[str]:
    """Text on so many lines at most, each no wider than asked; the last one is cut as `truncate_to_width` does."""
    words = text.split()
    wrapped: list[str] = []
    while len(wrapped) < lines - 1 and text_width(" ".join(words), size_px=size_px) > width_px:
        fits = (
            count
            for count in range(len(words), 1, -1)
            if text_width(" ".join(words[:count]), size_px=size_px) <= width_px
        )
        count = next(fits, 1)
        wrapped.append(" ".join(words[:count]))
        words = words[count:]
    return [truncate_to_width(line, width_px, size_px=size_px) for line in (*wrapped, " ".join(words)) if line]


def sanitise_name(name: str, characters: int = NAME_CHARACTERS) -> str:
    """A stranger's name on one line, cut, without characters that cannot be drawn or written into an SVG."""
    text = "".join(character if character.isprintable() else " " for character in name)
    text = " ".join(text.split())
    return text if len(text) <= characters else f"{text[: characters - 1]}…"


def _fill(image: Picture, x1: int, y1: int, x2: int, y2: int, colour: Rgb) -> None:
    image[max(y1, 0) : max(y2, 0), max(x1, 0) : max(x2, 0)] = colour


@functools.lru_cache(maxsize=16)
def _font(size_px: int, bold: bool) -> ImageFont.FreeTypeFont:
    path = Path(mpl.get_data_path()) / "fonts" / "ttf" / _FONTS[bold]
    # The other layout engine is not available everywhere, and gives other pixels.
    return ImageFont.truetype(str(path), size_px, layout_engine=ImageFont.Layout.BASIC)


@functools.lru_cache(maxsize=2048)
def _mask(text: str, size_px: int, bold: bool) -> NDArray[np.float32]:
    """(h, w) share of ink; h is that of the font, so that lines of text stand on one line."""
    font = _font(size_px, bold)
    ascent, descent = font.getmetrics()
    width = max(round(font.getlength(text)), 1)
    picture = Image.new("L", (width, ascent + descent), 0)
    ImageDraw.Draw(picture).text((0, 0), text, fill=255, font=font)
    mask = np.asarray(picture, np.float32) / 255
    mask.setflags(write=False)
    return mask


SHIFT = 4
"""Binary digits of the fraction in OpenCV's coordinates."""
_MARGIN_PX = 8
"""Marks and thick lines reach so far beyond their points."""
_FARTHEST_PX = 30_000.0
"""OpenCV takes short integers in places; what is farther away is out of sight anyway."""


@dataclass(frozen=True, slots=True)
class GroundView:
    """Map from metres on the ground to pixels: ``matrix`` (2, 3) takes x, y in metres to column and row."""

    matrix: Floats
    scale_px_m: float
    width_px: int
    height_px: int

    def pixels(self, points: Floats) -> Floats:
        """Columns and rows, (..., 2) pixels, of (..., 2) metres, cut where they are far outside."""
        unclipped = np.asarray(points, np.float64) @ self.matrix[:, :2].T + self.matrix[:, 2]
        return np.asarray(np.clip(unclipped, -_FARTHEST_PX, _FARTHEST_PX))

    def fixed(self, points: Floats) -> NDArray[np.int32]:
        """The same with `SHIFT` binary digits of fraction, as OpenCV wants them."""
        return np.asarray(np.round(self.pixels(points) * (1 << SHIFT)), np.int32)

    def near(self, centres: Floats, reaches_m: Floats) -> NDArray[np.int64]:
        """Places, ascending, of the circles that may touch the picture: (N, 2) centres and (N,) radii in metres."""
        middle = self.pixels(centres) - (0.5 * self.width_px, 0.5 * self.height_px)
        reach = 0.5 * np.hypot(self.width_px, self.height_px) + reaches_m * self.scale_px_m
        return np.flatnonzero((middle**2).sum(axis=-1) <= reach**2)

    def sees(self, points: Floats) -> bool:
        """Whether the rectangle around some points touches the picture; (M, 2) metres."""
        if not len(points):
            return False
        pixels = self.pixels(points)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        return bool((high >= 0).all() and low[0] <= self.width_px and low[1] <= self.height_px)


def make_view(
    pose: Floats,
    *,
    width_px: int,
    height_px: int,
    extent_m: float,
    heading_up: bool = True,
    middle: float = 0.5,
) -> GroundView:
    """A view with a pose (x, y, yaw in metres and radians) in it, at the share ``middle`` of its height from above.

    The shorter side shows twice ``extent_m``. The heading points up, or else +y, which is north in the global frame.
    """
    scale = min(width_px, height_px) / (2.0 * extent_m)
    yaw = float(pose[2]) if heading_up else np.pi / 2
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = scale * np.array([[sin, -cos], [-cos, -sin]])
    at = np.array([(width_px - 1) / 2.0, (height_px - 1) * middle])
    return GroundView(np.column_stack([turn, at - turn @ pose[:2]]), scale, width_px, height_px)


def fill_rings(image: Picture, view: GroundView, rings: Sequence[Floats], colour: Rgb) -> None:
    """Fill rings, each (M, 2) metres, in place; a point inside an even number of rings is outside the area."""
    if rings and view.sees(np.concatenate(rings)):
        cv2.fillPoly(image, _split(view, rings), colour, cv2.LINE_AA, SHIFT)


def stroke(
    image: Picture,
    view: GroundView,
    points: Floats,
    colour: Rgb,
    width_px: int,
    *,
    dash: Dash = (),
    closed: bool = False,
) -> None:
    """Draw a line through (M, 2) metres on the picture in place; the pattern of ``dash`` is in pixels."""
    if len(points) < 2 or not view.sees(points):
        return
    pixels = view.pixels(np.concatenate([points, points[:1]]) if closed else points)
    lines = split_into_dashes(pixels, dash) if dash else [pixels]
    fixed = [np.round(line * (1 << SHIFT)).astype(np.int32) for line in lines]
    cv2.polylines(image, fixed, False, colour, width_px, cv2.LINE_AA, SHIFT)


def stroke_all(image: Picture, view: GroundView, lines: Sequence[Floats], colour: Rgb, width_px: int) -> None:
    """Draw many lines, each (M, 2) metres."""
    if lines:
        cv2.polylines(image, _split(view, lines), False, colour, width_px, cv2.LINE_AA, SHIFT)


def fill_box(image: Picture, view: GroundView, box: Floats, colour: Rgb) -> None:
    """Fill a box (5,)."""
    corners = box_corners(box)
    if view.sees(corners):
        cv2.fillConvexPoly(image, view.fixed(corners), colour, cv2.LINE_AA, SHIFT)


def outline_box(image: Picture, view: GroundView, box: Floats, colour: Rgb, width_px: int = 1, dash: Dash = ()) -> None:
    """Draw the edges of a box (5,)."""
    stroke(image, view, box_corners(box), colour, width_px, dash=dash, closed=True)


def mark_at(image: Picture, pixel: Floats, shape: str, radius_px: float, colour: Rgb, edge: Rgb | None = None) -> None:
    """Draw a filled ``circle``, ``square``, ``triangle`` or ``diamond`` around a (2,) pixel in place."""
    if shape == "circle":
        centre = tuple(int(value) for value in np.round(pixel * (1 << SHIFT)))
        cv2.circle(image, centre, round(radius_px * (1 << SHIFT)), colour, -1, cv2.LINE_AA, SHIFT)
        if edge is not None:
            cv2.circle(image, centre, round(radius_px * (1 << SHIFT)), edge, 1, cv2.LINE_AA, SHIFT)
        return
    corners = np.round((pixel + radius_px * _SHAPES[shape]) * (1 << SHIFT)).astype(np.int32)
    cv2.fillConvexPoly(image, corners, colour, cv2.LINE_AA, SHIFT)
    if edge is not None:
        cv2.polylines(image, [corners], True, edge, 1, cv2.LINE_AA, SHIFT)


def draw_translucent(
    image: Picture, view: GroundView, points: Floats, opacity: float, draw: Callable[[], None]
) -> None:
    """Draw with an opacity of 0 to 1, in the rectangle around (M, 2) metres or a few pixels outside it."""
    if opacity <= 0.0 or not view.sees(points):
        return
    pixels = view.pixels(points)
    left, top = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - _MARGIN_PX, 0)
    right, bottom = np.maximum(np.ceil(pixels.max(axis=0)).astype(int) + _MARGIN_PX, 0)
    before = image[top:bottom, left:right].copy()
    draw()
    area = image[top:bottom, left:right]
    if area.size:
        area[:] = cv2.addWeighted(area, opacity, before, 1.0 - opacity, 0.0)


def encode_png(image: Picture) -> bytes:
    """A picture as a file without loss."""
    done, data = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    assert done
    return bytes(data)


def split_into_dashes(line: Floats, pattern: Dash) -> list[Floats]:
    """Strokes (K, 2) of a dashed line (M, 2); ``pattern`` alternates lengths of strokes and gaps, in its unit."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    total = float(along[-1])
    if not total > 0.0:
        return []
    # A line that leaves the picture by far would be thousands of invisible strokes.
    steps = np.tile(pattern, int(min(total, 4 * _FARTHEST_PX) // sum(pattern)) + 1)
    ends = np.cumsum(steps)
    begins, ends = (ends - steps)[::2], np.minimum(ends[::2], total)
    begins, ends = begins[begins < total], ends[begins < total]
    tips = np.column_stack([np.interp(np.concatenate([begins, ends]), along, line[:, axis]) for axis in (0, 1)])
    first, last = np.searchsorted(along, begins, "right"), np.searchsorted(along, ends, "left")
    count = len(begins)
    return [
        np.concatenate(
            [tips[index : index + 1], line[first[index] : last[index]], tips[count + index : count + index + 1]]
        )
        for index in range(count)
    ]


def _split(view: GroundView, lines: Sequence[Floats]) -> list[NDArray[np.int32]]:
    """Lines in fixed point, by one product."""
    fixed = view.fixed(np.concatenate(lines))
    ends = np.cumsum([len(line) for line in lines]).tolist()
    return [fixed[begin:end] for begin, end in zip([0, *ends], ends)]


_SHAPES = {
    "square": np.array([[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]]),
    "triangle": np.array([[0.0, -1.2], [1.1, 0.8], [-1.1, 0.8]]),
    "diamond": np.array([[0.0, -1.25], [1.25, 0.0], [0.0, 1.25], [-1.25, 0.0]]),
}
