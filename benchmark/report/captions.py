"""Captions of a bird's-eye picture: time, scale, legend, verdicts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from benchmark.records.scene_pages import ScenePage
from benchmark.report.canvas import (
    SHIFT,
    GroundView,
    Picture,
    mark_at,
    sanitise_name,
    split_into_dashes,
    text_width,
    write_text,
)
from benchmark.report.overlays import CandidatesOverlay, Overlay, PlanOverlay
from benchmark.report.palette import (
    ADVERSARY,
    BEST,
    CONTACT,
    EGO,
    FAINT_INK,
    INK,
    ON_LIGHT,
    PAPER,
    PATH_DASH,
    PlannerStyle,
    Rgb,
    mix_colours,
)

_SCALES_M: Final = (1, 2, 5, 10, 20, 50, 100)


@dataclass(frozen=True, slots=True)
class LegendEntry:
    """One line of the legend; ``kind`` is ``box``, ``way``, ``path``, ``forecast`` or ``candidates``."""

    kind: str
    colour: Rgb
    words: str


def build_legend(sheet: ScenePage, overlays: Sequence[Overlay]) -> list[LegendEntry]:
    """Entries of the legend beside those of planners, for things in the picture only."""
    adversaries = sum(agent.adversary for agent in sheet.agents)
    plans = [
        overlay
        for overlay in overlays
        if isinstance(overlay, PlanOverlay) and overlay.details and overlay.plan is not None
    ]
    entries = [LegendEntry("box", EGO, "ego")]
    if adversaries:
        entries.append(LegendEntry("box", ADVERSARY, "adversary" if adversaries == 1 else "adversaries"))
    if len(sheet.agents) > adversaries:
        entries.append(LegendEntry("box", ON_LIGHT.vehicle, "others"))
    entries.append(LegendEntry("way", EGO, "recorded, 3 s"))
    if any(plan.plan is not None and plan.plan.forecasts is not None for plan in plans):
        entries.append(LegendEntry("forecast", FAINT_INK, "forecasts"))
    if any(isinstance(overlay, CandidatesOverlay) for overlay in overlays):
        entries.append(LegendEntry("candidates", BEST, "candidates of the search"))
    return entries


def draw_entry(image: Picture, entry: LegendEntry, at: tuple[float, float], *, size_px: int = 12) -> int:
    """Draw an entry of the legend in place; returns its width in pixels. ``at`` is its left end, mid-height."""
    x, y = at
    left, right, row = round(x), round(x) + 20, round(y)
    if entry.kind == "box":
        cv2.rectangle(image, (left + 1, row - 4), (right - 2, row + 4), entry.colour, -1)
        cv2.rectangle(image, (left + 1, row - 4), (right - 2, row + 4), INK, 1)
    elif entry.kind == "candidates":
        for number, share in enumerate((1.0, 0.6, 0.3, 0.0)):
            shade = mix_colours(BEST, (190, 214, 90), share)
            cv2.line(image, (left, row + 4), (right, row - 6 + 4 * number), shade, 1, cv2.LINE_AA)
    elif entry.kind == "path":
        line_pixels(image, (left, row), (right, row), entry.colour, 2, PATH_DASH)
    else:
        line_pixels(image, (left, row), (right, row), entry.colour, 2, (3.0, 3.0) if entry.kind == "forecast" else ())
        inside = PAPER if entry.kind == "forecast" else entry.colour
        mark_at(image, np.array([(left + right) / 2, row]), "circle", 3.0, inside, entry.colour)
    write_text(image, entry.words, (x + 26, y), size_px=size_px)
    return 26 + text_width(entry.words, size_px=size_px)


def draw_swatch(image: Picture, style: PlannerStyle, at: tuple[float, float], width_px: int = 30) -> None:
    """A piece of a planner's line with its mark, from ``at`` to the right."""
    x, y = at
    line_pixels(image, (x, y), (x + width_px, y), style.colour, 3, style.dash)
    mark_at(image, np.array([x + width_px / 2, y]), style.mark, 5.0, style.colour, PAPER)


def line_pixels(
    image: Picture,
    first: tuple[float, float],
    second: tuple[float, float],
    colour: Rgb,
    width_px: int,
    dash: tuple[float, ...] = (),
) -> None:
    """A line between two pixels, in a pattern."""
    line = np.array([first, second], np.float64)
    parts = split_into_dashes(line, dash) if dash else [line]
    fixed = [np.round(part * (1 << SHIFT)).astype(np.int32) for part in parts]
    cv2.polylines(image, fixed, False, colour, width_px, cv2.LINE_AA, SHIFT)


def draw_scale_bar(image: Picture, view: GroundView) -> None:
    """A bar of a round number of metres in the lower right corner."""
    fits = [metres for metres in _SCALES_M if metres * view.scale_px_m <= 0.25 * view.width_px]
    metres = fits[-1] if fits else _SCALES_M[0]
    right, row = view.width_px - 12, view.height_px - 12
    left = round(right - metres * view.scale_px_m)
    cv2.rectangle(image, (left - 6, row - 20), (right + 6, row + 6), PAPER, -1)
    for edge in (left, right):
        cv2.line(image, (edge, row - 3), (edge, row + 3), INK, 1)
    cv2.line(image, (left, row), (right, row), INK, 1)
    write_text(image, f"{metres} m", ((left + right) / 2, row - 10), size_px=11, anchor="centre")


def draw_time(image: Picture, seconds: float) -> None:
    """The time of a frame in the upper left corner."""
    write_text(image, f"t = {seconds:.1f} s", (10.0, 14.0), size_px=13, bold=True, plate=PAPER)


def draw_captions(
    image: Picture, view: GroundView, sheet: ScenePage, seconds: float, overlays: Sequence[Overlay]
) -> None:
    """Time above on the left, scale below on the right, the legend and the verdicts below on the left."""
    draw_time(image, seconds)
    draw_scale_bar(image, view)
    entries = build_legend(sheet, overlays)
    plans = [overlay for overlay in overlays if isinstance(overlay, PlanOverlay)]
    words = [f"{sanitise_name(plan.name)}: {plan.verdict.words}" for plan in plans]
    widths = [26 + text_width(entry.words, size_px=12) for entry in entries]
    widths += [38 + text_width(text, size_px=12, bold=True) for text in words]
    height = 18 * (len(entries) + len(words)) + 8
    top = view.height_px - height - 8
    image[max(top, 0) : view.height_px - 8, 8 : 24 + max(widths)] = PAPER
    row = top + 13.0
    for entry in entries:
        draw_entry(image, entry, (14.0, row))
        row += 18
    for plan, text in zip(plans, words):
        draw_swatch(image, plan.style, (14.0, row), 26)
        alarms = plan.verdict.alarms
        write_text(image, text, (46.0, row), size_px=12, colour=CONTACT if alarms else INK, bold=alarms)
        row += 18
