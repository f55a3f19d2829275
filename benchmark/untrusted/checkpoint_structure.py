"""Tensors that a PyTorch file declares, read without PyTorch and without any of their numbers.

Runs in the child process. Tensors and storages are stand-ins with declared values; whether these are possible is for
the parent to check (`checkpoints.py`), which maps the numbers from the file.
"""

import struct
import zipfile
from collections import Counter, OrderedDict
from typing import Any, BinaryIO, ClassVar, Final

from benchmark.untrusted.answers import UnencodableValueError
from benchmark.untrusted.files import Limits, to_one_line
from benchmark.untrusted.legacy_storages import ALLOWED, AllowListUnpickler, NumberType

ITEM_BYTES: Final = {
    "float64": 8, "float32": 4, "float16": 2, "bfloat16": 2, "int64": 8, "int32": 4, "int16": 2, "int8": 1, "uint8": 1,
    "bool": 1, "uint16": 2, "uint32": 4, "uint64": 8, "float8_e4m3fn": 1, "float8_e5m2": 1, "float8_e4m3fnuz": 1,
    "float8_e5m2fnuz": 1,
}  # fmt: skip
"""Bytes of a number, by PyTorch's name of its type: dense real numbers, which weights are."""
_STORAGES: Final = {
    "Double": "float64", "Float": "float32", "Half": "float16", "BFloat16": "bfloat16", "Long": "int64", "Int": "int32",
    "Short": "int16", "Char": "int8", "Byte": "uint8", "Bool": "bool", "Untyped": "uint8",
}  # fmt: skip
_OTHER_TYPES: Final = ("ComplexDouble", "ComplexFloat", "QInt8", "QInt32", "QUInt8", "QUInt4x2", "QUInt2x4")
_MAGIC: Final = 0x1950A86A20F9469CFC6C
_PROTOCOL: Final = 1001
_LOCAL_HEADER: Final = struct.Struct("<4s22xHH")
_LONGEST_PICKLE_BYTES: Final = 1 << 28


_PLAIN: Final = ("state_dict", "model", "model_state_dict", "module")
_AVERAGED: Final = ("state_dict_ema", "model_ema", "ema_model", "ema_state_dict", "model_ema_state_dict", "ema")
"""Entries of files in which weights lie: those of the last step, and those averaged over steps."""
_INNER: Final = ("module", "state_dict", "model")
"""Entries of an average in which its weights lie, beside its counters."""


class _TypeStandIn:
    """Stands for a type of numbers, of storages or of tensors; ``name`` is empty for those that weights have not."""

    __slots__ = ("name",)

    def __init__(self, name: str) -> None:
        self.name = name


class _StorageStandIn:
    """Stands for stored numbers: which, and of what type."""

    __slots__ = ("count", "key", "name", "start")

    def __init__(self, name: str, key: str, count: int, start: int = 0) -> None:
        self.name, self.key, self.count, self.start = name, key, count, start


class _TensorStandIn:
    """Stands for a tensor; without a storage where it is none of dense real numbers."""

    __slots__ = ("name", "offset", "shape", "storage", "strides")

    def __init__(self, storage: _StorageStandIn | None, name: str, offset: Any, shape: Any, strides: Any) -> None:
        self.storage, self.name, self.offset, self.shape, self.strides = storage, name, offset, shape, strides

    def __setstate__(self, state: Any) -> None:
        raise ValueError("a tensor with its own state")


_SPECIAL: Final = (None, "", 0, (), ())


def _tensor(storage: Any, offset: Any, shape: Any, strides: Any, *rest: Any) -> _TensorStandIn:
    """Stand-in that rebuilds a tensor; conjugates and negatives are views that no weights need."""
    if not isinstance(storage, _StorageStandIn) or (len(rest) > 2 and rest[2]):
        return _TensorStandIn(*_SPECIAL)
    return _TensorStandIn(storage, storage.name, offset, shape, strides)


def _typed_tensor(storage: Any, offset: Any, shape: Any, strides: Any, *rest: Any) -> _TensorStandIn:
    """The same for numbers that have no storage of their own type."""
    if (
        not isinstance(storage, _StorageStandIn)
        or len(rest) < 3
        or not isinstance(rest[2], _TypeStandIn)
        or any(rest[3:])
    ):
        return _TensorStandIn(*_SPECIAL)
    return _TensorStandIn(storage, rest[2].name, offset, shape, strides)


