"""Data as scripts: a page opened from disk may load scripts and may not fetch files."""

from typing import Any

from benchmark.machine.storage import canonical_json


def data_script(target: str, value: Any) -> bytes:
    """A script that assigns a value.

    The value is parsed as JSON, not as JavaScript: faster for large values, and a name such as ``__proto__`` stays a
    name.

    Args:
        target: What is assigned to, JavaScript of ours (never a name from a record, unless written as JSON).
        value: Anything ``json`` can write, without NaN and infinity.

    Returns:
        The script, ASCII.
    """
    text = canonical_json(value).replace("\\", "\\\\").replace("'", "\\'").replace("<", "\\x3c")
    return f"\"use strict\";\n{target} = JSON.parse('{text}');\n".encode("ascii")
