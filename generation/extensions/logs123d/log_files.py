"""The door through which 123D logs come in: which logs there are, their columns, images and maps, all checked.

Files are taken apart by a child process (`child_reader`), within limits; what it answers is checked here once more.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.scenario_map import FARTHEST_M
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.extension import require_package
from benchmark.untrusted.children import read_in_child
from benchmark.untrusted.files import (
    GIB,
    MAP_POINTS,
    MIB,
    RECORDED_OBJECTS,
    RECORDING_S,
    Limits,
    to_one_line,
)

NEEDS_A_PACKAGE: Final = (
    "reading 123D logs needs the package msgpack, which is not installed; install it with: "
    "pip install 'challenger-bench[123d]'"
)
KNOWN_VERSIONS: Final = re.compile(r"0\.7\.\d+")
"""Of py123d, which wrote a log: the form has no version of its own."""
LOG_FILE: Final = Limits(
    "file of a 123D log", 64 * GIB, depth=32, values=8 * MAP_POINTS, content_bytes=512 * MIB, cpu_s=60, clock_s=180.0
)
EGO, BOXES, SYNC, LIDAR, CAMERA = "ego_state_se3", "box_detections_se3", "sync", "lidar", "camera"
_KNOWN: Final = (
    EGO, BOXES, SYNC, LIDAR, CAMERA, "traffic_light_detections", "camera_semantic", "camera_instance", "camera_depth",
    "radar", "imu", "gnss", "barometer", "magnetometer", "route_position", "custom", "map",
)  # fmt: skip
_CHILD: Final = "generation.extensions.logs123d.child_reader"
_CHUNK_BYTES: Final = 32 * MIB
_VIDEO_CHUNK: Final = 64
_AGAIN: Final = "it is damaged or cut short, convert the log again"


def find_logs(folder: Path) -> tuple[Path, ...]:
    """Folders with a ``sync.arrow``, at any depth, sorted; one without is a conversion that was broken off."""
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; give a folder of 123D logs (DATA/logs) or one log")
    found = tuple(sorted(path.parent for path in folder.rglob("sync.arrow") if path.is_file()))
    if not found:
        raise InputError(f"{folder} has no 123D logs (folders with sync.arrow); give the folder DATA/logs")
    return found


@dataclass(frozen=True, slots=True)
class Table:
    """One file of a log: rows, rows of each record batch, metadata, columns, and the type of each column."""

    path: Path
    rows: int
    batches: tuple[int, ...]
    metadata: Mapping[str, Any]
    columns: Mapping[str, Any]
    types: Mapping[str, str]

    def times_us(self) -> NDArray[np.int64]:
        """(R,) times of the rows."""
        times = self.numbers("timestamp_us")
        if (np.diff(times) < 0).any() or (times < 0).any():
            raise self.damaged("its times go back, or are missing")
        return times

    def numbers(self, name: str) -> NDArray[np.int64]:
        """(R,) whole numbers, -1 for nothing."""
        return np.asarray(self._column(name, np.ndarray, 1), np.int64)

    def poses(self, name: str, width: int = 7) -> Floats:
        """(R, width) numbers, NaN in rows that have nothing; poses have rotations that are some."""
        values = np.asarray(self._column(name, np.ndarray, 2), np.float64)
        if values.shape[1] != width:
            raise self.damaged(f"its {name} has {values.shape[1]} numbers a row, not {width}")
        return self.require_poses(values, name) if width == 7 else values

    def require_poses(self, values: Floats, name: str) -> Floats:
        """Refuse poses, (N, 7) and more, that are no places in the world or no rotations; rows of NaN are none."""
        known = values[~np.isnan(values).all(axis=1)]
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.linalg.norm(known[:, 3:7], axis=1)
        if not np.isfinite(known).all() or (np.abs(known[:, :3]) > FARTHEST_M).any():
            raise self.damaged(f"its {name} holds numbers that are not finite, or no place on earth")
        if (np.abs(length - 1.0) > 1e-2).any():
            raise self.damaged(f"its {name} holds rotations that are none")
        return values

    def pose(self, name: str) -> Floats:
        """(7,) pose in the metadata."""
        return to_pose(self.metadata.get(name), f"{self.path}: its {name}")

    def number(self, name: str) -> float:
        """A finite number of the metadata that is not negative."""
        value = self.metadata.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e6:
            raise self.damaged(f"its {name} is {to_one_line(repr(value), 40)}, not a number")
        return float(value)

    def damaged(self, why: str) -> InputError:
        """The sentence on this file."""
        return InputError(f"{self.path} cannot be used: {why}; {_AGAIN}")

    def _column(self, name: str, kind: type, dimensions: int) -> Any:
        values = self.columns.get(name)
        if not isinstance(values, kind) or np.ndim(values) != dimensions or len(values) != self.rows:  # type: ignore[arg-type]
            raise self.damaged(f"it lacks the column {name}, or it is of another type")
        return values


def to_pose(value: Any, where: str) -> Floats:
    """(7,) pose of foreign metadata."""
    fits = isinstance(value, list) and len(value) == 7 and all(type(number) in (int, float) for number in value)
    pose = np.array(value, np.float64) if fits else np.full(7, np.nan)
    if not np.isfinite(pose).all() or np.abs(pose[:3]).max() > 1000.0 or abs(np.linalg.norm(pose[3:]) - 1.0) > 1e-2:
        raise InputError(f"{where} is {to_one_line(repr(value), 60)}, not a pose; {_AGAIN}")
    return pose


@dataclass(frozen=True, slots=True)
class LogTables:
    """A log that was read but for images and map.

    Attributes:
        folder: Where it lies.
        sync: Its frames.
        others: Files of known modalities that are used, by key.
        unused: Keys of the others, which nuScenes tables have no place for.
    """

    folder: Path
    sync: Table
    others: Mapping[str, Table]
    unused: tuple[str, ...]

    def text(self, name: str) -> str:
        """A word of the log's metadata, empty for none; a name that could be a file's."""
        value = self.sync.metadata.get(name)
        if value is None:
            return ""
        if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,149}", value):
            raise self.sync.damaged(f"its {name} is {to_one_line(repr(value), 60)}, which is no name")
        return value

    @property
    def title(self) -> str:
        """Split and name."""
        return f"{self.text('split')}/{self.text('log_name')}"

    @property
    def cameras(self) -> list[str]:
        """Keys of cameras, sorted."""
        return sorted(key for key in self.others if key.startswith(f"{CAMERA}."))

    def times_us(self) -> NDArray[np.int64]:
        """(F,) times of the frames, which rise."""
        times = self.sync.times_us()
        if len(times) < 2 or not (np.diff(times) > 0).all():
            raise self.sync.damaged(f"it has {len(times)} frames, or two at one time")
        if times[-1] - times[0] > RECORDING_S * 1e6:
            raise self.sync.damaged(f"it lasts longer than {RECORDING_S:g} s")
        return times

    def rows_of(self, key: str) -> NDArray[np.int64]:
        """(F,) row of a modality's file for each frame, -1 for none."""
        if key not in self.sync.columns:
            return np.full(self.sync.rows, -1, np.int64)
        rows = self.sync.numbers(key)
        if rows.max(initial=-1) >= self.others[key].rows or rows.min(initial=-1) < -1:
            raise self.sync.damaged(f"a frame names row {rows.max()} of {key}, which has {self.others[key].rows}")
        return rows


