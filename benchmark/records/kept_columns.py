"""Columns and compressed lines of large records, kept in the user's cache: a record is parsed and checked once.

They count for rows with one SHA-256, that of ``samples.jsonl``, and for the code that made them; whatever does not fit
is as good as none. The cache says nothing that the record does not say, and what is in it is made again from there.
"""

import contextlib
import functools
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.machine.kept_arrays import kept_place, read_arrays, said_of, write_arrays
from benchmark.machine.storage import content_key, file_sha256, parse_json
from benchmark.records.column_arrays import Arrays, Name
from benchmark.records.rows import Rows
from benchmark.untrusted.files import open_file
from benchmark.untrusted.limits import RECORD

WORTH_BYTES: Final = 1 << 22
"""Rows of less are read in less time than anybody notices."""
_FOLDER: Final = "records"
_PARTS: Final = {"index": "u1", "arrays": "u1"}
"""Where each array lies, as JSON, and the arrays one after the other."""
_TYPES: Final = frozenset({"bool", "uint8", "int32", "int64", "float64"})
_ALIGNED: Final = 64


def kept_rows(rows: Path, sha256: str) -> Rows | None:
    """Rows that somebody has read before.

    Args:
        rows: The file.
        sha256: What its hash must be.

    Returns:
        The rows with their columns, which lie in a file of the cache; ``None`` where they are not kept, or the file has
        another hash.
    """
    place = kept_at(rows)
    kept = None if place is None else read_arrays(place, _made_of(sha256), _PARTS)
    arrays = None if kept is None else _taken_apart(kept)
    if arrays is None:
        return None
    try:
        with open_file(rows, RECORD) as stream:
            own = hashlib.file_digest(stream, "sha256").hexdigest()
    except (InputError, OSError):
        return None
    return Rows.of_arrays(arrays) if own == sha256 else None


def keep_rows(path: Path, sha256: str, rows: Rows) -> Rows:
    """Keep rows for the next who reads them, if they are worth it and there is room.

    Args:
        path: The file that they are in.
        sha256: Its hash.
        rows: The rows, checked.

    Returns:
        The same rows, in the file of the cache where they are kept: they need no memory of their own there.
    """
    place = kept_at(path)
    if place is None or path.stat().st_size < WORTH_BYTES:
        return rows
    arrays = rows.arrays()
    if not all(values.dtype.name in _TYPES for values in arrays.values()):
        return rows
    _forget_what_is_gone(place.parent)
    if not write_arrays(place, _made_of(sha256), {"rows": str(path.resolve())}, _put_together(arrays)):
        return rows
    return kept_rows(path, sha256) or rows


def kept_at(rows: Path) -> Path | None:
    """Where what is known of a file of rows is kept; nowhere where the user has no home."""
    return kept_place(_FOLDER, rows)


def _made_of(sha256: str) -> str:
    return content_key(_checks(), sha256)


@functools.cache
def _checks() -> str:
    """What decides which rows are refused and what columns say of them: code, and who checks for it."""
    import pydantic

    own = ("column_arrays", "driving", "judgement", "kept_columns", "row_schema", "rows", "run", "stored")
    others = (
        *("constants", "geometry", "waypoints", "untrusted/json_text", "untrusted/limits", "pdm/totals"),
        "protocols/contract",
    )
    here = Path(__file__).parent
    files = [*(here / f"{name}.py" for name in own), *(here.parent / f"{name}.py" for name in others)]
    return content_key(pydantic.VERSION, [(path.name, file_sha256(path)) for path in files])


def _put_together(arrays: Arrays) -> dict[str, NDArray[Any]]:
    index: list[list[Any]] = []
    parts: list[NDArray[np.uint8]] = []
    starts: dict[int, int] = {}
    end = 0
    for name, values in arrays.items():
        if id(values) not in starts:
            starts[id(values)] = end
            data = np.frombuffer(np.ascontiguousarray(values).tobytes(), np.uint8)
            parts += [data, np.zeros(-len(data) % _ALIGNED, np.uint8)]
            end += len(data) + len(parts[-1])
        index.append([list(name), values.dtype.name, list(values.shape), starts[id(values)]])
    text = np.frombuffer(json.dumps(index, separators=(",", ":")).encode(), np.uint8)
    return {"index": text, "arrays": np.concatenate([np.zeros(0, np.uint8), *parts])}


def _taken_apart(kept: Mapping[str, NDArray[Any]]) -> dict[Name, NDArray[Any]] | None:
    found: dict[Name, NDArray[Any]] = {}
    for name, kind, shape, start in parse_json(kept["index"].tobytes(), RECORD):
        if kind not in _TYPES:
            return None
        dtype = np.dtype(kind)
        size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        found[tuple(name)] = kept["arrays"][start : start + size].view(dtype).reshape(shape)
    return found


@functools.cache
def _forget_what_is_gone(kept: Path) -> None:
    """Remove what is kept of rows that are no longer there; once is enough for a process."""
    for path in kept.glob("*.arrays"):
        rows = (said_of(path) or {}).get("rows")
        if isinstance(rows, str) and Path(rows).is_file():
            continue
        with contextlib.suppress(OSError):
            path.unlink()
