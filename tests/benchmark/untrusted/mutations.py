"""Seeded changes of a valid file: of its bytes, and of what is written in them where the form is known.

For tests (a sample) and for ``bench/attack.py`` (as many as one likes), beside what somebody thought of (`variants`).
"""

import hashlib
import io
import json
import pickletools
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Any, Final

from tests.benchmark.untrusted.variants import DEEP

_HERE: Final = "put the other value here"


@dataclass(frozen=True, slots=True)
class Mutation:
    """One kind of change, the same for the same state of the generator.

    Where the result ``may_be_valid``, it may be a valid file with another content, whose other numbers are right.
    """

    name: str
    change: Callable[[bytes, Random], bytes]
    may_be_valid: bool


def _place(data: bytes, chance: Random) -> tuple[int, int]:
    start = chance.randrange(len(data) + 1)
    return start, min(len(data), start + chance.choice((1, 4, 16, 64, 512, 4096)))


def _flip(data: bytes, chance: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        # Headers are short, and most of what can go wrong is said in them.
        near = min(len(data), chance.choice((16, 256, len(data))))
        changed[chance.randrange(near)] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _truncate(data: bytes, chance: Random) -> bytes:
    return data[: chance.choice((chance.randrange(len(data)), len(data) - 1, 1))]


def _double(data: bytes, chance: Random) -> bytes:
    start, end = _place(data, chance)
    return data[:end] + data[start:end] * chance.choice((1, 1, 100)) + data[end:]


def _delete(data: bytes, chance: Random) -> bytes:
    start, end = _place(data, chance)
    return data[:start] + data[end:]


def _swap(data: bytes, chance: Random) -> bytes:
    (first, first_end), (second, second_end) = sorted((_place(data, chance), _place(data, chance)))
    if first_end > second:
        return data[::-1]
    middle = data[first_end:second]
    return data[:first] + data[second:second_end] + middle + data[first:first_end] + data[second_end:]


def _extremes(data: bytes, chance: Random) -> bytes:
    start, end = _place(data, chance)
    return data[:start] + chance.choice((b"\0", b"\xff", b"\x7f", b"[", b'"', b"\r")) * (end - start) + data[end:]


BYTES: Final = (
    Mutation("bits flipped", _flip, may_be_valid=True),
    Mutation("truncated", _truncate, may_be_valid=False),
    Mutation("a piece twice", _double, may_be_valid=True),
    Mutation("a piece missing", _delete, may_be_valid=True),
    Mutation("two pieces swapped", _swap, may_be_valid=True),
    Mutation("a piece of one byte", _extremes, may_be_valid=True),
)

_OTHER_VALUES: Final[tuple[tuple[str, Any], ...]] = (
    ("null", None),
    ("true", True),
    ("text", "other"),
    ("an empty text", ""),
    ("a number as text", "7"),
    ("a list", [1, "a", None]),
    ("an empty list", []),
    ("an object", {"a": 1}),
    ("NaN", float("nan")),
    ("infinity", float("-inf")),
    ("1e300", 1e300),
    ("2^63", 1 << 63),
    ("10^400", 10**400),
    ("-1e9", -1e9),
    ("10^5 letters", "x" * 100_000),
    ("half a pair", "a\ud800"),
    ("a zero byte", "a\0b"),
    ("two lines", "a\nb"),
    ("a step up", "../../a"),
    ("nested 10^5 deep", _HERE),
)


def _written(value: Any) -> bytes:
    return json.dumps(value).replace(f'"{_HERE}"', DEEP).encode()


def _inner(value: Any, chance: Random) -> tuple[Any, Any]:
    """Somewhere in a value: a container and the index or key of one of its items."""
    while True:
        items = [*value] if isinstance(value, dict) else range(len(value))
        key = chance.choice(items)
        below = value[key]
        if not isinstance(below, dict | list) or not below or chance.random() < 0.1:
            return value, key
        value = below


def _in_json(act: Callable[[Any, Any, Random], None]) -> Callable[[bytes, Random], bytes]:
    def change(data: bytes, chance: Random) -> bytes:
        value = json.loads(data)
        if not isinstance(value, dict | list) or not value:
            return _written([value])
        act(*_inner(value, chance), chance)
        return _written(value)

    return change


def become(name: str, other: Any) -> Mutation:
    """A value somewhere in JSON becomes another."""

    def act(container: Any, key: Any, _: Random) -> None:
        container[key] = other

    return Mutation(f"a value is {name}", _in_json(act), may_be_valid=False)


def _leave(container: Any, key: Any, _: Random) -> None:
    del container[key]


def _twice(container: Any, key: Any, chance: Random) -> None:
    if isinstance(container, list):
        container.insert(chance.randrange(len(container) + 1), container[key])
    else:
        container[f"{key} "] = container[key]


def _rows(data: bytes, chance: Random, act: Callable[[Any, Random], None]) -> bytes:
    """A change of the order or number of rows: of a list, or of the longest list in an object."""
    value = json.loads(data)
    lists = [value] if isinstance(value, list) else [held for held in value.values() if isinstance(held, list)]
    act(max(lists, key=len, default=[]), chance)
    return _written(value)


def _shuffle(rows: list[Any], chance: Random) -> None:
    chance.shuffle(rows)


def _duplicate(rows: list[Any], chance: Random) -> None:
    if rows:
        rows.append(chance.choice(rows))


def _drop(rows: list[Any], chance: Random) -> None:
    if rows:
        rows.pop(chance.randrange(len(rows)))


def _same_key_twice(data: bytes, chance: Random) -> bytes:
    places = [place for place in range(len(data)) if data[place : place + 1] == b"{"]
    at = chance.choice(places or [0]) + 1
    end = data.find(b":", at)
    return data[:at] + data[at:end] + b": null, " + data[at:] if end > 0 else data


JSON: Final = (
    *(become(name, other) for name, other in _OTHER_VALUES),
    Mutation("a value is missing", _in_json(_leave), may_be_valid=False),
    Mutation("a value twice", _in_json(_twice), may_be_valid=False),
    Mutation("a key twice", _same_key_twice, may_be_valid=False),
    Mutation("rows in another order", lambda data, chance: _rows(data, chance, _shuffle), may_be_valid=False),
    Mutation("a row twice", lambda data, chance: _rows(data, chance, _duplicate), may_be_valid=False),
    Mutation("a row missing", lambda data, chance: _rows(data, chance, _drop), may_be_valid=True),
)


def _in_line(mutation: Mutation) -> Mutation:
    """The same in one line of many."""

    def change(data: bytes, chance: Random) -> bytes:
        lines = data.splitlines()
        at = chance.randrange(len(lines))
        lines[at] = mutation.change(lines[at], chance)
        return b"\n".join(lines) + b"\n"

    return Mutation(f"in a line, {mutation.name}", change, mutation.may_be_valid)


JSON_LINES: Final = tuple(_in_line(each) for each in JSON)

_CELLS: Final = (
    "", "nan", "inf", "-1e300", "1e999", "true", "null", "x", "1;2", "1e5", "0x10", "9" * 5000, "x" * 50_000, "\x00",
    '"', '"a\nb"', "=1+1", "\u0661", "1_0", " 1",
)  # fmt: skip


def _cell(data: bytes, chance: Random) -> bytes:
    rows = [line.split(",") for line in data.decode().splitlines()]
    row = chance.choice(rows)
    row[chance.randrange(len(row))] = chance.choice(_CELLS)
    return "\n".join(map(",".join, rows)).encode() + b"\n"


def _lines(act: Callable[[list[bytes], Random], None]) -> Callable[[bytes, Random], bytes]:
    def change(data: bytes, chance: Random) -> bytes:
        first, *rows = data.splitlines()
        act(rows, chance)
        return b"\n".join([first, *rows]) + b"\n"

    return change


def _column(act: Callable[[list[str], int], None]) -> Callable[[bytes, Random], bytes]:
    def change(data: bytes, chance: Random) -> bytes:
        rows = [line.split(",") for line in data.decode().splitlines()]
        at = chance.randrange(len(rows[0]))
        for row in rows:
            act(row, at)
        return "\n".join(map(",".join, rows)).encode() + b"\n"

    return change


CSV: Final = (
    Mutation("another cell", _cell, may_be_valid=True),
    Mutation("a column missing", _column(lambda row, at: row.__delitem__(at)), may_be_valid=True),
    Mutation("a column twice", _column(lambda row, at: row.append(row[at])), may_be_valid=False),
    Mutation("columns in another order", _column(lambda row, at: row.reverse()), may_be_valid=False),
    Mutation("rows in another order", _lines(_shuffle), may_be_valid=False),
    Mutation("a row twice", _lines(_duplicate), may_be_valid=False),
    Mutation("a row missing", _lines(_drop), may_be_valid=True),
)

_OPCODES: Final = (
    b"N", b"\x88", b"K\xff", b"J\xff\xff\xff\x7f", b"}", b"]", b")", b"(", b"t", b"0", b"2", b"a", b"s", b"u", b"e",
    b"R", b"b", b"\x85", b"\x86", b"\x87", b"h\x00", b"q\x00", b"\x94", b"X\x04\0\0\0rows", b"G\x7f\xf8" + bytes(6),
    b"cos\nsystem\n", b"cbuiltins\neval\n", b"\x8a\xff" + b"\x7f" * 255, b"\x8f", b"\x90", b"\x91", b".", b"P0\n", b"Q",
)  # fmt: skip


def _opcodes(data: bytes, chance: Random) -> bytes:
    places = [place for _, _, place in pickletools.genops(data) if place is not None]
    parts = [data[start:end] for start, end in zip(places, [*places[1:], len(data)])]
    for _ in range(chance.choice((1, 1, 1, 3))):
        at, other = chance.randrange(len(parts)), chance.randrange(len(parts))
        act = chance.randrange(5)
        if act == 0:
            parts[at] = chance.choice(_OPCODES)
        elif act == 1:
            parts.insert(at, parts[other] * chance.choice((1, 1, 1000)))
        elif act == 2:
            parts[at], parts[other] = parts[other], parts[at]
        elif act == 3:
            parts.insert(at, chance.choice(_OPCODES) * chance.choice((1, 1, 2000)))
        elif len(parts) > 1:
            del parts[at]
    return b"".join(parts)


PICKLE: Final = (Mutation("other opcodes", _opcodes, may_be_valid=True),)


def _in_archive(data: bytes, chance: Random) -> bytes:
    """One record of an archive is changed, and the archive made anew, with checksums that are right."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        records = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    at = chance.choice([place for place, (_, held) in enumerate(records) if held])
    name, held = records[at]
    if name.endswith(".pkl"):
        records[at] = name, _opcodes(held, chance)
    else:
        records[at] = name, chance.choice(BYTES).change(held, chance)
    with zipfile.ZipFile(made, "w") as archive:
        for name, held in records:
            archive.writestr(name, held)
    return made.getvalue()


ARCHIVE: Final = (Mutation("another record in the archive", _in_archive, may_be_valid=True),)


def _in_package(mutation: Mutation) -> Mutation:
    """The same in one member of a package, whose manifest says what is there then: hashes are right."""

    def change(data: bytes, chance: Random) -> bytes:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            held = {entry.filename: archive.read(entry) for entry in archive.infolist()}
        name = chance.choice([each for each in held if each.endswith(".json")])
        held[name] = mutation.change(held[name], chance)
        if name != _MANIFEST:
            manifest = json.loads(held[_MANIFEST])
            said = manifest["files"][name]
            said["bytes"], said["sha256"] = len(held[name]), hashlib.sha256(held[name]).hexdigest()
            held[_MANIFEST] = json.dumps(manifest).encode()
        made = io.BytesIO()
        with zipfile.ZipFile(made, "w") as archive:
            for each, content in held.items():
                archive.writestr(each, content)
        return made.getvalue()

    # Neither statistics nor an inspector's words can be looked up anywhere.
    return Mutation(f"in a member, {mutation.name}", change, may_be_valid=True)


_MANIFEST: Final = "manifest.json"
_TOML_VALUES: Final = (
    "nan", "-inf", "1e400", "-1", "0", "9" * 400, "true", '""', "[]", "{}", '"x"', "1979-05-27T07:32:00Z",
    "0x7fffffffffffffffffff", '"\\u0000"', '"\\U0010ffff"', '"""\na\nb"""', "[[[[]]]]", "1_000", "", "= 1",
    "[" * 100_000, "'a\nb'",
)  # fmt: skip


def _toml_value(data: bytes, chance: Random) -> bytes:
    lines = data.decode().splitlines()
    at = chance.choice([number for number, line in enumerate(lines) if " = " in line])
    lines[at] = f"{lines[at].split(' = ')[0]} = {chance.choice(_TOML_VALUES)}"
    return "\n".join(lines).encode() + b"\n"


def _toml_lines(act: Callable[[list[str], int], None]) -> Callable[[bytes, Random], bytes]:
    def change(data: bytes, chance: Random) -> bytes:
        lines = data.decode().splitlines()
        act(lines, chance.randrange(len(lines)))
        return "\n".join(lines).encode() + b"\n"

    return change


TOML: Final = (
    Mutation("another value", _toml_value, may_be_valid=True),
    Mutation("another value", _toml_value, may_be_valid=True),
    Mutation("a line missing", _toml_lines(lambda lines, at: lines.__delitem__(at)), may_be_valid=True),
    Mutation("a line twice", _toml_lines(lambda lines, at: lines.insert(at, lines[at])), may_be_valid=True),
    Mutation("lines in another order", _toml_lines(lambda lines, _: lines.reverse()), may_be_valid=True),
    Mutation("a key of keys", _toml_lines(lambda lines, at: lines.insert(at, "a" + ".b" * 5000 + " = 1")), False),
)


def _in_header(mutation: Mutation) -> Mutation:
    """The same in the header of a file of tensors, whose length stays right."""

    def change(data: bytes, chance: Random) -> bytes:
        (length,) = struct.unpack("<Q", data[:8])
        header = mutation.change(data[8 : 8 + length], chance)
        return struct.pack("<Q", len(header)) + header + data[8 + length :]

    # The same tensors in another order of bytes are other weights by their hash, and seeds are made of that.
    reordered = mutation.name == "rows in another order"
    return Mutation(f"in the header, {mutation.name}", change, mutation.may_be_valid or reordered)


TENSORS: Final = tuple(_in_header(each) for each in JSON)

FORMS: Final[dict[str, tuple[Mutation, ...]]] = {
    "bytes": BYTES,
    "json": (*JSON, *JSON, *BYTES),
    "jsonl": (*JSON_LINES, *BYTES),
    "csv": (*CSV, *CSV, *BYTES),
    "pickle": (*PICKLE * 6, *BYTES),
    "archive": (*ARCHIVE * 6, *BYTES),
    "tensors": (*TENSORS, *BYTES, *BYTES),
    "package": (*map(_in_package, JSON), *map(_in_package, BYTES), *BYTES),
    "toml": (*TOML, *BYTES),
}
"""What is done to files of each form; what is named twice is done twice as often."""
