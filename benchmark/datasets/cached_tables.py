"""Index of large tables in the user's cache, from one pass: where rows are, which scene has which, which images.

The tables are not parsed again as long as each is the file that it was (`benchmark.machine.user_cache.Stamp`) and the
checks are the same; rows themselves are always read from the tables. All processes share the memory of what is kept.
"""

import functools
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.scene_tables import GROWING_TABLES, SceneTables, read_scene_tables, read_shared
from benchmark.datasets.schema import FaultList, StrictFaultList
from benchmark.datasets.stored_rows import TableRowIndex, drop_inode_time
from benchmark.machine.cached_arrays import find_cache_file, read_batch, to_arrow, to_numpy_array, write_batch
from benchmark.machine.storage import content_key, file_sha256, parse_json
from benchmark.machine.user_cache import Stamp, is_settled, make_stamp
from benchmark.untrusted.files import TABLE

if TYPE_CHECKING:
    import pyarrow as pa

WORTH_BYTES: Final = 1 << 24
"""Tables of less are parsed in less time than anybody notices."""
_FOLDER: Final = "opened"
_IMAGES: Final = "images"
_PARTS: Final = {"starts": "int64", "lengths": "int32", "rows": "int32", "ends": "int64"}
"""Of each growing table: places and lengths of its rows; numbers of the rows of all scenes, and where a scene ends."""
_TYPES: Final = {
    **{f"{table}.{part}": f"large_list<item: {kind}>" for table in GROWING_TABLES for part, kind in _PARTS.items()},
    _IMAGES: "large_list<item: uint8>",
}


def read_tables_cached(folder: Path, rates: FaultList) -> SceneTables | None:
    """`read_scene_tables`, with nothing to read where the same tables were opened before."""
    looked_ns, stamps = time.time_ns(), _stamps(folder)
    place = find_cache_folder(folder)
    if place is None or sum(stamps[table][2] for table in GROWING_TABLES if table in stamps) < WORTH_BYTES:
        return read_scene_tables(folder, rates)
    made_of = content_key(_checks_key(), sorted(stamps.items()))
    batch = read_batch(place, made_of)
    cached_tables = None if batch is None else _decode_tables(folder, stamps, batch)
    if cached_tables is not None and _stamps(folder) == stamps:
        return cached_tables
    noted = rates.counts.total()
    tables = read_scene_tables(folder, rates)
    settled = all(is_settled(stamp, looked_ns) for stamp in stamps.values())
    # Findings about scenes are not cached, so tables with findings are read again.
    if tables is not None and settled and rates.counts.total() == noted and _stamps(folder) == stamps:
        write_batch(place, folder, made_of, _encode_tables(tables))
    return tables


def find_cache_folder(folder: Path) -> Path | None:
    """Folder in which facts about a version folder are kept; ``None`` where the user has no home."""
    return find_cache_file(_FOLDER, folder)


def find_digest_file(kept: Path) -> Path:
    """File with the kept hashes of the same folder's files."""
    return kept.with_suffix(".digests.json")


def _stamps(folder: Path) -> dict[str, Stamp]:
    paths = {table: folder / f"{table}.json" for table in NUSCENES_TABLES}
    return {table: make_stamp(path.stat()) for table, path in paths.items() if path.is_file()}


@functools.cache
def _checks_key() -> str:
    """Content key of the code of this folder, which decides what tables are refused and what is found in them."""
    folder = Path(__file__).parent
    code_files = [folder / f"{name}.py" for name in ("cached_tables", "scene_tables", "stored_rows")]
    modules = sorted((*folder.glob("schema/*.py"), *code_files))
    return content_key([(path.name, file_sha256(path)) for path in modules])


def _encode_tables(tables: SceneTables) -> "pa.RecordBatch":
    import pyarrow as pa

    images = json.dumps(tables.keyframe_images(), separators=(",", ":")).encode()
    arrays: dict[str, NDArray[Any]] = {_IMAGES: np.frombuffer(images, np.uint8)}
    for table in GROWING_TABLES:
        stored, of_scenes = tables.stored[table], tables.rows_of_scenes[table]
        rows = np.concatenate([np.zeros(0, np.int32), *of_scenes])
        ends = np.cumsum([len(numbers) for numbers in of_scenes])
        parts: tuple[NDArray[Any], ...] = (stored.starts, stored.lengths, rows, ends)
        arrays |= {f"{table}.{part}": values.astype(_PARTS[part]) for part, values in zip(_PARTS, parts)}
    # Each array is the one value of a column.
    columns = {
        name: pa.LargeListArray.from_arrays(to_arrow(np.array([0, len(values)])), to_arrow(values))
        for name, values in arrays.items()
    }
    return pa.RecordBatch.from_arrays(list(columns.values()), names=list(columns))


def _decode_tables(folder: Path, stamps: dict[str, Stamp], batch: "pa.RecordBatch") -> SceneTables | None:
    if {field.name: str(field.type) for field in batch.schema} != _TYPES:
        return None
    arrays = {name: to_numpy_array(batch.column(name).values) for name in _TYPES}

    def images() -> Sequence[str]:
        names: list[str] = parse_json(arrays[_IMAGES].tobytes(), TABLE)
        return names

    stored, by_scene = {}, {}
    for table in GROWING_TABLES:
        starts, lengths, rows, ends = (arrays[f"{table}.{part}"] for part in _PARTS)
        stored[table] = TableRowIndex(folder / f"{table}.json", drop_inode_time(stamps[table]), starts, lengths)
        by_scene[table] = np.split(rows, ends)[:-1]
    faults = StrictFaultList(folder=folder)
    return SceneTables(images, stored, by_scene, read_shared(folder, faults), faults)
