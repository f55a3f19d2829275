"""Taking apart files of a 123D log, in the child process of `benchmark.untrusted` alone.

What comes out is plain arrays, texts and bytes of checked types. Every record batch is validated whole before a value
of it is looked at; what lengths and offsets claim costs no more than the child may have.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from benchmark.untrusted.answers import UnencodableValueError
from benchmark.untrusted.files import RECORDED_POSES, Limits, open_file, to_one_line

if TYPE_CHECKING:
    import pyarrow as pa

MOST_ROWS: Final = 400_000
"""An hour at 100 Hz."""
MOST_COLUMNS: Final = 64
MOST_MAP_OBJECTS: Final = 400_000
MOST_TEXT: Final = 4096
POSE, BOX, VECTOR, DYNAMICS = 7, 10, 3, 9
"""Numbers of a pose, a box, a velocity, and of velocity, acceleration and turning together."""


def read_tables(stream: BinaryIO, limits: Limits, request: str) -> dict[str, Any]:
    """Columns of files of a log, by name: ``{folder, files}`` is asked for; ``sync.arrow`` is ``stream``.

    A file that is refused is ``{"error": why}``; the others are read all the same.
    """
    asked = json.loads(request)
    answers: dict[str, Any] = {}
    for name in asked["files"]:
        try:
            with open_file(Path(asked["folder"]) / name, limits) as file:
                answers[name] = _read_table(name.removesuffix(".arrow"), file)
        except MemoryError:
            answers[name] = {"error": "it takes too much memory"}
        except Exception as error:
            answers[name] = {"error": to_one_line(error) or type(error).__name__}
    return answers


def _read_table(key: str, stream: BinaryIO) -> dict[str, Any]:
    import pyarrow as pa

    file = pa.ipc.open_file(stream)
    schema = file.schema
    if len(schema) > MOST_COLUMNS or len(set(schema.names)) < len(schema):
        raise ValueError(f"it has {len(schema)} columns, or two of the same name")
    modality = key.partition(".")[0]
    wanted = [name for name in schema.names if _is_wanted(modality, name, schema.field(name).type)]
    options = pa.ipc.IpcReadOptions(use_threads=False, included_fields=[schema.get_field_index(one) for one in wanted])
    stream.seek(0)
    file = pa.ipc.open_file(stream, options=options)
    batches, rows = [], 0
    for number in range(file.num_record_batches):
        batch = file.get_batch(number)
        batch.validate(full=True)
        rows += len(batch)
        if rows > MOST_ROWS:
            raise ValueError(f"it has more than {MOST_ROWS} rows")
        batches.append(batch)
    table = pa.Table.from_batches(batches, schema=pa.schema([schema.field(name) for name in wanted])).combine_chunks()
    columns = {name.removeprefix(f"{key}."): _read_column(table.column(name), name) for name in wanted}
    return {
        "rows": rows,
        "batches": [len(batch) for batch in batches],
        "metadata": read_metadata(schema),
        "columns": columns,
        "types": {name.removeprefix(f"{key}."): _name_type(schema.field(name).type) for name in schema.names},
    }


def _is_wanted(modality: str, name: str, kind: "pa.DataType") -> bool:
    """Whether a column is read: not images (`read_images`), identifiers, and what nothing is made of."""
    last = name.rpartition(".")[2]
    if modality == "sync":
        return last != "uuid"
    if modality == "camera":
        return last in ("timestamp_us", "camera_to_global_se3") or (last == "data" and _name_type(kind) != "binary")
    return last in _COLUMNS.get(modality, ("timestamp_us",))


_COLUMNS: Final = {
    "ego_state_se3": ("timestamp_us", "imu_se3", "dynamic_state_se3"),
    "box_detections_se3": (
        "timestamp_us", "bounding_box_se3", "track_token", "label", "velocity_3d", "num_lidar_points",
    ),
}  # fmt: skip


def read_metadata(schema: "pa.Schema") -> Any:
    """What a file says of itself, a map in MessagePack."""
    import msgpack

    packed = (schema.metadata or {}).get(b"metadata")
    if packed is None:
        raise ValueError("its schema has no metadata")
    if len(packed) > 1 << 24:
        raise ValueError(f"its metadata has {len(packed)} bytes")
    return msgpack.unpackb(packed, raw=False, strict_map_key=False)


def _name_type(kind: "pa.DataType") -> str:
    import pyarrow as pa

    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        return "binary"
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return "string"
    return str(kind)


def _read_column(column: "pa.ChunkedArray", name: str) -> Any:
    """One column: whole numbers with -1 for nothing, rows of numbers with NaN, lists as lengths and values."""
    import pyarrow as pa

    array = column.chunk(0) if column.num_chunks else pa.array([], column.type)
    kind = array.type
    if pa.types.is_integer(kind):
        return array.cast(pa.int64()).fill_null(-1).to_numpy(zero_copy_only=False)
    if pa.types.is_fixed_size_list(kind):
        return _read_rows(array, name)
    if _name_type(kind) == "string":
        _require_short_texts(array, name)
        return array.to_pylist()
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        return _read_lists(array, name)
    raise ValueError(f"its column {name} is {kind}, which is not known")


def _read_rows(array: Any, name: str) -> Any:
    import numpy as np
    import pyarrow as pa

    width = array.type.list_size
    if not pa.types.is_floating(array.type.value_type) or width not in (POSE, BOX, VECTOR, DYNAMICS):
        raise ValueError(f"its column {name} is {array.type}, which is not known")
    values = array.flatten()
    known = np.asarray(array.is_valid().to_numpy(zero_copy_only=False), np.bool_)
    if values.null_count or len(values) != width * int(known.sum()):
        raise ValueError(f"its column {name} holds rows with numbers missing")
    rows = np.full((len(array), width), np.nan)
    rows[known] = values.cast(pa.float64()).to_numpy(zero_copy_only=False).reshape(-1, width)
    return rows


def _read_lists(array: Any, name: str) -> dict[str, Any]:
    import numpy as np
    import pyarrow as pa

    lengths = array.value_lengths().fill_null(0).to_numpy(zero_copy_only=False).astype(np.int64)
    values = array.flatten()
    if len(values) != int(lengths.sum()) or len(values) > RECORDED_POSES:
        raise ValueError(f"its column {name} holds {len(values)} values in lists of {int(lengths.sum())}")
    kind = values.type
    if pa.types.is_fixed_size_list(kind):
        held: Any = _read_rows(values, name)
    elif pa.types.is_integer(kind):
        held = values.cast(pa.int64()).fill_null(-1).to_numpy(zero_copy_only=False)
    elif _name_type(kind) == "string":
        _require_short_texts(values, name)
        held = values.to_pylist()
    else:
        raise ValueError(f"its column {name} is {array.type}, which is not known")
    known = np.asarray(array.is_valid().to_numpy(zero_copy_only=False), np.bool_)
    return {"lengths": lengths, "values": held, "known": known}


def _require_short_texts(array: Any, name: str) -> None:
    import pyarrow.compute as pc

    longest = pc.max(pc.binary_length(array)).as_py() or 0
    if longest > MOST_TEXT:
        raise ValueError(f"its column {name} holds a text of {longest} bytes")


def read_images(stream: BinaryIO, limits: Limits, request: str) -> list[Any]:
    """Bytes of images, of which ``{folder, wanted: [file, batch, rows of it]}`` is asked; in that order."""
    import pyarrow as pa

    asked = json.loads(request)
    images: list[Any] = []
    taken = 0
    for name, number, rows in asked["wanted"]:
        with open_file(Path(asked["folder"]) / name, limits) as file, _named(name):
            column = f"{name.removesuffix('.arrow')}.data"
            reader = pa.ipc.open_file(file)
            fields = [reader.schema.get_field_index(column)]
            file.seek(0)
            batch = pa.ipc.open_file(
                file, options=pa.ipc.IpcReadOptions(use_threads=False, included_fields=fields)
            ).get_batch(number)
            batch.validate(full=True)
            array = batch.column(0)
            if _name_type(array.type) != "binary":
                raise ValueError("its images are not what they were before")
            for row in rows:
                # One that is null, or empty, is refused by the parent, which names the row.
                image = array[row].as_py() or b""
                taken += len(image)
                if taken > limits.content_bytes:
                    raise ValueError(f"{len(rows)} images of it have more than {limits.content_bytes} bytes")
                images.append(image)
    return images


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Say which file an error is of."""
    try:
        yield
    except (MemoryError, UnencodableValueError):
        raise
    except Exception as error:
        raise ValueError(f"{name}: {to_one_line(error)}") from error


