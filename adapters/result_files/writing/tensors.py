"""Tensors in pickles as PyTorch writes them there, with the same bytes each time.

PyTorch names a storage by where it lies in memory; here it is always the first one.
"""

import io
import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.machine.storage import write_bytes
from benchmark.untrusted.legacy_storages import FORMAT, MAGIC, STORAGES

_PROTOCOL: Final = 2
"""What mmcv writes."""
_SYSTEM: Final = {
    "protocol_version": FORMAT,
    "little_endian": True,
    "type_sizes": {"short": 2, "int": 4, "long": 4},
}
_CLASS_OF: Final = {kind: name for name, kind in STORAGES.items() if name != "BFloat16Storage"}


class PickledTensor:
    """An array that is pickled as the tensor of the same numbers.

    Single precision unless `kind`, a number type as numpy names it, says otherwise.
    """

    def __init__(self, values: ArrayLike, kind: str = "<f4") -> None:
        self._values: NDArray[Any] = np.ascontiguousarray(values, kind)

    def __reduce__(self) -> tuple[Any, ...]:
        """As a tensor reduces itself."""
        from torch._utils import _rebuild_tensor_v2

        values = self._values
        strides = tuple(step // values.itemsize for step in values.strides)
        return _rebuild_tensor_v2, (_Storage(values), 0, values.shape, strides, False, OrderedDict())


class _Storage:
    """The numbers of a tensor, pickled as PyTorch's storages are."""

    def __init__(self, values: NDArray[Any]) -> None:
        self.values = values

    def __reduce__(self) -> tuple[Any, ...]:
        """As a storage reduces itself: the bytes of a file in PyTorch's old form."""
        from torch.storage import _load_from_bytes

        return _load_from_bytes, (_storage_bytes(self),)


class _StoragePickler(pickle.Pickler):
    def persistent_id(self, obj: Any) -> Any:
        """Tuple that stands for the storage."""
        if not isinstance(obj, _Storage):
            return None
        import torch

        kind = getattr(torch, _CLASS_OF[obj.values.dtype.str])
        return ("storage", kind, "0", "cpu", obj.values.size, None)


def _storage_bytes(storage: _Storage) -> bytes:
    stream = io.BytesIO()
    for value in (MAGIC, FORMAT, _SYSTEM):
        pickle.dump(value, stream, _PROTOCOL)
    _StoragePickler(stream, _PROTOCOL).dump(storage)
    pickle.dump(["0"], stream, _PROTOCOL)
    stream.write(storage.values.size.to_bytes(8, "little"))
    stream.write(storage.values.tobytes())
    return stream.getvalue()


def write_pickle(path: Path, value: Any, protocol: int = _PROTOCOL) -> Path:
    """Write a pickle of plain values, arrays and `PickledTensor`."""
    write_bytes(path, pickle.dumps(value, protocol))
    return path
