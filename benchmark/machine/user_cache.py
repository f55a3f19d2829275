"""Where a user's cache is, and how a file is known again without reading it."""

import os
from pathlib import Path
from typing import Final

SETTLED_S: Final = 3.0
"""A file that was changed less long ago may change once more without its times showing it: some file systems count
in steps of two seconds."""
Stamp = tuple[int, ...]


def cache_root() -> Path:
    """Folder for what is built once per user."""
    explicit = os.environ.get("CHALLENGER_BENCH_CACHE")
    if explicit:
        return Path(explicit).expanduser()
    general = os.environ.get("XDG_CACHE_HOME")
    return (Path(general) if general else Path.home() / ".cache") / "challenger-bench"


def make_stamp(status: os.stat_result) -> Stamp:
    """Five numbers that tell whether a file is still the same: device, inode, bytes, times of content and of inode.

    A process that puts the time of the content back changes that of the inode.
    """
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def is_settled(stamp: Stamp, looked_ns: int) -> bool:
    """Whether any later change of a file shows in its stamp: it was last changed long enough before ``looked_ns``.

    ``looked_ns`` is when the stamp was taken (`time.time_ns`).
    """
    return looked_ns - max(stamp[-2:]) > SETTLED_S * 1e9
