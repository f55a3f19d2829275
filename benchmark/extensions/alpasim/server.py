"""gRPC server of a service of AlpaSim's, on this machine alone by default: bounded messages, errors as sentences."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from types import FrameType, TracebackType
from typing import Any, Final, Protocol, Self

import grpc

from benchmark.errors import InputError
from benchmark.extensions.alpasim.connection import CONTRACT
from benchmark.extensions.alpasim.messages import EGODRIVER, METHODS
from benchmark.extensions.alpasim.session import EgodriverService
from benchmark.extensions.alpasim.sessions import CallRefusedError
from benchmark.machine.address import parse_renaming
from benchmark.machine.listening import LOOPBACK, is_open_address
from benchmark.planning import Planner
from benchmark.untrusted.files import GRPC_PICTURE, Limits, to_one_line

PORT: Final = 6789
_HOST_VARIABLE, _PORT_VARIABLE = "ALPASIM_DRIVER_HOST", "ALPASIM_DRIVER_PORT"
_REPLICA_VARIABLES: Final = ("ALPASIM_CONTESTANT_REPLICA_INDEX", "ALPASIM_CONTESTANT_REPLICAS")
_THREADS: Final = 16
_CALLS: Final = 64
"""So many are in memory at once; what is more is refused."""
_ENDS_S: Final = 3.0
_OPTIONS: Final = (("grpc.max_metadata_size", 16 * 1024), ("grpc.so_reuseport", 0))


class GrpcService(Protocol):
    """A service of AlpaSim's whose paths begin with ``prefix``."""

    @property
    def prefix(self) -> str:
        """As above."""

    def call(self, path: str, data: bytes, metadata: Mapping[str, str]) -> bytes:
        """The answer to a call; raises `CallRefusedError`."""


class _Calls(grpc.GenericRpcHandler):  # type: ignore[misc, unused-ignore]
    """Handlers of the service's calls, from bytes to bytes: what cannot be read is an answer, and no traceback."""

    def __init__(self, service: GrpcService) -> None:
        self._service = service
        self._shown: set[tuple[str, str]] = set()

    def service(self, details: Any) -> Any:
        path = details.method
        if path not in METHODS or not path.startswith(self._service.prefix):
            return None

        def answer(data: bytes, context: Any) -> bytes:
            if path == EGODRIVER + "get_version":
                context.send_initial_metadata(((CONTRACT, "2"),))
            try:
                return self._service.call(path, data, dict(context.invocation_metadata()))
            except CallRefusedError as refused:
                self._show(path, refused)
                context.abort(grpc.StatusCode[refused.code], to_one_line(refused, 400))
                raise

        return grpc.unary_unary_rpc_method_handler(answer)

    def _show(self, path: str, refused: CallRefusedError) -> None:
        """Print a refusal, unless one of its kind was; the service prints each failure of the planner itself."""
        kind = path, refused.code
        if refused.code == "INTERNAL" or kind in self._shown:
            return
        self._shown.add(kind)
        name = path.removeprefix(self._service.prefix)
        print(
            f"refused {name} ({refused.code}): {to_one_line(refused, 300)}; more of this kind are not shown",
            file=sys.stderr,
            flush=True,
        )


class GrpcServer:
    """Serves a service, here (`serve`) or in threads (``with``)."""

    def __init__(
        self,
        service: GrpcService,
        host: str = LOOPBACK,
        port: int = 0,
        limits: Limits = GRPC_PICTURE,
        at_end: Callable[[], None] = lambda: None,
    ) -> None:
        """Listen; requests are answered once it serves."""
        self.host, self._at_end = host, at_end
        self._server = grpc.server(
            ThreadPoolExecutor(_THREADS, thread_name_prefix="egodriver"),
            handlers=(_Calls(service),),
            options=(*_OPTIONS, ("grpc.max_receive_message_length", limits.file_bytes)),
            maximum_concurrent_rpcs=_CALLS,
        )
        try:
            self.port: int = self._server.add_insecure_port(f"[{host}]:{port}" if ":" in host else f"{host}:{port}")
        except RuntimeError as error:
            raise InputError(f"cannot listen on {host} port {port}; choose another --port or --host") from error

    @property
    def url(self) -> str:
        """Address for clients."""
        return f"grpc://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def is_open(self) -> bool:
        """Whether other machines can reach it."""
        return is_open_address(self.host)

    def serve(self) -> None:
        """Answer until interrupted or terminated, as a container is."""
        ends = threading.Event()

        def end(number: int, frame: FrameType | None) -> None:
            ends.set()

        before = signal.signal(signal.SIGTERM, end)
        try:
            self._server.start()
            while not ends.wait(1.0):
                pass
        finally:
            signal.signal(signal.SIGTERM, before)
            self.close()

    def close(self) -> None:
        """Stop listening; calls under way have some seconds."""
        self._server.stop(_ENDS_S).wait()
        self._at_end()

    def __enter__(self) -> Self:
        self._server.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def find_address(host: str | None, port: int | None) -> tuple[str, int]:
    """Where to listen: as given, else as the challenge's environment says, else this machine's port 6789."""
    named = os.environ.get(_PORT_VARIABLE, "")
    if port is None and named:
        if not (named.isdecimal() and int(named[:6]) <= 65_535):
            raise InputError(f"{_PORT_VARIABLE} is {to_one_line(named, 40)!r}, which is no port; set it to one")
        port = int(named)
    return host or os.environ.get(_HOST_VARIABLE) or LOOPBACK, PORT if port is None else port


def make_planner_server(
    build: Callable[[], Planner], host: str, port: int, *, seed: int, wants_images: bool, cameras: str = ""
) -> GrpcServer:
    """A server that listens; ``cameras`` are the simulator's names of ours, ``CAM_FRONT=camera_front_wide,...``."""
    theirs = {other: name for name, other in parse_renaming(cameras, "--cameras").items()}
    service = EgodriverService(build, cameras=theirs, wants_images=wants_images, seed=seed)
    index, count = (os.environ.get(variable) for variable in _REPLICA_VARIABLES)
    if index is not None and count is not None:
        print(f"replica {to_one_line(index, 20)} of {to_one_line(count, 20)}", file=sys.stderr, flush=True)
    return GrpcServer(service, host, port)
