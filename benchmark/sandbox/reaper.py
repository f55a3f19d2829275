"""The reaper between a planner and its parent: it ends the planner with all its children and reports how it died.

A planner's children outlive it where they want to; the guardian becomes their parent then (Linux), finds them and ends
them. It ends when its connection to the parent closes, which even a sudden end of the parent does.
"""

import contextlib
import ctypes
import os
import select
import signal
import socket
import struct
import time
from pathlib import Path
from typing import Final

from benchmark.sandbox.limits import REAPING_S

STATUS: Final = struct.Struct("<i")
"""How the planner's process ended, as ``os.waitpid`` says it."""
_DIE_WITH_PARENT: Final = 1
_ADOPT_ORPHANS: Final = 36
"""``PR_SET_PDEATHSIG`` and ``PR_SET_CHILD_SUBREAPER`` of Linux."""
_PAUSE_S: Final = 0.005


def run_under_reaper(channel: int, lifeline: int, pictures: int, memory_bytes: int) -> None:
    """Run as the reaper and as the planner's process that it watches; the main function of both.

    Descriptors of the planner's connection, of the reaper's, and of the shared memory; 0 bytes: no limit.
    """
    for descriptor in (channel, lifeline, pictures):
        os.set_inheritable(descriptor, False)
    _fork_under_reaper(socket.socket(fileno=lifeline))
    # Imported only in the child, which keeps the guardian small.
    from benchmark.sandbox.child import main

    main(channel, pictures, memory_bytes)


def _fork_under_reaper(lifeline: socket.socket) -> None:
    """Continue in a child process; this one watches it and does not return."""
    _control(_ADOPT_ORPHANS, 1)
    guardian = os.getpid()
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    # Set before the child starts, so that its end is not missed.
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake)
    planner = os.fork()
    if planner == 0:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for descriptor in (woken, wake):
            os.close(descriptor)
        lifeline.close()
        _control(_DIE_WITH_PARENT, signal.SIGKILL)
        if os.getppid() != guardian:
            os._exit(1)
        return
    try:
        _reap_until_end(planner, lifeline, woken, wake)
    finally:
        os._exit(0)


def _reap_until_end(planner: int, lifeline: socket.socket, woken: int, wake: int) -> None:
    # A pipe without a writer is always ready: waiting for it would take a whole processor.
    _close_all_but(lifeline.fileno(), woken, wake)
    status: int | None = None
    while status is None:
        ready, _, _ = select.select([lifeline.fileno(), woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
        status, _ = _reap_children(planner)
        if lifeline.fileno() in ready:
            break
    status = _end_all(planner, status)
    with contextlib.suppress(OSError):
        lifeline.sendall(STATUS.pack(status))


def _close_all_but(*kept: int) -> None:
    """Hold nothing of what the planner holds: who asks must see its end."""
    highest = os.sysconf("SC_OPEN_MAX")
    first = 0
    for descriptor in sorted(kept):
        os.closerange(first, descriptor)
        first = descriptor + 1
    os.closerange(first, min(highest, 1 << 16))


def _reap_children(planner: int) -> tuple[int | None, bool]:
    """Bury the dead: how the planner ended, if it did, and whether anybody is left."""
    planner_status = None
    try:
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            planner_status = ended[1] if ended[0] == planner else planner_status
    except ChildProcessError:
        return planner_status, False
    return planner_status, True


def _end_all(planner: int, status: int | None) -> int:
    """Kill all descendants of this process until none is left; returns how the planner ended."""
    until, has_children = time.monotonic() + REAPING_S, True
    while has_children and time.monotonic() < until:
        for process in {*_list_descendants(os.getpid()), *([planner] if status is None else [])}:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
        planner_status, has_children = _reap_children(planner)
        status = status if planner_status is None else planner_status
        time.sleep(_PAUSE_S if has_children else 0.0)
    return signal.SIGKILL if status is None else status


def _list_descendants(of: int) -> set[int]:
    """Processes that descend from one, as far as ``/proc`` says."""
    parents: dict[int, int] = {}
    for stat_file in Path("/proc").glob("[0-9]*/stat"):
        # It may have ended since, and its name may hold anything, brackets too.
        with contextlib.suppress(OSError, ValueError, IndexError):
            parents[int(stat_file.parent.name)] = int(
                stat_file.read_text(errors="replace").rpartition(")")[2].split()[1]
            )
    descendants, fresh = set[int](), {of}
    while fresh:
        fresh = {process for process, parent in parents.items() if parent in fresh} - descendants
        descendants |= fresh
    return descendants


def _control(option: int, value: int) -> None:
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(option, value)
