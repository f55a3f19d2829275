"""What Linux tells of processes in ``/proc``: who began whom, who is still there, and what they hold."""

import contextlib
from pathlib import Path


def children(process: int) -> list[int]:
    """Processes that one began and that are still there."""
    found = []
    for path in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += list(map(int, path.read_text().split()))
    return sorted(found)


def descendants(process: int) -> list[int]:
    """Its children, their children, and so on."""
    below = children(process)
    return [*below, *(each for child in below for each in descendants(child))]


def title(process: int) -> str:
    """The first word of its command line, which it may have set itself; empty where it is gone."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")[0].decode(errors="replace")
    return ""


def stat(process: int) -> list[str]:
    """What stands behind its name in ``stat``, from its state on; empty where it is gone."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return []


def alive(process: int) -> bool:
    """Whether it runs; a child that was not waited for does not."""
    return stat(process)[:1] not in ([], ["Z"])


def resident_mb(process: int) -> float:
    """Memory that it holds now; 0 where it is gone."""
    with contextlib.suppress(OSError, IndexError):
        status = Path(f"/proc/{process}/status").read_text()
        return float(status.partition("VmRSS:")[2].split()[0]) / 1024
    return 0.0
