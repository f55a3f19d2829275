"""Films of scenes, frame by frame: cameras with the adversary's box, view from above, each planner's samples so far."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import cv2
import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.errors import InputError
from benchmark.records.run import RunRecord
from benchmark.records.scene_pages import PageCamera, StoredScenePage
from benchmark.report.birdseye import BirdseyeScene
from benchmark.report.canvas import SHIFT, Picture, sanitise_name, text_width, write_text
from benchmark.report.captions import draw_scale_bar
from benchmark.report.overlays import EXACT, Overlay, build_candidates_overlay
from benchmark.report.palette import ADVERSARY, FAINT_INK, PANEL, PAPER, TITLE, TITLE_FAINT, TITLE_INK
from leaderboard.extensions.films.panel import MOST_PLANNERS, Panel
from leaderboard.extensions.films.tracks import PlannerTrack, build_planner_tracks


class CameraMosaic:
    """Pictures of one sheet, each read once and held until the next one."""

    def __init__(self, stored: StoredScenePage, width_px: int, height_px: int) -> None:
        """Pictures within the width and height that there is for all cameras."""
        self._stored = stored
        cells = stored.sheet.cameras
        self._whole = (
            max((cell.left + cell.width for cell in cells), default=1),
            max((cell.top + cell.height for cell in cells), default=1),
        )
        self._scale = min(width_px / self._whole[0], height_px / self._whole[1])
        self._kept: tuple[int, Picture] | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of what `at` returns."""
        return round(self._whole[0] * self._scale), round(self._whole[1] * self._scale)

    def at(self, frame: int) -> Picture:
        """(h, w, 3) RGB of all cameras at a frame, or at the last one before it that has a picture."""
        past = [pictured for pictured in self._stored.sheet.pictures if pictured <= frame]
        shown_frame = max(past, default=-1)
        if self._kept is None or self._kept[0] != shown_frame:
            self._kept = shown_frame, self._drawn(shown_frame) if past else self._missing()
        return self._kept[1]

    def _drawn(self, frame: int) -> Picture:
        path = self._stored.picture_path(frame)
        try:
            data = np.frombuffer(path.read_bytes(), np.uint8)
        except OSError as error:
            raise InputError(
                f"cannot read {path}: {error.strerror or error}; run challenger-bench sheets again"
            ) from error
        decoded = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
        if decoded is None or decoded.shape[:2] != self._whole[::-1]:
            raise InputError(
                f"{path} is not a picture of {self._whole[0]}x{self._whole[1]} pixels, as in its sheet; run "
                "challenger-bench sheets again"
            )
        method = cv2.INTER_AREA if self._scale < 1.0 else cv2.INTER_CUBIC
        resized = cv2.resize(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), self.size_px, interpolation=method)
        image: Picture = np.asarray(resized, np.uint8)
        self._draw_edges(image, frame)
        self._draw_cells(image)
        return image

    def _draw_edges(self, image: Picture, frame: int) -> None:
        edges_of = self._stored.sheet.adversary_edges.get(str(frame), {})
        for cell in self._stored.sheet.cameras:
            edges = np.array(edges_of.get(cell.name, ()), np.float64).reshape(-1, 2, 2)
            left, top, right, bottom = self._corners(cell)
            # The centre of the first pixel is 0 before and after resizing.
            pixels = (edges + 0.5) * self._scale - 0.5 - (left, top)
            lines = list(np.round(pixels * (1 << SHIFT)).astype(np.int32))
            for colour, width in ((PAPER, 4), (ADVERSARY, 2)):
                cv2.polylines(image[top:bottom, left:right], lines, False, colour, width, cv2.LINE_AA, SHIFT)

    def _corners(self, cell: PageCamera) -> tuple[int, int, int, int]:
        ends = (cell.left, cell.top, cell.left + cell.width, cell.top + cell.height)
        left, top, right, bottom = (round(end * self._scale) for end in ends)
        return left, top, right, bottom

    def _draw_cells(self, image: Picture) -> None:
        for cell in self._stored.sheet.cameras:
            left, top, right, bottom = self._corners(cell)
            cv2.rectangle(image, (left, top), (right, bottom), PANEL, 1)
            words = sanitise_name(cell.name.removeprefix("CAM_").replace("_", " ").lower())
            write_text(image, words, (left + 9.0, top + 12.0), size_px=12, colour=TITLE_INK, plate=TITLE)

    def _missing(self) -> Picture:
        width, height = self.size_px
        image: Picture = np.empty((height, width, 3), np.uint8)
        image[:] = PANEL
        write_text(image, "no picture yet", (width / 2, height / 2), colour=FAINT_INK, anchor="centre")
        return image