def read_log(folder: Path) -> LogTables:
    """Read a log but for images and map; a modality or a version that is not known is refused by name."""
    require_package("msgpack", NEEDS_A_PACKAGE)
    keys = sorted(path.stem for path in folder.glob("*.arrow") if path.is_file())
    for key in keys:
        if key.partition(".")[0] not in _KNOWN or not re.fullmatch(r"[A-Za-z0-9_]+(\.[A-Za-z0-9_-]+)*", key):
            raise InputError(
                f"{folder} holds the modality {to_one_line(key, 60)}, which 123D {KNOWN_VERSIONS.pattern[:1]}.7 does "
                "not have; remove the file, or convert the log with py123d 0.7"
            )
    read = [key for key in keys if key in (SYNC, EGO, BOXES) or key.partition(".")[0] in (LIDAR, CAMERA)]
    tables = _read_tables(folder, read)
    sync = tables.pop(SYNC)
    version = sync.metadata.get("version")
    if not isinstance(version, str) or not KNOWN_VERSIONS.fullmatch(version):
        raise InputError(
            f"{sync.path} was written by py123d {to_one_line(repr(version), 40)}; only 0.7 is known here: convert "
            "the log with it"
        )
    for key in sync.columns:
        is_used = key in (EGO, BOXES) or key.startswith(f"{CAMERA}.")
        if is_used and key not in tables and (sync.numbers(key) >= 0).any():
            raise InputError(f"{folder} has no file {key}.arrow, of which its frames name rows; convert the log again")
    unused = [key for key in keys if key not in read and key not in ("map", SYNC)]
    log = LogTables(folder, sync, tables, tuple(unused))
    for name in ("split", "log_name", "dataset"):
        if not log.text(name):
            raise sync.damaged(f"its metadata says no {name}")
    if EGO not in tables:
        raise InputError(f"{folder} has no {EGO}.arrow; a scene needs its ego, choose other logs with --scenes")
    return log