def _make_unsupported_tensor(*_: Any, **__: Any) -> _TensorStandIn:
    """Sparse, quantised, nested tensors and tensors without content."""
    return _TensorStandIn(*_SPECIAL)


def _parameter(data: Any = None, *_: Any) -> Any:
    return data


def _rebuild_by_function(function: Any, _: Any, arguments: tuple[Any, ...], __: Any) -> Any:
    """Stand-in for tensors of subclasses, or with attributes."""
    return function(*arguments)


def _device(*_: Any) -> str:
    return "device"


def _size(values: Any = ()) -> tuple[Any, ...]:
    return tuple(values)


class _CheckpointNumberType(NumberType):
    """A number type in a checkpoint, where there is no need of texts; refused in the words of PyTorch."""

    kinds: ClassVar = "biuf"
    refusal: ClassVar = "Unsupported class numpy.{}"


_KINDS: Final[dict[str, _TypeStandIn]] = {
    **{kind: _TypeStandIn(name) for kind, name in _STORAGES.items()},
    **{kind: _TypeStandIn("") for kind in _OTHER_TYPES},
}
_STRANGE: Final = ("complex32", "complex64", "complex128", "quint8", "qint8", "qint32", "quint4x2", "quint2x4")
_STRANGE_MARKS: Final = (
    "strided", "sparse_coo", "per_tensor_affine", "per_tensor_symmetric", "per_channel_affine", "per_channel_symmetric",
    "per_channel_affine_float_qparams",
)  # fmt: skip
_SHARED: Final = (
    ("_codecs", "encode"),
    *((module, name) for module in ("builtins", "__builtin__") for name in ("bytearray", "set", "complex")),
)
_TORCH: Final[dict[tuple[str, str], Any]] = {
    **{(place, f"{kind}Storage"): made for place in ("torch", "torch.cuda") for kind, made in _KINDS.items()},
    **{(place, f"{kind}Tensor"): made for place in ("torch", "torch.cuda") for kind, made in _KINDS.items()},
    ("torch.storage", "UntypedStorage"): _KINDS["Untyped"],
    ("torch", "Tensor"): _TypeStandIn(""),
    **{("torch", name): _TypeStandIn(name) for name in ITEM_BYTES},
    **{("torch", name): _TypeStandIn("") for name in (*_STRANGE, *_STRANGE_MARKS)},
    ("torch", "Size"): _size,
    ("torch", "device"): _device,
    ("torch.serialization", "_get_layout"): _device,
    ("torch.nn.parameter", "Parameter"): _parameter,
    ("torch._utils", "_rebuild_parameter"): _parameter,
    ("torch._utils", "_rebuild_parameter_with_state"): _parameter,
    ("torch._utils", "_rebuild_tensor"): _tensor,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch._utils", "_rebuild_tensor_v3"): _typed_tensor,
    **{
        ("torch._utils", f"_rebuild_{kind}"): _make_unsupported_tensor
        for kind in (
            "qtensor", "sparse_tensor", "meta_tensor_no_storage", "nested_tensor", "wrapper_subclass",
            "device_tensor_from_cpu_tensor",
        )
    },
    ("torch._tensor", "_rebuild_from_type_v2"): _rebuild_by_function,
}  # fmt: skip
"""Names that PyTorch's own weights-only reader allows."""


