"""One command in a child process that is a copy of this one, so that nothing is imported anew; measured and bounded."""

import contextlib
import os
import resource
import signal
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Final

HANG_S: Final = 20.0
MEMORY_BYTES: Final = 2 << 30
_OVER: Final = 1.25
"""How far beyond a limit a child goes before it is ended: what is measured must be seen to be over."""
_LOOK_S: Final = 0.02


@dataclass(frozen=True, slots=True)
class Ended:
    """How a command ended.

    Attributes:
        code: Its exit code; minus the signal's number where it died of one.
        out: What it printed.
        err: What it said on standard error.
        cpu_s: Processor time, with its own children's.
        wall_s: Time on the wall.
        patience_s: How long it might have taken on the wall: 20 s where a processor is free, more where others wait.
        peak_bytes: Largest memory in use, of it or one of its children.
    """

    code: int
    out: str
    err: str
    cpu_s: float
    wall_s: float
    patience_s: float
    peak_bytes: int


def patience_s() -> float:
    """20 s of a machine with a free processor, on this one as loaded as it is."""
    return HANG_S * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def run_command(
    arguments: list[str], folder: Path, cache: Path, *, patience: float | None = None, until: str = ""
) -> Ended:
    """Run a command of the command line.

    Args:
        arguments: What follows ``challenger-bench``.
        folder: Current directory of the command; what it prints is kept beside it.
        cache: The user's cache of the command.
        patience: How long it may take on the wall, seconds; `patience_s` by default.
        until: It is interrupted, as by Ctrl-C, once it has printed this; nothing by default.

    Returns:
        How it ended.
    """
    allowed = patience_s() if patience is None else patience
    child, printed = begin_command(arguments, folder, cache, bounded=patience is None)
    return end_command(child, printed, allowed, until=until)


def begin_command(
    arguments: list[str], folder: Path, cache: Path, *, bounded: bool = False
) -> tuple[int, tuple[Path, Path]]:
    """Begin a command in a process group of its own.

    Args:
        arguments: What follows ``challenger-bench``.
        folder: Its current directory.
        cache: The user's cache of the command.
        bounded: Whether its processor time is.

    Returns:
        The process, and the files of what it prints, for `end_command`.
    """
    printed = folder.with_name(f"{folder.name}.out"), folder.with_name(f"{folder.name}.err")
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        _be_command(arguments, folder, cache, printed, bounded=bounded)
    return child, printed


def end_command(child: int, printed: tuple[Path, Path], patience: float, *, until: str = "") -> Ended:
    """Wait for a command, and end what is left of its process group.

    Args:
        child: From `begin_command`.
        printed: From there, too; the files are removed.
        patience: How long it may take from now, seconds.
        until: As of `run_command`.

    Returns:
        How it ended.
    """
    began = time.monotonic()
    code, usage = _await(child, began + patience * _OVER, printed, until)
    wall = time.monotonic() - began
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    out, err = (path.read_text(errors="replace") if path.exists() else "" for path in printed)
    for path in printed:
        path.unlink(missing_ok=True)
    cpu = usage.ru_utime + usage.ru_stime
    # Kilobytes on Linux, bytes on macOS.
    peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return Ended(code, out, err, cpu, wall, patience, peak)


def _await(child: int, deadline: float, printed: tuple[Path, Path], until: str) -> tuple[int, resource.struct_rusage]:
    """Wait for a child; killed where it takes too long or too much, and interrupted once it has said something."""
    statm = Path(f"/proc/{child}/statm")
    waiting = bool(until)
    while True:
        found, status, usage = os.wait4(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status), usage
        with contextlib.suppress(OSError, IndexError, ValueError):
            pages = int(statm.read_text().split()[1])
            if pages * resource.getpagesize() > MEMORY_BYTES * _OVER:
                os.kill(child, signal.SIGKILL)
        if waiting and any(path.exists() and until in path.read_text(errors="replace") for path in printed):
            os.kill(child, signal.SIGINT)
            waiting = False
        if time.monotonic() > deadline:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
        time.sleep(_LOOK_S)


def _be_command(arguments: list[str], folder: Path, cache: Path, printed: tuple[Path, Path], *, bounded: bool) -> None:
    """Become the command; never returns."""
    code = 1
    try:
        os.setsid()
        seconds = int(HANG_S * _OVER)
        if bounded:
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.chdir(folder)
        for path, number in zip(printed, (1, 2)):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        sys.stdout, sys.stderr = (os.fdopen(number, "w", buffering=1) for number in (1, 2))
        os.environ["CHALLENGER_BENCH_CACHE"] = str(cache)
        sys.argv = ["challenger-bench", *arguments]
        code = _run()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _run() -> int:
    import torch

    from benchmark.cli.app import main

    # Threads of the parent do not come along, and a copy that waits for them waits for ever.
    torch.set_num_threads(1)
    try:
        main()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0
