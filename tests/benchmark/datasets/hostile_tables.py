"""Hostile variants of a valid nuScenes-format root: one small change each, for tests and campaigns."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from tests.benchmark.datasets.nuscenes_tables import VERSION
from tests.benchmark.untrusted.variants import DEEP

NOTHING: Final = object()
"""In place of a value: the field is taken away."""
Damage = Callable[[Path], None]


@dataclass(frozen=True, slots=True)
class HostileRoot:
    """A change of a valid root, and what must be said about it.

    Attributes:
        name: Says what is wrong.
        damage: Changes the root; its tables are in the folder ``v1.0-tiny``.
        table: Table that is blamed.
        words: Regular expression of what is said.
    """

    name: str
    damage: Damage
    table: str
    words: str


def edit(table: str, field: str, value: object, *, row: int = 0) -> Damage:
    """One field of one row gets another value."""

    def act(root: Path) -> None:
        path = root / VERSION / f"{table}.json"
        rows = json.loads(path.read_text())
        if value is NOTHING:
            del rows[row][field]
        else:
            rows[row][field] = value
        path.write_text(json.dumps(rows))

    return act


def edit_all(table: str, field: str, change: Callable[[Any], Any]) -> Damage:
    """One field of all rows is changed."""

    def act(root: Path) -> None:
        path = root / VERSION / f"{table}.json"
        rows = json.loads(path.read_text())
        for row in rows:
            row[field] = change(row[field])
        path.write_text(json.dumps(rows))

    return act


def together(*damages: Damage) -> Damage:
    """Several changes."""

    def act(root: Path) -> None:
        for damage in damages:
            damage(root)

    return act


def raw(table: str, content: str | bytes) -> Damage:
    """Other content of a table's file."""
    data = content if isinstance(content, bytes) else content.encode()

    def act(root: Path) -> None:
        (root / VERSION / f"{table}.json").write_bytes(data)

    return act


def raw_field(table: str, field: str, text: str) -> Damage:
    """One field of the first row, as JSON that no writer would write."""

    def act(root: Path) -> None:
        edit(table, field, "HERE")(root)
        path = root / VERSION / f"{table}.json"
        path.write_text(path.read_text().replace('"HERE"', text))

    return act


def truncate(table: str) -> Damage:
    """The last characters are missing."""

    def act(root: Path) -> None:
        path = root / VERSION / f"{table}.json"
        path.write_text(path.read_text()[:-20])

    return act


def unlink(table: str) -> Damage:
    """The file is missing."""
    return lambda root: (root / VERSION / f"{table}.json").unlink()


def times(change: Callable[[int], Any]) -> Damage:
    """All times of a root are changed."""
    return together(*(edit_all(table, "timestamp", change) for table in ("sample", "sample_data", "ego_pose")))


def slower(factor: float) -> Damage:
    """All that happens takes longer, or less long: keyframes lie farther apart, or nearer to each other."""
    start_us = 1_700_000_000_000_000
    return times(lambda time_us: start_us + round((time_us - start_us) * factor))


def _wrong(table: str, field: str, *values: tuple[str, object]) -> list[HostileRoot]:
    """Values that a field must not hold."""
    words = rf"{table}\.json row [^:]*: {field} is .*, it must be "
    return [
        HostileRoot(f"{table}.{field} is {name}", edit(table, field, value), table, words) for name, value in values
    ]


def _lost(table: str, field: str, target: str, value: object = "gone") -> HostileRoot:
    words = rf"{table}\.json row [^:]*: {field} \"gone\" is not in {target}\.json"
    return HostileRoot(f"{table}.{field} leads nowhere", edit(table, field, value), table, words)


