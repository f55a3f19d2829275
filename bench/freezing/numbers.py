"""Numbers, keys and names of files in a text, apart from its sentences: what stays when words are given other names."""

import json
import re
from collections.abc import Iterator
from typing import Any

_ENDINGS = "jsonl?|csv|md|html|js|css|svg|png|webp|webm|jpg|npz|npy|pkl|parquet|safetensors|toml|tex|xosc|zip"
_NAME_OF_FILE = rf"(?<![\w.@/-])[\w.@/-]*\w\.(?:{_ENDINGS})\b"
_NUMBER = r"(?<![\w.])[-+]?\d[\d,]*(?:\.\d+)?(?:[eE][-+]?\d+)?(?!\w)"
_FOUND = re.compile(rf"{_NAME_OF_FILE}|{_NUMBER}")


def numbers_in(text: str) -> str:
    """What of a text is compared apart from sentences.

    Args:
        text: Printed or of a file: an ``exit code N`` first or not, then JSON, JSON lines, or anything else.

    Returns:
        A line for each: of JSON the paths of members with numbers, truths and null, and what its texts have of the
        following; of everything else numbers and names of files in their order.
    """
    head, body = re.match(r"(exit code \d+\n)?(.*)", text, re.DOTALL).groups()  # type: ignore[union-attr]
    return "\n".join([*([head.strip()] if head else []), *_of_text(body)])


def _of_text(text: str) -> Iterator[str]:
    decoder, at = json.JSONDecoder(), 0
    # JSON, perhaps line by line, and behind it what was told on stderr.
    while text[at : at + 1] in ("{", "["):
        try:
            value, end = decoder.raw_decode(text, at)
        except ValueError:
            break
        yield from _of_value(value, "")
        at = end + len(text[end:]) - len(text[end:].lstrip())
    yield from _FOUND.findall(text[at:])


def _of_value(value: Any, path: str) -> Iterator[str]:
    if isinstance(value, dict):
        yield f"{path}{{}}"
        for name, inner in value.items():
            yield from _of_value(inner, f"{path}.{name}")
    elif isinstance(value, list):
        yield f"{path}[{len(value)}]"
        for inner in value:
            yield from _of_value(inner, f"{path}[]")
    elif isinstance(value, str):
        yield f"{path}: {' '.join(_FOUND.findall(value))}"
    else:
        yield f"{path}: {value!r}"
