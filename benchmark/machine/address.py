"""Where a server is and what it is called: ``http://HOST:PORT``, or ``NAME=http://HOST:PORT``."""

import re
from dataclasses import dataclass
from typing import Any, Final, Self
from urllib.parse import urlsplit

from benchmark.errors import InputError
from benchmark.untrusted.files import to_one_line

_ADDRESS: Final = re.compile(r"([^=]*=)?https?:/", re.IGNORECASE)
_LONGEST_NAME: Final = 60


@dataclass(frozen=True, slots=True)
class Address:
    """A server's address ``http://HOST:PORT`` with a name for tables: the user's, else host and port.

    The protocol says nothing of who answers, so that what is kept goes by a name that the user gave, wherever the
    server listens; without one it goes by the address.
    """

    name: str
    url: str
    named: bool

    @classmethod
    def of(cls, text: str, option: str) -> Self:
        """Read an address as the user gave it; anything beside name, host and port is refused."""
        name, equals, url = text.rpartition("=") if "=" in text.partition("://")[0] else ("", "", text)
        form = f"{option} {to_one_line(text, 80)!r} is not an address; write http://HOST:PORT or NAME=http://HOST:PORT"
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise InputError(f"{form} ({to_one_line(error)})") from error
        if parts.scheme.lower() == "https":
            raise InputError(f"{form}; only plain HTTP is supported")
        extra_parts = parts.username or parts.password or parts.query or parts.fragment or parts.path.strip("/")
        if parts.scheme.lower() != "http" or not host or not port or extra_parts:
            raise InputError(form)
        if equals and (not name.strip() or not name.isprintable() or len(name) > _LONGEST_NAME or "/" in name):
            raise InputError(f"{form}; a name has 1 to {_LONGEST_NAME} printable characters")
        where = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        return cls(name.strip() or where, f"http://{where}", bool(equals))

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that are part of an identity beside the name."""
        return {} if self.named else {"address": self.url}


def is_address(text: str) -> bool:
    """Whether a text is meant as an address, right or wrong."""
    return _ADDRESS.match(text) is not None
