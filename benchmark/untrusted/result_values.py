"""Values in pickles of planners' repositories, read without running their code: arrays, tensors, plain values.

Runs in the child process. Names are answered by stand-ins of this module alone, exact pairs of module and name. Tensors
hide a second pickle stream in the bytes of their storage, which has a list of its own (the names of storages). Of the
value only what plans are read from is kept; everything else becomes ``None``, so that boxes of a whole data set need
not travel.
"""

import math
import pickle
import re
import sys
from collections.abc import Callable
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.untrusted.answers import UnencodableValueError
from benchmark.untrusted.files import EXPANSION, MIB, Limits, to_one_line
from benchmark.untrusted.legacy_storages import DisallowedNameError, LegacyStorage, read_legacy_storage

_CORES: Final = ("core", "_core")
_NUMBERS: Final = re.compile(r"[<>|=]?(f[248]|[iu][1248]|b1|[SU]\d{1,4})")
_MOST_AXES: Final = 32
_PLAIN: Final = frozenset({bool, int, float, str, bytes, type(None)})
_KEPT: Final = frozenset(
    {
        "meta", "plan_results", "bbox_results", "token", "planning_traj", "planning_traj_gt", "command", "img_bbox",
        "final_planning", "planning", "planning_score", "pts_bbox", "ego_fut_preds", "ego_fut_cmd", "metric_results",
        "pred_ego_traj", "pred_ego_fut_trajs", "gt_ego_fut_trajs", "index", "index_w_scene", "ego_trajs_in_global",
    }
)  # fmt: skip
"""Keys that plans and proofs of their order are read from: a dictionary with one of them keeps these alone."""
_ALWAYS_PARTLY: Final = ("img_bbox", "pts_bbox")
_FARTHEST_DOWN: Final = 1000
"""Containers within containers that are looked into at all."""
_LONG: Final = ("meta",)
"""Says what kind of file it is; what it holds is of no use."""


class _FunctionStandIn:
    """Stands for a function: it can be called as pickles of arrays call it, and nothing else."""

    __slots__ = ("_does", "name")
    name: str
    _does: Callable[..., Any] | None

    def __init__(self, name: str, does: Callable[..., Any] | None) -> None:
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "_does", does)

    def __call__(self, *arguments: Any) -> Any:
        if self._does is None:
            raise DisallowedNameError(f"a call of {self.name}")
        return self._does(*arguments)

    def __setattr__(self, name: str, value: Any) -> None:
        raise DisallowedNameError(f"a change of {self.name}")

    def __setstate__(self, state: Any) -> None:
        raise DisallowedNameError(f"a state for {self.name}")


class _NumberTypeStandIn:
    """Stands for a number type of numpy; its state may be a byte order and nothing else."""

    __slots__ = ("dtype",)

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.dtype = dtype

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) < 5 or any(part is not None for part in state[2:5]):
            raise DisallowedNameError("a number type with fields")
        if state[1] not in ("<", ">", "|", "="):
            raise DisallowedNameError("a number type with another byte order")
        if self.dtype.kind in "fiuU":
            self.dtype = self.dtype.newbyteorder(state[1])


class _ArrayStandIn:
    """Stands for an array or a tensor; takes its content once."""

    __slots__ = ("value",)

    def __init__(self, value: NDArray[Any] | None = None) -> None:
        self.value = value

    def __setstate__(self, state: Any) -> None:
        if self.value is not None or not isinstance(state, tuple) or len(state) != 5:
            raise DisallowedNameError("an array with an unknown state")
        _, shape, kind, fortran, data = state
        self.value = _numbers(data, kind, shape, "F" if fortran else "C")


class _BoxesStandIn:
    """Stands for the boxes of mmdet3d, whose content is never used."""

    __slots__ = ("held",)

    def __setstate__(self, state: Any) -> None:
        if type(state) is not dict or hasattr(self, "held"):
            raise DisallowedNameError("boxes with an unknown state")
        self.held = state


def _numbers(data: Any, kind: Any, shape: Any, order: Any) -> NDArray[Any]:
    """Bytes as numbers; says no before it claims any memory."""
    if not isinstance(kind, _NumberTypeStandIn) or not isinstance(data, bytes | bytearray) or order not in ("C", "F"):
        raise DisallowedNameError("an array of something other than numbers and short texts")
    if not _are_counts(shape):
        raise UnencodableValueError(f"it declares an array of shape {to_one_line(shape, 60)}")
    if math.prod(shape) * kind.dtype.itemsize != len(data):
        raise UnencodableValueError(
            f"it declares an array of {math.prod(shape)} values and holds {len(data)} bytes of it"
        )
    if not data:
        return np.zeros(shape, kind.dtype)
    return np.frombuffer(data, kind.dtype).reshape(shape, order=order)


