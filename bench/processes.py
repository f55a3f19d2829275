"""What Linux tells of processes in ``/proc``: who began whom, who is still there, and what they hold."""

import contextlib
from pathlib import Path


def children(process: int) -> list[int]:
    """Processes that one began and that are still there."""
    processes = []
    for path in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            processes += list(map(int, path.read_text().split()))
    return sorted(processes)


def descendants(process: int) -> list[int]:
    """Its children, their children, and so on."""
    below = children(process)
    return [*below, *(grandchild for child in below for grandchild in descendants(child))]


def command_line(process: int) -> str:
    """Its words, or the title that it gave itself."""
    return _read(process, "cmdline").replace("\0", " ")


def is_alive(process: int) -> bool:
    """Whether it runs; a child that was not waited for does not."""
    return _stat(process)[:1] not in ([], ["Z"])


def processor_ticks(process: int) -> int:
    """Processor time of it and of children that it waited for, in ticks of the system's clock."""
    return sum(map(int, _stat(process)[11:15]))


def resident_mb(process: int, of: str = "VmRSS") -> float:
    """Memory that it holds now; 0 where it is gone. ``RssAnon`` is what a copy of it begins with: not mapped files."""
    words = _read(process, "status").partition(f"{of}:")[2].split()
    return float(words[0]) / 1024 if words else 0.0


def _stat(process: int) -> list[str]:
    """What stands behind its name, from its state on."""
    return _read(process, "stat").rpartition(")")[2].split()


def _read(process: int, name: str) -> str:
    """What the system tells; nothing where the process is gone."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/{name}").read_text(errors="replace")
    return ""
