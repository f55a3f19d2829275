"""Rows of a record in memory: compressed JSON lines, columns of what tables read, and the scenes that a planner fails.

A parsed row takes 20 to 30 kB, its line 3 to 4 kB, and compressed, scene by scene, 0.4 kB; iteration parses a scene at
a time. Lines and columns of large records are kept in the user's cache, for the SHA-256 of ``samples.jsonl`` and the
code that made them; a cache file that does not match is ignored.
"""

import contextlib
import functools
import hashlib
import operator
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import groupby, islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, overload

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Bools
from benchmark.machine.cached_arrays import find_cache_file, is_batch_of, read_batch, write_batch
from benchmark.machine.progress import CountedUnits
from benchmark.machine.storage import canonical_json, content_key, file_sha256
from benchmark.machine.workers import default_workers, map_ordered
from benchmark.protocols import find_protocol as definition_of
from benchmark.records.row_schema import SampleRow
from benchmark.untrusted.files import RECORD, open_file
from benchmark.untrusted.text_files import read_lines

if TYPE_CHECKING:
    import pyarrow as pa

    from benchmark.records.columns import RowColumns

WORTH_BYTES: Final = 1 << 22
"""Rows of less are read in less time than anybody notices; nothing is kept of them."""
WORTH_WORKERS_BYTES: Final = 1 << 27
"""Rows of less are read before workers have begun."""
_FOLDER: Final = "records"
_CODE: Final = (
    *(f"records/{name}" for name in ("columns", "driving", "scene_assessment", "row_schema", "rows", "run", "stored")),
    *("constants", "geometry", "waypoints", "untrusted/text_files", "untrusted/files", "pdm/totals"),
    "protocols/contract",
)
_LINES_AT_ONCE: Final = 64
"""Lines that are looked at together before they are parsed one by one."""
_QUICK: Final = 1
"""Level of compression: lines of a scene repeat each other, so that more effort gains little."""