def _are_counts(shape: Any) -> bool:
    return (
        isinstance(shape, tuple)
        and len(shape) <= _MOST_AXES
        and all(type(length) is int and 0 <= length < 1 << 48 for length in shape)
    )


def _number_type(name: Any, *_: Any) -> _NumberTypeStandIn:
    if not isinstance(name, str) or not _NUMBERS.fullmatch(name):
        raise DisallowedNameError(f"numpy.dtype({to_one_line(name, 40)!r})")
    return _NumberTypeStandIn(np.dtype(name))


def _empty_array(subtype: Any, shape: Any, kind: Any) -> _ArrayStandIn:
    if subtype is not _NDARRAY or kind not in (b"b", "b"):
        raise DisallowedNameError("an array of a subclass")
    if shape != (0,):
        raise UnencodableValueError(f"it declares an array of shape {to_one_line(shape, 60)} before any content")
    return _ArrayStandIn()


def _array_from_buffer(data: Any, kind: Any, shape: Any, order: Any) -> _ArrayStandIn:
    return _ArrayStandIn(_numbers(data, kind, shape, order))


def _scalar(kind: Any, data: Any) -> Any:
    return _numbers(data, kind, (), "C")[()]


def _encode(text: Any, encoding: Any = None) -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        raise DisallowedNameError("_codecs.encode with another encoding than latin1")
    return text.encode("latin1")


def _ordered(*arguments: Any) -> dict[Any, Any]:
    if arguments:
        raise DisallowedNameError("a call of collections.OrderedDict with content")
    return {}


def _tensor(storage: Any, offset: Any, shape: Any, strides: Any, *rest: Any) -> _ArrayStandIn:
    if not isinstance(storage, LegacyStorage) or any(not isinstance(part, bool | dict | None) or part for part in rest):
        raise DisallowedNameError("a tensor that is not a plain one")
    if not _are_counts(shape) or not _are_counts(strides) or len(shape) != len(strides) or not _are_counts((offset,)):
        raise UnencodableValueError("it declares a tensor of an impossible shape")
    values = storage.values
    if math.prod(shape) * values.itemsize > EXPANSION * values.nbytes + MIB:
        raise UnencodableValueError(
            f"it declares a tensor of {math.prod(shape)} values and stores {len(values)} of them"
        )
    last = offset + sum((length - 1) * step for length, step in zip(shape, strides))
    if math.prod(shape) and last >= len(values):
        raise UnencodableValueError("it declares a tensor that exceeds its stored numbers")
    if not math.prod(shape):
        return _ArrayStandIn(np.zeros(shape, values.dtype))
    steps = [step * values.itemsize for step in strides]
    return _ArrayStandIn(np.lib.stride_tricks.as_strided(values[offset:], shape, steps).copy())


_NDARRAY: Final = _FunctionStandIn("numpy.ndarray", None)
_LIDAR_BOXES: Final = (
    ("mmdet3d.core.bbox.structures.lidar_box3d", "LiDARInstance3DBoxes"),
    ("mmdet3d.structures.bbox_3d.lidar_box3d", "LiDARInstance3DBoxes"),
    ("projects.mmdet3d_plugin.core.bbox.structures.lidar_box3d", "CustomLiDARInstance3DBoxes"),
)
_ALLOWED: Final[dict[tuple[str, str], Any]] = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _FunctionStandIn("numpy.dtype", _number_type),
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _FunctionStandIn("_reconstruct", _empty_array) for core in _CORES},
    **{(f"numpy.{core}.multiarray", "scalar"): _FunctionStandIn("scalar", _scalar) for core in _CORES},
    **{
        (f"numpy.{core}.numeric", "_frombuffer"): _FunctionStandIn("_frombuffer", _array_from_buffer) for core in _CORES
    },
    ("collections", "OrderedDict"): _FunctionStandIn("collections.OrderedDict", _ordered),
    ("_codecs", "encode"): _FunctionStandIn("_codecs.encode", _encode),
    ("torch._utils", "_rebuild_tensor_v2"): _FunctionStandIn("_rebuild_tensor_v2", _tensor),
    ("torch.storage", "_load_from_bytes"): _FunctionStandIn("_load_from_bytes", read_legacy_storage),
    **dict.fromkeys(_LIDAR_BOXES, _BoxesStandIn),
}
"""Allowed names of result files, and their stand-ins."""


