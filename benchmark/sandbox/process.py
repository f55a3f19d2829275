"""A planner's process as seen by who asks: started, asked, watched, and ended with all that it started.

A question ends in one of a closed list of ways, decided by facts that the planner cannot print: it was answered, it was
late, its answer is none, or its process died. After any but the first the process is gone.
"""

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.planning import PlannerLostError
from benchmark.sandbox.frames import ClosedError, LateError, MalformedError, QuestionChannel, encode_question
from benchmark.sandbox.limits import GRACE_S, MOST_PICTURE_BYTES, ONE_THREAD, REAPING_S, SandboxLimits
from benchmark.sandbox.reaper import STATUS
from benchmark.sandbox.shared_images import SharedImagePool, TooManyPicturesError
from benchmark.untrusted.files import format_bytes, to_one_line

_PROGRAM: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); numbers = [*map(int, sys.argv[2:])]; del sys.argv[1:]; "
    "from benchmark.sandbox.reaper import run_under_reaper; run_under_reaper(*numbers)"
)
_LOOK_S: Final = 1.0
"""So often is the heart listened to."""
_STDERR: Final = 2


class PlannerProcess:
    """The process of one planner."""

    def __init__(self, supervision: SandboxLimits) -> None:
        """Start the process; the planner is not loaded yet."""
        self._supervision = supervision
        self._number = 0
        self._shelf = SharedImagePool()
        channel, theirs = socket.socketpair()
        lifeline, guardians = socket.socketpair()
        given = (theirs.fileno(), guardians.fileno(), self._shelf.file)
        numbers = map(str, (*given, supervision.memory_bytes or 0))
        try:
            process = subprocess.Popen(
                [sys.executable, "-u", "-X", "faulthandler", "-c", _PROGRAM, json.dumps(sys.path), *numbers],
                stdin=subprocess.DEVNULL,
                # Stdout belongs to the command (--json); what a planner prints goes to stderr.
                stdout=_STDERR if _is_open(_STDERR) else subprocess.DEVNULL,
                pass_fds=given,
                env={**os.environ, **ONE_THREAD},
                start_new_session=True,
            )
        except OSError as error:
            raise InputError(
                f"cannot start a process for a planner: {error.strerror or error}; close other programs, then try again"
            ) from error
        finally:
            theirs.close()
            guardians.close()
        self._asker, self._lifeline, self._guardian = QuestionChannel(channel), lifeline, process.pid
        self._end = weakref.finalize(self, _end_process, process, channel, lifeline, self._shelf)

    def ask(
        self,
        kind: str,
        *parts: Any,
        doing: str,
        limit_s: float,
        picture: Callable[[str], NDArray[np.uint8]] | None = None,
        ahead: Sequence[str] = (),
    ) -> list[Any]:
        """Ask, and wait for the answer: a word, and what belongs to it.

        Args:
            kind: One that `benchmark.sandbox.child` knows.
            doing: What the planner does then, in words that end "... within 10 s".
            limit_s: Without the reading of pictures.
            picture: Reads a picture that is asked for meanwhile.
            ahead: Pictures that will probably be asked for; those that can be read are sent with the question.
        """
        self._number += 1
        broken: list[InputError] = []
        try:
            parts = parts if picture is None else (*parts, self._ready(picture, ahead))
            deadline = time.monotonic() + limit_s
            self._asker.send(encode_question(self._number, kind, *parts), deadline)
            while True:
                self._listen(deadline)
                answer = self._received(deadline)
                if answer[0] != "picture" or picture is None:
                    break
                begun = time.monotonic()
                reply = self._shown(answer, picture, broken)
                deadline += time.monotonic() - begun
                self._asker.send(reply, deadline)
        except ClosedError:
            raise PlannerLostError(self._death()) from None
        except LateError:
            self.end(at_once=True)
            raise PlannerLostError(f"{doing} within {limit_s:g} s; its process was ended", late=True) from None
        except _SilentError:
            self.end(at_once=True)
            silence = f"{doing}, and its process gave no sign of life for {self._supervision.silence_s:g} s"
            raise PlannerLostError(f"{silence}; it was ended", late=True) from None
        except MalformedError as error:
            self.end(at_once=True)
            raise PlannerLostError(f"the planner's process broke the connection: {to_one_line(error)}") from None
        except BaseException:
            # A late answer must not be taken for the answer to the next question.
            self.end(at_once=True)
            raise
        if answer[0] == "picture missing" and broken:
            raise broken[-1]
        return answer

    @property
    def pid(self) -> int | None:
        """The planner's process, the first child of its guardian; ``None`` where the system does not tell."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            return int(
                Path(f"/proc/{self._guardian}/task/{self._guardian}/children").read_text(encoding="utf-8").split()[0]
            )
        return None

    def end(self, *, at_once: bool = False) -> None:
        """End the process and all that it started; ``at_once`` without letting it end by itself."""
        if at_once:
            self._lifeline.close()
        self._end()

    def _listen(self, deadline: float) -> None:
        beats, heard = self._shelf.beats(), time.monotonic()
        while not self._asker.wait(select.POLLIN, min(deadline - time.monotonic(), _LOOK_S)):
            now = time.monotonic()
            if now >= deadline:
                raise LateError
            if self._shelf.beats() != beats:
                beats, heard = self._shelf.beats(), now
            elif beats and now - heard > self._supervision.silence_s:
                # Before the first heartbeat it is still starting.
                raise _SilentError

    def _received(self, deadline: float) -> list[Any]:
        # An answer that began in time may end a little later.
        message = self._asker.receive(self._number, max(deadline, time.monotonic() + GRACE_S))
        try:
            let_go, answer = message
            self._shelf.reclaim(let_go)
            if not isinstance(answer, list) or not isinstance(answer[0], str):
                raise MalformedError("its answer is none")
        except (TypeError, ValueError, KeyError, IndexError) as error:
            raise MalformedError("its answer is none") from error
        return answer

    def _ready(
        self, picture: Callable[[str], NDArray[np.uint8]], names: Sequence[str]
    ) -> dict[str, tuple[int, tuple[int, ...], bool]]:
        """Pictures that are sent with a question; a broken one is reported when the planner reads it."""
        ready = {}
        for name in names:
            with contextlib.suppress(InputError, KeyError, TooManyPicturesError):
                ready[name] = self._put(picture(name))
        return ready

    def _put(self, picture: NDArray[np.uint8]) -> tuple[int, tuple[int, ...], bool]:
        return self._shelf.put(picture), picture.shape, bool(picture.flags.writeable)

    def _shown(
        self, request: list[Any], picture: Callable[[str], NDArray[np.uint8]], broken: list[InputError]
    ) -> bytes:
        """The reply to a planner that looks."""
        try:
            _, name = request
            return encode_question(self._number, "shown", *self._put(picture(name)))
        except InputError as error:
            broken.append(error)
            return encode_question(self._number, "broken", str(error))
        except (KeyError, ValueError, TypeError) as error:
            raise MalformedError("it asked for a picture that does not exist") from error
        except TooManyPicturesError as error:
            raise MalformedError(f"it keeps more than {format_bytes(MOST_PICTURE_BYTES)} of pictures") from error

    def _death(self) -> str:
        """How the process ended; it is gone then."""
        data = b""
        with contextlib.suppress(OSError):
            self._lifeline.settimeout(GRACE_S)
            data = self._lifeline.recv(STATUS.size)
        self.end(at_once=True)
        if len(data) < STATUS.size:
            return "the planner's process closed its connection and was ended"
        (status,) = STATUS.unpack(data)
        if not os.WIFSIGNALED(status):
            return f"the planner's process ended by itself with exit status {os.waitstatus_to_exitcode(status)}"
        number = os.WTERMSIG(status)
        hint = ", as happens where memory runs out" if number == signal.SIGKILL else ""
        return f"the planner's process died (signal {_find_signal_name(number)}{hint})"


class _SilentError(Exception):
    """No sign of life."""


def _end_process(
    process: "subprocess.Popen[bytes]", channel: socket.socket, lifeline: socket.socket, shelf: SharedImagePool
) -> None:
    """Let a process end by itself for a moment if it has a lifeline still, then see to it that it is gone."""
    channel.close()
    if lifeline.fileno() >= 0:
        with contextlib.suppress(OSError):
            lifeline.settimeout(GRACE_S)
            lifeline.recv(STATUS.size)
        lifeline.close()
    try:
        process.wait(timeout=REAPING_S + GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    shelf.close()


def _is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


def _find_signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return str(number)