WIDTH_PX, HEIGHT_PX = 1280, 720
TITLE_PX: Final = 44
_EXTENT_M: Final = 24.0
EGO_DOWN: Final = 0.62
"""The road ahead matters more than the road behind."""
_LATE_S: Final = 1e-6


class FilmLayout(StrEnum):
    """Parts of a frame beside the planners' samples."""

    BOTH = "both"
    CAMERAS = "cameras"
    BIRDSEYE = "birdseye"


@dataclass(frozen=True, slots=True)
class FilmSettings:
    """Settings of a film.

    Attributes:
        layout: Layout of a frame.
        protocol: Protocol of the verdicts; ``native`` is each planner's own.
        begin_s: First moment, seconds after the scene's first frame.
        end_s: Last moment; the scene's last frame by default.
        fps: Frames a second; the film runs as fast as the scene did.
        width_px: Width of the frames.
        extent_m: Half the width of what is seen from above.
        heading_up: Whether the ego's heading points up; else north does.
        candidates: Whether to draw what the search chose from, where it was traced.

    Raises:
        InputError: If a number is out of its range.
    """

    layout: FilmLayout = FilmLayout.BOTH
    protocol: str = EXACT
    begin_s: float = 0.0
    end_s: float | None = None
    fps: float = float(FRAME_HZ)
    width_px: int = WIDTH_PX
    extent_m: float = _EXTENT_M
    heading_up: bool = True
    candidates: bool = True

    def __post_init__(self) -> None:
        if not 0.5 <= self.fps <= 60.0:
            raise InputError(f"--fps must be 0.5 to 60 frames a second, got {self.fps}")
        if self.width_px % 32 or not 320 <= self.width_px <= WIDTH_PX:
            raise InputError(f"--width must be a multiple of 32 from 320 to {WIDTH_PX} pixels, got {self.width_px}")
        if not 5.0 <= self.extent_m <= 200.0:
            raise InputError(f"--extent must be 5 to 200 metres, got {self.extent_m}")
        end = np.inf if self.end_s is None else self.end_s
        if not 0.0 <= self.begin_s <= end:
            raise InputError(f"--from must be 0 or more and not after --until, got {self.begin_s} and {self.end_s} s")

    @property
    def height_px(self) -> int:
        """Height of the frames."""
        return self.width_px * HEIGHT_PX // WIDTH_PX


