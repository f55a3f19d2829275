"""One command in a child process that is a copy of this one, so that nothing is imported anew; measured and bounded."""

import contextlib
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from bench.processes import resident_mb

HANG_S: Final = 20.0
MEMORY_BYTES: Final = 2 << 30
_OVER: Final = 1.25
"""How far beyond a limit a child goes before it is ended: what is measured must be seen to be over."""
_LOOK_S: Final = 0.02


@dataclass(frozen=True, slots=True)
class CommandOutcome:
    """How a command ended.

    Attributes:
        code: Its exit code; minus the signal's number where it died of one.
        out: What it printed.
        err: What it said on standard error.
        cpu_s: Processor time, with its own children's.
        wall_s: Time on the wall.
        patience_s: How long it might have taken on the wall: 20 s where a processor is free, more where others wait.
        peak_bytes: Largest memory in use, of it or one of its children, without what it was copied with.
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


@dataclass(frozen=True, slots=True)
class RunningCommand:
    """A command that runs.

    Attributes:
        process: It, which leads a process group.
        printed: Files of what it prints.
        copied_bytes: Memory of the process that it is a copy of, when it began.
    """

    process: int
    printed: tuple[Path, Path]
    copied_bytes: int

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def held_bytes(self) -> int:
        """Memory that it holds now, without what it was copied with."""
        return max(int(resident_mb(self.process) * 2**20) - self.copied_bytes, 0)

    def kill(self) -> None:
        """End its process group at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process, signal.SIGKILL)

    def end(self, patience: float, *, until: str = "") -> CommandOutcome:
        """Wait for it, and end what is left of its process group.

        Args:
            patience: How long it may take from now, seconds.
            until: As of `run_command`.

        Returns:
            How it ended; the files of what it printed are removed.
        """
        began = time.monotonic()
        code, usage = _await(self, began + patience * _OVER, until)
        wall = time.monotonic() - began
        self.kill()
        out, err = (path.read_text(errors="replace") if path.exists() else "" for path in self.printed)
        for path in self.printed:
            path.unlink(missing_ok=True)
        # Kilobytes on Linux, bytes on macOS.
        peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
        return CommandOutcome(
            code, out, err, usage.ru_utime + usage.ru_stime, wall, patience, max(peak - self.copied_bytes, 0)
        )


def run_command(
    arguments: Sequence[str], folder: Path, *, patience: float | None = None, until: str = ""
) -> CommandOutcome:
    """Run a command of the command line.

    Args:
        arguments: What follows ``challenger-bench``.
        folder: Its current directory, with the user's cache; what it prints is kept beside it.
        patience: How long it may take on the wall, seconds; `patience_s` by default, with its processor time bounded.
        until: It is interrupted, as by Ctrl-C, once it has printed this; nothing by default.

    Returns:
        How it ended.
    """
    allowed = patience_s() if patience is None else patience
    with begin_command(arguments, folder, bounded=patience is None) as begun:
        return begun.end(allowed, until=until)


def begin_command(arguments: Sequence[str], folder: Path, *, bounded: bool = False) -> RunningCommand:
    """Begin a command in a process group of its own; arguments and folder as of `run_command`."""
    printed = folder.with_name(f"{folder.name}.out"), folder.with_name(f"{folder.name}.err")
    sys.stdout.flush()
    sys.stderr.flush()
    copied = int(resident_mb(os.getpid(), "RssAnon") * 2**20)
    child = os.fork()
    if child == 0:
        _become_command(arguments, folder, printed, bounded=bounded)
    return RunningCommand(child, printed, copied)


def _await(begun: RunningCommand, deadline: float, until: str) -> tuple[int, resource.struct_rusage]:
    """Wait for a child; killed where it takes too long or too much, and interrupted once it has said something."""
    child, waiting = begun.process, bool(until)
    while True:
        ended_child, status, usage = os.wait4(child, os.WNOHANG)
        if ended_child:
            return os.waitstatus_to_exitcode(status), usage
        if begun.held_bytes() > MEMORY_BYTES * _OVER:
            os.kill(child, signal.SIGKILL)
        if waiting and any(path.exists() and until in path.read_text(errors="replace") for path in begun.printed):
            os.kill(child, signal.SIGINT)
            waiting = False
        if time.monotonic() > deadline:
            begun.kill()
        time.sleep(_LOOK_S)


def _become_command(arguments: Sequence[str], folder: Path, printed: tuple[Path, Path], *, bounded: bool) -> None:
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
        os.environ["CHALLENGER_BENCH_CACHE"] = str(folder / "cache")
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
