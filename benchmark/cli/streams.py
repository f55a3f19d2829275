"""Text on terminals whose encoding lacks some of its characters: the closest ASCII stands for them."""

import codecs
import io
import sys
import unicodedata
from typing import Final

_HANDLER: Final = "closest-ascii"
_CLOSEST: Final = {
    "×": "x",
    "−": "-",
    "–": "-",
    "—": "-",
    "±": "+-",
    "→": "->",
    "∞": "inf",
    "φ": "phi",
    "…": "...",
    "†": "+",
    "‡": "#",
    "§": "$",
    "¶": "*",
    "✓": "v",
    "█": "#",
    "░": ".",
}
"""Marks of tables stay different from each other."""


def replace_what_cannot_be_shown() -> None:
    """Let stdout and stderr print any text; what their encoding lacks is replaced instead of ending the command."""
    codecs.register_error(_HANDLER, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_HANDLER)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_CLOSEST.get(character) or _without_accents(character) for character in missing), error.end


def _without_accents(character: str) -> str:
    return unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode() or "?"