def read_video(stream: BinaryIO, limits: Limits, request: str) -> list[Any]:
    """JPEG bytes of frames of the video in ``stream``, by their numbers, which rise: ``{"frames": [...]}``."""
    import av
    import cv2

    frames, encoded = json.loads(request)["frames"], []
    # Packages' own threads would each take the memory of one.
    with av.open(stream, mode="r", format="mp4") as container:
        video = container.streams.video[0]
        video.thread_type = "NONE"
        if video.width * video.height > limits.values:
            raise UnencodableValueError(f"its pictures have {video.width} x {video.height} pixels")
        rate, base = float(video.average_rate or 30), float(video.time_base or 0)
        container.seek(max(0, int((frames[0] - 0.5) / rate / base)), stream=video, backward=True)
        wanted = iter(frames)
        following = next(wanted)
        for picture in container.decode(video):
            if picture.pts is None or round(picture.pts * base * rate) < following:
                continue
            if round(picture.pts * base * rate) > following:
                break
            image = cv2.cvtColor(picture.to_ndarray(format="rgb24"), cv2.COLOR_RGB2BGR)
            encoded.append(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())
            following = next(wanted, None)
            if following is None:
                break
    return encoded


def read_map(stream: BinaryIO, limits: Limits, request: str) -> dict[str, Any]:
    """Objects of a map that touch ``{"bounds": [x, y, x, y]}``, or all: layer, id, features and surface or line.

    Surfaces and lines are WKB without heights, written anew; lines of features are arrays.
    """
    import numpy as np
    import pyarrow as pa
    import shapely

    bounds = json.loads(request)["bounds"]
    file = pa.ipc.open_file(stream)
    names = ["object_id", "map_layer", "features", "wkb"]
    if [name for name in names if name not in file.schema.names]:
        raise ValueError(f"it lacks one of the columns {', '.join(names)}")
    metadata = read_metadata(file.schema)
    objects: list[tuple[int, int, dict[str, Any], bytes]] = []
    points = 0
    for number in range(file.num_record_batches):
        batch = file.get_batch(number)
        batch.validate(full=True)
        columns = [batch.column(file.schema.get_field_index(name)) for name in names]
        if any(column.null_count for column in columns) or not all(map(_fits, columns, (True, True, False, False))):
            raise ValueError("its columns are of other types, or have nothing in some row")
        shapes = shapely.from_wkb(columns[3].to_numpy(zero_copy_only=False))
        keep = np.ones(len(shapes), np.bool_)
        if bounds is not None:
            keep = shapely.intersects(shapely.box(*bounds), shapely.envelope(shapes))
        points += int(shapely.get_num_coordinates(shapes[keep]).sum())
        if points > limits.values or len(objects) + int(keep.sum()) > MOST_MAP_OBJECTS:
            raise UnencodableValueError(f"its map has more than {limits.values} points or {MOST_MAP_OBJECTS} objects")
        for row in np.flatnonzero(keep).tolist():
            if not np.isfinite(shapely.get_coordinates(shapes[row])).all():
                raise ValueError(f"object {columns[0][row].as_py()} has coordinates that are not finite")
            features = _read_features(columns[2][row].as_py())
            wkb = shapely.to_wkb(shapes[row], output_dimension=2)
            objects.append((columns[1][row].as_py(), columns[0][row].as_py(), features, wkb))
    return {"metadata": metadata, "objects": objects}


def _fits(column: Any, whole: bool) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_integer(column.type)) if whole else _name_type(column.type) == "binary"


def _read_features(packed: bytes) -> dict[str, Any]:
    """Features of an object of the map; arrays are maps with four keys of bytes."""
    import msgpack
    import numpy as np

    def restore(pairs: dict[Any, Any]) -> Any:
        if b"__ndarray__" not in pairs:
            return pairs
        kind, shape = np.dtype(pairs[b"dtype"]), [int(side) for side in pairs[b"shape"]]
        if kind.kind not in "fiu":
            raise ValueError(f"an array of {kind}")
        return np.frombuffer(pairs[b"data"], kind).reshape(shape).astype(np.float64)

    features = msgpack.unpackb(packed, raw=False, strict_map_key=False, object_hook=restore)
    if not isinstance(features, dict):
        raise ValueError("features of an object that are no map")
    return features
