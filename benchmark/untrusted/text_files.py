"""Foreign JSON, TOML and YAML, with limits on bytes, values and nesting, and no text that cannot be written again."""

import codecs
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.untrusted.files import JSON, SETTINGS, Limits, format_bytes, open_file, read_file, to_one_line

_LONGEST_NUMBER: Final = 200
"""Characters: what is longer takes long to read, and cannot be printed in a message."""


def read_yaml(path: Path, limits: Limits = SETTINGS) -> Any:
    """Read a YAML file of plain values: no tags, and no aliases, of which a few lines can make billions of values."""
    import yaml

    class PlainLoader(yaml.SafeLoader):  # type: ignore[misc]
        """Loader that refuses aliases, tags, deep nesting and numbers without end while it reads."""

        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("it has an alias; write the value out")
            tag = getattr(self.peek_event(), "tag", None)
            if tag not in (None, "!"):
                raise yaml.YAMLError(f"it has the tag {to_one_line(tag, 60)}; write a plain value")
            self.depth += 1
            if self.depth > limits.depth:
                raise yaml.YAMLError(f"its containers lie more than {limits.depth} deep")
            try:
                return super().compose_node(parent, index)
            finally:
                self.depth -= 1

        def construct_scalar(self, node: Any) -> Any:
            if node.tag.endswith((":int", ":float")) and len(node.value) > _LONGEST_NUMBER:
                raise yaml.YAMLError(f"it has a number of {len(node.value)} characters")
            return super().construct_scalar(node)

    try:
        return yaml.load(read_file(path, limits).decode("utf-8-sig"), Loader=PlainLoader)
    except (yaml.YAMLError, ValueError, ArithmeticError, RecursionError) as error:
        raise InputError(
            f"{path} is not valid YAML ({to_one_line(error) or 'nested too deeply'}); correct it"
        ) from error


def read_toml(path: Path, limits: Limits = SETTINGS) -> dict[str, Any]:
    """Tables of a TOML file."""
    return parse_toml(read_file(path, limits), str(path))


def parse_toml(data: bytes, where: str) -> dict[str, Any]:
    """Tables of a TOML text in UTF-8; `where` names it in messages."""
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{where} is not valid TOML ({to_one_line(error) or 'nested too deeply'}); correct it"
        ) from error


_BETWEEN: Final = bytes(sorted(set(range(256)) - set(b'[]{}"')))
_ONE_KIND: Final = bytes.maketrans(b"{}", b"[]")
_STRINGS: Final = re.compile(rb'"(?:[^"\\]|\\.)*+"', re.DOTALL)
_STARTS: Final = frozenset(b'[{"-0123456789tfnNI')
_SPACE: Final = b" \t\r\n"
_FIRST_BYTES: Final = 4096
_BYTES_OF_ENCODING: Final = 4


class TooDeepError(ValueError):
    """Containers within containers within containers."""


class TooLargeError(ValueError):
    """More values than there may be, or than fit into memory."""


def require_utf8(start: bytes) -> int:
    """Length of the byte order mark that JSON text may begin with; a `ValueError` names UTF-16 or UTF-32."""
    encoding = json.detect_encoding(start[:_BYTES_OF_ENCODING])
    # Zeros alone are a hole in a file, not text.
    if not encoding.startswith("utf-8") and start[:_BYTES_OF_ENCODING].strip(b"\0"):
        raise ValueError(f"it is text in {encoding[:6].upper()}, save it as UTF-8")
    return len(codecs.BOM_UTF8) if start.startswith(codecs.BOM_UTF8) else 0


