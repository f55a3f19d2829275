"""A socket for an application of ASGI: on this machine alone unless asked otherwise, and bounded in what it holds.

The server's three routes: bodies bounded in size and time, planning in a thread of its own, errors as sentences.
"""

import asyncio
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http import HTTPStatus
from types import TracebackType
from typing import Any, Final, Self

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route
from uvicorn.protocols.http.h11_impl import H11Protocol

from benchmark.extensions.http.listening import LOOPBACK, is_open, listening
from benchmark.extensions.http.requests import encoded
from benchmark.extensions.http.session import Refused, Session
from benchmark.untrusted.files import WIRE_REQUEST, in_words

_RESET_BYTES: Final = 64 * 1024
_BODIES: Final = 4
"""So many bodies are in memory at once; what is more waits."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits on a request.

    Attributes:
        body_s: How long a body may take to arrive.
        answer_s: How long an answer may take, waiting for the one before included.
    """

    body_bytes: int = WIRE_REQUEST.file_bytes
    body_s: float = 30.0
    answer_s: float = 300.0


def application(session: Session, bounds: Bounds) -> Starlette:
    """The routes of a session as an ASGI application.

    The planner is asked in one thread, request after request, so that ``/alive`` answers meanwhile.
    """
    thread = ThreadPoolExecutor(1, thread_name_prefix="planner")
    bodies = asyncio.Semaphore(_BODIES)

    async def alive(_: Request) -> bytes:
        return encoded(True)

    async def reset(request: Request) -> bytes:
        # Whatever it says: it is always obeyed.
        await _body(request, _RESET_BYTES, bounds.body_s)
        return await _in_thread(thread, session.reset, bounds.answer_s)

    async def infer(request: Request) -> bytes:
        async with bodies:
            body = await _body(request, bounds.body_bytes, bounds.body_s)
            return await _in_thread(thread, lambda: session.infer(body), bounds.answer_s)

    return Starlette(
        routes=[
            Route("/alive", _answered(alive), methods=["GET"]),
            Route("/reset", _answered(reset), methods=["POST"]),
            Route("/infer", _answered(infer), methods=["POST"]),
        ],
        exception_handlers={HTTPException: _no_route},
    )


def _answered(work: Callable[[Request], Awaitable[bytes]]) -> Callable[[Request], Awaitable[Response]]:
    """A route whose refusals are JSON with a sentence under ``detail``."""

    async def answer(request: Request) -> Response:
        try:
            _require_welcome(request)
            return _response(HTTPStatus.OK, await work(request))
        except Refused as refused:
            return _sentence(refused.status, str(refused))
        except ClientDisconnect:
            # Nobody is there to be answered.
            return _sentence(HTTPStatus.BAD_REQUEST, "the request broke off")

    return answer


async def _body(request: Request, most: int, seconds: float) -> bytes:
    """A body, counted while it arrives; what it says of its length is only good for refusing it sooner."""
    too_long = Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a body has at most {in_words(most)}")
    content_length = request.headers.get("content-length", "")
    if content_length.isdigit() and int(content_length[:20]) > most:
        raise too_long
    parts: list[bytes] = []
    size = 0
    try:
        async with asyncio.timeout(seconds):
            async for part in request.stream():
                size += len(part)
                if size > most:
                    raise too_long
                parts.append(part)
    except TimeoutError:
        raise Refused(HTTPStatus.REQUEST_TIMEOUT, f"the body did not arrive within {seconds:g} s") from None
    return b"".join(parts)


async def _in_thread(thread: ThreadPoolExecutor, work: Callable[[], bytes], seconds: float) -> bytes:
    """Let the planner's thread work. What has begun is not broken off: the next request waits for it."""
    waiting = asyncio.get_running_loop().run_in_executor(thread, work)
    try:
        return await asyncio.wait_for(waiting, seconds)
    except TimeoutError:
        raise Refused(HTTPStatus.GATEWAY_TIMEOUT, f"there was no answer within {seconds:g} s") from None


def _require_welcome(request: Request) -> None:
    """Refuse pages in a browser, which a stranger may have made, and bodies that would have to be unpacked."""
    if "origin" in request.headers:
        raise Refused(HTTPStatus.FORBIDDEN, "pages of a browser are not answered")
    if request.headers.get("content-encoding", "identity") != "identity":
        raise Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a body is sent as it is, not packed")


async def _no_route(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else HTTPStatus.INTERNAL_SERVER_ERROR
    return _sentence(status, "there are GET /alive, POST /reset and POST /infer")


def _sentence(status: int, sentence: str) -> Response:
    return _response(status, encoded({"detail": sentence}))


def _response(status: int, body: bytes) -> Response:
    # One connection a request, as NeuroNCAP has it: nothing is left open that somebody could hold on to.
    return Response(body, status, {"connection": "close"}, "application/json")


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