class SampleRows(Sequence[SampleRow]):
    """Rows in compressed form; every access makes new `SampleRow` objects, which are equal.

    ``blocks`` are, for each scene, its name, how many rows it has, and their lines, compressed.
    """

    def __init__(self, blocks: Iterable[tuple[str, int, bytes | memoryview]] = ()) -> None:
        self._blocks = list(blocks)

    @classmethod
    def of(cls, rows: Sequence[SampleRow]) -> "SampleRows":
        """Checked rows in compressed form, which they may be in already."""
        if isinstance(rows, cls):
            return rows
        compressed = cls()
        compressed.add(rows)
        return compressed

    def add(self, rows: Sequence[SampleRow]) -> None:
        """Add rows, scene after scene, at the end, before columns are asked for."""
        for scene, scene_rows in groupby(rows, key=lambda row: row.scene):
            self._add(scene, list(map(format_line, scene_rows)))

    def _add(self, scene: str, lines: Sequence[str]) -> None:
        self._blocks.append((scene, len(lines), zlib.compress("\n".join(lines).encode(), _QUICK)))

    @classmethod
    def read(cls, path: Path, parse: Callable[[Sequence[tuple[int, str]]], Sequence[SampleRow]]) -> "SampleRows":
        """Read a file of rows, with their columns; ``parse`` checks some lines, each given with its number."""
        from benchmark.records.columns import RowColumns, build_batch

        compressed, waiting = cls(), read_lines(path, RECORD)
        chunks = iter(lambda: list(islice(waiting, _LINES_AT_ONCE)), [])
        checked = ((row, line) for chunk in chunks for row, (_, line) in zip(parse(chunk), chunk, strict=True))

        def added() -> Iterator[SampleRow]:
            for scene, pairs in groupby(checked, key=lambda pair: pair[0].scene):
                lines = []
                for row, line in pairs:
                    lines.append(line)
                    yield row
                compressed._add(scene, lines)

        batch = build_batch(added())
        # Of separate rows: a reference cycle would stay in memory until Python's next collection.
        compressed.columns = RowColumns(cls(compressed._blocks), batch)
        return compressed

    @classmethod
    def of_batch(cls, batch: "pa.RecordBatch") -> "SampleRows":
        """Rows as `batch` gives them, which stay where they are, in a file perhaps."""
        from benchmark.records.columns import LINES, RowColumns

        rows, (_, ends, packed) = cls(), batch.column(LINES).buffers()
        columns, lines = RowColumns(rows, batch), np.frombuffer(ends, np.int32)
        scenes, starts = columns.values("scene"), np.flatnonzero(np.diff(lines)).tolist()
        for first, last in pairwise([*starts, len(scenes)]):
            rows._blocks.append((scenes[first], last - first, memoryview(packed)[lines[first] : lines[last]]))
        compressed = cls(rows._blocks)
        compressed.columns = columns
        return compressed

    def batch(self) -> "pa.RecordBatch":
        """All of them: their columns, and their lines, compressed, beside the first row of each scene."""
        import pyarrow as pa

        from benchmark.records.columns import LINES, concatenate_bytes

        batch = self.columns.batch
        if LINES in batch.schema.names:
            return batch
        lines = [part for _, count, packed in self._blocks for part in (packed, *[b""] * (count - 1))]
        return batch.append_column(LINES, concatenate_bytes(pa.binary(), lines))

    def in_order_of(self, scenes: Sequence[str]) -> "SampleRows":
        """The same rows with their scenes, all of which are named, in another order."""
        place = {name: number for number, name in enumerate(scenes)}
        return SampleRows(sorted(self._blocks, key=lambda block: place[block[0]]))

    def lines(self) -> Iterator[str]:
        """One JSON text a row, as files have them."""
        for _, lines in self.texts():
            yield from lines

    def texts(self) -> Iterator[tuple[str, list[str]]]:
        """Name and JSON texts of the rows of each scene."""
        for scene, _, packed in self._blocks:
            yield scene, zlib.decompress(packed).decode().split("\n")

    def of_scene(self, scene: str) -> list[SampleRow]:
        """Rows of one scene; none of a scene that is not there."""
        return [row for block in self._blocks if block[0] == scene for row in _parsed(block[2])]

    def of_failed_scenes(self) -> list[SampleRow]:
        """Rows of the scenes in which a sample has no plan."""
        columns = self.columns
        failed = {columns.values("scene")[place] for place in np.flatnonzero(columns.failed).tolist()}
        return [row for scene, _, packed in self._blocks if scene in failed for row in _parsed(packed)]

    @cached_property
    def columns(self) -> "RowColumns":
        """Columns of the rows, which tables read."""
        from benchmark.records.columns import RowColumns

        return RowColumns(SampleRows(self._blocks))

    def __reduce__(self) -> tuple[Any, ...]:
        # Columns are made again: other processes cannot read our mapped file.
        return SampleRows, ([(scene, count, bytes(packed)) for scene, count, packed in self._blocks],)

    def __len__(self) -> int:
        return sum(count for _, count, _ in self._blocks)

    def __iter__(self) -> Iterator[SampleRow]:
        for _, _, packed in self._blocks:
            yield from _parsed(packed)

    @overload
    def __getitem__(self, place: int) -> SampleRow: ...
    @overload
    def __getitem__(self, place: slice) -> list[SampleRow]: ...
    def __getitem__(self, place: int | slice) -> SampleRow | list[SampleRow]:
        if isinstance(place, slice):
            return list(self)[place]
        wanted, ends = range(len(self))[place], np.cumsum([count for _, count, _ in self._blocks])
        block = int(np.searchsorted(ends, wanted, side="right"))
        lines = zlib.decompress(self._blocks[block][2]).split(b"\n")
        return SampleRow.model_validate_json(lines[wanted - ends[block]])

    def __eq__(self, other: object) -> bool:
        if isinstance(other, SampleRows) and self._blocks == other._blocks:
            return True
        return isinstance(other, Sequence) and len(self) == len(other) and all(map(operator.eq, self, other))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<{len(self)} rows of {len(self._blocks)} scenes>"


def get_columns(rows: "Sequence[SampleRow] | RowColumns") -> "RowColumns":
    """Columns of rows, made once where they are a record's."""
    from benchmark.records.columns import RowColumns

    if isinstance(rows, RowColumns):
        return rows
    return rows.columns if isinstance(rows, SampleRows) else RowColumns(rows)


def read_cached_rows(rows: Path, sha256: str) -> SampleRows | None:
    """Rows with their columns that were read before from a file with that hash, where they are kept in the cache."""
    from benchmark.records.columns import is_column_batch

    place = find_cache_file(_FOLDER, rows)
    batch = None if place is None else read_batch(place, content_key(_checks_key(), sha256))
    if batch is None or not is_column_batch(batch):
        return None
    with open_file(rows, RECORD) as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return SampleRows.of_batch(batch) if digest == sha256 else None


def cache_rows(path: Path, sha256: str, rows: SampleRows) -> SampleRows:
    """The same rows, kept for the next who reads the file, and so in no memory, if that is worth it and possible."""
    place = find_cache_file(_FOLDER, path)
    if place is None or path.stat().st_size < WORTH_BYTES:
        return rows
    return (
        write_batch(place, path, content_key(_checks_key(), sha256), rows.batch()) and read_cached_rows(path, sha256)
    ) or rows


