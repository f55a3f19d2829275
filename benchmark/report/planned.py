"""Plans, what planners expect, candidates and contacts on a picture from above."""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from benchmark.geometry import Floats, box_corners
from benchmark.report.canvas import (
    SHIFT,
    GroundView,
    fill_box,
    mark_at,
    outline_box,
    stroke,
    stroke_all,
    through,
)
from benchmark.report.lettering import Picture, text_width, write_text
from benchmark.report.overlays import CandidatesOverlay, Contact, PlanOverlay, Whom
from benchmark.report.palette import BEST, BYSTANDER, CONTACT, INK, PAPER, WORST, Rgb, mixed

_LABEL_PX, _LABEL_LINE_PX = 114, 18
"""Size of a label at a contact."""
MOVES_M: Final = 1.0
"""Forecasts that stay within this are of parked cars, and are not drawn."""


def draw_candidates(image: Picture, view: GroundView, overlay: CandidatesOverlay) -> None:
    """Lines from pale (worst score) to dark (best), and the executed one, if one was, on top of them."""

    def lines() -> None:
        for path, share in zip(overlay.paths, overlay.shares):
            stroke(image, view, path, mixed(BEST, WORST, float(share)), 1)

    through(image, view, overlay.paths.reshape(-1, 2), 0.55, lines)
    if overlay.chosen is None:
        return
    stroke(image, view, overlay.chosen, BEST, 2)
    for point in overlay.chosen[1:]:
        mark_at(image, view.pixels(point), "diamond", 2.5, BEST)


def draw_expectations(image: Picture, view: GroundView, overlay: PlanOverlay) -> None:
    """Other modes of a plan, and where the planner expects others to go."""
    plan = overlay.plan
    if plan is None or not overlay.details:
        return
    colour = overlay.style.colour
    ways = [np.concatenate([plan.start[None, :2], mode]) for mode in plan.modes]

    def modes() -> None:
        stroke_all(image, view, ways, colour, 1)

    if ways:
        through(image, view, np.concatenate(ways), 0.35 * overlay.opacity, modes)
    if plan.forecasts is None:
        return
    expected = [np.concatenate([box[None, :2], path]) for box, path in zip(plan.forecasts.boxes, plan.forecasts.paths)]
    moving = [way for way in expected if np.hypot(*(way - way[0]).T).max() >= MOVES_M and view.sees(way)]

    def forecasts() -> None:
        for way in moving:
            stroke(image, view, way, mixed(colour, PAPER, 0.15), 1, dash=(3.0, 3.0))
            for point in view.pixels(way[1:]):
                mark_at(image, point, "circle", 2.6, PAPER, colour)

    if moving:
        through(image, view, np.concatenate(moving), 0.7 * overlay.opacity, forecasts)


def draw_plan(image: Picture, view: GroundView, overlay: PlanOverlay) -> None:
    """A plan: the ego's outline at each waypoint, a line in the planner's pattern, its mark at each waypoint."""
    plan = overlay.plan
    if plan is None:
        return
    style = overlay.style
    way = np.concatenate([plan.start[None, :2], plan.footprints[:, :2]])

    def outlines() -> None:
        for box in plan.at_waypoints:
            outline_box(image, view, box, style.colour, 1)

    def line() -> None:
        stroke(image, view, way, PAPER, 5)
        stroke(image, view, way, style.colour, 3, dash=style.dash)
        for point in view.pixels(plan.at_waypoints[:, :2]):
            mark_at(image, point, style.mark, 4.0, style.colour, PAPER)

    through(image, view, box_corners(plan.at_waypoints).reshape(-1, 2), 0.6 * overlay.opacity, outlines)
    through(image, view, way, overlay.opacity, line)


def draw_contacts(image: Picture, view: GroundView, overlays: Sequence[PlanOverlay]) -> None:
    """First contacts of plans: both rectangles then, a star, and in how many seconds.

    The star is hollow if it is with another than the adversary, or with whom is not said.
    """
    seen: list[tuple[float, float, PlanOverlay, Contact]] = []
    for overlay in reversed(overlays):
        if overlay.contact is not None:
            at = _draw_contact(image, view, overlay.contact, overlay.style.colour, hollow=not overlay.verdict.alarms)
            if 0 <= at[0] < view.width_px and 0 <= at[1] < view.height_px:
                seen.append((float(at[1]), float(at[0]), overlay, overlay.contact))
    row = {False: -np.inf, True: -np.inf}
    for y, x, overlay, contact in sorted(seen, key=lambda each: each[:2]):
        left = contact.seconds - overlay.age_s
        what = "another" if overlay.verdict.whom is Whom.OTHER else "contact"
        when = f"{what} in {left:.1f} s" if left >= 0.05 else f"{what} now"
        colour = CONTACT if overlay.verdict.alarms else BYSTANDER
        # At the edge of the picture, so that they cover neither cars nor each other.
        on_left = x > view.width_px - 1.4 * _LABEL_PX
        row[on_left] = max(y, row[on_left] + _LABEL_LINE_PX)
        start = 22.0 if on_left else view.width_px - _LABEL_PX
        end = start + text_width(when, size_px=12, bold=True) + 4 if on_left else start - 14
        line = np.round(np.array([(x, y), (end, row[on_left])]) * (1 << SHIFT)).astype(np.int32)
        cv2.polylines(image, [line], False, colour, 1, cv2.LINE_AA, SHIFT)
        write_text(image, when, (start, row[on_left]), size_px=12, colour=colour, bold=True, plate=PAPER)
        mark_at(image, np.array([start - 9.0, row[on_left]]), overlay.style.mark, 4.5, overlay.style.colour, PAPER)


def _draw_contact(image: Picture, view: GroundView, contact: Contact, colour: Rgb, *, hollow: bool) -> Floats:
    """Rectangles and star; where the star is, pixels."""
    corners = box_corners(contact.ego)
    through(image, view, corners, 0.35, lambda: fill_box(image, view, contact.ego, colour))
    outline_box(image, view, contact.ego, colour, 2)
    if contact.other is not None:
        outline_box(image, view, contact.other, INK, 2, dash=(4.0, 3.0))
    at = view.pixels(contact.point)
    turn = np.pi * np.arange(16) / 8
    rings = ((11.0, PAPER), (9.0, BYSTANDER), (5.5, PAPER)) if hollow else ((11.0, PAPER), (9.0, CONTACT))
    for radius, shade in rings:
        reach = np.where(np.arange(16) % 2 == 0, radius, 0.5 * radius)
        points = at + reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        cv2.fillPoly(image, [np.round(points * (1 << SHIFT)).astype(np.int32)], shade, cv2.LINE_AA, SHIFT)
    return at
