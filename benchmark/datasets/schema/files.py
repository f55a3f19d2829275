"""Files that the tables name: there, inside the root, whole, and of the size that the row says."""

import os
from pathlib import Path
from typing import BinaryIO, Final

from benchmark.datasets.can_bus import CanBus
from benchmark.datasets.schema import FaultList
from benchmark.datasets.schema.table_checks import CheckedTables, Row
from benchmark.errors import InputError

_PNG_START: Final = b"\x89PNG\r\n\x1a\n"
_PNG_END: Final = b"IEND\xaeB`\x82"
_JPEG_SIZES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Start-of-frame markers, which carry the image size."""
_IMAGES: Final = (".jpg", ".jpeg", ".png")
_LIDAR_POINT_BYTES: Final = 20


def check_files(root: Path, tables: CheckedTables, faults: FaultList, *, drawn_later: bool = False) -> None:
    """Note sensor files and map masks that are missing, broken, or of another size.

    Images that are ``drawn_later`` (`benchmark.datasets.drawn_later`) may be missing.
    """
    folders = _FolderSizes(root)
    owners: dict[str, str] = {}
    undrawn = [] if drawn_later else _without_sweep_images(folders, tables)
    if undrawn:
        sentence = (
            f"{undrawn[0]['filename']} is missing, and so is every other image between samples; films play at 2 Hz "
            "without them"
        )
        faults.add("no images between samples", "sample_data", undrawn[0]["token"], sentence, severity="warning")
    left_out = {row["token"] for row in undrawn}
    for row in tables.having("sample_data", "filename", "width", "height"):
        name = row["filename"]
        if name in owners:
            sentence = f"{name} also belongs to {owners[name]}"
            faults.add("files of two rows", "sample_data", row["token"], sentence, severity="warning")
        owners[name] = row["token"]
        size = folders.size(name)
        if size is None and (row["token"] in left_out or (drawn_later and name.endswith(_IMAGES))):
            continue
        if size is None:
            faults.add("missing files", "sample_data", row["token"], f"{name} is missing")
            continue
        problem = _problem(root / name, size, row)
        if problem:
            faults.add("broken files", "sample_data", row["token"], f"{name} {problem}")
    for row in tables.having("map", "filename"):
        if folders.size(row["filename"]) is None:
            sentence = f"{row['filename']} is missing; the devkit cannot open a data set without its map masks"
            faults.add("missing map masks", "map", row["token"], sentence)
        elif not _is_png(root / row["filename"]):
            faults.add("broken map masks", "map", row["token"], f"{row['filename']} is not a complete PNG image")
    for scene in tables.having("scene", "name"):
        try:
            CanBus.read(root, scene["name"])
        except InputError as error:
            faults.add("broken CAN bus files", "can_bus", scene["token"], str(error))


def _without_sweep_images(folders: "_FolderSizes", tables: CheckedTables) -> list[Row]:
    """Rows of all images between samples, if not one is there: data sets of samples alone leave them out."""
    rows = [
        row
        for row in tables.having("sample_data", "filename", "is_key_frame")
        if row["is_key_frame"] is False and row["filename"].endswith(_IMAGES)
    ]
    return [] if any(folders.size(row["filename"]) is not None for row in rows) else rows


class _FolderSizes:
    """Sizes of files, from one listing a folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.listed: dict[str, dict[str, int]] = {}

    def size(self, name: str) -> int | None:
        """Bytes of a file below the root, or ``None`` if there is no such file."""
        folder, _, base = name.rpartition("/")
        if folder not in self.listed:
            self.listed[folder] = self._list(self.root / folder)
        return self.listed[folder].get(base)

    @staticmethod
    def _list(folder: Path) -> dict[str, int]:
        try:
            with os.scandir(folder) as entries:
                return {entry.name: entry.stat().st_size for entry in entries if entry.is_file()}
        except OSError:
            return {}


def _problem(path: Path, size: int, row: Row) -> str:
    """Fault of a sensor file, in words; empty if it has none."""
    suffix = path.suffix.lower()
    if suffix == ".bin":
        # An empty lidar file is legal: generated data sets have no lidar, but converters want the file to exist.
        is_complete = size % _LIDAR_POINT_BYTES == 0 or "LIDAR" not in row["filename"]
        return "" if is_complete else f"has {size} bytes, not a whole number of points"
    if suffix not in (".jpg", ".jpeg", ".png"):
        return ""
    if not size:
        return "is empty"
    try:
        size_px = _png_size(path) if suffix == ".png" else _jpeg_size(path)
    except OSError as error:
        return f"cannot be read: {error.strerror or error}"
    if size_px is None:
        return f"is not a complete {'PNG' if suffix == '.png' else 'JPEG'} image"
    expected = (row["width"], row["height"])
    if size_px != expected:
        return f"is {size_px[0]} x {size_px[1]} pixels, the row says {expected[0]} x {expected[1]}"
    return ""


def _is_png(path: Path) -> bool:
    try:
        return _png_size(path) is not None
    except OSError:
        return False


def _png_size(path: Path) -> tuple[int, int] | None:
    """Width and height of a PNG that starts and ends as it should."""
    with path.open("rb") as stream:
        head = stream.read(24)
        if not head.startswith(_PNG_START) or len(head) < 24 or not _tail(stream, 12).endswith(_PNG_END):
            return None
        return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")


def _jpeg_size(path: Path) -> tuple[int, int] | None:
    """Width and height of a JPEG that starts and ends as it should."""
    with path.open("rb") as stream:
        if stream.read(2) != b"\xff\xd8":
            return None
        size = None
        while size is None:
            marker = stream.read(4)
            if len(marker) < 4 or marker[0] != 0xFF or marker[1] == 0xDA:
                return None
            length = int.from_bytes(marker[2:], "big")
            if marker[1] in _JPEG_SIZES:
                frame = stream.read(5)
                size = int.from_bytes(frame[3:5], "big"), int.from_bytes(frame[1:3], "big")
            else:
                stream.seek(length - 2, os.SEEK_CUR)
        return size if _tail(stream, 64).rstrip(b"\0").endswith(b"\xff\xd9") else None


def _tail(stream: BinaryIO, count: int) -> bytes:
    end = stream.seek(0, os.SEEK_END)
    stream.seek(max(end - count, 0))
    return stream.read()
