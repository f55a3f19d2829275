"""Server of the page: reachable from this machine only, at a secret address, closed to posts from other sites.

Each address on 127.0.0.1 begins with a newly drawn secret, so that neither another site in the inspector's browser nor
another user of the machine can ask for anything; requests for another host name (rebinding) and posts from another
origin are refused all the same. Pages may load nothing from anywhere else.
"""

import json
import re
import secrets
import sys
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.extensions.review.inspection import Inspection
from benchmark.untrusted.files import VERDICTS
from benchmark.untrusted.text_files import parse_json

ADDRESS: Final = "127.0.0.1"
_POST_BYTES: Final = 16 * 1024
_ASSETS: Final = {
    "": ("index.html", "text/html; charset=utf-8"),
    "review.js": ("review.js", "text/javascript; charset=utf-8"),
    "review.css": ("review.css", "text/css; charset=utf-8"),
}
_PICTURE: Final = re.compile(r"picture/(\d{1,9})/(\d{1,9})/(cameras\.webp|above\.png)")
_SCENE: Final = re.compile(r"scene/(\d{1,9})")
_POLICY: Final = (
    "default-src 'none'; img-src 'self' data:; style-src 'self'; script-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class ReviewServer(ThreadingHTTPServer):
    """Server of an inspection until the inspector says that it is done; ``secret`` begins every address."""

    daemon_threads = True

    def __init__(self, inspection: Inspection, port: int = 0) -> None:
        """Listen on this machine alone; port 0 takes a free one."""
        self.inspection, self.secret, self.done = inspection, secrets.token_urlsafe(24), False
        try:
            super().__init__((ADDRESS, port), _ReviewHandler)
        except OSError as error:
            raise InputError(
                f"cannot listen on port {port}: {error.strerror}; choose another --port, or leave it out"
            ) from error

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{ADDRESS}:{self.server_port}/{self.secret}/"

    @property
    def hosts(self) -> tuple[str, ...]:
        """Names under which it may be asked."""
        return tuple(f"{name}:{self.server_port}" for name in (ADDRESS, "localhost"))

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that leaves before its picture has come is no error."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def serve_until_done(self) -> None:
        """Answer until the inspector is done; `KeyboardInterrupt` ends it, too."""
        self.timeout = 0.5
        while not self.done:
            self.handle_request()


class _ReviewHandler(BaseHTTPRequestHandler):
    server: ReviewServer
    timeout = 30
    server_version = "challenger-bench"
    sys_version = ""

    def do_GET(self) -> None:
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def log_message(self, format: str, *values: Any) -> None:
        """Nothing: the terminal belongs to the command."""

    def _answer(self, how: Callable[[str], tuple[str, bytes]]) -> None:
        """Send what a request gives; what is wrong with it as one sentence."""
        try:
            kind, data = how(self._place())
            self._send(HTTPStatus.OK, kind, data)
        except _ReviewRequestError as refused:
            self._send(refused.status, "application/json", _encode_json({"error": str(refused)}))
        except InputError as error:
            self._send(HTTPStatus.BAD_REQUEST, "application/json", _encode_json({"error": str(error)}))

    def _place(self) -> str:
        """Address without the secret; refuses clients that do not know it or call the machine by another name."""
        if self.headers.get("Host") not in self.server.hosts:
            raise _ReviewRequestError(HTTPStatus.FORBIDDEN, "this page is served on 127.0.0.1 only")
        _, secret, place = [*self.path.partition("?")[0].split("/", 2), "", ""][:3]
        if not secrets.compare_digest(secret.encode(), self.server.secret.encode()):
            raise _ReviewRequestError(HTTPStatus.NOT_FOUND, "not found; open the address that the command printed")
        return place

    def _get(self, place: str) -> tuple[str, bytes]:
        inspection = self.server.inspection
        if place in _ASSETS:
            name, kind = _ASSETS[place]
            return kind, (resources.files("benchmark.extensions.review") / "assets" / name).read_bytes()
        if place == "state":
            return "application/json", _encode_json(inspection.state())
        if scene := _SCENE.fullmatch(place):
            return "application/json", _encode_json(inspection.describe(int(scene[1])))
        if picture := _PICTURE.fullmatch(place):
            draw = inspection.cameras if picture[3] == "cameras.webp" else inspection.above
            kind = "image/webp" if picture[3] == "cameras.webp" else "image/png"
            return kind, draw(int(picture[1]), int(picture[2]))
        raise _ReviewRequestError(HTTPStatus.NOT_FOUND, "not found")

    def _post(self, place: str) -> tuple[str, bytes]:
        self._require_same_origin()
        posted = self._read_posted()
        if place == "done":
            self.server.done = True
        elif place == "verdict" and type(posted.get("scene")) is int:
            self.server.inspection.record(posted["scene"], posted.get("verdict"), posted.get("reason", ""))
        else:
            raise _ReviewRequestError(HTTPStatus.NOT_FOUND, "this address takes no posts")
        return "application/json", _encode_json(self.server.inspection.state())

    def _require_same_origin(self) -> None:
        origin, site = self.headers.get("Origin"), self.headers.get("Sec-Fetch-Site")
        own = {f"http://{host}" for host in self.server.hosts}
        if (origin is not None and origin not in own) or site not in (None, "same-origin"):
            raise _ReviewRequestError(HTTPStatus.FORBIDDEN, "posts from other sites are refused")
        if self.headers.get_content_type() != "application/json":
            raise _ReviewRequestError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "verdicts are posted as JSON")

    def _read_posted(self) -> dict[str, Any]:
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > _POST_BYTES:
            raise _ReviewRequestError(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a verdict must have at most {_POST_BYTES} bytes"
            )
        try:
            posted = parse_json(self.rfile.read(int(length)), VERDICTS)
        except ValueError as error:
            raise _ReviewRequestError(HTTPStatus.BAD_REQUEST, f"the body is not JSON: {error}") from error
        if not isinstance(posted, dict):
            raise _ReviewRequestError(HTTPStatus.BAD_REQUEST, "a verdict must be a JSON object")
        return posted

    def _send(self, status: HTTPStatus, kind: str, data: bytes) -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(data))),
            ("Content-Security-Policy", _POLICY),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)


class _ReviewRequestError(Exception):
    """A request that is not answered, and the status that says so."""

    def __init__(self, status: HTTPStatus, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


def _encode_json(value: Any) -> bytes:
    return json.dumps(value, allow_nan=False).encode()
