"""Films of drives, frame by frame: what the planner saw, the driven world from above, how fast it went."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.records.drives import DriveRecord
from benchmark.records.search_trace import FrameAction
from benchmark.report.birdseye import BirdseyeScene
from benchmark.report.canvas import (
    SHIFT,
    Picture,
    sanitise_name,
    text_width,
    truncate_to_width,
    wrap_to_width,
    write_text,
)
from benchmark.report.captions import LegendEntry, draw_entry, draw_swatch
from benchmark.report.cells import MINIATURE_WORDS
from benchmark.report.episode_page import STRIP_S, EpisodePage, list_strip_steps, list_touches
from benchmark.report.fault_words import describe_fault
from benchmark.report.overlays import Overlay
from benchmark.report.palette import (
    ADVERSARY,
    BEST,
    CONTACT,
    EGO,
    FAINT_INK,
    INK,
    ON_LIGHT,
    PANEL,
    PATH,
    RULE,
    TITLE,
    TITLE_FAINT,
    TITLE_INK,
    choose_planner_style,
    mix_colours,
)
from leaderboard.extensions.films.film import (
    CAMERAS_PX,
    HEIGHT_PX,
    TITLE_PX,
    WIDTH_PX,
    CameraMosaic,
    FilmLayout,
    FilmSettings,
    compose_frame,
    draw_from_above,
    select_film_frames,
)
from leaderboard.frame.rows import mark_planner_name

HELD_S: Final = 1.5
"""The last frame of a drive that did not reach the scene's end is shown so much longer."""
DRIVE_FPS: Final = 10.0
"""A drive has an instant each tenth of a second."""
OUTCOME_WORDS: Final[dict[FrameAction, str]] = {
    "track": "drives the scene's own track",
    "searched": "drives what its search found",
    "slowed": "found nothing admissible; brakes or keeps its plan",
}
_EDGE_PX: Final = 14
_LINE_PX: Final = 18
_WORLD_CHARACTERS: Final = 400
_CHART_PX: Final = 240
_STRIP_PX: Final = 54
_LEAST_TOP_M_S: Final = 5.0


