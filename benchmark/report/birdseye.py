"""A scene from above: the road, agents and their ways, plans, forecasts, candidates and contacts."""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import VEHICLE_CATEGORIES
from benchmark.errors import InputError
from benchmark.geometry import Floats, box_corners
from benchmark.records.scene_pages import PageAgent, ScenePage
from benchmark.report.canvas import (
    SHIFT,
    GroundView,
    Picture,
    draw_translucent,
    fill_box,
    make_view,
    mark_at,
    outline_box,
    stroke,
    stroke_all,
    text_width,
    write_text,
)
from benchmark.report.captions import draw_captions
from benchmark.report.ground import PageGround, build_ground, draw_ground
from benchmark.report.overlays import (
    CandidatesOverlay,
    CollisionMark,
    CollisionParty,
    Overlay,
    PathOverlay,
    PlanOverlay,
)
from benchmark.report.palette import (
    ADVERSARY,
    BEST,
    BYSTANDER,
    CONTACT,
    EGO,
    INK,
    ON_LIGHT,
    PAPER,
    PATH,
    PATH_DASH,
    WORST,
    GroundColours,
    Rgb,
    mix_colours,
)
from benchmark.report.placement import agent_box, ego_box, frame_seconds

_LABEL_PX, _LABEL_LINE_PX = 114, 18
"""Size of a label at a contact."""
MOVES_M: Final = 1.0
"""Forecasts that stay within this are of parked cars, and are not drawn."""


def draw_candidates(image: Picture, view: GroundView, overlay: CandidatesOverlay) -> None:
    """Lines from pale (worst score) to dark (best), and the executed one, if one was, on top of them."""

    def lines() -> None:
        for path, share in zip(overlay.paths, overlay.shares):
            stroke(image, view, path, mix_colours(BEST, WORST, float(share)), 1)

    draw_translucent(image, view, overlay.paths.reshape(-1, 2), 0.55, lines)
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
        draw_translucent(image, view, np.concatenate(ways), 0.35 * overlay.opacity, modes)
    if plan.forecasts is None:
        return
    expected = [np.concatenate([box[None, :2], path]) for box, path in zip(plan.forecasts.boxes, plan.forecasts.paths)]
    moving = [way for way in expected if np.hypot(*(way - way[0]).T).max() >= MOVES_M and view.sees(way)]

    def forecasts() -> None:
        for way in moving:
            stroke(image, view, way, mix_colours(colour, PAPER, 0.15), 1, dash=(3.0, 3.0))
            for point in view.pixels(way[1:]):
                mark_at(image, point, "circle", 2.6, PAPER, colour)

    if moving:
        draw_translucent(image, view, np.concatenate(moving), 0.7 * overlay.opacity, forecasts)


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

    draw_translucent(image, view, box_corners(plan.at_waypoints).reshape(-1, 2), 0.6 * overlay.opacity, outlines)
    draw_translucent(image, view, way, overlay.opacity, line)


def draw_contacts(image: Picture, view: GroundView, overlays: Sequence[PlanOverlay]) -> None:
    """First contacts of plans: both rectangles then, a star, and in how many seconds.

    The star is hollow if it is with another than the adversary, or with whom is not said.
    """
    marks: list[tuple[float, float, PlanOverlay, CollisionMark]] = []
    for overlay in reversed(overlays):
        if overlay.contact is not None:
            at = _draw_contact(image, view, overlay.contact, overlay.style.colour, hollow=not overlay.verdict.alarms)
            if 0 <= at[0] < view.width_px and 0 <= at[1] < view.height_px:
                marks.append((float(at[1]), float(at[0]), overlay, overlay.contact))
    row = {False: -np.inf, True: -np.inf}
    for y, x, overlay, contact in sorted(marks, key=lambda mark: mark[:2]):
        left = contact.seconds - overlay.age_s
        party = "another" if overlay.verdict.whom is CollisionParty.OTHER else "contact"
        when = f"{party} in {left:.1f} s" if left >= 0.05 else f"{party} now"
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


def _draw_contact(image: Picture, view: GroundView, contact: CollisionMark, colour: Rgb, *, hollow: bool) -> Floats:
    """Rectangles and star; where the star is, pixels."""
    corners = box_corners(contact.ego)
    draw_translucent(image, view, corners, 0.35, lambda: fill_box(image, view, contact.ego, colour))
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


