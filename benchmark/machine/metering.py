"""How long a call takes until the device is done, and how much memory a process needs meanwhile, and keeps.

Memory that a process gives back to the system comes again page by page, each cleared by the kernel.
"""

import ctypes
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4
"""Parameters of ``mallopt`` (malloc.h)."""
_NEVER: Final = 2**31 - 1


def disable_malloc_trim_for(*weights_sha256: str | None) -> None:
    """`disable_malloc_trim` where a planner with weights is going to run; ``None`` stands for a planner without."""
    if any(sha256 is not None for sha256 in weights_sha256):
        disable_malloc_trim()


def disable_malloc_trim() -> bool:
    """Let this process keep what it frees, to use it again; False where the C library is not glibc."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    # Large blocks come from the heap too, whose end is never returned to the system.
    return bool(mallopt(_MMAP_MAX, 0)) and bool(mallopt(_TRIM_THRESHOLD, _NEVER))


_CLEAR_PEAK: Final = "5"
"""Written to ``clear_refs`` it makes the peak of resident memory begin again (Linux, proc(5))."""
_MB: Final = 1e6


class Meter:
    """Meter of this process from when it is made; ``latency_s`` of each call so far, ``None`` for calls that raised."""

    def __init__(self) -> None:
        """Begin."""
        self.latency_s: list[float | None] = []
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text(_CLEAR_PEAK, encoding="utf-8")
        cuda = _gpu()
        if cuda is not None:
            cuda.reset_peak_memory_stats()

    @contextmanager
    def call(self) -> Iterator[None]:
        """Time what is done inside, the device's work included."""
        _wait()
        begun = time.perf_counter()
        try:
            yield
            _wait()
        except BaseException:
            self.latency_s.append(None)
            raise
        self.latency_s.append(time.perf_counter() - begun)

    @property
    def peak_device_mb(self) -> float | None:
        """Greatest memory allocated on this process' GPU since the beginning; ``None`` without one."""
        cuda = _gpu()
        return None if cuda is None else cuda.max_memory_allocated() / _MB


def peak_memory_mb(pid: int | None = None) -> float | None:
    """Greatest resident memory of a process, megabytes; ``None`` where the system does not tell.

    Of the process with the number since it began, or of this one since a `Meter` was made last.
    """
    with suppress(OSError, ValueError, IndexError):
        for line in Path(f"/proc/{pid or 'self'}/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / _MB
    return None


def _gpu() -> Any:
    """PyTorch's CUDA part, if this process uses a GPU: else there is nothing to wait for."""
    torch = sys.modules.get("torch")
    return torch.cuda if torch is not None and torch.cuda.is_initialized() else None


def _wait() -> None:
    cuda = _gpu()
    if cuda is not None:
        cuda.synchronize()
