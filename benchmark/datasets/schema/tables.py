"""The tables of nuScenes: what each field of a row must be, and which rows of other tables it names.

Only fields that are read, here or in software for this format, are described; a row may have others.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import PurePosixPath
from typing import Any, Final

import numpy as np

EARTH_M: Final = 1e8
"""No coordinate of a map projection is farther than this from its origin."""
HIGHEST_M: Final = 1e4
"""No road is higher, or deeper, than this."""
CAR_M: Final = 100.0
"""No sensor sits farther than this from the origin of its car."""
LARGEST_M: Final = 200.0
"""No road user is longer, wider or higher."""
NORM_TOLERANCE: Final = 1e-3
MOST_COUNTED: Final = 10**9
EARLIEST_US: Final = 946_684_800_000_000
"""The year 2000; seconds and milliseconds lie before it."""
LATEST_US: Final = 4_102_444_800_000_000
"""The year 2100; nanoseconds lie after it."""
LONGEST_TOKEN: Final = 200
LONGEST_NAME_BYTES: Final = 100
"""Generated names, and those of files made of a name, are longer; file systems end at 255 bytes."""
LONGEST_PATH_BYTES: Final = 1000
_FORBIDDEN: Final = frozenset('<>:"/\\|?*')
_RESERVED: Final = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)

Test = Callable[[Any], bool]
ColumnTest = Callable[[list[Any]], bool]


@dataclass(frozen=True, slots=True)
class ValueKind:
    """Contents that a field may have, ``words`` for sentences.

    ``column`` tells whether all values of a column (never empty) are. It is quick, and may err on one side only: where
    it says no, the values are looked at one by one.
    """

    words: str
    holds: Test
    column: ColumnTest


def _of_type(values: list[Any], *types: type) -> bool:
    return set(map(type, values)) <= set(types)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def whole_number(words: str, low: int, high: int) -> ValueKind:
    """Whole numbers of a range, both ends included."""

    def holds(value: Any) -> bool:
        return type(value) is int and low <= value <= high

    def column(values: list[Any]) -> bool:
        return _of_type(values, int) and min(values) >= low and max(values) <= high

    return ValueKind(words, holds, column)


def number(words: str, low: float, high: float) -> ValueKind:
    """Finite numbers of a range, both ends included."""

    def holds(value: Any) -> bool:
        return _is_number(value) and low <= value <= high

    def column(values: list[Any]) -> bool:
        return _of_type(values, int, float) and all(low <= value <= high for value in values)

    return ValueKind(words, holds, column)


def numbers(words: str, length: int, sound: Callable[[Any], Any]) -> ValueKind:
    """Lists of ``length`` finite numbers; ``sound`` maps (N, length) to N truths, false for NaN."""

    def holds(value: Any) -> bool:
        if type(value) is not list or len(value) != length or not all(map(_is_number, value)):
            return False
        try:
            return bool(sound(np.array([value], dtype=np.float64))[0])
        except OverflowError:
            return False

    def column(values: list[Any]) -> bool:
        if not _of_type(values, list) or set(map(len, values)) != {length}:
            return False
        flat = list(chain.from_iterable(values))
        if not _of_type(flat, int, float):
            return False
        try:
            return bool(sound(np.array(flat, dtype=np.float64).reshape(-1, length)).all())
        except OverflowError:
            return False

    return ValueKind(words, holds, column)


def _within(*limits_m: float) -> Callable[[Any], Any]:
    return lambda values: (np.abs(values) <= limits_m).all(axis=-1)


def _of_norm_one(values: Any) -> Any:
    with np.errstate(over="ignore"):
        return np.abs((values * values).sum(axis=-1) - 1.0) <= 2 * NORM_TOLERANCE


def _size(values: Any) -> Any:
    return ((values >= 0) & (values <= LARGEST_M)).all(axis=-1)


def is_file_name(value: Any) -> bool:
    """Whether a text can be the name of a file on every system: Linux, macOS, Windows."""
    return (
        type(value) is str
        and value.isprintable()
        and 0 < len(value.encode(errors="replace")) <= LONGEST_NAME_BYTES
        and _FORBIDDEN.isdisjoint(value)
        and not value.startswith((".", " "))
        and not value.endswith((".", " "))
        and not _RESERVED.fullmatch(value)
    )


def is_file_inside(value: Any) -> bool:
    """Whether a text is the path of a file below a folder, on any system."""
    if type(value) is not str or not value.isprintable() or not 0 < len(value.encode()) <= LONGEST_PATH_BYTES:
        return False
    path = PurePosixPath(value.replace("\\", "/"))
    return not path.is_absolute() and bool(path.parts) and ".." not in path.parts and ":" not in path.parts[0]


def _is_token(value: Any) -> bool:
    return type(value) is str and 0 < len(value) <= LONGEST_TOKEN and value.isprintable()


def _is_token_or_none(value: Any) -> bool:
    return value == "" or _is_token(value)


def _is_text(value: Any) -> bool:
    if type(value) is not str:
        return False
    return value.isascii() or not any("\ud800" <= character <= "\udfff" for character in value)


def _are_tokens(value: Any) -> bool:
    return type(value) is list and all(map(_is_token, value))


def _is_matrix(value: Any) -> bool:
    if type(value) is not list or not all(type(row) is list and len(row) == 3 for row in value):
        return False
    flat = list(chain.from_iterable(value))
    return len(value) in (0, 3) and all(_is_number(entry) and abs(entry) < 1e9 for entry in flat)


def _short_texts(values: list[Any], *, longest: int) -> str | None:
    """All texts of a column in one; nothing if some is no text, empty, too long or not plain."""
    if not _of_type(values, str) or not all(values) or max(map(len, values)) > longest:
        return None
    joined = "".join(values)
    return joined if joined.isascii() and joined.isprintable() else None


def _token_column(values: list[Any]) -> bool:
    return _short_texts(values, longest=LONGEST_TOKEN) is not None


def _link_column(values: list[Any]) -> bool:
    # Long and odd tokens fail where they lead to no row; an empty one where it must lead to a row.
    return _of_type(values, str)


def _file_column(values: list[Any]) -> bool:
    joined = _short_texts(values, longest=LONGEST_PATH_BYTES)
    if joined is None or ".." in joined or ":" in joined or "\\" in joined:
        return False
    return "/" not in {value[0] for value in values}


def _one_by_one(test: Test) -> ColumnTest:
    return lambda values: all(map(test, values))


def _list_column(values: list[Any]) -> bool:
    return _of_type(values, list) and _of_type(list(chain.from_iterable(values)), str)


FLAG: Final = ValueKind("true or false", lambda value: type(value) is bool, lambda values: _of_type(values, bool))
TEXT: Final = ValueKind("text", _is_text, lambda values: _of_type(values, str) and "".join(values).isascii())
TOKEN: Final = ValueKind("a token: printable text that is not empty", _is_token, _token_column)
LINK: Final = ValueKind("a token", _is_token, _link_column)
LINK_OR_NONE: Final = ValueKind("a token, or empty text", _is_token_or_none, _link_column)
LINKS_OF_LIST: Final = ValueKind("a list of tokens", _are_tokens, _list_column)
NAME: Final = ValueKind(
    f"a name that a file can have on every system: 1 to {LONGEST_NAME_BYTES} bytes of printable text, no separators, "
    "not reserved",
    is_file_name,
    _one_by_one(is_file_name),
)
FILE: Final = ValueKind(
    "the name of a file, relative to the data set's folder and inside it",
    is_file_inside,
    _file_column,
)
TIME: Final = whole_number("a whole number of microseconds between the years 2000 and 2100", EARLIEST_US, LATEST_US)
COUNT: Final = whole_number("a whole number, at least 0", 0, MOST_COUNTED)
POSITION: Final = numbers("three finite numbers, metres within the earth", 3, _within(EARTH_M, EARTH_M, HIGHEST_M))
MOUNTING: Final = numbers("three finite numbers, metres within the car", 3, _within(CAR_M, CAR_M, CAR_M))
ROTATION: Final = numbers("four finite numbers (w, x, y, z) of norm one", 4, _of_norm_one)
SIZE: Final = numbers(f"three numbers from 0 to {LARGEST_M:g} metres", 3, _size)
MATRIX: Final = ValueKind("an empty list or three rows of three numbers", _is_matrix, _one_by_one(_is_matrix))


@dataclass(frozen=True, slots=True)
class TableField:
    """A field of a row; ``target`` is the table whose rows it names by token, empty where it names none."""

    kind: ValueKind
    target: str = ""
    unique: bool = False


@dataclass(frozen=True, slots=True)
class Link:
    """A field that names rows of the table ``target``, or none if it may."""

    table: str
    field: str
    target: str
    may_be_empty: bool


def _chain(table: str) -> dict[str, TableField]:
    return {"prev": TableField(LINK_OR_NONE, table), "next": TableField(LINK_OR_NONE, table)}


_TOKEN: Final = {"token": TableField(TOKEN, unique=True)}

SCHEMA: Final[Mapping[str, Mapping[str, TableField]]] = {
    "attribute": {**_TOKEN, "name": TableField(TEXT, unique=True)},
    "calibrated_sensor": {
        **_TOKEN,
        "sensor_token": TableField(LINK, "sensor"),
        "translation": TableField(MOUNTING),
        "rotation": TableField(ROTATION),
        "camera_intrinsic": TableField(MATRIX),
    },
    "category": {**_TOKEN, "name": TableField(TEXT, unique=True)},
    "ego_pose": {
        **_TOKEN,
        "timestamp": TableField(TIME),
        "translation": TableField(POSITION),
        "rotation": TableField(ROTATION),
    },
    "instance": {
        **_TOKEN,
        "category_token": TableField(LINK, "category"),
        "nbr_annotations": TableField(COUNT),
        "first_annotation_token": TableField(LINK_OR_NONE, "sample_annotation"),
        "last_annotation_token": TableField(LINK_OR_NONE, "sample_annotation"),
    },
    "log": {
        **_TOKEN,
        "logfile": TableField(TEXT),
        "vehicle": TableField(TEXT),
        "date_captured": TableField(TEXT),
        "location": TableField(NAME),
    },
    # The logs that a map lists may be missing: the maps of the official v1.0-mini list logs that only trainval has.
    "map": {
        **_TOKEN,
        "category": TableField(TEXT),
        "filename": TableField(FILE),
        "log_tokens": TableField(LINKS_OF_LIST),
    },
    "sample": {**_TOKEN, "timestamp": TableField(TIME), "scene_token": TableField(LINK, "scene"), **_chain("sample")},
    "sample_annotation": {
        **_TOKEN,
        "sample_token": TableField(LINK, "sample"),
        "instance_token": TableField(LINK, "instance"),
        "visibility_token": TableField(LINK_OR_NONE, "visibility"),
        "attribute_tokens": TableField(LINKS_OF_LIST, "attribute"),
        "translation": TableField(POSITION),
        "size": TableField(SIZE),
        "rotation": TableField(ROTATION),
        "num_lidar_pts": TableField(COUNT),
        "num_radar_pts": TableField(COUNT),
        **_chain("sample_annotation"),
    },
    "sample_data": {
        **_TOKEN,
        "sample_token": TableField(LINK, "sample"),
        "ego_pose_token": TableField(LINK, "ego_pose"),
        "calibrated_sensor_token": TableField(LINK, "calibrated_sensor"),
        "timestamp": TableField(TIME),
        "fileformat": TableField(TEXT),
        "is_key_frame": TableField(FLAG),
        "height": TableField(COUNT),
        "width": TableField(COUNT),
        "filename": TableField(FILE),
        **_chain("sample_data"),
    },
    "scene": {
        **_TOKEN,
        "name": TableField(NAME, unique=True),
        "description": TableField(TEXT),
        "log_token": TableField(LINK, "log"),
        "nbr_samples": TableField(COUNT),
        "first_sample_token": TableField(LINK, "sample"),
        "last_sample_token": TableField(LINK, "sample"),
    },
    "sensor": {**_TOKEN, "channel": TableField(NAME, unique=True), "modality": TableField(TEXT)},
    "visibility": {**_TOKEN, "level": TableField(TEXT)},
}
"""Fields by table and name. What lies beside the tables has its own readers: masks and map expansion, CAN bus."""

LINKS: Final = tuple(
    Link(table, name, field.target, field.kind is LINK_OR_NONE)
    for table, fields in SCHEMA.items()
    for name, field in fields.items()
    if field.target
)