class _StructureUnpickler(AllowListUnpickler):
    """Reads checkpoints; stored numbers are only named."""

    allowed: ClassVar = {
        **_TORCH,
        ("collections", "OrderedDict"): OrderedDict,
        ("collections", "Counter"): Counter,
        **{asked: ALLOWED[asked] for asked in _SHARED},
        **{asked: made for asked, made in ALLOWED.items() if asked[1] == "scalar"},
        ("numpy", "dtype"): _CheckpointNumberType,
    }

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(stream, encoding="utf-8")
        self.counts: dict[str, tuple[str, int]] = {}

    def persistent_load(self, saved: Any) -> Any:
        """Resolve a reference to a storage: ``("storage", type, key, place, count)``, older ones with a view."""
        kind, *arguments = saved
        if kind in ("module", b"module"):
            return arguments[0]
        stand_in, key, _, count, *view = arguments
        if kind not in ("storage", b"storage") or not isinstance(stand_in, _TypeStandIn) or type(count) is not int:
            raise ValueError("an unknown kind of storage")
        key = key.decode() if isinstance(key, bytes) else str(key)
        self.counts.setdefault(key, (stand_in.name, count))
        if not view or view[0] is None:
            return _StorageStandIn(stand_in.name, key, count)
        _, start, length = view[0]
        if not 0 <= start <= start + length <= count:
            raise ValueError("a view outside its storage")
        return _StorageStandIn(stand_in.name, key, length, start)


def read_checkpoint_structure(stream: BinaryIO, limits: Limits) -> dict[str, Any]:
    """Structure of a checkpoint: a zip archive, or the form of PyTorch before 1.6.

    ``tensors`` are rows of name, type, storage, first element, shape and strides, where the type is empty for what is
    no tensor of dense real numbers. ``storages`` have first byte and bytes of each, ``records`` first byte, bytes,
    CRC-32 and name of everything that has a checksum. There are ``note``, words on averaged weights if there are some,
    ``big_endian`` and ``configuration``, or ``wrong``, words about a content that is no state dict.
    """
    if stream.read(2) == b"PK":
        stream.seek(0)
        return _of_archive(stream, limits)
    stream.seek(0)
    return _of_stream(stream, limits)


def _of_archive(stream: BinaryIO, limits: Limits) -> dict[str, Any]:
    size = stream.seek(0, 2)
    with zipfile.ZipFile(stream) as archive:
        entries = archive.infolist()
        stored = all(entry.compress_type == zipfile.ZIP_STORED for entry in entries)
        if not stored or sum(entry.file_size for entry in entries) > size:
            return {"wrong": "size"}
        names = {entry.filename: entry for entry in entries}
        if not entries or len(names) != len(entries):
            raise zipfile.BadZipFile("two records with the same name" if entries else "no records")
        top = entries[0].filename.partition("/")[0]
        if f"{top}/constants.pkl" in names:
            raise ValueError("a TorchScript archive")
        if names[f"{top}/data.pkl"].file_size > _LONGEST_PICKLE_BYTES:
            raise UnencodableValueError("its pickle is larger than any list of weights")
        order = archive.read(f"{top}/byteorder") if f"{top}/byteorder" in names else b"little"
        if order not in (b"little", b"big"):
            raise ValueError("an unknown byte order")
        with archive.open(f"{top}/data.pkl") as held:
            reader = _StructureUnpickler(held)  # type: ignore[arg-type]
            loaded = reader.load()
            # Read to the end, so that its checksum is compared.
            held.read()
    starts = {entry.filename: _first_byte(stream, entry, size) for entry in entries}
    records = [[starts[e.filename], e.file_size, e.CRC, to_one_line(e.filename)] for e in entries if not e.is_dir()]
    places = {
        key: (starts[f"{top}/data/{key}"], names[f"{top}/data/{key}"].file_size)
        for key in reader.counts
        if f"{top}/data/{key}" in names
    }
    return {**_table(loaded, places, limits), "records": records, "big_endian": order == b"big"}


def _first_byte(stream: BinaryIO, entry: zipfile.ZipInfo, size: int) -> int:
    stream.seek(entry.header_offset)
    mark, name, extra = _LOCAL_HEADER.unpack(stream.read(_LOCAL_HEADER.size))
    first = entry.header_offset + _LOCAL_HEADER.size + int(name) + int(extra)
    if mark != b"PK\3\4" or first + entry.file_size > size or entry.flag_bits & 1:
        raise zipfile.BadZipFile("a record outside the file")
    return first