def _read_tables(folder: Path, keys: Sequence[str]) -> dict[str, Table]:
    files = [f"{key}.arrow" for key in keys]
    request = json.dumps({"folder": str(folder.resolve()), "files": files})
    answers = _ask(folder / "sync.arrow", "read_tables", request)
    tables = {}
    for key, name in zip(keys, files, strict=True):
        answer, path = answers[name], folder / name
        if "error" in answer:
            raise InputError(f"{path} cannot be read ({to_one_line(answer['error'])}); {_AGAIN}")
        if not isinstance(answer["metadata"], dict):
            raise InputError(f"{path} cannot be read (its metadata is no map); {_AGAIN}")
        tables[key] = Table(
            path, answer["rows"], tuple(answer["batches"]), answer["metadata"], answer["columns"], answer["types"]
        )
    return tables


def _ask(path: Path, reader: str, request: str, limits: Limits = LOG_FILE) -> Any:
    answer = read_in_child(path, f"{_CHILD}:{reader}", limits, request)
    if answer.kind != "value":
        raise InputError(f"{path} cannot be read ({to_one_line(': '.join(map(str, answer.parts[1:])))}); {_AGAIN}")
    return answer.parts[0]


@dataclass(frozen=True, slots=True)
class BoxRows:
    """Boxes of all rows of a log, one after the other.

    Attributes:
        row: (B,) row of the file.
        box: (B, 10) centre, quaternion, length, width, height, in the world.
        track: B names.
        label: (B,) codes.
        velocity: (B, 3) m/s in the world, NaN for none.
        points: (B,) lidar points, -1 for none known.
    """

    row: NDArray[np.int64]
    box: Floats
    track: list[str]
    label: NDArray[np.int64]
    velocity: Floats
    points: NDArray[np.int64]


def read_boxes(table: Table) -> BoxRows:
    """The boxes of a log; lists of different lengths, and boxes that are none, are refused."""
    lists = {}
    for name in ("bounding_box_se3", "track_token", "label", "velocity_3d", "num_lidar_points"):
        found = table.columns.get(name)
        if isinstance(found, dict) and len(found["lengths"]) == table.rows:
            lists[name] = found
        elif found is not None or name in ("bounding_box_se3", "track_token", "label"):
            raise table.damaged(f"it lacks the column {name}, or it is of another type")
    lengths = lists["bounding_box_se3"]["lengths"]
    for name, found in lists.items():
        optional = name in ("velocity_3d", "num_lidar_points")
        same = found["lengths"] == lengths
        if not (same | (optional & ~found["known"])).all():
            raise table.damaged(f"row {int(np.argmin(same))} has {name} of another length than boxes")
    count, box = int(lengths.sum()), np.asarray(lists["bounding_box_se3"]["values"], np.float64)
    tracks = lists["track_token"]["values"]
    if box.shape != (count, 10) or not isinstance(tracks, list) or np.isnan(box).any():
        raise table.damaged("its boxes are not ten numbers each")
    table.require_poses(box, "bounding_box_se3")
    if ((box[:, 7:] <= 0) | (box[:, 7:] > 1000)).any():
        raise table.damaged("a box has a side that is not positive, or longer than a kilometre")
    if len(set(tracks)) > RECORDED_OBJECTS or not all(isinstance(one, str) and one.isprintable() for one in tracks):
        raise table.damaged(f"it has more than {RECORDED_OBJECTS} tracks, or names that cannot be printed")
    return BoxRows(
        np.repeat(np.arange(table.rows), lengths),
        box,
        tracks,
        np.asarray(lists["label"]["values"], np.int64),
        _spread(lists.get("velocity_3d"), lengths, np.full((count, 3), np.nan)),
        _spread(lists.get("num_lidar_points"), lengths, np.full(count, -1, np.int64)),
    )


