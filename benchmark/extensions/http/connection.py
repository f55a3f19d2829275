"""One request and its answer over HTTP: a connection of its own, a deadline over all of it, a bound on its size.

Requests are never repeated. Failures are a closed list: no answer, or a connection lost half-way
(`PlannerAwayError`), a late answer (`PlannerLateError`), or another kind of server (`PlannerGoneError`).
"""

import contextlib
import socket
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from benchmark.planning import PlannerAwayError, PlannerGoneError, PlannerLateError
from benchmark.untrusted.files import HTTP_ANSWER, format_bytes, to_one_line

if TYPE_CHECKING:
    import httpx2

CONNECT_S: Final = 5.0


class ServerHungUpError(PlannerAwayError):
    """A server took a request and closed the connection: it went away, or failed without an answer."""


_JSON: Final = "application/json"
_AGENT: Final = "challenger-bench"


@dataclass(frozen=True, slots=True)
class HttpReply:
    """An HTTP answer: status and body."""

    status: int
    body: bytes

    @property
    def is_page(self) -> bool:
        """Whether it is a web page."""
        return self.body[:256].lstrip().lower().startswith((b"<!doctype", b"<html"))

    @property
    def said(self) -> str:
        """Its beginning, fit for a sentence."""
        return to_one_line(self.body[:400].decode("utf-8", "replace").strip(), 200) or "nothing"


@dataclass(frozen=True, slots=True)
class HttpConnection:
    """Asks one server, named ``what`` in messages; the deadline runs from connecting to the last byte."""

    url: str
    what: str
    deadline_s: float

    def get(self, path: str, deadline_s: float | None = None) -> HttpReply:
        """Ask for something; errors as of `post`."""
        return self._exchange("GET", path, None, deadline_s)

    def post(self, path: str, body: bytes, deadline_s: float | None = None) -> HttpReply:
        """Send JSON, once; any status is an answer. Failures are those of the module."""
        return self._exchange("POST", path, body, deadline_s)

    def wait(self, seconds: float) -> None:
        """Wait until something answers ``/alive``; any answer will do, as for NeuroNCAP; then `PlannerAwayError`."""
        until = time.monotonic() + seconds
        while True:
            try:
                self.get("/alive", max(min(CONNECT_S, until - time.monotonic()), 0.1))
                return
            except (PlannerAwayError, PlannerLateError):
                if time.monotonic() >= until:
                    raise
            time.sleep(0.1)

    def _exchange(self, method: str, path: str, body: bytes | None, deadline_s: float | None) -> HttpReply:
        import httpx2

        seconds = self.deadline_s if deadline_s is None else deadline_s
        where = f"{self.what} at {self.url}"
        # Proxies and passwords of the environment are ignored.
        limits = httpx2.Timeout(seconds, connect=min(CONNECT_S, seconds))
        # Timeouts apply to each read, so an answer that trickles in byte by byte would never time out.
        watch = _DeadlineWatch(seconds)
        try:
            # Plain HTTP: loading certificates for every request would take longer than the request.
            with watch, httpx2.Client(trust_env=False, verify=False, follow_redirects=False, timeout=limits) as client:
                client.headers["user-agent"] = _AGENT
                # No compression: the size limit is on the bytes that arrive.
                del client.headers["accept-encoding"]
                headers = {} if body is None else {"content-type": _JSON}
                trace_extension = {"trace": watch.connected}
                with client.stream(
                    method, f"{self.url}{path}", content=body, headers=headers, extensions=trace_extension
                ) as response:
                    reply = HttpReply(response.status_code, self._read_body(response, path))
            # A body without a length ends when the connection is cut, and looks complete.
            if watch.cut:
                raise self._build_late_error(path, seconds)
            return reply
        except httpx2.TimeoutException as error:
            if isinstance(error, httpx2.ConnectTimeout):
                raise PlannerAwayError(f"{where} cannot be reached; start it, and check its address") from error
            raise self._build_late_error(path, seconds) from error
        except httpx2.ConnectError as error:
            raise PlannerAwayError(
                f"nobody answers at {self.url} ({to_one_line(error, 80)}); start {self.what}, then the same "
                "command again"
            ) from error
        except httpx2.TransportError as error:
            if watch.cut:
                raise self._build_late_error(path, seconds) from error
            disconnected = "disconnected" in str(error) or "closed" in str(error)
            if disconnected or not isinstance(error, httpx2.RemoteProtocolError):
                raise self._build_away_error(path, error) from error
            raise PlannerGoneError(
                f"{where} does not answer {path} as a web server would ({to_one_line(error, 80)}); name another address"
            ) from error
        except httpx2.HTTPError as error:
            raise PlannerGoneError(f"{where} cannot be sent {path} ({to_one_line(error, 80)})") from error

    def _read_body(self, response: "httpx2.Response", path: str) -> bytes:
        """All of an answer, within the bound."""
        parts: list[bytes] = []
        size = 0
        for part in response.iter_raw():
            size += len(part)
            if size > HTTP_ANSWER.file_bytes:
                raise PlannerGoneError(
                    f"{self.what} at {self.url} answers {path} with more than {format_bytes(HTTP_ANSWER.file_bytes)}; "
                    "this is not an answer of this protocol; check the address"
                )
            parts.append(part)
        return b"".join(parts)

    def _build_late_error(self, path: str, seconds: float) -> PlannerLateError:
        return PlannerLateError(
            f"{self.what} at {self.url} did not answer {path} within {seconds:g} s; it hangs or is slow; check its log"
        )

    def _build_away_error(self, path: str, error: Any) -> PlannerAwayError:
        return ServerHungUpError(
            f"{self.what} at {self.url} hung up before answering {path} ({to_one_line(error, 80)}); look at its log, "
            "restart it, then run the same command again: finished work is kept"
        )


class _DeadlineWatch:
    """Cuts a connection whose time is over, in any state, and remembers in ``cut`` that it did."""

    def __init__(self, seconds: float) -> None:
        self.cut = False
        self._socket: socket.socket | None = None
        self._timer = threading.Timer(seconds, self._cut_connection)
        self._timer.daemon = True

    def __enter__(self) -> None:
        self._timer.start()

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()

    def connected(self, event: str, info: dict[str, Any]) -> None:
        """Called by the HTTP library with all that it does; what is looked for is the socket."""
        if event == "connection.connect_tcp.complete":
            self._socket = info["return_value"].get_extra_info("socket")

    def _cut_connection(self) -> None:
        self.cut = True
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