class _ResultUnpickler(pickle.Unpickler):
    """Knows exactly these names; there are no persistent ids in the outer stream."""

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in; nothing is ever imported."""
        if (module, name) not in _ALLOWED:
            raise DisallowedNameError(f"{module}.{name}")
        return _ALLOWED[module, name]

    def persistent_load(self, pid: Any) -> Any:
        """Never: only storages of tensors have such ids."""
        raise DisallowedNameError("a persistent id")


def read_result_value(stream: BinaryIO, limits: Limits) -> dict[str, Any]:
    """``{"value": V}`` of a result file, or ``{"wrong": CATEGORY, "why": TEXT}``."""
    try:
        value = _ResultUnpickler(stream).load()
        if stream.read(1):
            return {"wrong": "trailing", "why": "it has bytes after its end"}
        # Deep enough to tell endless structures from deep ones; Python's own calls take no C stack.
        sys.setrecursionlimit(max(sys.getrecursionlimit(), 8 * _FARTHEST_DOWN))
        copy, _, height = _LimitedCopier(limits).of(value, 0)
        if height > limits.depth:
            raise _NestingError(f"its containers are nested more than {limits.depth} deep")
        return {"value": copy}
    except DisallowedNameError as refused:
        return {"wrong": "class", "why": to_one_line(refused)}
    except _NestingError as why:
        return {"wrong": "nesting", "why": to_one_line(why)}
    except UnencodableValueError as why:
        return {"wrong": "size", "why": to_one_line(why)}
    except EOFError:
        return {"wrong": "truncated", "why": "it ends before its end"}
    except pickle.UnpicklingError as error:
        return {"wrong": "truncated" if "truncated" in str(error) else "unknown", "why": to_one_line(error)}
    except TypeError as error:
        # A stand-in was used in a way that arrays, tensors and boxes never are.
        return {"wrong": "class", "why": to_one_line(error)}


class _NestingError(Exception):
    """Containers within containers within containers; says how many."""


class _LimitedCopier:
    """Copies what is kept of a value, within limits; one that is named often is copied once and counted each time."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        # The values are kept alive, so that no other object gets the same `id`.
        self._known: dict[int, tuple[Any, int, int, Any]] = {}

    def of(self, value: Any, depth: int) -> tuple[Any, int, int]:
        """The copy, how many values it stands for, and how many containers deep it is."""
        if type(value) in _PLAIN or isinstance(value, np.generic):
            return value, 1, 0
        if isinstance(value, _ArrayStandIn) and value.value is not None:
            return value.value, 1, 0
        known = self._known.get(id(value))
        if known is None:
            if depth > _FARTHEST_DOWN:
                raise _NestingError(f"its containers are nested more than {self._limits.depth} deep")
            copied = self._container(value, depth)
            self._known[id(value)] = known = (*copied, value)
        copy, count, height = known[:3]
        if count > self._limits.values:
            raise UnencodableValueError(f"it holds more than {self._limits.values} values")
        return copy, count, height

    def _container(self, value: Any, depth: int) -> tuple[Any, int, int]:
        if type(value) is list or type(value) is tuple:
            parts = [self.of(item, depth + 1) for item in value]
            return type(value)(part[0] for part in parts), 1 + sum(p[1] for p in parts), 1 + _highest(parts)
        if type(value) is dict:
            return self._dictionary(value, depth, all(key not in _KEPT for key in value))
        if isinstance(value, _BoxesStandIn):
            return None, 1, 0
        name = value.name if isinstance(value, _FunctionStandIn) else type(value).__name__.strip("_")
        raise DisallowedNameError(f"{name} as a value")

    def _dictionary(self, value: dict[Any, Any], depth: int, whole: bool) -> tuple[Any, int, int]:
        copy: dict[Any, Any] = {}
        parts = []
        for key, member in value.items():
            if type(key) not in _PLAIN or (isinstance(key, str) and len(key) > self._limits.name_characters):
                raise UnencodableValueError("it holds a key that is not short text")
            if not whole and (key not in _KEPT or key in _LONG):
                parts.append((None, 1, 0))
            elif key in _ALWAYS_PARTLY and type(member) is dict:
                parts.append(self._dictionary(member, depth + 1, whole=False))
            else:
                parts.append(self.of(member, depth + 1))
            copy[key] = parts[-1][0]
        return copy, 1 + 2 * len(copy) + sum(part[1] for part in parts), 1 + _highest(parts)


def _highest(parts: list[tuple[Any, int, int]]) -> int:
    return max((part[2] for part in parts), default=0)