PAST_S: Final = 2.0
FUTURE_S: Final = 3.0
"""How much of the ways of ego and adversaries is drawn."""
_SMALLEST_PERSON_PX: Final = 3.0
_FINE_PX_M: Final = 4.0
"""Below so many pixels a metre, outlines and noses of boxes are left out."""


class BirdseyeScene:
    """Draws frames of one sheet; what does not change is made ready once."""

    def __init__(self, sheet: ScenePage, colours: GroundColours = ON_LIGHT) -> None:
        """Make the map ready; a sheet without frames, or without an ego pose for each, is refused.

        ``colours`` are of everything but ego, adversary and plans; plans are drawn for `ON_LIGHT`.
        """
        count = len(sheet.timestamps_us)
        if not count or {len(sheet.ego.x_m), len(sheet.ego.y_m), len(sheet.ego.yaw_rad)} != {count}:
            raise InputError(
                f"the sheet of {sheet.scene} has {count} frames but another number of ego poses, or no frames; run "
                "challenger-bench sheets again"
            )
        self.sheet = sheet
        self.seconds: Floats = frame_seconds(sheet)
        self._colours = colours
        self._ground: PageGround = build_ground(sheet, colours)
        self._ego: list[Floats] = [ego_box(sheet, frame) for frame in range(len(self.seconds))]

    def draw(
        self,
        frame: int,
        overlays: Sequence[Overlay] = (),
        *,
        width_px: int,
        height_px: int,
        extent_m: float = 40.0,
        heading_up: bool = True,
        middle: float = 0.5,
    ) -> tuple[Picture, GroundView]:
        """Draw one frame without captions: (height_px, width_px, 3) RGB, and where metres fall on it.

        The shorter side shows twice ``extent_m``; the ego is at the share ``middle`` of the height, from above. Its
        heading or else north points up.
        """
        sheet = self.sheet
        if not 0 <= frame < len(self.seconds):
            raise InputError(f"{sheet.scene} has frames 0 to {len(self.seconds) - 1}, not {frame}; choose one of these")
        if min(width_px, height_px) < 1 or not 0.0 < extent_m < np.inf:
            raise InputError(
                f"a bird's-eye picture needs a positive size and extent, got {width_px}x{height_px} px and {extent_m} m"
            )
        pose = np.array([sheet.ego.x_m[frame], sheet.ego.y_m[frame], sheet.ego.yaw_rad[frame]])
        view = make_view(
            pose,
            width_px=width_px,
            height_px=height_px,
            extent_m=extent_m,
            heading_up=heading_up,
            middle=middle,
        )
        image: Picture = np.empty((height_px, width_px, 3), np.uint8)
        draw_ground(image, view, self._ground)
        plans = [candidate for candidate in overlays if isinstance(candidate, PlanOverlay)]
        self._draw_trails(image, view, frame)
        for overlay in overlays:
            if isinstance(overlay, CandidatesOverlay):
                draw_candidates(image, view, overlay)
            if isinstance(overlay, PathOverlay):
                stroke(image, view, overlay.points, PATH, 2, dash=PATH_DASH)
        for plan in plans:
            draw_expectations(image, view, plan)
        self._draw_boxes(image, view, frame)
        # Later planners are drawn first, so that the first planner is on top.
        for plan in reversed(plans):
            draw_plan(image, view, plan)
        draw_contacts(image, view, plans)
        return image, view

    def _draw_trails(self, image: Picture, view: GroundView, frame: int) -> None:
        seconds = self.seconds[frame]
        near = np.flatnonzero((self.seconds >= seconds - PAST_S - 1e-6) & (self.seconds <= seconds + FUTURE_S + 1e-6))
        for agent in self.sheet.agents:
            if agent.adversary:
                boxes = [agent_box(agent, int(frame_index)) for frame_index in near]
                self._trail(image, view, near, boxes, frame, ADVERSARY)
        self._trail(image, view, near, [self._ego[frame_index] for frame_index in near], frame, EGO)

    def _trail(
        self,
        image: Picture,
        view: GroundView,
        frames: NDArray[np.int64],
        boxes: Sequence[Floats | None],
        frame: int,
        colour: Rgb,
    ) -> None:
        """A way: thin and pale where it was, thick with a dot each half second where it goes."""
        centre = {int(frame_index): box[:2] for frame_index, box in zip(frames, boxes) if box is not None}
        behind = [centre[frame_index] for frame_index in sorted(centre) if frame_index <= frame]
        ahead = [centre[frame_index] for frame_index in sorted(centre) if frame_index >= frame]
        stroke(image, view, np.array(behind).reshape(-1, 2), mix_colours(colour, self._colours.paper, 0.45), 1)
        stroke(image, view, np.array(ahead).reshape(-1, 2), mix_colours(colour, self._colours.paper, 0.25), 2)
        for dot in np.arange(1, round(2 * FUTURE_S) + 1) / 2:
            nearest = int(np.argmin(np.abs(self.seconds - self.seconds[frame] - dot)))
            if nearest in centre and abs(self.seconds[nearest] - self.seconds[frame] - dot) < 0.05:
                mark_at(image, view.pixels(centre[nearest]), "circle", 2.5, colour, self._colours.paper)

    def _draw_boxes(self, image: Picture, view: GroundView, frame: int) -> None:
        for agent in sorted(self.sheet.agents, key=lambda each: each.adversary):
            box = agent_box(agent, frame)
            if box is not None and view.sees(box_corners(box)):
                _draw_agent(image, view, agent, box, self._colours)
        _draw_car(image, view, self._ego[frame], EGO, self._colours, edge_px=2)


