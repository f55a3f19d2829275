"""Where a server is and what it is called: ``http://HOST:PORT``, or ``NAME=http://HOST:PORT``; other schemes alike."""

import re
from dataclasses import dataclass
from typing import Any, Final, Self
from urllib.parse import urlsplit

from benchmark.errors import InputError
from benchmark.untrusted.files import to_one_line

_ADDRESS: Final = re.compile(r"(?:[^=]*=)?(https?|grpcs?):/", re.IGNORECASE)
_LONGEST_NAME: Final = 60
SCHEMES: Final = ("http", "grpc")
DEADLINE_S: Final = 120.0
"""Of one request to a planner elsewhere."""
ALIVE_S: Final = 30.0
"""So long may the first answer take."""
RETURN_S: Final = 60.0
"""So long is waited for a server that went away half-way: networks take long to load."""


@dataclass(frozen=True, slots=True)
class Address:
    """A server's address ``http://HOST:PORT`` with a name for tables: the user's, else host and port.

    Protocols say nothing of who answers, so that what is kept goes by a name that the user gave, wherever the
    server listens; without one it goes by the address.
    """

    name: str
    url: str
    named: bool

    @classmethod
    def of(cls, text: str, option: str, schemes: tuple[str, ...] = ("http",)) -> Self:
        """Read an address of some schemes as the user gave it; anything beside name, host and port is refused."""
        name, equals, url = text.rpartition("=") if "=" in text.partition("://")[0] else ("", "", text)
        known = " or ".join(f"{scheme}://HOST:PORT" for scheme in schemes)
        form = f"{option} {to_one_line(text, 80)!r} is not an address; write {known} or NAME={known}"
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise InputError(f"{form} ({to_one_line(error)})") from error
        scheme = parts.scheme.lower()
        if scheme in ("https", "grpcs"):
            raise InputError(f"{form}; only plain {'HTTP' if scheme == 'https' else 'gRPC'} is supported")
        extra_parts = parts.username or parts.password or parts.query or parts.fragment or parts.path.strip("/")
        if scheme not in schemes or not host or not port or extra_parts:
            raise InputError(form)
        if equals and (not name.strip() or not name.isprintable() or len(name) > _LONGEST_NAME or "/" in name):
            raise InputError(f"{form}; a name has 1 to {_LONGEST_NAME} printable characters")
        where = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        return cls(name.strip() or where, f"{scheme}://{where}", bool(equals))

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that are part of an identity beside the name."""
        return {} if self.named else {"address": self.url}


def is_address(text: str) -> bool:
    """Whether a text is meant as an address, right or wrong."""
    return find_scheme(text) is not None


def find_scheme(text: str) -> str | None:
    """``http`` or ``grpc`` of a text that is meant as an address, right or wrong; of others ``None``."""
    found = _ADDRESS.match(text)
    return None if found is None else found[1].lower().removesuffix("s")


def parse_renaming(text: str, option: str) -> dict[str, str]:
    """``CAM_FRONT=front,CAM_BACK=rear`` by the first names; both sides must be there once."""
    pairs = [pair.partition("=") for pair in text.split(",") if pair.strip()]
    renamed = {name.strip(): other.strip() for name, _, other in pairs}
    if any(not (name.strip() and other.strip()) for name, _, other in pairs):
        raise InputError(f"{option} {to_one_line(text, 80)!r} is not a list of NAME=OTHER with commas between")
    if len(renamed) < len(pairs) or len(set(renamed.values())) < len(pairs):
        raise InputError(f"{option} {to_one_line(text, 80)!r} has a name twice")
    return renamed
