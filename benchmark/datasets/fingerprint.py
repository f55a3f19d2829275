"""A content hash of a data set: equal for equal data, wherever it lies and whatever its folder is called."""

import os
import stat
from collections.abc import Iterable
from pathlib import Path

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.kept_digests import KeptDigests
from benchmark.machine.storage import content_key


def fingerprint_of(root: Path, version: str, images: Iterable[str]) -> str:
    """Hash of everything that a run reads.

    Bytes of the tables, of ``splits.json``, ``challenger.json`` and the map expansions; names and sizes of CAN bus
    files and of keyframe images. Sweeps and lidar files are read by nothing here and do not count.

    Args:
        images: Names of image files relative to the root.
    """
    tables = root / version
    hashed = {f"tables/{table}.json": tables / f"{table}.json" for table in NUSCENES_TABLES}
    for name in ("splits.json", "challenger.json"):
        hashed[f"tables/{name}"] = tables / name
    hashed["splits.json"] = root / "splits.json"
    for path in sorted((root / "maps" / "expansion").glob("*.json")):
        hashed[f"maps/expansion/{path.name}"] = path
    kept = KeptDigests.of(tables)
    contents = {name: kept.sha256(path) for name, path in hashed.items() if path.is_file()}
    kept.keep()
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
