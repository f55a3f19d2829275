"""Sessions of a service side by side, by the names that their clients give them, and calls that are refused."""

import threading
import time
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from benchmark.untrusted.files import to_one_line

MOST_SESSIONS: Final = 16
IDLE_S: Final = 120.0
"""A session without a call for so long makes room for another."""
_LONGEST_UUID: Final = 200
Session = TypeVar("Session")


class CallRefusedError(Exception):
    """A call that is answered with an error: the name of a status of gRPC, and a sentence."""

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


class SessionTable(Generic[Session]):
    """Open sessions; safe to use from several threads. ``ended`` is given each that is closed or makes room."""

    def __init__(self, ended: Callable[[Session], None]) -> None:
        self._ended = ended
        self._open: dict[str, Session] = {}
        self._asked: dict[str, float] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._open)

    def add(self, uuid: str, begin: Callable[[], Session]) -> Session:
        """A new session; `CallRefusedError` where its name is taken or there is no room."""
        if len(uuid) > _LONGEST_UUID:
            raise CallRefusedError("INVALID_ARGUMENT", f"session_uuid has more than {_LONGEST_UUID} characters")
        with self._lock:
            if uuid in self._open:
                raise CallRefusedError("ALREADY_EXISTS", f"session {uuid} was begun already")
            if len(self._open) >= MOST_SESSIONS:
                oldest = min(self._asked, key=lambda name: self._asked[name])
                if time.monotonic() - self._asked[oldest] < IDLE_S:
                    raise CallRefusedError("RESOURCE_EXHAUSTED", f"{MOST_SESSIONS} sessions are open; close one")
                self._remove(oldest)
            session = self._open[uuid] = begin()
            self._asked[uuid] = time.monotonic()
        return session

    def find(self, uuid: str) -> Session:
        """An open session; `CallRefusedError` for any other name."""
        with self._lock:
            if uuid not in self._open:
                raise CallRefusedError("NOT_FOUND", f"there is no session {to_one_line(uuid, 60)}")
            self._asked[uuid] = time.monotonic()
            return self._open[uuid]

    def close(self, uuid: str) -> None:
        """End a session, if there is one of that name."""
        with self._lock:
            if uuid in self._open:
                self._remove(uuid)

    def close_all(self) -> None:
        """End all of them."""
        with self._lock:
            for uuid in [*self._open]:
                self._remove(uuid)

    def _remove(self, uuid: str) -> None:
        del self._asked[uuid]
        self._ended(self._open.pop(uuid))