def cache_in_parallel(files: Mapping[Path, str], read: Callable[[Path], object]) -> None:
    """Let workers read files (with SHA-256) that are not kept yet, where that takes less time.

    ``read`` is importable, reads the record in a folder and keeps its rows.
    """
    new = {path: sha256 for path, sha256 in files.items() if path.is_file() and not _is_cached((path, sha256))}
    sizes = [path.stat().st_size for path in new]
    workers = min(default_workers(), sum(size >= WORTH_BYTES for size in sizes))
    if workers > 1 and sum(sizes) >= WORTH_WORKERS_BYTES:
        # The next reader reports damage; if the first record cannot be cached, no other is tried.
        with contextlib.suppress(InputError):
            keep, count = functools.partial(_cache_file, read), CountedUnits("record")
            all(map_ordered(keep, list(new.items()), workers=workers, label="reading records", count=count))


def _cache_file(read: Callable[[Path], object], file: tuple[Path, str]) -> bool:
    read(file[0].parent)
    return file[0].stat().st_size < WORTH_BYTES or _is_cached(file)


def _is_cached(file: tuple[Path, str]) -> bool:
    place = find_cache_file(_FOLDER, file[0])
    return place is not None and is_batch_of(place, content_key(_checks_key(), file[1]))


def format_line(row: SampleRow) -> str:
    """A row as files have it."""
    # Younger than records that must stay the same bytes.
    return canonical_json(row.model_dump(mode="json", exclude=None if row.note else {"note"}))


@functools.cache
def _checks_key() -> str:
    """Content key of all that decides which rows are refused and what their columns hold: code, and its checkers."""
    import pydantic

    root = Path(__file__).parents[1]
    return content_key(pydantic.VERSION, [(name, file_sha256(root / f"{name}.py")) for name in _CODE])


def _parsed(packed: bytes | memoryview) -> list[SampleRow]:
    return [SampleRow.model_validate_json(line) for line in zlib.decompress(packed).split(b"\n")]


_FAILURES: Final = "failures of scenes"


def find_scene_failures(rows: "Sequence[SampleRow] | RowColumns", protocol: str) -> dict[str, bool | None]:
    """Which scenes a planner fails, by name: those with a counted sample that collides at any step.

    ``None`` where no verdict is possible: no counted sample whose collisions are known, or no contact but the planner
    raised on a sample that could have shown one.
    """
    definition_of(protocol)
    columns = get_columns(rows)
    if (_FAILURES, protocol) not in columns.kept:
        judged = columns.values("judged")
        unjudged = next((place for place in columns.planned.tolist() if protocol not in judged[place]), None)
        if unjudged is not None:
            raise InputError(
                f"scene {columns.values('scene')[unjudged]} was not judged by protocol {protocol!r}; run "
                "challenger-bench rescore"
            )
        columns.kept[_FAILURES, protocol] = find_scenes_with(columns, protocol, columns.collides(protocol))
    return dict(columns.kept[_FAILURES, protocol])


def find_scenes_with(columns: "RowColumns", protocol: str, hits: Bools) -> dict[str, bool | None]:
    """Which scenes have one of the (R,) colliding samples ``hits``, which count; verdicts as of `find_scene_failures`.

    All R rows of ``columns`` are judged by the protocol.
    """
    counted, unknown = columns.counted(protocol), _unknown(columns, protocol)
    return {
        scene: _fails(hits[places], counted[places], unknown[places])
        for scene, places in sorted(columns.places_of_scenes.items())
    }


def _fails(hits: Bools, counted: Bools, unknown: Bools) -> bool | None:
    if hits.any():
        return True
    return None if unknown.any() or not counted.any() else False


def _unknown(columns: "RowColumns", protocol: str) -> Bools:
    """(R,) whether the planner raised on a sample that could have shown a contact."""
    could = columns.flags("complete")
    if definition_of(protocol).counts_incomplete:
        could = could | columns.flags("recorded")
    return columns.failed & could


def find_raised_line(error: str) -> str:
    """The line of a traceback that says what was raised."""
    # A message may have many lines; the one that names the exception is the last that is not indented.
    lines = [line for line in error.rstrip().splitlines() if line.strip()]
    last_frame = max((number for number, line in enumerate(lines) if line.startswith('  File "')), default=-1)
    raised = [line for line in lines[last_frame + 1 :] if not line.startswith(" ")]
    return (raised or lines or ["no message"])[0].strip()
