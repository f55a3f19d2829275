"""The part of a film's frame that says who is who and what each planner's samples came to."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from benchmark.geometry import Bools, Floats, box_gap
from benchmark.records.scene_pages import ScenePage
from benchmark.report.canvas import SHIFT, Picture, mark_at, sanitise_name, text_width, truncate_to_width, write_text
from benchmark.report.captions import build_legend, draw_entry, draw_swatch
from benchmark.report.cells import MINIATURE_MARK, MINIATURE_WORDS, UNDEFINED
from benchmark.report.overlays import CollisionParty, Overlay, PlanVerdict
from benchmark.report.palette import ADVERSARY, BYSTANDER, CONTACT, FAINT_INK, INK, PANEL, PAPER, RULE, Rgb, mix_colours
from benchmark.report.placement import agent_box, ego_box
from leaderboard.extensions.films.tracks import PlannerTrack, SampleTally

_ROW_PX: Final = (56, 76)
"""Least and greatest height of one planner."""
MOST_PLANNERS: Final = 8
"""More cannot be told apart."""
_EDGE_PX: Final = 14
_FOOT_PX: Final = 24
_LINE_PX: Final = 16
_GAP_CHART_PX: Final = (84, 190)
"""Least and greatest height of the chart of the gap."""
_WIDEST_GAP_M: Final = 10.0
_CLEAR: Final[Rgb] = (190, 208, 222)


@dataclass(frozen=True, slots=True)
class PixelRectangle:
    """A rectangle of pixels: a row of samples, or one of them."""

    left: int
    top: int
    width: int
    height: int


class Panel:
    """Draws the panel of one film."""

    def __init__(self, sheet: ScenePage, tracks: Sequence[PlannerTrack], *, from_above: bool) -> None:
        """Take what does not change; a frame that shows the scene from above has more to explain."""
        self._sheet, self._tracks, self._from_above = sheet, tracks, from_above
        self._miniatures = any(track.miniature for track in tracks)
        self._gap_m: Floats = compute_adversary_gap(sheet)

    def draw(self, width_px: int, height_px: int, overlays: Sequence[Overlay], frame: int) -> Picture:
        """Legend, planners with their samples so far, the gap to the adversary if there is room; (h, w, 3) RGB."""
        image: Picture = np.empty((height_px, width_px, 3), np.uint8)
        cv2.rectangle(image, (0, 0), (width_px, height_px), PANEL, -1)
        top = self._draw_legend(image, overlays)
        foot = height_px - _FOOT_PX - (_LINE_PX if self._miniatures else 0)
        top = self._draw_tracks(image, frame, top, foot) if self._tracks else self._draw_description(image, top)
        room = min(foot - top - 8, _GAP_CHART_PX[1])
        if room >= _GAP_CHART_PX[0] and np.isfinite(self._gap_m).any():
            self._draw_gap(image, frame, PixelRectangle(_EDGE_PX, foot - room, width_px - 2 * _EDGE_PX, room))
        return image

    def _draw_legend(self, image: Picture, overlays: Sequence[Overlay]) -> int:
        """Entries side by side, in as many lines as they need; where the next thing may begin."""
        x, y = float(_EDGE_PX), 18.0
        entries = build_legend(self._sheet, overlays)
        if not self._from_above:
            entries = [legend_entry for legend_entry in entries if legend_entry.colour == ADVERSARY]
        for entry in entries:
            if x > _EDGE_PX and x + 26 + text_width(entry.words, size_px=12) > image.shape[1] - _EDGE_PX:
                x, y = float(_EDGE_PX), y + 20.0
            x += draw_entry(image, entry, (x, y)) + 18
        return round(y) + 16

    def _draw_tracks(self, image: Picture, frame: int, top: int, foot: int) -> int:
        rows = min(max((foot - top) // _ROW_PX[0], 1), len(self._tracks))
        columns = -(-len(self._tracks) // rows)
        row_px = min(max((foot - top) // rows, _ROW_PX[0]), _ROW_PX[1])
        each_px = (image.shape[1] - _EDGE_PX * (columns + 1)) // columns
        for place, track in enumerate(self._tracks):
            left = _EDGE_PX + (place // rows) * (each_px + _EDGE_PX)
            corner = left, top + (place % rows) * row_px
            _draw_track(image, self._sheet, track, frame, corner, (each_px, row_px))
        judges = ", ".join(dict.fromkeys(track.protocol for track in self._tracks))
        failure = (
            "hits the adversary first within 3 s, ◇ another" if _has_adversary(self._sheet) else "collides within 3 s"
        )
        words = f"one cell a sample; × is a plan that {failure} (protocol {_to_one_line(judges)})"
        words = truncate_to_width(words, image.shape[1] - 2 * _EDGE_PX, size_px=12)
        write_text(image, words, (_EDGE_PX, foot + 12.0), size_px=12, colour=FAINT_INK)
        if self._miniatures:
            write_text(image, MINIATURE_WORDS, (_EDGE_PX, foot + 12.0 + _LINE_PX), size_px=12, colour=FAINT_INK)
        return top + rows * row_px

    def _draw_description(self, image: Picture, top: int) -> int:
        words = truncate_to_width(_to_one_line(self._sheet.description), image.shape[1] - 2 * _EDGE_PX, size_px=13)
        if words:
            write_text(image, words, (_EDGE_PX, top + 12.0), size_px=13, colour=FAINT_INK)
        return top + 30

    def _draw_gap(self, image: Picture, frame: int, area: PixelRectangle) -> None:
        """Draw the distance of the recorded ego from the nearest adversary, over the whole scene; now is marked."""
        now = self._gap_m[frame]
        gap_text = f"{now:.1f} m" if np.isfinite(now) else "no adversary in the scene"
        words = f"gap between recorded ego and adversary: {gap_text}"
        write_text(image, truncate_to_width(words, area.width, size_px=12), (area.left, area.top + 8.0), size_px=12)
        top, bottom, right = (
            area.top + 24,
            area.top + area.height - 8,
            area.left + _compute_bar_width(self._sheet, area.width),
        )
        for metres in (0.0, _WIDEST_GAP_M / 2, _WIDEST_GAP_M):
            y = round(bottom - metres / _WIDEST_GAP_M * (bottom - top))
            cv2.line(image, (area.left, y), (right, y), RULE, 1)
            text = f"{metres:.0f} m" if metres < _WIDEST_GAP_M else f"{metres:.0f} m or more"
            write_text(image, text, (right + 6.0, y), size_px=11, colour=FAINT_INK)
        # Below the samples, on the same time axis.
        edges = _compute_cell_edges(self._sheet, area.left, right - area.left)
        x = np.interp(np.arange(len(self._gap_m)), [*self._sheet.keyframes, len(self._gap_m)], edges)
        y_px = bottom - np.clip(self._gap_m / _WIDEST_GAP_M, 0.0, 1.0) * (bottom - top)
        for begin, end in _find_stretches(np.isfinite(self._gap_m)):
            for last, colour in ((end, mix_colours(ADVERSARY, PANEL, 0.6)), (min(end, frame + 1), ADVERSARY)):
                line = np.round(np.column_stack([x[begin:last], y_px[begin:last]]) * (1 << SHIFT)).astype(np.int32)
                if len(line) > 1:
                    cv2.polylines(image, [line], False, colour, 2, cv2.LINE_AA, SHIFT)
        cv2.line(image, (round(x[frame]), top - 4), (round(x[frame]), bottom + 4), INK, 1)
        if np.isfinite(now):
            mark_at(image, np.array([x[frame], y_px[frame]]), "circle", 4.0, ADVERSARY, PAPER)


def compute_adversary_gap(sheet: ScenePage) -> Floats:
    """(T,) metres between the recorded ego and the nearest adversary at each frame; NaN where there is none."""
    gaps = np.full(len(sheet.timestamps_us), np.nan)
    for agent in sheet.agents:
        for frame in range(len(gaps)) if agent.adversary else ():
            box = agent_box(agent, frame)
            if box is not None:
                gaps[frame] = np.fmin(gaps[frame], box_gap(ego_box(sheet, frame), box))
    return gaps


def _to_one_line(text: str) -> str:
    """Text of any length on one line, without characters that cannot be drawn."""
    return " ".join("".join(character if character.isprintable() else " " for character in text).split())


def _has_adversary(sheet: ScenePage) -> bool:
    return any(agent.adversary for agent in sheet.agents)


def _compute_bar_width(sheet: ScenePage, width_px: int) -> int:
    """Width of a row of samples with words to the right of it."""
    widest = SampleTally(
        88, {CollisionParty.ANYBODY: 88, CollisionParty.ADVERSARY: 88, CollisionParty.OTHER: 88}
    ).words(adversaries=_has_adversary(sheet))
    return width_px - text_width(widest, size_px=12) - 10


def _compute_cell_edges(sheet: ScenePage, left: int, width_px: int) -> list[int]:
    """Edges at which samples begin, and at which the last one ends."""
    count = len(sheet.keyframes)
    return [left + round(width_px * number / max(count, 1)) for number in range(count + 1)]


def _find_stretches(there: Bools) -> list[tuple[int, int]]:
    """Beginnings and ends of stretches of True."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(np.int8)))
    return [(int(begin), int(end)) for begin, end in zip(steps[::2], steps[1::2])]


