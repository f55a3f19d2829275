"""Data as scripts: a page opened from disk may load scripts and may not fetch files."""

import re
from typing import Any

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, parse_json


def data_script(target: str, value: Any) -> bytes:
    """A script, in ASCII, that assigns a value to JavaScript of ours (no name from a record, unless written as JSON).

    The value, without NaN and infinity, is parsed as JSON, not as JavaScript: faster for large values, and a name such
    as ``__proto__`` stays a name.
    """
    text = canonical_json(value).replace("\\", "\\\\").replace("'", "\\'").replace("<", "\\x3c")
    return f"\"use strict\";\n{target} = JSON.parse('{text}');\n".encode("ascii")


def script_data(text: str) -> Any:
    """The value that a script of `data_script` assigns."""
    _, found, rest = text.partition("JSON.parse('")
    literal, end, _ = rest.rpartition("')")
    if not found or not end:
        raise InputError("a script of the site assigns no data; write the leaderboard again")
    plain = re.sub(r"\\(x3c|.)", lambda escape: "<" if escape[1] == "x3c" else escape[1], literal)
    try:
        return parse_json(plain.encode())
    except ValueError as error:
        raise InputError(f"a script of the site holds damaged data ({error}); write the leaderboard again") from error
