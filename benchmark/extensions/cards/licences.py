"""Licences by the identifiers that hubs use, and where each is to be read."""

import re
from collections.abc import Mapping
from typing import Final

from benchmark.errors import InputError

PAGES: Final[Mapping[str, str]] = {
    "apache-2.0": "https://www.apache.org/licenses/LICENSE-2.0",
    "mit": "https://opensource.org/license/mit",
    "cc0-1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "cc-by-4.0": "https://creativecommons.org/licenses/by/4.0/",
    "cc-by-sa-4.0": "https://creativecommons.org/licenses/by-sa/4.0/",
    "cc-by-nc-4.0": "https://creativecommons.org/licenses/by-nc/4.0/",
    "cc-by-nc-sa-4.0": "https://creativecommons.org/licenses/by-nc-sa/4.0/",
}
UNKNOWN: Final = "unknown"
OTHER: Final = "other"
_IDENTIFIER: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]{0,99}")


def licence_named(text: str | None) -> str:
    """Identifier of the licence that a user means; ``unknown`` where none is given."""
    if text is None:
        return UNKNOWN
    if not _IDENTIFIER.fullmatch(text):
        raise InputError(f"--licence {text!r} is no licence identifier; name one such as cc-by-nc-sa-4.0, or other")
    return text.lower()


def licence_page(identifier: str) -> str:
    """Where a licence is to be read; the identifier itself where that is not known here."""
    return PAGES.get(identifier, identifier)
