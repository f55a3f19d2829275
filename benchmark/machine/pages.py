"""Memory that a process gives back to the system comes again page by page, each cleared by the kernel.

A network on a processor frees and takes blocks of many megabytes for each layer, and glibc gives large blocks back at
once: a quarter of the time of a frame of VAD-tiny went into clearing pages that it had just had.
"""

import ctypes
import sys
from typing import Final

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4
"""Parameters of ``mallopt`` (malloc.h)."""
_NEVER: Final = 2**31 - 1


def keep_pages_of(*weights_sha256: str | None) -> None:
    """`keep_pages` of a process in which a planner with weights is going to run; without one nothing changes.

    ``None`` stands for a planner that has none.
    """
    if any(each is not None for each in weights_sha256):
        keep_pages()


def keep_pages() -> bool:
    """Let this process keep what it frees, to use it again; what it computes does not change.

    False where the C library has no such switch: glibc does, others manage without.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    # Large blocks come from the heap too, and its end is never given back.
    return bool(mallopt(_MMAP_MAX, 0)) and bool(mallopt(_TRIM_THRESHOLD, _NEVER))
