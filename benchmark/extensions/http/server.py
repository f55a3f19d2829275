"""ASGI server, on this machine alone by default: bounded bodies, planning in a thread, errors as sentences."""

import asyncio
import sys
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
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

from benchmark.extensions.http.requests import encode_json
from benchmark.extensions.http.session import FAILED, PlannerSession, PlanRequestError
from benchmark.machine.listening import LOOPBACK, is_open_address, open_listening_socket
from benchmark.planning import Planner
from benchmark.untrusted.files import HTTP_REQUEST, format_bytes, to_one_line

_RESET_BYTES: Final = 64 * 1024
_BODIES: Final = 4
"""So many bodies are in memory at once; what is more waits."""


@dataclass(frozen=True, slots=True)
class RequestBounds:
    """Limits on a request: bytes and arrival of a body, and its answer, waiting for the one before included."""

    body_bytes: int = HTTP_REQUEST.file_bytes
    body_s: float = 30.0
    answer_s: float = 300.0


def build_application(session: PlannerSession, bounds: RequestBounds) -> Starlette:
    """ASGI routes of a session; one thread asks the planner, so that ``/alive`` answers meanwhile."""
    thread = ThreadPoolExecutor(1, thread_name_prefix="planner")
    bodies = asyncio.Semaphore(_BODIES)
    log = RefusalLog()

    async def alive(_: Request) -> bytes:
        return encode_json(True)

    async def reset(request: Request) -> bytes:
        # The content does not matter: a reset is always obeyed.
        await _read_body(request, _RESET_BYTES, bounds.body_s)
        return await _run_in_thread(thread, session.reset, bounds.answer_s)

    async def infer(request: Request) -> bytes:
        async with bodies:
            body = await _read_body(request, bounds.body_bytes, bounds.body_s)
            return await _run_in_thread(thread, lambda: session.infer(body), bounds.answer_s)

    return Starlette(
        routes=[
            Route("/alive", _wrap_route(alive, log), methods=["GET"]),
            Route("/reset", _wrap_route(reset, log), methods=["POST"]),
            Route("/infer", _wrap_route(infer, log), methods=["POST"]),
        ],
        exception_handlers={HTTPException: partial(_answer_unknown_route, log)},
    )


class RefusalLog:
    """Shows the first refusal of each kind on the terminal: NeuroNCAP's client does not look at answers."""

    def __init__(self) -> None:
        self._shown: set[tuple[int, str]] = set()

    def note(self, request: Request, refused: PlanRequestError) -> None:
        """Print a refusal, unless one of its kind was; the session prints each failure of the planner itself."""
        kind = refused.status, refused.kind
        if refused.status == FAILED or kind in self._shown:
            return
        self._shown.add(kind)
        asked = to_one_line(f"{request.method} {request.url.path}", 80)
        print(
            f"refused {asked} (status {refused.status}): {to_one_line(refused, 400)}; more of this kind are not shown "
            "(docs/extensions/http.md)",
            file=sys.stderr,
            flush=True,
        )


def _wrap_route(
    work: Callable[[Request], Awaitable[bytes]], log: RefusalLog
) -> Callable[[Request], Awaitable[Response]]:
    """A route whose refusals are JSON with a sentence under ``detail``."""

    async def answer(request: Request) -> Response:
        try:
            _require_trusted_client(request)
            return _build_response(HTTPStatus.OK, await work(request))
        except PlanRequestError as refused:
            log.note(request, refused)
            return _build_error_response(refused.status, str(refused))
        except ClientDisconnect:
            # The client is gone; there is no one to answer.
            return _build_error_response(HTTPStatus.BAD_REQUEST, "the request was cut off")

    return answer


async def _read_body(request: Request, most: int, seconds: float) -> bytes:
    """A body, counted while it arrives; what it says of its length is only good for refusing it sooner."""
    too_long = PlanRequestError(
        HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a body has at most {format_bytes(most)}; send smaller images"
    )
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
        raise PlanRequestError(HTTPStatus.REQUEST_TIMEOUT, f"the body did not arrive within {seconds:g} s") from None
    return b"".join(parts)


async def _run_in_thread(thread: ThreadPoolExecutor, work: Callable[[], bytes], seconds: float) -> bytes:
    """Let the planner's thread work. What has begun is not broken off: the next request waits for it."""
    waiting = asyncio.get_running_loop().run_in_executor(thread, work)
    try:
        return await asyncio.wait_for(waiting, seconds)
    except TimeoutError:
        raise PlanRequestError(HTTPStatus.GATEWAY_TIMEOUT, f"there was no answer within {seconds:g} s") from None


def _require_trusted_client(request: Request) -> None:
    """Refuse pages in a browser, which a stranger may have made, and bodies that would have to be unpacked."""
    if "origin" in request.headers:
        raise PlanRequestError(HTTPStatus.FORBIDDEN, "requests from web pages are refused; send them from a program")
    if request.headers.get("content-encoding", "identity") != "identity":
        raise PlanRequestError(
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "compressed bodies are refused; send the body uncompressed", "compressed"
        )


async def _answer_unknown_route(log: RefusalLog, request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else HTTPStatus.INTERNAL_SERVER_ERROR
    refused = PlanRequestError(status, "unknown path or method; use GET /alive, POST /reset or POST /infer")
    log.note(request, refused)
    return _build_error_response(status, str(refused))


def _build_error_response(status: int, sentence: str) -> Response:
    return _build_response(status, encode_json({"detail": sentence}))


def _build_response(status: int, body: bytes) -> Response:
    # One connection per request, as in NeuroNCAP: no client can hold a connection open.
    return Response(body, status, {"connection": "close"}, "application/json")


HEADER_S: Final = 15.0
"""Within which a connection has to say what it wants."""
_CONNECTIONS: Final = 64
_ENDS_S: Final = 3


class _BoundedConnection(H11Protocol):
    """A connection that is closed if no request comes on it."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._patience = self.loop.call_later(HEADER_S, self._require_begun)

    def connection_lost(self, exc: Exception | None) -> None:
        # A pending timer would keep the connection and its received data in memory.
        self._patience.cancel()
        super().connection_lost(exc)

    def _require_begun(self) -> None:
        if self.cycle is None:
            self.transport.close()


class PlannerServer:
    """Serves a session, here (`serve`) or in a thread (``with``)."""

    def __init__(
        self, session: PlannerSession, host: str = LOOPBACK, port: int = 0, bounds: RequestBounds | None = None
    ) -> None:
        """Listen, on this machine alone and a free port by default; requests are answered once it serves."""
        self.host = host
        self._socket = open_listening_socket(host, port)
        self.port: int = self._socket.getsockname()[1]
        settings: dict[str, Any] = {
            "http": _BoundedConnection,
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
        self._server = uvicorn.Server(uvicorn.Config(build_application(session, bounds or RequestBounds()), **settings))
        self._thread = threading.Thread(target=self.serve, name="server", daemon=True)

    @property
    def url(self) -> str:
        """Address for clients."""
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def is_open(self) -> bool:
        """Whether other machines can reach it."""
        return is_open_address(self.host)

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


def make_planner_server(
    build: Callable[[], Planner],
    host: str,
    port: int,
    *,
    seed: int,
    wants_images: bool,
    accept_torch_tensors: bool = False,
) -> PlannerServer:
    """A server that listens; one planner serves all scenes, one after another, and pictures come with every request."""
    return PlannerServer(PlannerSession(build(), tensors=accept_torch_tensors, seed=seed), host, port)
