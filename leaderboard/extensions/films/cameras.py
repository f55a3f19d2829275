"""The pictures of all cameras, with the adversary's box drawn on them."""

import cv2
import numpy as np

from benchmark.errors import InputError
from benchmark.records.scenes import SheetCamera, StoredSheet
from benchmark.report.canvas import SHIFT
from benchmark.report.lettering import Picture, drawable, write_text
from benchmark.report.palette import ADVERSARY, FAINT_INK, PANEL, PAPER, TITLE, TITLE_INK


class CameraPictures:
    """Pictures of one sheet, each read once and held until the next one."""

    def __init__(self, stored: StoredSheet, width_px: int, height_px: int) -> None:
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
        past = [each for each in self._stored.sheet.pictures if each <= frame]
        shown = max(past, default=-1)
        if self._kept is None or self._kept[0] != shown:
            self._kept = shown, self._drawn(shown) if past else self._missing()
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
                f"{path} is not a picture of {self._whole[0]}x{self._whole[1]} pixels, as its sheet says; run "
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
            # The middle of the first pixel is 0 before and after the change of size.
            pixels = (edges + 0.5) * self._scale - 0.5 - (left, top)
            lines = list(np.round(pixels * (1 << SHIFT)).astype(np.int32))
            for colour, width in ((PAPER, 4), (ADVERSARY, 2)):
                cv2.polylines(image[top:bottom, left:right], lines, False, colour, width, cv2.LINE_AA, SHIFT)

    def _corners(self, cell: SheetCamera) -> tuple[int, int, int, int]:
        ends = (cell.left, cell.top, cell.left + cell.width, cell.top + cell.height)
        left, top, right, bottom = (round(end * self._scale) for end in ends)
        return left, top, right, bottom

    def _draw_cells(self, image: Picture) -> None:
        for cell in self._stored.sheet.cameras:
            left, top, right, bottom = self._corners(cell)
            cv2.rectangle(image, (left, top), (right, bottom), PANEL, 1)
            words = drawable(cell.name.removeprefix("CAM_").replace("_", " ").lower())
            write_text(image, words, (left + 9.0, top + 12.0), size_px=12, colour=TITLE_INK, plate=TITLE)

    def _missing(self) -> Picture:
        width, height = self.size_px
        image: Picture = np.empty((height, width, 3), np.uint8)
        image[:] = PANEL
        write_text(image, "no picture yet", (width / 2, height / 2), colour=FAINT_INK, anchor="centre")
        return image
