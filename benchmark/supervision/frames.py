"""What goes between a planner's process and the one that asks: a number and a length, then the message.

Questions are pickles: the planner's process trusts who asks. Answers are plain values (`benchmark.foreign.answers`):
who asks trusts nothing in them. Every answer repeats the number of its question, so that none is taken for another's.
"""

import io
import pickle
import select
import socket
import struct
import time
from typing import Any, Final

from benchmark.foreign.answers import read_answer, write_answer
from benchmark.foreign.limits import PLANNER_ANSWER

_HEAD: Final = struct.Struct("<QQ")
_PIECE: Final = 1 << 20


class ClosedError(Exception):
    """The other side is gone."""


class LateError(Exception):
    """The other side takes too long."""


class MalformedError(Exception):
    """What the other side says is no message, or not an answer to what was asked."""


def question(number: int, kind: str, *parts: Any) -> bytes:
    """The bytes of a question."""
    body = pickle.dumps((kind, parts), protocol=5)
    return _HEAD.pack(number, len(body)) + body


def answer(number: int, value: Any) -> bytes:
    """The bytes of an answer; raises `benchmark.foreign.answers.Unanswerable` for what is no plain value."""
    stream = io.BytesIO()
    write_answer(stream, value, PLANNER_ANSWER)
    body = stream.getbuffer()
    return _HEAD.pack(number, len(body)) + body


def next_question(stream: socket.socket) -> tuple[int, str, tuple[Any, ...]]:
    """In the planner's process: wait for a question; raises `ClosedError` when nobody asks any more."""
    number, length = _HEAD.unpack(_exactly(stream, _HEAD.size))
    kind, parts = pickle.loads(_exactly(stream, length))  # noqa: S301 - from the process that started this one
    return number, kind, parts


def _exactly(stream: socket.socket, count: int) -> bytearray:
    found, place = bytearray(count), 0
    while place < count:
        size = stream.recv_into(memoryview(found)[place:])
        if not size:
            raise ClosedError
        place += size
    return found


class Asker:
    """The asking side of a connection.

    Args:
        stream: The connection.
    """

    def __init__(self, stream: socket.socket) -> None:
        self._stream = stream
        stream.setblocking(False)

    def send(self, message: bytes, deadline: float) -> None:
        """Send a question.

        Args:
            message: From `question`.
            deadline: On the monotonic clock.

        Raises:
            ClosedError: If nobody listens any more.
            LateError: If nobody reads.
        """
        left = memoryview(message)
        while left:
            self.wait(select.POLLOUT, deadline - time.monotonic(), required=True)
            try:
                left = left[self._stream.send(left) :]
            except BlockingIOError:
                continue
            except OSError as error:
                raise ClosedError from error

    def wait(self, what: int, seconds: float, *, required: bool = False) -> bool:
        """Whether the connection is ready within a time; with ``required`` `LateError` is raised where it is not."""
        poll = select.poll()
        poll.register(self._stream, what)
        ready = bool(poll.poll(max(seconds, 0.0) * 1000.0))
        if required and not ready:
            raise LateError
        return ready

    def receive(self, number: int, deadline: float) -> Any:
        """Read the answer that has begun to arrive.

        Args:
            number: Of the question.
            deadline: On the monotonic clock.

        Returns:
            The value.

        Raises:
            ClosedError: If it ends half-way.
            LateError: If it does not end.
            MalformedError: If it is none, or one to another question.
        """
        found, length = _HEAD.unpack(self._exactly(_HEAD.size, deadline))
        if found != number:
            raise MalformedError("it answered what it was not asked")
        if length > PLANNER_ANSWER.content_bytes:
            raise MalformedError(f"its answer has {length} bytes")
        data = self._exactly(length, deadline)
        try:
            return read_answer(data)
        # What a stranger's process says may be anything, and readers raise whatever they come upon.
        except Exception as error:
            raise MalformedError("its answer cannot be read") from error

    def _exactly(self, count: int, deadline: float) -> bytearray:
        found, place = bytearray(count), 0
        while place < count:
            self.wait(select.POLLIN, deadline - time.monotonic(), required=True)
            try:
                size = self._stream.recv_into(memoryview(found)[place : place + _PIECE])
            except BlockingIOError:
                continue
            except OSError as error:
                raise ClosedError from error
            if not size:
                raise ClosedError
            place += size
        return found