_NAN, _INFINITE = float("nan"), float("inf")
_NO_TIMES: Final = (
    ("text", "1700000000000000"),
    ("seconds", 1_700_000_000),
    ("nanoseconds", 1_700_000_000_000_000_000),
    ("a fraction", 1_700_000_000_000_000.5),
    ("null", None),
    ("true", True),
    ("huge", 10**400),
    ("negative", -5),
)
_NO_POSITIONS: Final = (
    ("text", ["1.0", "2.0", "0.0"]),
    ("two numbers", [1.0, 2.0]),
    ("four numbers", [1.0, 2.0, 0.0, 0.0]),
    ("null", None),
    ("an object", {"x": 1.0, "y": 2.0, "z": 0.0}),
    ("nested", [[1.0, 2.0, 0.0]]),
    ("NaN", [1.0, _NAN, 0.0]),
    ("infinite", [_INFINITE, 2.0, 0.0]),
    ("beyond the earth", [1e300, 2.0, 0.0]),
    ("below the earth", [1.0, 2.0, -1e6]),
    ("flags", [True, False, True]),
    ("huge", [10**400, 2, 0]),
)
_NO_ROTATIONS: Final = (
    ("zero", [0, 0, 0, 0]),
    ("of norm two", [2.0, 0.0, 0.0, 0.0]),
    ("a matrix", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    ("three numbers", [1.0, 0.0, 0.0]),
    ("NaN", [_NAN] * 4),
    ("text", ["1", "0", "0", "0"]),
    ("infinite", [_INFINITE, 0, 0, 0]),
)
_NO_NAMES: Final = (
    ("a surrogate", "scene-\ud800"),
    ("a separator", "a/b"),
    ("a step up", ".."),
    ("a backslash", "a\\b"),
    ("reserved", "COM1"),
    ("reserved, with an ending", "nul.txt"),
    ("empty", ""),
    ("too long", "s" * 101),
    ("a line break", "a\nb"),
    ("a number", 7),
    ("null", None),
    ("ending with a dot", "a."),
    ("a colon", "C:a"),
)
_NO_FILES: Final = (
    ("null", None),
    ("a number", 7),
    ("empty", ""),
    ("absolute", "/etc/passwd"),
    ("outside", "samples/../../a.jpg"),
    ("outside, on Windows", "..\\a.jpg"),
    ("of a drive", "C:\\a.jpg"),
    ("a zero byte", "samples/\0.jpg"),
    ("a surrogate", "samples/\ud800.jpg"),
    ("endless", "a/" * 1000),
)

HOSTILE_ROOTS: Final[tuple[HostileRoot, ...]] = (
    HostileRoot("a table missing", unlink("visibility"), "visibility", r"lacks visibility\.json"),
    HostileRoot("truncated JSON", truncate("sample_data"), "sample_data", r"sample_data\.json is not a JSON list"),
    HostileRoot("an object for a table", raw("sample", '{"a": 1}'), "sample", r"sample\.json is not a JSON list"),
    HostileRoot("a number for a row", raw("sample_annotation", "[3]"), "sample_annotation", "a row is no object"),
    HostileRoot("null for a table", raw("log", "null"), "log", r"log\.json is not a JSON list"),
    HostileRoot("empty", raw("map", b""), "map", r"map\.json is not a JSON list"),
    HostileRoot("no text", raw("scene", b"\xff\xfe["), "scene", r"scene\.json is not a JSON list"),
    HostileRoot("a table nested deeply", raw("sample", DEEP), "sample", r"sample\.json is not a JSON list"),
    HostileRoot(
        "a shared table nested deeply", raw("visibility", f'[{{"token": {DEEP}}}]'), "visibility", "nested too deeply"
    ),
    HostileRoot(
        "a field nested deeply", raw_field("sample_data", "filename", DEEP), "sample_data", "nested too deeply"
    ),
    HostileRoot(
        "a number of many digits", raw_field("sample", "timestamp", "9" * 5000), "sample", "is not a JSON list"
    ),
    HostileRoot("no scenes", raw("scene", "[]"), "scene", r"scene\.json is empty|is not in scene\.json"),
    HostileRoot("no map at all", raw("map", "[]"), "log", "no map has this log"),
    HostileRoot("no map for the log", edit("map", "log_tokens", []), "log", "no map has this log"),
    HostileRoot("mask missing", edit("map", "filename", "maps/none.png"), "map", r"map mask .*none\.png"),
    HostileRoot(
        "a field missing",
        edit("sample_data", "ego_pose_token", NOTHING),
        "sample_data",
        r"sample_data\.json row scene-9901-LIDAR_TOP-0: the field ego_pose_token is missing",
    ),
    HostileRoot("not a token", edit("log", "token", NOTHING), "log", r"log\.json: row 0: the field token is missing"),
    HostileRoot("an empty token", edit("ego_pose", "token", ""), "ego_pose", r"row 0: token is \"\", it must be"),
    HostileRoot(
        "a token with a surrogate", edit("instance", "token", "\udfff"), "instance", r"token is \"\\udfff\", it must be"
    ),
    HostileRoot("a token that is a list", edit("sample", "token", ["a"]), "sample", r"token is \[\"a\"\], it must be"),
    HostileRoot(
        "a token twice",
        edit("ego_pose", "token", "scene-9901-LIDAR_TOP-1"),
        "ego_pose",
        "row scene-9901-LIDAR_TOP-1: two rows have this token",
    ),
    _lost("sample_annotation", "instance_token", "instance"),
    _lost("sample_annotation", "sample_token", "sample"),
    _lost("sample_annotation", "attribute_tokens", "attribute", ["gone"]),
    _lost("sample_annotation", "visibility_token", "visibility"),
    _lost("sample_data", "sample_token", "sample"),
    _lost("sample_data", "ego_pose_token", "ego_pose"),
    _lost("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
    _lost("sample_data", "next", "sample_data"),
    _lost("sample", "next", "sample"),
    _lost("sample", "scene_token", "scene"),
    _lost("scene", "log_token", "log"),
    _lost("scene", "first_sample_token", "sample"),
    _lost("calibrated_sensor", "sensor_token", "sensor"),
    _lost("instance", "category_token", "category"),
    *_wrong("sample", "timestamp", *_NO_TIMES),
    *_wrong("sample_data", "timestamp", *_NO_TIMES),
    *_wrong("ego_pose", "timestamp", ("text", "1700000000000000")),
    *_wrong("ego_pose", "translation", *_NO_POSITIONS),
    *_wrong("sample_annotation", "translation", *_NO_POSITIONS),
    *_wrong("calibrated_sensor", "translation", ("outside the car", [1e4, 0.0, 0.0])),
    *_wrong("ego_pose", "rotation", *_NO_ROTATIONS),
    *_wrong("sample_annotation", "rotation", *_NO_ROTATIONS),
    *_wrong("calibrated_sensor", "rotation", *_NO_ROTATIONS),
    *_wrong(
        "sample_annotation",
        "size",
        ("negative", [-1.0, 4.0, 2.0]),
        ("words", ["a", "b", "c"]),
        ("a mountain", [1.0, 1e5, 2.0]),
    ),
    *_wrong(
        "sample_annotation", "visibility_token", ("a number", 4), ("a list", ["4"]), ("null", None), ("an object", {})
    ),
    *_wrong(
        "sample_annotation", "num_lidar_pts", ("negative", -1), ("a fraction", 1.5), ("text", "3"), ("huge", 10**30)
    ),
    *_wrong("sample_annotation", "attribute_tokens", ("text", "att-vehicle.moving"), ("nested", [["a"]])),
    *_wrong("sample_data", "is_key_frame", ("text", "true"), ("a number", 1), ("null", None)),
    *_wrong("sample_data", "filename", *_NO_FILES),
    *_wrong("sample_data", "width", ("text", "16"), ("null", None), ("negative", -16)),
    *_wrong("map", "filename", *_NO_FILES),
    *_wrong("scene", "name", *_NO_NAMES),
    *_wrong("scene", "description", ("a surrogate", "\ud800"), ("null", None)),
    *_wrong("log", "location", ("a step up", "../../secret"), ("null", None)),
    *_wrong("sensor", "channel", ("a separator", "CAM/FRONT"), ("a list", [])),
    *_wrong(
        "calibrated_sensor",
        "camera_intrinsic",
        ("a number", 3),
        ("two rows", [[1, 0, 0], [0, 1, 0]]),
        ("huge", [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]]),
    ),
    *_wrong("visibility", "level", ("a number", 4)),
    *_wrong("category", "name", ("null", None)),
    HostileRoot("all times in nanoseconds", times(lambda time: time * 1000), "sample", "timestamp is .* it must be"),
    HostileRoot("all times in seconds", times(lambda time: time // 10**6), "sample", "timestamp is .* it must be"),
    HostileRoot(
        "samples out of order",
        edit("sample", "timestamp", 1_700_000_000_000_001, row=2),
        "sample",
        "is not later",
    ),
    HostileRoot(
        "a wrong count of samples", edit("scene", "nbr_samples", 7), "scene", "nbr_samples is 7, but the scene has"
    ),
    HostileRoot(
        "a camera without matrix",
        edit("calibrated_sensor", "camera_intrinsic", [], row=1),
        "calibrated_sensor",
        "camera_intrinsic of CAM_FRONT is not a 3 x 3 matrix",
    ),
)
