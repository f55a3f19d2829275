"""Requests to our own model server that are none: it has to refuse them, and to go on as if they had not been."""

import atexit
import contextlib
import shutil
import signal
import time
from pathlib import Path
from typing import Final

from bench.attacking.children import HANG_S, CommandOutcome, begin_command
from bench.attacking.verdicts import Verdict, fall
from bench.processes import is_alive, resident_mb
from benchmark.errors import InputError
from benchmark.extensions.http.model import http_planner
from benchmark.extensions.http.session import build_request
from benchmark.extensions.http.values import HttpImageFormat
from tests.benchmark.extensions.http.made import free_port, observed
from tests.benchmark.extensions.http.malformed import Request, answered, posted

SERVED: Final = "constant-velocity"
_SETTLED: Final = 200
"""Requests after which its memory may grow by `_GROWTH_MB` at most: what Python collects now and then."""
_GROWTH_MB: Final = 32.0
_EVERY: Final = 20
"""The first and each so many requests, it is asked for good plans."""
_BEGINS_S: Final = 120.0


class OwnServer:
    """A model server as a user starts it, in a process that ends with this one.

    Attributes:
        url: Its address, the same however often it begins.
    """

    def __init__(self, folder: Path) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        self._folder, self._port = folder, free_port()
        self.url = f"http://127.0.0.1:{self._port}"
        self.begin()
        self._bodies = [build_request(observed(index), HttpImageFormat.PNG).encoded() for index in range(3)]
        self._plans, self._said, self._asked, self._settled_mb = self._plan_frame(), 0, 0, float("inf")

    @property
    def process(self) -> int:
        """That it runs in now."""
        return self._begun.process

    def begin(self) -> None:
        """Begin it, and wait until it answers."""
        line = ["serve", "--model", SERVED, "--port", str(self._port)]
        self._begun = begin_command(line, self._folder)
        atexit.register(self.end)
        one, until = http_planner(f"served={self.url}"), time.monotonic() + _BEGINS_S
        while True:
            try:
                return one.require_alive()
            except InputError:
                if time.monotonic() > until or not is_alive(self.process):
                    raise InputError(f"no server began: {self.end().err}") from None
                time.sleep(0.05)

    def end(self) -> CommandOutcome:
        """End it at once."""
        atexit.unregister(self.end)
        return self._begun.end(0.0)

    def asked(self, request: Request) -> tuple[Verdict, CommandOutcome]:
        """Send it a request, and say what became of it: of the server, and at times of good requests that follow."""
        began = time.monotonic()
        reply = self._answer(request.sent, request.whole)
        output = self._begun.printed[1].read_text(errors="replace")
        memory_mb = resident_mb(self.process)
        code = 0 if is_alive(self.process) else -signal.SIGKILL
        spent = time.monotonic() - began
        ended = CommandOutcome(code, "", output[self._said :], 0.0, spent, HANG_S, self._begun.held_bytes())
        outcome = fall(ended) or self._verdict(request, reply, memory_mb)
        self._said = len(output)
        return outcome, ended

    def _verdict(self, request: Request, reply: bytes, memory_mb: float) -> Verdict:
        if self._asked == _SETTLED:
            self._settled_mb = memory_mb
        if memory_mb > self._settled_mb + _GROWTH_MB:
            return Verdict.MEMORY
        if self._asked % _EVERY == 0 and self._plan_frame() != self._plans:
            return Verdict.SILENT
        self._asked += 1
        status = reply[9:10]
        if status == b"4" or not (reply or request.whole):
            return Verdict.ANSWERED
        return Verdict.OTHER_INPUT if status == b"2" else Verdict.UNCLEAR

    def _plan_frame(self) -> list[bytes]:
        """The plans of three good requests."""
        self._answer(posted(b"{}", "/reset"))
        return [self._answer(posted(body)).partition(b"\r\n\r\n")[2] for body in self._bodies]

    def _answer(self, sent: bytes, whole: bool = True) -> bytes:
        """What it answers; nothing where it is gone."""
        with contextlib.suppress(OSError):
            return answered(self._port, sent, whole)
        return b""