def _spread(found: Any, lengths: NDArray[np.int64], nothing: Any) -> Any:
    """Values of a column some of whose rows have nothing; (B, ...) with ``nothing`` there."""
    if found is not None:
        nothing[np.repeat(found["known"] & (found["lengths"] == lengths), lengths)] = found["values"]
    return nothing


@dataclass(frozen=True, slots=True)
class MapObject:
    """An object of a map: its features, and as WKB its surface or line, planar."""

    layer: int
    identifier: int
    features: Mapping[str, Any]
    wkb: bytes


def read_map_objects(
    path: Path, bounds: tuple[float, float, float, float] | None = None
) -> tuple[Mapping[str, Any], list[MapObject]]:
    """Metadata and objects of a map file, those that touch ``bounds``, x and y twice in metres, or all."""
    require_package("msgpack", NEEDS_A_PACKAGE)
    answer = _ask(path, "read_map", json.dumps({"bounds": bounds}))
    return answer["metadata"], [MapObject(*given) for given in answer["objects"]]


def find_map(log: LogTables, maps: Path | None) -> Path | None:
    """The map of a log: its own, else that of its place below ``maps``, else none."""
    own = log.folder / "map.arrow"
    if own.exists() or own.is_symlink():
        return own
    place = f"{log.text('dataset')}_{log.text('location')}.arrow"
    shared = None if maps is None or not log.text("location") else maps / log.text("dataset") / place
    return shared if shared is not None and shared.is_file() else None


def list_images(log: LogTables, wanted: Sequence[tuple[str, int]]) -> Iterator[bytes]:
    """Bytes of images in the files, by key of the camera and row, in that order; some megabytes at a time."""
    waiting: list[tuple[str, int, int]] = []
    size = 0.0
    for key, row in wanted:
        table = log.others[key]
        starts = np.cumsum([0, *table.batches])
        batch = int(np.searchsorted(starts, row, side="right")) - 1
        waiting.append((key, batch, row - int(starts[batch])))
        size += table.path.stat().st_size / max(1, table.rows)
        if size > _CHUNK_BYTES:
            yield from _read_chunk(log, waiting)
            waiting, size = [], 0.0
    if waiting:
        yield from _read_chunk(log, waiting)


def _read_chunk(log: LogTables, rows: Sequence[tuple[str, int, int]]) -> list[bytes]:
    grouped: list[tuple[str, int, list[int]]] = []
    for key, batch, row in rows:
        if not grouped or grouped[-1][:2] != (f"{key}.arrow", batch):
            grouped.append((f"{key}.arrow", batch, []))
        grouped[-1][2].append(row)
    request = json.dumps({"folder": str(log.folder.resolve()), "wanted": grouped})
    images = _ask(log.folder / "sync.arrow", "read_images", request)
    for (key, _, row), image in zip(rows, images, strict=True):
        if not isinstance(image, bytes) or not image:
            raise log.others[key].damaged(f"row {row} of a batch has no image")
    return list(images)


def list_video_images(path: Path, frames: Sequence[int]) -> Iterator[bytes]:
    """JPEG bytes of frames of a video, by their rising numbers, decoded in a child process."""
    require_package(
        "av",
        f"{path} holds images as video, which needs PyAV; install it with: pip install 'challenger-bench[video]'",
    )
    limits = replace(LOG_FILE, what="video", memory_bytes=2 * GIB, cpu_s=120, clock_s=300.0, values=64_000_000)
    for first in range(0, len(frames), _VIDEO_CHUNK):
        part = list(frames[first : first + _VIDEO_CHUNK])
        images = _ask(path, "read_video", json.dumps({"frames": part}), limits)
        if len(images) != len(part):
            raise InputError(f"{path} has no frame {part[len(images)]}, which its log names; {_AGAIN}")
        yield from images
