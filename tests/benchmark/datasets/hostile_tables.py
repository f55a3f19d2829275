"""Hostile variants of a valid nuScenes-format root: one small change each, for tests and campaigns."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import starmap
from pathlib import Path
from typing import Any, Final

from tests.benchmark.datasets.nuscenes_tables import VERSION
from tests.benchmark.untrusted.variants import DEEP

NOTHING: Final = object()
"""In place of a value: the field is taken away."""
Damage = Callable[[Path], None]


@dataclass(frozen=True, slots=True)
class HostileRoot:
    """A change of a valid root with tables in ``v1.0-tiny``, the table that is blamed and a pattern of what is said."""

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


def content(table: str, change: Callable[[bytes], bytes]) -> Damage:
    """Other content of a table's file."""

    def act(root: Path) -> None:
        path = root / VERSION / f"{table}.json"
        path.write_bytes(change(path.read_bytes()))

    return act


def raw(table: str, data: bytes) -> Damage:
    """This as a table's file."""
    return content(table, lambda _: data)


def raw_field(table: str, field: str, text: str) -> Damage:
    """One field of the first row, as JSON that no writer would write."""
    return together(edit(table, field, "HERE"), content(table, lambda data: data.replace(b'"HERE"', text.encode())))


def times(change: Callable[[int], Any]) -> Damage:
    """All times of a root are changed."""
    return together(*(edit_all(table, "timestamp", change) for table in ("sample", "sample_data", "ego_pose")))


def slower(factor: float) -> Damage:
    """All that happens takes longer, or less long: keyframes lie farther apart, or nearer to each other."""
    start_us = 1_700_000_000_000_000
    return times(lambda time_us: start_us + round((time_us - start_us) * factor))


_NAN, _INFINITE = float("nan"), float("inf")
Values = dict[str, object]
_NO_TIMES: Final[Values] = {
    "text": "1700000000000000", "seconds": 1_700_000_000, "nanoseconds": 1_700_000_000_000_000_000,
    "a fraction": 1_700_000_000_000_000.5, "null": None, "true": True, "huge": 10**400, "negative": -5,
}  # fmt: skip
_NO_POSITIONS: Final[Values] = {
    "text": ["1.0", "2.0", "0.0"], "NaN": [1.0, _NAN, 0.0], "two numbers": [1.0, 2.0],
    "four numbers": [1.0, 2.0, 0.0, 0.0], "null": None, "an object": {"x": 1.0, "y": 2.0, "z": 0.0},
    "nested": [[1.0, 2.0, 0.0]], "infinite": [_INFINITE, 2.0, 0.0], "beyond the earth": [1e300, 2.0, 0.0],
    "below the earth": [1.0, 2.0, -1e6], "flags": [True, False, True], "huge": [10**400, 2, 0],
}  # fmt: skip
_NO_ROTATIONS: Final[Values] = {
    "zero": [0, 0, 0, 0], "of norm two": [2.0, 0.0, 0.0, 0.0], "three numbers": [1.0, 0.0, 0.0], "NaN": [_NAN] * 4,
    "a matrix": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "text": ["1", "0", "0", "0"],
    "infinite": [_INFINITE, 0, 0, 0],
}  # fmt: skip
_NO_NAMES: Final[Values] = {
    "a surrogate": "scene-\ud800", "a separator": "a/b", "a step up": "..", "a backslash": "a\\b", "reserved": "COM1",
    "reserved, with an ending": "nul.txt", "empty": "", "too long": "s" * 101, "a line break": "a\nb", "a number": 7,
    "null": None, "ending with a dot": "a.", "a colon": "C:a",
}  # fmt: skip
_NO_FILES: Final[Values] = {
    "null": None, "outside": "samples/../../a.jpg", "a number": 7, "empty": "", "absolute": "/etc/passwd",
    "outside, on Windows": "..\\a.jpg", "of a drive": "C:\\a.jpg", "a zero byte": "samples/\0.jpg",
    "a surrogate": "samples/\ud800.jpg", "endless": "a/" * 1000,
}  # fmt: skip


def _two(values: Values) -> Values:
    """Enough for a field that is checked as another one, which gets all of them."""
    return dict(list(values.items())[:2])


