"""Address of a server: reachable from this machine only by default."""

import socket
from typing import Final

from benchmark.errors import InputError

LOOPBACK: Final = "127.0.0.1"
_BACKLOG: Final = 128


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
