"""123D logs damaged in ways that are listed here, and by chance: of files as Arrow, and of their bytes."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any, Final

from tests.benchmark.untrusted.mutations import BYTES


@dataclass(frozen=True)
class Damage:
    """A change of one file of a log; one that ``may_be_valid`` may be read as well as refused."""

    name: str
    change: Callable[[Path, Random], None]
    may_be_valid: bool = False


def _table(path: Path) -> Any:
    import pyarrow as pa

    with pa.OSFile(str(path)) as stream:
        return pa.ipc.open_file(stream).read_all()


def _write(path: Path, table: Any, **options: Any) -> None:
    import pyarrow as pa

    path.unlink()
    with pa.ipc.new_file(str(path), table.schema, options=pa.ipc.IpcWriteOptions(**options)) as writer:
        writer.write_table(table, max_chunksize=10)


def _without_column(path: Path, chance: Random) -> None:
    table = _table(path)
    _write(path, table.drop_columns([chance.choice(table.schema.names)]))


def _other_type(path: Path, chance: Random) -> None:
    import pyarrow as pa

    table = _table(path)
    place = chance.randrange(len(table.schema))
    others = (
        pa.array(["x"] * len(table)),
        pa.array([1.5] * len(table)),
        pa.array([[1]] * len(table), pa.list_(pa.int8())),
        pa.array([None] * len(table), pa.null()),
        pa.array([{"a": 1}] * len(table)),
        pa.array(["x"] * len(table)).dictionary_encode(),
    )
    _write(path, table.set_column(place, table.schema.field(place).name, chance.choice(others)))


def _nothing_in(path: Path, chance: Random) -> None:
    import pyarrow as pa

    table = _table(path)
    place = chance.randrange(len(table.schema))
    field = table.schema.field(place)
    _write(path, table.set_column(place, field.name, pa.nulls(len(table), field.type)))


def _fewer_rows(path: Path, chance: Random) -> None:
    table = _table(path)
    _write(path, table.slice(0, chance.randrange(len(table))))


def _shuffled_rows(path: Path, chance: Random) -> None:
    table = _table(path)
    _write(path, table.take(chance.sample(range(len(table)), len(table))))


def _many_rows(path: Path, chance: Random) -> None:
    import pyarrow as pa

    table = _table(path)
    _write(path, pa.concat_tables([table] * chance.choice((2, 50))), compression="zstd")


def _numbers_replaced(path: Path, chance: Random) -> None:
    """Some values of a column of numbers become absurd."""
    import pyarrow as pa

    table = _table(path)
    fields = [place for place, field in enumerate(table.schema) if _holds_numbers(field.type)]
    if not fields:
        _fewer_rows(path, chance)
        return
    place = chance.choice(fields)
    field = table.schema.field(place)
    value = chance.choice(
        (-1, 2**62, 10**6, 7) if not _is_real(field.type) else (float("nan"), float("inf"), 1e300, 0.0)
    )
    values = [_replaced(row, value, chance) for row in table.column(place).to_pylist()]
    try:
        changed = pa.array(values, field.type)
    except (pa.ArrowInvalid, OverflowError):
        changed = pa.nulls(len(table), field.type)
    _write(path, table.set_column(place, field.name, changed))


def _holds_numbers(kind: Any) -> bool:
    text = str(kind)
    return "int" in text or "double" in text or "float" in text


def _is_real(kind: Any) -> bool:
    return "double" in str(kind) or "float" in str(kind)


def _replaced(value: Any, by: Any, chance: Random) -> Any:
    if isinstance(value, list):
        return [_replaced(one, by, chance) for one in value]
    return by if chance.random() < 0.3 else value


def _other_metadata(path: Path, chance: Random) -> None:
    """One thing that a file says of itself is gone, or another thing."""
    import msgpack

    table = _table(path)
    metadata = msgpack.unpackb(table.schema.metadata[b"metadata"], raw=False, strict_map_key=False)
    name = chance.choice(sorted(metadata, key=str))
    if chance.random() < 0.3:
        del metadata[name]
    else:
        metadata[name] = chance.choice(
            (None, "../../etc", "x" * 100_000, -1, 1e308, [], [[0]] * 7, {"a": 1}, True, [0.0] * 7)
        )
    packed = chance.choice((msgpack.packb(metadata), msgpack.packb([1, 2]), msgpack.packb(metadata)[:-3], b""))
    _write(path, table.replace_schema_metadata({b"metadata": packed}))


def _deep_metadata(path: Path, _: Random) -> None:
    _write(path, _table(path).replace_schema_metadata({b"metadata": b"\x91" * 200_000 + b"\xc0"}))


def _claimed_size(path: Path, chance: Random) -> None:
    """A length or an offset within the file becomes absurd."""
    data = bytearray(path.read_bytes())
    places = [at for at in range(8, len(data) - 8, 4) if 0 < struct.unpack_from("<q", data, at)[0] < 1 << 20]
    for _ in range(chance.choice((1, 3, 20))):
        struct.pack_into("<q", data, chance.choice(places), chance.choice((1 << 40, 1 << 62, -1, 1 << 31, 0)))
    path.unlink()
    path.write_bytes(data)


def _inflating(path: Path, _: Random) -> None:
    """A column of gigabytes of zeros, compressed to some megabytes at most."""
    import numpy as np
    import pyarrow as pa

    table = _table(path)
    zeros = pa.array(np.zeros(1 << 28, np.int64))
    path.unlink()
    schema = pa.schema([pa.field(table.schema.names[0], pa.int64())], metadata=table.schema.metadata)
    with pa.ipc.new_file(str(path), schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as writer:
        writer.write_batch(pa.record_batch([zeros], schema=schema))


def _no_images(path: Path, chance: Random) -> None:
    """Images that are none, or end too early."""
    import pyarrow as pa

    table = _table(path)
    names = [name for name in table.schema.names if name.endswith(".data")]
    if not names:
        _fewer_rows(path, chance)
        return
    images = [
        chance.choice((one, one[: len(one) // 2], b"", b"\xff\xd8", b"none")) if chance.random() < 0.5 else one
        for one in table.column(names[0]).to_pylist()
    ]
    _write(path, table.set_column(table.schema.get_field_index(names[0]), names[0], pa.array(images)))


def _is_folder(path: Path, _: Random) -> None:
    path.unlink()
    path.mkdir()


def _is_absent(path: Path, _: Random) -> None:
    path.unlink()


def _leads_to_itself(path: Path, _: Random) -> None:
    path.unlink()
    path.symlink_to(path.name)


def _bytes(mutation: Any) -> Damage:
    def change(path: Path, chance: Random) -> None:
        data = mutation.change(path.read_bytes(), chance)
        path.unlink()
        path.write_bytes(data)

    return Damage(mutation.name, change, mutation.may_be_valid)


DAMAGES: Final = (
    Damage("a column missing", _without_column, may_be_valid=True),
    Damage("a column of another type", _other_type, may_be_valid=True),
    Damage("nothing in a column", _nothing_in, may_be_valid=True),
    Damage("fewer rows", _fewer_rows, may_be_valid=True),
    Damage("rows in another order", _shuffled_rows, may_be_valid=True),
    Damage("rows many times", _many_rows, may_be_valid=True),
    Damage("absurd numbers", _numbers_replaced, may_be_valid=True),
    Damage("other metadata", _other_metadata, may_be_valid=True),
    Damage("metadata nested deep", _deep_metadata),
    Damage("a claimed size", _claimed_size, may_be_valid=True),
    Damage("gigabytes of zeros", _inflating),
    Damage("images that are none", _no_images, may_be_valid=True),
    Damage("a folder in its place", _is_folder, may_be_valid=True),
    Damage("gone", _is_absent, may_be_valid=True),
    Damage("a link to itself", _leads_to_itself, may_be_valid=True),
    *map(_bytes, BYTES),
)


def damage(folder: Path, number: int, seed: int = 0) -> tuple[Damage, str]:
    """Damage one file of a log; each kind of damage comes in turn, the file by chance."""
    chance = Random(f"{seed}/{number}")
    found = DAMAGES[number % len(DAMAGES)]
    path = chance.choice(sorted(folder.glob("*.arrow")))
    found.change(path, chance)
    return found, path.name
