"""Messages between a planner's process and its parent: a number and a length, then the message.

Questions are pickles: the process trusts its parent. Answers are plain values (`benchmark.untrusted.answers`):
who asks trusts nothing in them. Every answer repeats the number of its question, so that none is taken for another's.
"""

import io
import pickle
import select
import socket
import struct
import time
from typing import Any, Final

from benchmark.untrusted.answers import read_answer, write_answer
from benchmark.untrusted.files import PLANNER_ANSWER

_HEAD: Final = struct.Struct("<QQ")
_PIECE: Final = 1 << 20
_AT_ONCE: Final = 1 << 16
"""Bytes that are read of a message before its length is known; most messages are shorter."""


class ClosedError(Exception):
    """The other side is gone."""


class LateError(Exception):
    """The other side takes too long."""


class MalformedError(Exception):
    """The other side sent no valid message, or not an answer to the question."""


def encode_question(number: int, kind: str, *parts: Any) -> bytes:
    """The bytes of a question."""
    body = pickle.dumps((kind, parts), protocol=5)
    return _HEAD.pack(number, len(body)) + body


def encode_answer(number: int, value: Any) -> bytes:
    """The bytes of an answer; raises `benchmark.untrusted.answers.UnencodableValueError` for what is no plain value."""
    stream = io.BytesIO()
    write_answer(stream, value, PLANNER_ANSWER)
    body = stream.getbuffer()
    return _HEAD.pack(number, len(body)) + body


def receive_question(stream: socket.socket) -> tuple[int, str, tuple[Any, ...]]:
    """In the planner's process: wait for a question; raises `ClosedError` when the parent has closed it."""
    # The parent sends no second question before the first is answered, so bytes that arrive belong to one message.
    begun = b""
    while len(begun) < _HEAD.size:
        received = stream.recv(_AT_ONCE)
        if not received:
            raise ClosedError
        begun += received
    number, length = _HEAD.unpack_from(begun)
    body = memoryview(begun)[_HEAD.size :]
    if len(body) < length:
        body = memoryview(_receive_exactly(stream, length, body))
    kind, parts = pickle.loads(body)  # noqa: S301 - from the process that started this one
    return number, kind, parts


def _receive_exactly(stream: socket.socket, count: int, begun: memoryview) -> bytearray:
    received, place = bytearray(count), len(begun)
    received[:place] = begun
    while place < count:
        size = stream.recv_into(memoryview(received)[place:])
        if not size:
            raise ClosedError
        place += size
    return received


class QuestionChannel:
    """The asking side of a connection."""

    def __init__(self, stream: socket.socket) -> None:
        self._stream = stream
        stream.setblocking(False)
        self._poll = select.poll()
        self._poll.register(stream, 0)
        self._ahead = bytearray()

    def send(self, message: bytes, deadline: float) -> None:
        """Send a question of `encode_question` before a deadline on the monotonic clock.

        Raises `ClosedError` if the other side has closed the connection, `LateError` if it does not read in time.
        """
        left = memoryview(message)
        while left:
            try:
                left = left[self._stream.send(left) :]
            except BlockingIOError:
                self.wait(select.POLLOUT, deadline - time.monotonic(), required=True)
            except OSError as error:
                raise ClosedError from error

    def wait(self, what: int, seconds: float, *, required: bool = False) -> bool:
        """Whether the connection is ready within a time; with ``required`` `LateError` is raised where it is not."""
        if what == select.POLLIN and self._ahead:
            return True
        self._poll.modify(self._stream, what)
        ready = bool(self._poll.poll(max(seconds, 0.0) * 1000.0))
        if required and not ready:
            raise LateError
        return ready

    def receive(self, number: int, deadline: float) -> Any:
        """Read the answer that has begun to arrive, before a deadline on the monotonic clock.

        Raises `ClosedError`, `LateError`, or `MalformedError` if it is none, or one to another question.
        """
        begun = self._begun(deadline)
        answered_number, length = _HEAD.unpack_from(begun)
        if answered_number != number:
            raise MalformedError("it answered another question")
        if length > PLANNER_ANSWER.content_bytes:
            raise MalformedError(f"its answer of {length} bytes is too large")
        data = self._whole(begun, length, deadline)
        try:
            return read_answer(data)
        # Bytes of a third-party process may be anything, and readers raise many kinds of exceptions.
        except Exception as error:
            raise MalformedError("its answer cannot be read") from error

    def _begun(self, deadline: float) -> bytearray:
        """The first bytes of an answer, a whole head at least."""
        received, self._ahead = self._ahead, bytearray()
        while len(received) < _HEAD.size:
            received += self._receive_some(_AT_ONCE, deadline)
        return received

    def _whole(self, begun: bytearray, length: int, deadline: float) -> bytearray:
        """An answer of which some bytes are there; what comes behind it is kept."""
        end = _HEAD.size + length
        if len(begun) >= end:
            self._ahead = begun[end:]
            return begun[_HEAD.size : end]
        received, place = bytearray(length), len(begun) - _HEAD.size
        received[:place] = memoryview(begun)[_HEAD.size :]
        while place < length:
            piece = self._receive_some(min(_PIECE, length - place), deadline)
            received[place : place + len(piece)] = piece
            place += len(piece)
        return received

    def _receive_some(self, most: int, deadline: float) -> bytes:
        while True:
            try:
                received = self._stream.recv(most)
            except BlockingIOError:
                self.wait(select.POLLIN, deadline - time.monotonic(), required=True)
                continue
            except OSError as error:
                raise ClosedError from error
            if not received:
                raise ClosedError
            return received