_WRONG: Final[dict[tuple[str, str], Values]] = {
    ("sample", "timestamp"): _NO_TIMES,
    ("sample_data", "timestamp"): _two(_NO_TIMES),
    ("ego_pose", "timestamp"): _two(_NO_TIMES),
    ("ego_pose", "translation"): _NO_POSITIONS,
    ("sample_annotation", "translation"): _two(_NO_POSITIONS),
    ("calibrated_sensor", "translation"): {"outside the car": [1e4, 0.0, 0.0]},
    ("ego_pose", "rotation"): _NO_ROTATIONS,
    ("sample_annotation", "rotation"): _two(_NO_ROTATIONS),
    ("calibrated_sensor", "rotation"): _two(_NO_ROTATIONS),
    ("sample_annotation", "size"): {
        "negative": [-1.0, 4.0, 2.0], "words": ["a", "b", "c"], "a mountain": [1.0, 1e5, 2.0]
    },
    ("sample_annotation", "visibility_token"): {"a number": 4, "a list": ["4"], "null": None, "an object": {}},
    ("sample_annotation", "num_lidar_pts"): {"negative": -1, "a fraction": 1.5, "text": "3", "huge": 10**30},
    ("sample_annotation", "attribute_tokens"): {"text": "att-vehicle.moving", "nested": [["a"]]},
    ("sample_data", "is_key_frame"): {"text": "true", "a number": 1, "null": None},
    ("sample_data", "filename"): _NO_FILES,
    ("sample_data", "width"): {"text": "16", "null": None, "negative": -16},
    ("map", "filename"): _two(_NO_FILES),
    ("scene", "name"): _NO_NAMES,
    ("scene", "description"): {"a surrogate": "\ud800", "null": None},
    ("log", "location"): {"a step up": "../../secret", "null": None},
    ("sensor", "channel"): {"a separator": "CAM/FRONT", "a list": []},
    ("calibrated_sensor", "camera_intrinsic"): {
        "a number": 3, "two rows": [[1, 0, 0], [0, 1, 0]], "huge": [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]]
    },
    ("visibility", "level"): {"a number": 4},
    ("category", "name"): {"null": None},
}  # fmt: skip
"""Values that a field must not hold."""
_LEADS_TO: Final = {
    "sample_annotation.instance_token": "instance", "sample_annotation.sample_token": "sample",
    "sample_annotation.attribute_tokens": "attribute", "sample_annotation.visibility_token": "visibility",
    "sample_data.sample_token": "sample", "sample_data.ego_pose_token": "ego_pose",
    "sample_data.calibrated_sensor_token": "calibrated_sensor", "sample_data.next": "sample_data",
    "sample.next": "sample", "sample.scene_token": "scene", "scene.log_token": "log",
    "scene.first_sample_token": "sample", "calibrated_sensor.sensor_token": "sensor",
    "instance.category_token": "category",
}  # fmt: skip
_NO_LIST: Final = "is not a JSON list"
_BROKEN: Final[tuple[tuple[str, Damage, str, str], ...]] = (
    ("a table missing", lambda root: (root / VERSION / "visibility.json").unlink(), "visibility",
     r"lacks visibility\.json"),
    ("truncated JSON", content("sample_data", lambda data: data[:-20]), "sample_data", f"sample_data.json {_NO_LIST}"),
    ("an object for a table", raw("sample", b'{"a": 1}'), "sample", rf"sample\.json {_NO_LIST}"),
    ("a number for a row", raw("sample_annotation", b"[3]"), "sample_annotation", "a row is no object"),
    ("null for a table", raw("log", b"null"), "log", rf"log\.json {_NO_LIST}"),
    ("empty", raw("map", b""), "map", rf"map\.json {_NO_LIST}"),
    ("no text", raw("scene", b"\xff\xfe["), "scene", rf"scene\.json {_NO_LIST}"),
    ("a table nested deeply", raw("sample", DEEP.encode()), "sample", rf"sample\.json {_NO_LIST}"),
    ("a shared table nested deeply", raw_field("visibility", "token", DEEP), "visibility", "nested too deeply"),
    ("a field nested deeply", raw_field("sample_data", "filename", DEEP), "sample_data", "nested too deeply"),
    ("a number of many digits", raw_field("sample", "timestamp", "9" * 5000), "sample", _NO_LIST),
    ("no scenes", raw("scene", b"[]"), "scene", r"scene\.json is empty|is not in scene\.json"),
    ("no map at all", raw("map", b"[]"), "log", "no map has this log"),
    ("no map for the log", edit("map", "log_tokens", []), "log", "no map has this log"),
    ("mask missing", edit("map", "filename", "maps/none.png"), "map", r"map mask .*none\.png"),
    ("a field missing", edit("sample_data", "ego_pose_token", NOTHING), "sample_data",
     r"sample_data\.json row scene-9901-LIDAR_TOP-0: the field ego_pose_token is missing"),
    ("not a token", edit("log", "token", NOTHING), "log", r"log\.json: row 0: the field token is missing"),
    ("an empty token", edit("ego_pose", "token", ""), "ego_pose", r"row 0: token is \"\", it must be"),
    ("a token with a surrogate", edit("instance", "token", "\udfff"), "instance", r"token is \"\\udfff\", it must be"),
    ("a token that is a list", edit("sample", "token", ["a"]), "sample", r"token is \[\"a\"\], it must be"),
    ("a token twice", edit("ego_pose", "token", "scene-9901-LIDAR_TOP-1"), "ego_pose",
     "row scene-9901-LIDAR_TOP-1: two rows have this token"),
    ("all times in nanoseconds", times(lambda time: time * 1000), "sample", "timestamp is .* it must be"),
    ("all times in seconds", times(lambda time: time // 10**6), "sample", "timestamp is .* it must be"),
    ("samples out of order", edit("sample", "timestamp", 1_700_000_000_000_001, row=2), "sample", "is not later"),
    ("a wrong count of samples", edit("scene", "nbr_samples", 7), "scene", "nbr_samples is 7, but the scene has"),
    ("a camera without matrix", edit("calibrated_sensor", "camera_intrinsic", [], row=1), "calibrated_sensor",
     "camera_intrinsic of CAM_FRONT is not a 3 x 3 matrix"),
)  # fmt: skip


def _list_roots() -> Iterator[HostileRoot]:
    yield from starmap(HostileRoot, _BROKEN)
    for place, target in _LEADS_TO.items():
        table, field = place.split(".")
        words = rf"{table}\.json row [^:]*: {field} \"gone\" is not in {target}\.json"
        damage = edit(table, field, ["gone"] if field == "attribute_tokens" else "gone")
        yield HostileRoot(f"{place} leads nowhere", damage, table, words)
    for (table, field), values in _WRONG.items():
        words = rf"{table}\.json row [^:]*: {field} is .*, it must be "
        for name, value in values.items():
            yield HostileRoot(f"{table}.{field} is {name}", edit(table, field, value), table, words)


HOSTILE_ROOTS: Final = tuple(_list_roots())
