"""Files that planners' own repositories write, opened: pickles in a child process, JSON with nothing twice in it."""

import json
import math
from pathlib import Path
from typing import Any, Final, NoReturn

from benchmark.errors import InputError
from benchmark.untrusted.children import read_in_child
from benchmark.untrusted.files import (
    CATEGORIES,
    JSON,
    RESULTS,
    Category,
    Limits,
    RefusedFileError,
    open_file,
    read_file,
    scale_limits,
    to_one_line,
)
from benchmark.untrusted.text_files import TooDeepError, TooLargeError, parse_json

_START_BYTES: Final = 64
_ADVICE: Final[dict[str, str]] = {
    "truncated": "copy or make it again",
    "trailing": "it is damaged or several files in one; make it again",
    "class": "it could run code: do not open it elsewhere either, and get the file from a source that you trust",
    "nesting": "it is damaged or malicious: get it from a source that you trust",
    "size": "it is damaged or malicious: get it from a source that you trust",
}


def first_bytes(path: Path) -> bytes:
    """Up to 64 bytes of the beginning of a result file."""
    with open_file(path, RESULTS) as stream:
        return stream.read(_START_BYTES)


def read_result_pickle(path: Path) -> Any:
    """Dictionaries, lists, arrays, numbers and texts of an untrusted result pickle; what holds no plan is ``None``."""
    with open_file(path, RESULTS) as stream:
        limits = scale_limits(RESULTS, stream.seek(0, 2))
    try:
        answer = read_in_child(path, "results", limits)
    except InputError as error:
        raise RefusedFileError("size", str(error)) from error
    if answer.kind != "value":
        raise RefusedFileError("unknown", f"{path} is not a readable pickle ({': '.join(answer.parts)}); make it again")
    content = answer.parts[0]
    if isinstance(content, dict) and "value" in content:
        return content["value"]
    category, why = (content.get("wrong"), str(content.get("why"))) if isinstance(content, dict) else (None, "")
    if category not in CATEGORIES:
        raise RefusedFileError("unknown", f"{path} is not a readable pickle; make it again")
    if category == "class":
        why = f"its pickle uses {why}, which no result file needs"
    advice = _ADVICE.get(category, "it is damaged or not a result file; make it again")
    raise RefusedFileError(category, f"{path} is refused: {why}; {advice}")


def read_result_text(path: Path, limits: Limits = JSON) -> bytes:
    """The bytes of a text file of results; errors as in `read_file`."""
    return read_file(path, limits)


def parse_result_json(data: bytes, where: str, limits: Limits = JSON) -> Any:
    """Value of a JSON text with no key twice and finite numbers alone; `where` (file, line) is for the message."""
    category: Category = "unknown"
    try:
        parse_json(data, limits)
        return json.loads(data, object_pairs_hook=_once, parse_constant=_not_finite, parse_float=_finite)
    except json.JSONDecodeError as error:
        ended = error.pos >= len(error.doc.rstrip()) or error.msg.startswith("Unterminated")
        behind = error.msg.startswith("Extra data")
        category, why = "trailing" if behind else "truncated" if ended else "unknown", to_one_line(error)
    except _NamedTwiceError as error:
        category, why = "duplicate", to_one_line(error)
    except _NotFiniteError as error:
        category, why = "not_finite", to_one_line(error)
    except TooDeepError as error:
        category, why = "nesting", to_one_line(error)
    except TooLargeError as error:
        category, why = "size", to_one_line(error)
    except ValueError as error:
        why = to_one_line(error)
    raise RefusedFileError(category, f"{where} is not readable JSON ({why}); {_ADVICE.get(category, 'make it again')}")


class _NamedTwiceError(ValueError):
    """A key twice in one object."""


class _NotFiniteError(ValueError):
    """NaN, infinity, or a number that is too large for one."""


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        names: set[str] = set()
        twice = next(name for name, _ in pairs if name in names or names.add(name))  # type: ignore[func-returns-value]
        raise _NamedTwiceError(f"{to_one_line(twice, 80)!r} occurs twice in one object")
    return members


def _not_finite(text: str) -> NoReturn:
    raise _NotFiniteError(f"it holds {text}, which is not a number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise _NotFiniteError(f"it holds {text[:40]}, which is out of range")
    return value