def _draw_track(
    image: Picture,
    sheet: ScenePage,
    track: PlannerTrack,
    frame: int,
    corner: tuple[int, int],
    size: tuple[int, int],
) -> None:
    """Swatch, name and present verdict; below them the samples."""
    (left, top), (width_px, height_px) = corner, size
    draw_swatch(image, track.style, (left, top + 12.0))
    plan = track.at(frame)
    verdict = PlanVerdict(None, "no plan yet", "no plan", counted=False) if plan is None else plan.verdict
    alarm, brief_px = verdict.alarms, text_width(verdict.brief, size_px=13, bold=True)
    name = f"{sanitise_name(track.name)} {MINIATURE_MARK}" if track.miniature else sanitise_name(track.name)
    name = truncate_to_width(name, width_px - 52 - brief_px, size_px=14, bold=True)
    write_text(image, name, (left + 40.0, top + 12.0), size_px=14, bold=True)
    room = width_px - 52 - text_width(name, size_px=14, bold=True)
    words = verdict.words if text_width(verdict.words, size_px=13, bold=alarm) <= room else verdict.brief
    right, colour = left + width_px, CONTACT if alarm else INK
    write_text(image, words, (right, top + 12.0), size_px=13, bold=alarm, colour=colour, anchor="right")
    tally_text = track.tally_until(frame).words(adversaries=_has_adversary(sheet))
    bar = PixelRectangle(left, top + 26, _compute_bar_width(sheet, width_px), height_px - _ROW_PX[0] + 18)
    _draw_samples(image, sheet, track, frame, bar)
    at = (right, bar.top + bar.height / 2)
    write_text(image, tally_text, at, size_px=12, colour=FAINT_INK, anchor="right")


