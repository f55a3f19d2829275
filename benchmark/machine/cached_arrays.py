"""Arrow batches in files of the user's cache: written whole, read as a part of memory that processes share.

A line of JSON says what a batch was made of and the SHA-256 of all that follows, a file of Arrow IPC; one that does not
fit is not read. Numbers go in and out through buffers: ``pyarrow.array`` and ``to_numpy`` would import pandas.
"""

import contextlib
import hashlib
import mmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, content_key, parse_json, write_parts
from benchmark.machine.user_cache import cache_root
from benchmark.untrusted.files import CACHED_ARRAYS, open_file

if TYPE_CHECKING:
    import pyarrow as pa


_ALIGNED: Final = 64
_LONGEST_HEAD: Final = 1 << 20


def find_cache_file(folder: str, source: Path) -> Path | None:
    """File of the user's cache, below ``folder``, for a batch made of ``source``; none where the user has no home."""
    try:
        root = cache_root()
    except RuntimeError:
        return None
    return root / folder / f"{content_key(str(source.resolve()))[:32]}.arrays"


def write_batch(path: Path, source: Path, made_of: str, batch: "pa.RecordBatch") -> bool:
    """Keep a batch, unless there is no room or right to. Of two who write at once one writes last, each a whole file.

    What is kept of sources that are gone, and what lies beside it under its name, is removed, so that the folder
    (`find_cache_file`) holds such files alone. ``made_of`` is the state of the source, and all else the batch depends
    on.
    """
    import pyarrow as pa

    stream = pa.BufferOutputStream()
    with pa.ipc.new_file(stream, batch.schema) as writer:
        writer.write_batch(batch)
    body = memoryview(stream.getvalue())
    head_values = {"source": str(source.resolve()), "made_of": made_of, "sha256": hashlib.sha256(body).hexdigest()}
    head = canonical_json(head_values).encode()
    _remove_orphans(path.parent)
    try:
        write_parts(path, (head, b" " * (-(len(head) + 1) % _ALIGNED), b"\n", body))
    except InputError:
        # Nothing is lost: the same is computed again.
        return False
    return True


def is_batch_of(path: Path, made_of: str) -> bool:
    """Whether a file says that it holds a batch that depends on that; whether it is sound shows when it is read."""
    try:
        with open_file(path, CACHED_ARRAYS) as stream:
            return bool(_head(stream).get("made_of") == made_of)
    except (InputError, OSError):
        return False


def read_batch(path: Path, made_of: str) -> "pa.RecordBatch | None":
    """A batch that was kept, which lies in the file; ``None`` if it is absent, damaged or not made of ``made_of``."""
    import pyarrow as pa

    try:
        with open_file(path, CACHED_ARRAYS) as stream:
            head, start = _head(stream), stream.tell()
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            if (head.get("made_of"), head.get("sha256")) != (made_of, digest):
                return None
            mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        batch = pa.ipc.open_file(pa.py_buffer(mapped)[start:]).get_batch(0)
        batch.validate(full=True)
        # Releases pages that were read only for the validation.
        mapped.madvise(mmap.MADV_DONTNEED)
    except (InputError, OSError, ValueError, pa.ArrowException):
        return None
    return batch


def to_arrow(values: NDArray[Any]) -> "pa.Array":
    """Numbers or truth values, in the order in which they lie, as a column."""
    import pyarrow as pa

    flat = np.ascontiguousarray(values).reshape(-1)
    data = np.packbits(flat, bitorder="little") if flat.dtype == np.bool_ else flat
    return pa.Array.from_buffers(pa.from_numpy_dtype(flat.dtype), len(flat), [None, pa.py_buffer(data)])


def to_numpy_array(column: "pa.Array") -> NDArray[Any]:
    """Values of a whole column, read-only; entries at nulls are arbitrary."""
    kind, data = np.dtype(str(column.type)), column.buffers()[1]
    if kind == np.bool_:
        values = np.unpackbits(np.frombuffer(data, np.uint8), count=len(column), bitorder="little").view(np.bool_)
    else:
        values = np.frombuffer(data, kind, len(column))
    values.flags.writeable = False
    return values


def _head(stream: BinaryIO) -> dict[str, Any]:
    """The parsed first line; empty if it is not one of ours."""
    try:
        head = parse_json(stream.readline(_LONGEST_HEAD))
    except ValueError:
        return {}
    return head if isinstance(head, dict) else {}


def _remove_orphans(folder: Path) -> None:
    for path in folder.glob("*.arrays"):
        with contextlib.suppress(InputError, OSError):
            with open_file(path, CACHED_ARRAYS) as stream:
                source = _head(stream).get("source")
            if not (isinstance(source, str) and Path(source).exists()):
                for orphan in folder.glob(f"{path.stem}.*"):
                    orphan.unlink()
