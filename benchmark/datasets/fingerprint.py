"""Content hash of a data set, whatever its folder is called; hashes of large files are kept in the user's cache."""

import hashlib
import os
import re
import stat
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, Self

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.cached_tables import find_cache_folder, find_digest_file
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, lock_folder, read_cached_json, write_json
from benchmark.machine.user_cache import Stamp, is_settled, make_stamp
from benchmark.untrusted.files import TABLE, open_file

WORTH_BYTES: Final = 1 << 22
"""Smaller files are hashed each time."""
_SHA256: Final = re.compile("[0-9a-f]{64}")


class DigestCache:
    """Hashes and stamps of the files of one root by path, kept in ``place`` if there is one."""

    def __init__(self, place: Path | None, known: dict[str, tuple[Stamp, str]]) -> None:
        self._place, self._known = place, known
        self._new: dict[str, tuple[Stamp, str]] = {}

    @classmethod
    def of(cls, folder: Path) -> Self:
        """Kept hashes of a root, given its version folder."""
        cache_folder = find_cache_folder(folder)
        place = None if cache_folder is None else find_digest_file(cache_folder)
        return cls(place, _select_valid(None if place is None or not place.is_file() else read_cached_json(place)))

    def sha256(self, path: Path) -> str:
        """Hash of a file's content, 64 hexadecimal digits; a file longer than any table is refused."""
        name, looked_ns = str(path.resolve()), time.time_ns()
        with open_file(path, TABLE) as stream:
            stamp = make_stamp(os.fstat(stream.fileno()))
            if name in self._known and self._known[name][0] == stamp:
                return self._known[name][1]
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            unchanged = make_stamp(os.fstat(stream.fileno())) == stamp
        if unchanged and stamp[2] >= WORTH_BYTES and is_settled(stamp, looked_ns):
            self._new[name] = stamp, digest
        return digest

    def save(self) -> None:
        """Keep what was hashed, where there is room and a right to; without, it is hashed again."""
        if not self._new or self._place is None:
            return
        entries = {name: [list(stamp), digest] for name, (stamp, digest) in (self._known | self._new).items()}
        try:
            with lock_folder(self._place.parent):
                write_json(self._place, entries)
        except InputError:
            return


def _select_valid(value: Any) -> dict[str, tuple[Stamp, str]]:
    digests: dict[str, tuple[Stamp, str]] = {}
    for name, entry in value.items() if isinstance(value, dict) else ():
        match entry:
            case [[*stamp], str(digest)] if _SHA256.fullmatch(digest) and all(type(number) is int for number in stamp):
                digests[name] = tuple(stamp), digest
    return digests


def compute_fingerprint(root: Path, version: str, images: Iterable[str]) -> str:
    """Hash of everything that a run reads.

    Bytes of the tables, of ``splits.json``, ``challenger.json`` and the map expansions; names and sizes of CAN bus
    files and of keyframe images (relative to the root). Sweeps and lidar files are read by nothing here and do not
    count.
    """
    tables = root / version
    hashed = {f"tables/{table}.json": tables / f"{table}.json" for table in NUSCENES_TABLES}
    for name in ("splits.json", "challenger.json"):
        hashed[f"tables/{name}"] = tables / name
    hashed["splits.json"] = root / "splits.json"
    for path in sorted((root / "maps" / "expansion").glob("*.json")):
        hashed[f"maps/expansion/{path.name}"] = path
    digests = DigestCache.of(tables)
    contents = {name: digests.sha256(path) for name, path in hashed.items() if path.is_file()}
    digests.save()
    can_bus = {path.name: path.stat().st_size for path in sorted((root / "can_bus").glob("*.json"))}
    sizes = _sizes(root, sorted(set(images)))
    return content_key("data set", 1, contents, can_bus, sizes)


def _sizes(root: Path, names: Iterable[str]) -> dict[str, int]:
    """Size of each file in bytes, -1 where it is missing; of hundreds of thousands, so that no path is made of them."""
    below = os.open(root, getattr(os, "O_PATH", os.O_RDONLY))
    try:
        return {name: _size(name, below) for name in names}
    finally:
        os.close(below)


def _size(name: str, below: int) -> int:
    try:
        status = os.stat(name, dir_fd=below)
    except (OSError, ValueError):
        return -1
    return status.st_size if stat.S_ISREG(status.st_mode) else -1
