"""What one pass over large tables found, kept in the user's cache: where rows are, which scene has which, which images.

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
from benchmark.datasets.schema import FaultList, Refusal
from benchmark.datasets.stored_rows import StoredRows, stamp_while_open
from benchmark.machine.kept_arrays import kept_place, read_batch, write_batch
from benchmark.machine.storage import content_key, file_sha256, parse_json
from benchmark.machine.user_cache import Stamp, is_settled, stamp_of
from benchmark.untrusted.limits import TABLE

if TYPE_CHECKING:
    import pyarrow as pa

WORTH_BYTES: Final = 1 << 24
"""Tables of less are parsed in less time than anybody notices."""
_FOLDER: Final = "opened"
_IMAGES: Final = "images"
_PARTS: Final = {"starts": "<i8", "lengths": "<i4", "rows": "<i4", "ends": "<i4"}
"""Of each growing table: places and lengths of its rows; numbers of the rows of all scenes, and where a scene ends."""
_TYPES: Final = {
    **{f"{table}.{part}": kind for table in GROWING_TABLES for part, kind in _PARTS.items()},
    _IMAGES: "u1",
}


def read_or_kept(folder: Path, rates: FaultList) -> SceneTables | None:
    """`read_scene_tables`, which it need not do where somebody has opened the same tables before.

    Args:
        folder: Version folder.
        rates: Gets scenes with another rate of keyframes than nuScenes.

    Returns:
        The tables; ``None`` as there.

    Raises:
        InputError: As there.
    """
    looked_ns, stamps = time.time_ns(), _stamps(folder)
    place = kept_at(folder)
    if place is None or sum(stamps[table][2] for table in GROWING_TABLES if table in stamps) < WORTH_BYTES:
        return read_scene_tables(folder, rates)
    made_of = content_key(_checks(), sorted(stamps.items()))
    kept = read_batch(place, made_of)
    found = None if kept is None else _of_kept(folder, stamps, kept)
    if found is not None and _stamps(folder) == stamps:
        return found
    noted = rates.counts.total()
    tables = read_scene_tables(folder, rates)
    settled = all(is_settled(stamp, looked_ns) for stamp in stamps.values())
    # What is noted of scenes is not kept, so that tables with anything to note are read again.
    if tables is not None and settled and rates.counts.total() == noted and _stamps(folder) == stamps:
        write_batch(place, folder, made_of, _to_keep(tables))
    return tables


def kept_at(folder: Path) -> Path | None:
    """Where what is known of a version folder is kept; nowhere where the user has no home."""
    return kept_place(_FOLDER, folder)


def digests_beside(kept: Path) -> Path:
    """Where the hashes of the same folder's files are kept."""
    return kept.with_suffix(".digests.json")


def _stamps(folder: Path) -> dict[str, Stamp]:
    """Of the tables that are there."""
    paths = {table: folder / f"{table}.json" for table in NUSCENES_TABLES}
    return {table: stamp_of(path.stat()) for table, path in paths.items() if path.is_file()}


@functools.cache
def _checks() -> str:
    """What decides which tables are refused and what is found in them: code of this folder."""
    here = Path(__file__).parent
    own = [here / f"{name}.py" for name in ("kept_tables", "scene_tables", "stored_rows")]
    modules = sorted((*here.glob("schema/*.py"), *own))
    return content_key([(path.name, file_sha256(path)) for path in modules])


def _schema() -> "pa.Schema":
    """Each array is one value of a column of its own."""
    import pyarrow as pa

    return pa.schema([(name, pa.large_list(pa.from_numpy_dtype(kind))) for name, kind in _TYPES.items()])


def _to_keep(tables: SceneTables) -> "pa.RecordBatch":
    import pyarrow as pa

    found: dict[str, NDArray[Any]] = {}
    for table in GROWING_TABLES:
        stored, of_scenes = tables.stored[table], tables.rows_of_scenes[table]
        values: dict[str, NDArray[Any]] = {
            "starts": stored.starts,
            "lengths": stored.lengths,
            "rows": np.concatenate([np.zeros(0, np.int32), *of_scenes]),
            "ends": np.cumsum([len(rows) for rows in of_scenes]),
        }
        found |= {f"{table}.{part}": values[part].astype(kind, copy=False) for part, kind in _PARTS.items()}
    images = json.dumps(tables.keyframe_images(), separators=(",", ":")).encode()
    found[_IMAGES] = np.frombuffer(images, np.uint8)
    return pa.RecordBatch.from_pydict({name: [values] for name, values in found.items()}, _schema())


def _of_kept(folder: Path, stamps: dict[str, Stamp], batch: "pa.RecordBatch") -> SceneTables | None:
    if not batch.schema.equals(_schema()):
        return None
    kept: dict[str, NDArray[Any]] = {name: batch.column(name).flatten().to_numpy() for name in _TYPES}

    def images() -> Sequence[str]:
        names: list[str] = parse_json(kept[_IMAGES].tobytes(), TABLE)
        return names

    def of_scenes(table: str) -> list[Any]:
        ends = kept[f"{table}.ends"].tolist()
        rows = kept[f"{table}.rows"]
        return [rows[first:last] for first, last in zip([0, *ends], ends)]

    faults = Refusal(folder=folder)
    stored = {
        table: StoredRows(
            folder / f"{table}.json",
            stamp_while_open(stamps[table]),
            kept[f"{table}.starts"],
            kept[f"{table}.lengths"],
        )
        for table in GROWING_TABLES
    }
    by_scene = {table: of_scenes(table) for table in GROWING_TABLES}
    return SceneTables(images, stored, by_scene, read_shared(folder, faults), faults)