def _draw_samples(image: Picture, sheet: ScenePage, track: PlannerTrack, frame: int, bar: PixelRectangle) -> None:
    """One cell a sample; those to come are empty."""
    edges = _compute_cell_edges(sheet, bar.left, bar.width)
    for keyframe, first, last in zip(sheet.keyframes, edges, edges[1:]):
        plan = track.plans.get(keyframe)
        if plan is not None:
            cell = PixelRectangle(first, bar.top, max(last - first - 2, 1), bar.height)
            _draw_cell(image, plan.verdict if keyframe <= frame else None, cell)
    past = [place for place, keyframe in enumerate(sheet.keyframes) if keyframe <= frame]
    if past:
        first, last = edges[past[-1]], edges[past[-1] + 1]
        cv2.rectangle(image, (first - 1, bar.top - 3), (last - 1, bar.top + bar.height + 2), INK, 1)


def _draw_cell(image: Picture, verdict: PlanVerdict | None, cell: PixelRectangle) -> None:
    corners = (cell.left, cell.top), (cell.left + cell.width, cell.top + cell.height - 1)
    x, y = cell.left + cell.width // 2, cell.top + cell.height // 2
    if verdict is None:
        cv2.rectangle(image, *corners, RULE, 1)
    elif verdict.collides is None:
        cv2.rectangle(image, *corners, FAINT_INK, -1)
        write_text(image, "!", (x, y), size_px=11, colour=PAPER, bold=True, anchor="centre")
    elif not verdict.collides:
        cv2.rectangle(image, *corners, _CLEAR, -1 if verdict.counted else 1)
    elif not verdict.alarms:
        cv2.rectangle(
            image, *corners, _CLEAR if verdict.whom is CollisionParty.OTHER else RULE, -1 if verdict.counted else 1
        )
        mark = "◇" if verdict.whom is CollisionParty.OTHER else UNDEFINED
        write_text(image, mark, (x, y), size_px=11, colour=BYSTANDER, bold=True, anchor="centre")
    else:
        cv2.rectangle(image, *corners, CONTACT, -1 if verdict.counted else 1)
        half, shade = min(3, max(cell.width // 3, 1)), PAPER if verdict.counted else CONTACT
        for tilt in (-half, half):
            cv2.line(image, (x - half, y - tilt), (x + half, y + tilt), shade, 1, cv2.LINE_AA)