def parse_json(data: bytes, limits: Limits = JSON) -> Any:
    """Value of a JSON text in UTF-8; NaN and infinity are read, as Python writes them.

    Raises `ValueError` if it is not JSON, over the limits, or has text that is not Unicode.
    """
    if data.count(b",") + data.count(b"[") + data.count(b"{") > limits.values:
        raise TooLargeError(f"it holds more than {limits.values} values")
    require_utf8(data)
    too_deep = f"its containers lie more than {limits.depth} deep"
    try:
        value = json.loads(data)
    except RecursionError:
        raise TooDeepError(too_deep) from None
    except MemoryError:
        raise TooLargeError(f"its {format_bytes(len(data))} do not fit into memory") from None
    if _is_deeper(data, limits.depth):
        raise TooDeepError(too_deep)
    # Halves of a pair of UTF-16 codes, escaped or as bytes; looked for only where there can be any.
    if b"\xed" in data or b"\\ud" in data or b"\\uD" in data:
        try:
            json.dumps(value, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("it holds text that is not Unicode") from None
    return value


def _is_deeper(data: bytes, depth: int) -> bool:
    """Whether brackets are nested deeper; text in quotes is left out only where there is a bracket in it."""
    # All of one kind, so that each round removes one layer: no JSON bracket closes one of another kind.
    left = data.translate(_ONE_KIND, _BETWEEN).replace(b'""', b"")
    if b'"' in left or b'\\"' in data:
        left = _STRINGS.sub(b"", data).translate(_ONE_KIND, _BETWEEN)
    for _ in range(depth):
        if not left:
            return False
        left = left.replace(b"[]", b"")
    return bool(left)


def read_json(path: Path, limits: Limits = JSON) -> Any:
    """Read a JSON file within limits."""
    try:
        return parse_json(_bytes(path, limits), limits)
    except ValueError as error:
        raise InputError(
            f"{path} is not valid JSON ({to_one_line(error)}); it may be truncated, fetch or make it again"
        ) from error


def read_json_lines(path: Path, limits: Limits = JSON) -> list[Any]:
    """Read one JSON value a line, within limits of the file, a line and a value."""
    return [parse_line(path, number, line, limits) for number, line in read_lines(path, limits)]


def read_lines(path: Path, limits: Limits = JSON) -> Iterator[tuple[int, str]]:
    """Number, from 1, and unread text of each line of a file of JSON lines."""
    try:
        text = _bytes(path, limits).decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not text ({error}); fetch or make it again") from error
    for number, line in enumerate(text.splitlines(), start=1):
        if len(line) > limits.line_bytes:
            raise InputError(
                f"{path} line {number} is longer than {format_bytes(limits.line_bytes)}; it is damaged or something "
                "else, fetch or make it again"
            )
        yield number, line


def parse_line(path: Path, number: int, line: str, limits: Limits = JSON) -> Any:
    """Value of one line of a file; path and number are for the message."""
    try:
        return parse_json(line.encode(), limits)
    except ValueError as error:
        raise InputError(
            f"{path} line {number} is not valid JSON ({to_one_line(error)}); it may be truncated"
        ) from error


def is_plain(data: bytes, limits: Limits = JSON) -> bool:
    """Whether a JSON text surely is within the limits and Unicode, so that a faster parser may read it."""
    if data.count(b",") + data.count(b"[") + data.count(b"{") > limits.values:
        return False
    return not (_is_deeper(data, limits.depth) or b"\xed" in data or b"\\ud" in data or b"\\uD" in data)


def _bytes(path: Path, limits: Limits) -> bytes:
    """The file, if it begins like JSON: nothing else, and no hole in a sparse file, is read to its end."""
    try:
        with open_file(path, limits) as stream:
            start = stream.peek(_FIRST_BYTES)[:_FIRST_BYTES].lstrip(_SPACE)
            if start and start[0] not in _STARTS and not start.startswith((b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")):
                # With the message that parsing the whole file gives.
                return start[:1] if 0 < start[0] < 0x80 else stream.read(_FIRST_BYTES)
            return stream.read()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except MemoryError:
        raise InputError(f"{path} does not fit into the memory of this machine; it is damaged, get it again") from None