def _of_stream(stream: BinaryIO, limits: Limits) -> dict[str, Any]:
    size = stream.seek(0, 2)
    stream.seek(0)
    if _StructureUnpickler(stream).load() != _MAGIC or _StructureUnpickler(stream).load() != _PROTOCOL:
        raise ValueError("not a checkpoint")
    _StructureUnpickler(stream).load()
    reader = _StructureUnpickler(stream)
    loaded = reader.load()
    keys = _StructureUnpickler(stream).load()
    if type(keys) is not list or len(keys) > limits.values:
        raise ValueError("no list of storages")
    places: dict[str, tuple[int, int]] = {}
    for key in keys:
        name, count = reader.counts[key.decode() if isinstance(key, bytes) else str(key)]
        length = stream.read(8)
        if len(length) != 8 or int.from_bytes(length, "little", signed=True) != count:
            raise EOFError("a storage of the wrong length")
        first, item = stream.tell(), ITEM_BYTES.get(name)
        if item is None:
            raise ValueError("numbers of a type that weights do not use")
        if count < 0 or first + count * item > size:
            raise EOFError("ends within its numbers")
        places[str(key)] = first, count * item
        stream.seek(first + count * item)
    return {**_table(loaded, places, limits), "records": [], "big_endian": False}


def _choose_entries(loaded: dict[Any, Any]) -> tuple[Any, str]:
    """The state dict of a file, and a note where it has averaged weights, which are taken.

    Beside an ``ema_state_dict`` that counts its steps, as mmengine writes it, they are the plain ones: it swaps both on
    saving.
    """
    plain = next((name for name in _PLAIN if _has_tensors(dict.get(loaded, name))), "")
    for name in _AVERAGED:
        averaged: Any = dict.get(loaded, name)
        for inner in _INNER if isinstance(averaged, dict) else ():
            averaged = dict.get(averaged, inner) if _has_tensors(dict.get(averaged, inner)) else averaged
        if not _has_tensors(averaged):
            continue
        taken, left = (plain, name) if plain and name == "ema_state_dict" and "steps" in averaged else (name, plain)
        note = f"averaged weights ({taken}){f'; {left} holds those of the last step and is left out' if left else ''}"
        tensors = {key: held for key, held in dict.items(averaged) if type(held) not in (int, float, bool)}
        return (dict.get(loaded, plain) if taken == plain else tensors), note
    return dict.get(loaded, plain or "state_dict", loaded), ""


def _has_tensors(value: Any) -> bool:
    return isinstance(value, dict) and any(isinstance(held, _TensorStandIn) for held in dict.values(value))


def _table(loaded: Any, places: dict[str, tuple[int, int]], limits: Limits) -> dict[str, Any]:
    entries, note = _choose_entries(loaded) if isinstance(loaded, dict) else (None, "")
    if not isinstance(entries, dict) or not len(entries):
        return {"wrong": "kind", "kind": to_one_line(type(loaded).__name__.strip("_"))}
    meta = dict.get(loaded, "meta")
    configuration = dict.get(meta, "config") if isinstance(meta, dict) else None
    numbers = {key: number for number, key in enumerate(places)}
    rows = []
    if len(entries) > limits.values:
        raise UnencodableValueError(f"it holds more than {limits.values} tensors")
    for name, tensor in dict.items(entries):
        if type(name) is not str or not isinstance(tensor, _TensorStandIn):
            return {"wrong": "entry", "entry": repr(to_one_line(name, 80))}
        if len(name) > limits.name_characters:
            raise UnencodableValueError(f"it holds a name of more than {limits.name_characters} characters")
        rows.append([name, *_describe_tensor(tensor, numbers)])
    return {
        "tensors": rows,
        "note": note,
        "storages": list(map(list, places.values())),
        "configuration": configuration if type(configuration) is str else "",
    }


def _describe_tensor(tensor: _TensorStandIn, numbers: dict[str, int]) -> tuple[Any, ...]:
    storage, item = tensor.storage, ITEM_BYTES.get(tensor.name)
    if storage is None or item is None or not storage.name:
        return "", 0, 0, [], []
    start = storage.start * ITEM_BYTES[storage.name]
    shape, strides = list(tensor.shape), list(tensor.strides)
    if start % item or not all(type(number) is int for number in (tensor.offset, *shape, *strides)):
        raise ValueError("a tensor whose offset is not a whole number")
    # `None` is an empty storage, which a tensor without elements may have.
    place = numbers.get(storage.key, -1)
    return tensor.name, place, tensor.offset + start // item, shape, strides
