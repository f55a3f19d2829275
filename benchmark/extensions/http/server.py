"""A socket for an application of ASGI: on this machine alone unless asked otherwise, and bounded in what it holds."""

import asyncio
import threading
from types import TracebackType
from typing import Any, Final, Self

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from benchmark.extensions.http.application import Bounds, application
from benchmark.extensions.http.listening import LOOPBACK, is_open, listening
from benchmark.extensions.http.session import Session

HEADER_S: Final = 15.0
"""Within which a connection has to say what it wants."""
_CONNECTIONS: Final = 64
_ENDS_S: Final = 3


class _Bounded(H11Protocol):
    """A connection that is closed if no request comes on it."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._patience = self.loop.call_later(HEADER_S, self._require_begun)

    def connection_lost(self, exc: Exception | None) -> None:
        # What waits would hold the connection, and all that arrived on it.
        self._patience.cancel()
        super().connection_lost(exc)

    def _require_begun(self) -> None:
        if self.cycle is None:
            self.transport.close()


class PlannerServer:
    """Serves a session, here (`serve`) or in a thread (``with``)."""

    def __init__(self, session: Session, host: str = LOOPBACK, port: int = 0, bounds: Bounds | None = None) -> None:
        """Listen, on this machine alone by default; requests from now on are answered once it serves.

        Port 0 takes a free one.
        """
        self.host = host
        self._socket = listening(host, port)
        self.port: int = self._socket.getsockname()[1]
        settings: dict[str, Any] = {
            "http": _Bounded,
            "ws": "none",
            "lifespan": "off",
            "log_config": None,
            "log_level": "error",
            "access_log": False,
            "proxy_headers": False,
            "server_header": False,
            "limit_concurrency": _CONNECTIONS,
            "timeout_graceful_shutdown": _ENDS_S,
        }
        self._server = uvicorn.Server(uvicorn.Config(application(session, bounds or Bounds()), **settings))
        self._thread = threading.Thread(target=self.serve, name="server", daemon=True)

    @property
    def url(self) -> str:
        """Address for clients."""
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def is_open(self) -> bool:
        """Whether other machines can reach it."""
        return is_open(self.host)

    def serve(self) -> None:
        """Answer until interrupted, or until `__exit__`; raises `KeyboardInterrupt` once everything is closed."""
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self.close()

    def close(self) -> None:
        """Stop listening; for servers that never served."""
        self._socket.close()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.should_exit = True
        self._thread.join()
