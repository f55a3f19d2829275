"""Text on pictures: any name, anti-aliased, the same pixels everywhere."""

import functools
from pathlib import Path
from typing import Final, Literal

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmark.report.palette import INK, Rgb

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

    Args:
        at: Pixels; x of its left end, middle or right end, y of the middle of its small letters' line.
        anchor: Point of the text that ``at`` is.
        plate: Colour of a plate behind it, to be read on anything.
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


def fitted(text: str, width_px: int, *, size_px: int = 14, bold: bool = False) -> str:
    """A line that is cut, with an ellipsis, to be no wider than asked."""
    if text_width(text, size_px=size_px, bold=bold) <= width_px:
        return text
    for length in range(len(text) - 1, 0, -1):
        if text_width(f"{text[:length]}…", size_px=size_px, bold=bold) <= width_px:
            return f"{text[:length]}…"
    return ""


def drawable(name: str) -> str:
    """A stranger's name on one line, cut, without characters that cannot be drawn or written into an SVG."""
    text = "".join(character if character.isprintable() else " " for character in name)
    text = " ".join(text.split())
    return text if len(text) <= NAME_CHARACTERS else f"{text[: NAME_CHARACTERS - 1]}…"


def _fill(image: Picture, x1: int, y1: int, x2: int, y2: int, colour: Rgb) -> None:
    image[max(y1, 0) : max(y2, 0), max(x1, 0) : max(x2, 0)] = colour


@functools.lru_cache(maxsize=16)
def _font(size_px: int, bold: bool) -> ImageFont.FreeTypeFont:
    path = Path(mpl.get_data_path()) / "fonts" / "ttf" / _FONTS[bold]
    # The other layout engine is not everywhere, and would give other pixels.
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