class DriveFilm:
    """One drive's film."""

    def __init__(self, driven: EpisodePage, record: DriveRecord, name: str, settings: FilmSettings) -> None:
        """Find what is to be shown, of a window from its beginning on if nothing else is asked for.

        A drive that ends before the film begins is an `InputError`.
        """
        if driven.row.window is not None and not settings.begin_s:
            settings = replace(settings, begin_s=float(driven.seconds[driven.begins]))
        self.driven, self.record, self.name, self.settings = driven, record, name, settings
        self.layout = _choose_layout(driven, settings.layout)
        self._sheet, self._style = driven.stored.sheet, choose_planner_style(0)
        self._above = BirdseyeScene(self._sheet)
        self._cameras = CameraMosaic(driven.stored, *CAMERAS_PX[self.layout]) if self.layout in CAMERAS_PX else None
        last = driven.last
        frames = tuple(frame for frame in select_film_frames(self._sheet.scene, self._above, settings) if frame <= last)
        if not frames:
            raise InputError(
                f"the drive of {self._sheet.scene} ends after {driven.seconds[last]:.1f} s, so a film from "
                f"{settings.begin_s} s on has no frames; choose an earlier --from"
            )
        reaches_end = settings.end_s is None or settings.end_s >= driven.seconds[last]
        held = round(HELD_S * settings.fps) if driven.row.end != "end" and reaches_end else 0
        self.frames: tuple[int, ...] = (*frames, *((last,) * held))

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def __iter__(self) -> Iterator[Picture]:
        """Its frames, (height, width, 3) RGB."""
        drawn: tuple[int, Picture] | None = None
        size = (self.settings.width_px, self.settings.height_px)
        for frame in self.frames:
            if drawn is None or drawn[0] != frame:
                full_size = self._frame(frame)
                same = size == (WIDTH_PX, HEIGHT_PX)
                small = full_size if same else cv2.resize(full_size, size, interpolation=cv2.INTER_AREA)
                drawn = frame, np.asarray(small, np.uint8)
            yield drawn[1]

    def _frame(self, frame: int) -> Picture:
        plan = self.driven.plan_at(frame, self.name, self._style)
        overlays: list[Overlay] = [self.driven.path(), *([] if plan is None else [plan])]
        search_trace = self.driven.candidates_at(frame) if self.settings.candidates else None
        overlays += [] if search_trace is None else [search_trace]
        return compose_frame(
            self.layout,
            None if self._cameras is None else self._cameras.at(frame),
            lambda image: self._draw_title(image, frame),
            lambda width_px, height_px: draw_from_above(
                self._above, frame, overlays, self.settings, width_px, height_px
            ),
            lambda image: self._draw_panel(image, frame),
        )

    def _draw_title(self, image: Picture, frame: int) -> None:
        cv2.rectangle(image, (0, 0), (image.shape[1], image.shape[0]), TITLE, -1)
        name, x, y = sanitise_name(self._sheet.scene), 14.0, TITLE_PX / 2
        write_text(image, name, (x, y), size_px=18, colour=TITLE_INK, bold=True)
        x += text_width(name, size_px=18, bold=True) + 16
        measured, run = self.record.facts.measured, self.driven.row.run
        family = self.driven.row.family
        numbered = f"{f', {family}' if family else ''}{f', run {run}' if self.record.facts.runs > 1 else ''}"
        world = f"{sanitise_name(measured.world, _WORLD_CHARACTERS)}, sensor {sanitise_name(measured.sensor)}{numbered}"
        where = f"closed loop: {world}; {sanitise_name(self._sheet.data.name)} {sanitise_name(self._sheet.split)}"
        lines = wrap_to_width(where, image.shape[1] - round(x) - 90, 2, size_px=14)
        for number, line in enumerate(lines):
            at = x, y + _LINE_PX * (number - (len(lines) - 1) / 2)
            write_text(image, line, at, size_px=14, colour=TITLE_FAINT)
        now = f"{self.driven.seconds[frame]:.1f} s"
        write_text(image, now, (image.shape[1] - 14.0, y), size_px=18, colour=TITLE_INK, bold=True, anchor="right")

    def _draw_panel(self, image: Picture, frame: int) -> None:
        """Legend, who drives and what came of it so far, speed over time."""
        miniature = self.record.facts.planner.miniature
        top, right = self._draw_legend(image), float(image.shape[1] - _EDGE_PX)
        draw_swatch(image, self._style, (_EDGE_PX, top + 12.0))
        privileged = self.record.facts.planner.privileged
        name = mark_planner_name(sanitise_name(self.name), privileged=privileged, miniature=miniature)
        words, alarm = self._describe_state(frame)
        room = image.shape[1] - 70 - text_width(words, size_px=13, bold=alarm)
        write_text(
            image,
            truncate_to_width(name, room, size_px=14, bold=True),
            (_EDGE_PX + 40.0, top + 12.0),
            size_px=14,
            bold=True,
        )
        colour = CONTACT if alarm else INK
        write_text(image, words, (right, top + 12.0), size_px=13, bold=alarm, colour=colour, anchor="right")
        outcome = self._describe_outcome(frame)
        lines = [(line, CONTACT) for line in outcome] or [(line, ADVERSARY) for line in self._describe_pursuit(frame)]
        for number, (line, shade) in enumerate(lines):
            text = truncate_to_width(line, image.shape[1] - 2 * _EDGE_PX, size_px=13)
            write_text(image, text, (_EDGE_PX, top + 34.0 + 18 * number), size_px=13, colour=shade)
        foot = image.shape[0] - 12 - (16 if miniature else 0)
        if miniature:
            write_text(image, MINIATURE_WORDS, (_EDGE_PX, foot + 14.0), size_px=12, colour=FAINT_INK)
        if self.driven.row.window is not None:
            foot -= _STRIP_PX
            self._draw_strip(image, frame, foot + 10, foot + _STRIP_PX)
        self._draw_speed(image, frame, max(top + 74, foot - _CHART_PX), foot)

    def _draw_legend(self, image: Picture) -> int:
        adversaries = any(agent.adversary for agent in self._sheet.agents)
        entries = [
            LegendEntry("box", EGO, "driven ego"),
            *([LegendEntry("box", ADVERSARY, "adversary")] if adversaries else []),
            LegendEntry("box", ON_LIGHT.vehicle, "others"),
            LegendEntry("way", EGO, "what happened, 3 s"),
            LegendEntry("path", PATH, "recorded path"),
            *([LegendEntry("candidates", BEST, "considered")] if self._shows_search_trace else []),
        ]
        entries = entries if self.layout is not FilmLayout.CAMERAS else entries[1:2] if adversaries else []
        x, y = float(_EDGE_PX), 18.0
        for entry in entries:
            if x > _EDGE_PX and x + 26 + text_width(entry.words, size_px=12) > image.shape[1] - _EDGE_PX:
                x, y = float(_EDGE_PX), y + 20.0
            x += draw_entry(image, entry, (x, y)) + 18
        return round(y) + 16

    def _describe_state(self, frame: int) -> tuple[str, bool]:
        """Present state of the ego, and whether it is in a contact."""
        contact = self.driven.contact
        if contact is not None and self.driven.seconds[frame] >= contact.seconds - 1e-6:
            return "contact", True
        if frame < self.driven.begins:
            return "not driving yet: the recorded ego", False
        aside = np.hypot(*(self._at(frame) - self.driven.recorded).T).min()
        return f"{aside:.1f} m beside the recorded path", False

    def _at(self, frame: int) -> Floats:
        ego = self._sheet.ego
        ahead = ego.centre_ahead_m * np.array([np.cos(ego.yaw_rad[frame]), np.sin(ego.yaw_rad[frame])])
        return np.asarray(np.array([ego.x_m[frame], ego.y_m[frame]]) + ahead)

    @property
    def _shows_search_trace(self) -> bool:
        return self.settings.candidates and bool(self.driven.considered)

    def _describe_pursuit(self, frame: int) -> list[str]:
        """Present pursuit of the adversary, where what it considered is shown."""
        now = self.driven.search_trace_at(frame) if self._shows_search_trace else None
        return [] if now is None else [f"adversary: {OUTCOME_WORDS[now.did]}"]

    def _describe_outcome(self, frame: int) -> list[str]:
        """Contacts of the ego so far, and how the drive ended, once it has."""
        row, driven = self.driven.row, self.driven
        over = frame >= driven.last
        since = driven.seconds[frame] - driven.seconds[driven.begins]
        passed = [touch for touch in row.passed if since >= touch.seconds]
        lines = [
            line
            for touch in passed[-1:]
            for line in (f"touched by {sanitise_name(touch.category)}: it is removed", describe_fault(touch))
        ]
        if row.contact is not None and self._describe_state(frame)[1]:
            whom = f"{row.contact.category}{', the adversary' if row.contact.adversary else ''}"
            return [
                f"contact with {sanitise_name(whom)}",
                describe_fault(row.contact),
                f"impact {row.contact.impact_speed:.1f} m/s, delta-v {row.contact.delta_v_ego:.1f} m/s",
            ]
        if row.failure is not None and over:
            return [f"the planner failed ({row.failure.reason}): nothing is scored"]
        return lines

    def _draw_strip(self, image: Picture, frame: int, top: int, bottom: int) -> None:
        """Smallest time to collision of each half second so far, on the time line of the speed, and who was touched."""
        driven, right = self.driven, image.shape[1] - 70
        now, begins = float(driven.seconds[frame]), float(driven.seconds[driven.begins])
        end = max(float(driven.recorded_seconds[-1]), float(driven.seconds[-1]), 1e-3)

        def place(seconds: float) -> int:
            return round(_EDGE_PX + min(seconds, now) / end * (right - _EDGE_PX))

        steps = [step for step in list_strip_steps(driven.row, begins) if step.start_s <= now]
        touches = [touch for touch in list_touches(driven.row, begins) if touch[0] <= now + 1e-6]
        high = top + 16
        last = next((f"{step.ttc_s:.1f} s" for step in steps if now < step.end_s), f"above {STRIP_S:.0f} s")
        write_text(image, f"time to collision: {last}", (_EDGE_PX, top + 4.0), size_px=12)
        cv2.line(image, (_EDGE_PX, bottom), (right, bottom), RULE, 1)
        for step in steps:
            level = round(bottom - step.share * (bottom - high))
            shade = mix_colours(CONTACT, PANEL, 1.0 - 0.3 - 0.7 * step.share)
            cv2.rectangle(image, (place(step.start_s), level), (place(step.end_s) - 1, bottom), shade, -1)
        for seconds, words, adversary in touches:
            cv2.line(image, (place(seconds), high), (place(seconds), bottom), ADVERSARY if adversary else CONTACT, 2)
            text = truncate_to_width(f"touches {words}", right - _EDGE_PX - 190, size_px=12)
            write_text(image, text, (right, top + 4.0), size_px=12, colour=CONTACT, anchor="right")

    def _draw_speed(self, image: Picture, frame: int, top: int, bottom: int) -> None:
        """Speed driven so far, over that of the recording."""
        driven = self.driven
        write_text(image, f"speed: {driven.speed[frame]:.1f} m/s", (_EDGE_PX, top + 8.0), size_px=12)
        beside = _EDGE_PX + text_width("speed: 00.0 m/s", size_px=12) + 12
        write_text(image, "(pale: recorded)", (beside, top + 8.0), size_px=12, colour=FAINT_INK)
        high, low, right = top + 24, bottom - 8, image.shape[1] - 70
        most = max(_LEAST_TOP_M_S, float(driven.speed.max()), float(driven.recorded_speed.max()))
        end = max(float(driven.recorded_seconds[-1]), float(driven.seconds[-1]), 1e-3)

        def line(seconds: Floats, speed: Floats) -> Floats:
            x = _EDGE_PX + seconds / end * (right - _EDGE_PX)
            return np.column_stack([x, low - np.clip(speed / most, 0.0, 1.0) * (low - high)])

        for share in (0.0, 0.5, 1.0):
            y = round(low - share * (low - high))
            cv2.line(image, (_EDGE_PX, y), (right, y), RULE, 1)
            write_text(image, f"{share * most:.0f} m/s", (right + 6.0, y), size_px=11, colour=FAINT_INK)
        past = slice(0, frame + 1)
        ways = (
            (line(driven.recorded_seconds, driven.recorded_speed), mix_colours(EGO, PANEL, 0.65)),
            (line(driven.seconds[past], driven.speed[past]), EGO),
        )
        for way, colour in ways:
            fixed = np.round(way * (1 << SHIFT)).astype(np.int32)
            cv2.polylines(image, [fixed], False, colour, 2, cv2.LINE_AA, SHIFT)
        x, y_now = ways[1][0][-1]
        alarm = self._describe_state(frame)[1]
        cv2.line(image, (round(x), high - 4), (round(x), low + 4), CONTACT if alarm else INK, 2 if alarm else 1)
        cv2.circle(image, (round(x), round(y_now)), 4, CONTACT if alarm else EGO, -1, cv2.LINE_AA)


def _choose_layout(driven: EpisodePage, layout: FilmLayout) -> FilmLayout:
    if driven.stored.sheet.pictures:
        return layout
    if layout is FilmLayout.CAMERAS:
        raise InputError(
            f"the drive of {driven.row.scene} has no camera images; film it with --layout birdseye, or drive with "
            "--sensor schematic"
        )
    return FilmLayout.BIRDSEYE
