"""Servers of planners and of traffic: their protocols, and addresses, reachable from this machine only by default."""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final, Literal, Protocol, Self

from benchmark.errors import InputError

LOOPBACK: Final = "127.0.0.1"
_BACKLOG: Final = 128


class PlannerService(Protocol):
    """A server that listens at an address; ``with`` answers in a thread."""

    host: str
    port: int

    @property
    def url(self) -> str:
        """Address for clients."""

    @property
    def is_open(self) -> bool:
        """Whether other machines can reach it."""

    def serve(self) -> None:
        """Answer until interrupted."""

    def close(self) -> None:
        """Stop listening."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def _choose_address(host: str | None, port: int | None) -> tuple[str, int]:
    return LOOPBACK if host is None else host, 9000 if port is None else port


@dataclass(frozen=True, slots=True)
class ServingProtocol:
    """A protocol of ``serve``, as an extension offers it.

    Attributes:
        make: From what builds a new planner, a host and a port to a server that listens there. Also given are ``seed``,
            ``wants_images`` (of one of our planners) and the values of the protocol's options.
        manner: How scenes are served, for people.
        packages: Packages that it needs, of the ``extra``.
        find_address: Host and port from those that were given.
        serves: A planner; or traffic, whose ``make`` is given a maker of adversaries in place of the planner's.
    """

    make: Callable[..., Any]
    manner: str
    packages: tuple[str, ...]
    extra: str
    find_address: Callable[[str | None, int | None], tuple[str, int]] = _choose_address
    serves: Literal["planner", "traffic"] = "planner"


def is_open_address(host: str) -> bool:
    """Whether other machines can reach a server on this host address."""
    return not (host in (LOOPBACK, "localhost", "::1") or host.startswith("127."))


def open_listening_socket(host: str, port: int) -> socket.socket:
    """A listening socket at an address of this machine; port 0 takes a free one."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
            listener.listen(_BACKLOG)
        except OSError:
            listener.close()
            raise
        return listener
    except (OSError, UnicodeError, OverflowError) as error:
        raise InputError(
            f"cannot listen on {host} port {port}: {getattr(error, 'strerror', None) or error}; choose another --port "
            "or --host"
        ) from error