def draw_birdseye(
    sheet: ScenePage,
    frame: int,
    overlays: Sequence[Overlay] = (),
    *,
    size_px: int = 480,
    extent_m: float = 40.0,
    heading_up: bool = True,
    captions: bool = False,
) -> NDArray[np.uint8]:
    """Draw the surroundings of the ego from above: (size_px, size_px, 3) RGB, a square of twice ``extent_m``.

    The heading or else north points up; captions are the time, a scale bar, the legend, and the verdicts on the plans.
    """
    drawer = BirdseyeScene(sheet)
    image, view = drawer.draw(
        frame, overlays, width_px=size_px, height_px=size_px, extent_m=extent_m, heading_up=heading_up
    )
    if captions:
        draw_captions(image, view, sheet, float(drawer.seconds[frame]), overlays)
    return image


def choose_colour(agent: PageAgent, colours: GroundColours = ON_LIGHT) -> Rgb:
    """Colour of an object by what it is."""
    if agent.adversary:
        return ADVERSARY
    if agent.category in ("vehicle.bicycle", "vehicle.motorcycle"):
        return colours.cycle
    if agent.category in VEHICLE_CATEGORIES:
        return colours.vehicle
    return colours.person if agent.category.startswith(("human", "animal")) else colours.thing


def _draw_agent(image: Picture, view: GroundView, agent: PageAgent, box: Floats, colours: GroundColours) -> None:
    colour = choose_colour(agent, colours)
    if colour is colours.person and float(box[2]) * view.scale_px_m < 2.0 * _SMALLEST_PERSON_PX:
        mark_at(image, view.pixels(box[:2]), "circle", _SMALLEST_PERSON_PX, colour)
    elif colour in (colours.vehicle, ADVERSARY, colours.cycle):
        _draw_car(image, view, box, colour, colours, edge_px=2 if agent.adversary else 1)
    else:
        fill_box(image, view, box, colour)


def _draw_car(
    image: Picture, view: GroundView, box: Floats, colour: Rgb, colours: GroundColours, *, edge_px: int
) -> None:
    """A box with an edge and a light wedge at its front."""
    fill_box(image, view, box, colour)
    if view.scale_px_m < _FINE_PX_M:
        return
    outline_box(image, view, box, colours.ink if edge_px > 1 else mix_colours(colour, colours.ink, 0.6), edge_px)
    ahead = np.array([np.cos(box[4]), np.sin(box[4])])
    left = np.array([-ahead[1], ahead[0]])
    tip, base = box[:2] + 0.42 * box[2] * ahead, box[:2] + 0.2 * box[2] * ahead
    wedge = np.array([tip, base + 0.3 * box[3] * left, base - 0.3 * box[3] * left])
    stroke(image, view, wedge, colours.paper, 1, closed=True)