def compose_frame(
    layout: FilmLayout,
    cameras: Picture | None,
    title: Callable[[Picture], None],
    above: Callable[[int, int], Picture],
    panel: Callable[[Picture], None],
) -> Picture:
    """(height, width, 3) RGB frame: title, cameras if the layout has them, below a panel and the view from above.

    `above` gives the view from above at a width and a height in pixels.
    """
    image: Picture = np.empty((HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    cv2.rectangle(image, (0, 0), (WIDTH_PX, HEIGHT_PX), PANEL, -1)
    title(image[:TITLE_PX])
    body, right, below = image[TITLE_PX:], WIDTH_PX, 0
    if layout is not FilmLayout.CAMERAS:
        width_px = ABOVE_PX[layout]
        body[:, WIDTH_PX - width_px :] = above(width_px, HEIGHT_PX - TITLE_PX)
        right -= width_px
    if cameras is not None:
        below, width_px = cameras.shape[:2]
        left = (right - width_px) // 2
        body[:below, left : left + width_px] = cameras
    panel(body[below:, :right])
    return image


def draw_from_above(
    above: BirdseyeScene,
    frame: int,
    overlays: Sequence[Overlay],
    settings: FilmSettings,
    width_px: int,
    height_px: int,
) -> Picture:
    """The view from above of a frame, with its scale."""
    image, view = above.draw(
        frame,
        overlays,
        width_px=width_px,
        height_px=height_px,
        extent_m=settings.extent_m,
        heading_up=settings.heading_up,
        middle=EGO_DOWN if settings.heading_up else 0.5,
    )
    draw_scale_bar(image, view)
    return image


class Film:
    """One scene's film."""

    def __init__(
        self, stored: StoredScenePage, records: Sequence[RunRecord], models: Sequence[str], settings: FilmSettings
    ) -> None:
        """Find what is to be shown: plans of `models`, as tables name them.

        Refused are planners without plans for the scene, too many, and scenes without pictures or over before the film
        begins.
        """
        if len(set(models)) > MOST_PLANNERS:
            raise InputError(
                f"a film shows at most {MOST_PLANNERS} planners, but {len(set(models))} were named; name fewer"
            )
        self.stored, self.settings = stored, settings
        self._above = BirdseyeScene(stored.sheet)
        self.tracks: tuple[PlannerTrack, ...] = build_planner_tracks(stored.sheet, records, models, settings.protocol)
        self.layout = _choose_layout(stored, settings.layout)
        self.frames: tuple[int, ...] = select_film_frames(stored.sheet.scene, self._above, settings)
        self._panel = Panel(stored.sheet, self.tracks, from_above=self.layout is not FilmLayout.CAMERAS)
        self._cameras = CameraMosaic(stored, *CAMERAS_PX[self.layout]) if self.layout in CAMERAS_PX else None

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def __iter__(self) -> Iterator[Picture]:
        """Its frames, (height, width, 3) RGB."""
        for frame in self.frames:
            full_size = self._frame(frame)
            size = (self.settings.width_px, self.settings.height_px)
            small = (
                full_size
                if size == (WIDTH_PX, HEIGHT_PX)
                else cv2.resize(full_size, size, interpolation=cv2.INTER_AREA)
            )
            yield np.asarray(small, np.uint8)

    def _frame(self, frame: int) -> Picture:
        overlays = self._overlays(frame)

        def panel(image: Picture) -> None:
            height_px, width_px = image.shape[:2]
            image[:] = self._panel.draw(width_px, height_px, overlays, frame)

        return compose_frame(
            self.layout,
            None if self._cameras is None else self._cameras.at(frame),
            lambda image: self._draw_title(image, frame),
            lambda width_px, height_px: draw_from_above(
                self._above, frame, overlays, self.settings, width_px, height_px
            ),
            panel,
        )

    def _overlays(self, frame: int) -> list[Overlay]:
        overlays: list[Overlay] = [plan for track in self.tracks if (plan := track.at(frame)) is not None]
        if self.settings.candidates and self.stored.rounds is not None:
            candidates = build_candidates_overlay(self.stored.sheet, self.stored.rounds, frame)
            overlays.extend([] if candidates is None else [candidates])
        return overlays

    def _draw_title(self, image: Picture, frame: int) -> None:
        sheet = self.stored.sheet
        cv2.rectangle(image, (0, 0), (image.shape[1], image.shape[0]), TITLE, -1)
        name, x, y = sanitise_name(sheet.scene), 14.0, TITLE_PX / 2
        write_text(image, name, (x, y), size_px=18, colour=TITLE_INK, bold=True)
        x += text_width(name, size_px=18, bold=True) + 16
        if sheet.manoeuvre is not None:
            manoeuvre = sanitise_name(sheet.manoeuvre)
            write_text(image, manoeuvre, (x, y), size_px=17, colour=TITLE_INK)
            x += text_width(manoeuvre, size_px=17) + 16
        where = f"{sanitise_name(sheet.data.name)} {sanitise_name(sheet.split)}"
        write_text(image, where, (x, y), size_px=14, colour=TITLE_FAINT)
        now = f"{self._above.seconds[frame]:.1f} s"
        write_text(image, now, (image.shape[1] - 14.0, y), size_px=18, colour=TITLE_INK, bold=True, anchor="right")


def _choose_layout(stored: StoredScenePage, layout: FilmLayout) -> FilmLayout:
    if stored.sheet.pictures and stored.sheet.cameras:
        return layout
    if layout is FilmLayout.CAMERAS:
        raise InputError(
            f"the sheet of {stored.sheet.scene} has no camera images; film it with --layout birdseye, or write "
            "its sheet from a data set that has images"
        )
    return FilmLayout.BIRDSEYE


def select_film_frames(scene: str, above: BirdseyeScene, settings: FilmSettings) -> tuple[int, ...]:
    """The frame that is shown at each moment of a film: the last one that has been."""
    seconds = above.seconds
    end = float(seconds[-1]) if settings.end_s is None else min(settings.end_s, float(seconds[-1]))
    if settings.begin_s > seconds[-1]:
        raise InputError(
            f"{scene} lasts {seconds[-1]:.1f} s, so a film from {settings.begin_s} s on has no frames; "
            "choose an earlier --from"
        )
    count = int((end - settings.begin_s) * settings.fps + _LATE_S) + 1
    # A frame late by less than half its length still counts as the requested one: recorders are inexact.
    moments = settings.begin_s + np.arange(count) / settings.fps + 0.5 / FRAME_HZ
    return tuple(
        int(frame_number) for frame_number in np.clip(np.searchsorted(seconds, moments) - 1, 0, len(seconds) - 1)
    )


ABOVE_PX: Final = {FilmLayout.BOTH: 500, FilmLayout.BIRDSEYE: 820}
CAMERAS_PX: Final = {FilmLayout.BOTH: (780, 320), FilmLayout.CAMERAS: (1280, 488)}
