"""Rows of a record as they are kept in memory: compressed JSON lines, and columns of what tables read.

A parsed row takes 20 to 30 kB, its line 3 to 4 kB, and compressed, scene by scene, 0.4 kB. Rows are parsed again when
somebody goes through them, a scene at a time.
"""

import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import groupby, islice
from pathlib import Path
from typing import Any, Final, overload

import numpy as np
from numpy.typing import NDArray

from benchmark.machine.garbage import uncollected
from benchmark.machine.storage import canonical_json
from benchmark.records.column_arrays import CODES, Arrays, Name, arrays_of, coded, different_values
from benchmark.records.columns import RowColumns
from benchmark.records.row_schema import SampleRow
from benchmark.untrusted.json_text import read_lines
from benchmark.untrusted.limits import RECORD

_LINES_AT_ONCE: Final = 64
"""Lines that are looked at together before they are parsed one by one."""
_BLOCKS: Final = "blocks"
_QUICK: Final = 1
"""Level of compression: lines of a scene repeat each other, so that more effort gains little."""


class Rows(Sequence[SampleRow]):
    """Rows in compressed form; every access makes new `SampleRow` objects, which are equal.

    Args:
        blocks: For each scene its name, how many rows it has, and their lines, compressed.
    """

    def __init__(self, blocks: Iterable[tuple[str, int, bytes | memoryview]] = ()) -> None:
        self._blocks = list(blocks)

    @classmethod
    def of(cls, rows: Sequence[SampleRow]) -> "Rows":
        """Rows in compressed form.

        Args:
            rows: Checked rows.

        Returns:
            The same rows, or themselves if they are in this form already.
        """
        if isinstance(rows, cls):
            return rows
        made = cls()
        for _, scene in groupby(rows, key=lambda row: row.scene):
            made.add(list(scene))
        return made

    def add(self, rows: Sequence[SampleRow], lines: Sequence[str] | None = None) -> None:
        """Add the rows of one scene at the end, before anybody asks for columns.

        Args:
            rows: The rows.
            lines: Their JSON, where it is at hand.
        """
        if rows:
            texts = [line_of(row) for row in rows] if lines is None else lines
            packed = zlib.compress("\n".join(texts).encode(), _QUICK)
            self._blocks.append((rows[0].scene, len(rows), packed))

    @classmethod
    def read(cls, path: Path, parse: Callable[[Sequence[tuple[int, str]]], Sequence[SampleRow]]) -> "Rows":
        """Read a file of rows.

        Args:
            path: The file.
            parse: Checks some lines, each given with its number.

        Returns:
            The rows, with their columns.

        Raises:
            InputError: If the file is damaged.
        """
        made, parsed = cls(), list[SampleRow]()
        with uncollected():
            for _, scene in groupby(_checked(path, parse), key=lambda pair: pair[0].scene):
                rows, lines = zip(*scene)
                made.add(rows, lines)
                parsed += rows
            vars(made)["columns"] = RowColumns(made, arrays_of(parsed))
        return made

    @classmethod
    def of_arrays(cls, arrays: Arrays) -> "Rows":
        """Rows in the form that `arrays` gives; they stay where they are, in a file perhaps, until they are asked."""
        scenes, packed = different_values(arrays, (_BLOCKS,)), arrays[_BLOCKS, "packed"].data
        names = (scenes[code] for code in arrays[_BLOCKS, CODES].tolist())
        counts, ends = arrays[_BLOCKS, "counts"].tolist(), arrays[_BLOCKS, "ends"].tolist()
        starts = [0, *ends]
        made = cls((name, count, packed[first:last]) for name, count, first, last in zip(names, counts, starts, ends))
        vars(made)["columns"] = RowColumns(made, arrays)
        return made

    def arrays(self) -> dict[Name, NDArray[Any]]:
        """All of them as arrays: their columns, and their lines compressed."""
        names, counts, packed = [], [], []
        for name, count, lines in self._blocks:
            names.append(name)
            counts.append(count)
            packed.append(lines)
        return {
            **self.columns.arrays,
            **coded((_BLOCKS,), names),
            (_BLOCKS, "counts"): np.array(counts, np.int64),
            (_BLOCKS, "ends"): np.cumsum([len(lines) for lines in packed], dtype=np.int64),
            (_BLOCKS, "packed"): np.frombuffer(b"".join(packed), np.uint8),
        }

    def in_order_of(self, scenes: Sequence[str]) -> "Rows":
        """The same rows with their scenes in another order.

        Args:
            scenes: Names of all scenes.

        Returns:
            The rows.
        """
        place = {name: number for number, name in enumerate(scenes)}
        return Rows(sorted(self._blocks, key=lambda block: place[block[0]]))

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
    def columns(self) -> RowColumns:
        """What tables read of them."""
        with uncollected():
            return RowColumns(self)

    def __reduce__(self) -> tuple[Any, ...]:
        # Columns are made again, and nobody else can read what lies in a file of ours.
        return Rows, ([(scene, count, bytes(packed)) for scene, count, packed in self._blocks],)

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
        wanted = range(len(self))[place]
        for _, count, packed in self._blocks:
            if wanted < count:
                return SampleRow.model_validate_json(zlib.decompress(packed).split(b"\n")[wanted])
            wanted -= count
        raise AssertionError("a place among the rows is in none of their blocks")

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Rows) and self._blocks == other._blocks:
            return True
        return isinstance(other, Sequence) and len(self) == len(other) and all(map(_equal, self, other))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<{len(self)} rows of {len(self._blocks)} scenes>"


def columns_of(rows: Sequence[SampleRow] | RowColumns) -> RowColumns:
    """Columns of rows, made once where they are a record's.

    Args:
        rows: One for each sample.

    Returns:
        The columns.
    """
    if isinstance(rows, RowColumns):
        return rows
    return rows.columns if isinstance(rows, Rows) else RowColumns(rows)


def line_of(row: SampleRow) -> str:
    """A row as files have it."""
    return canonical_json(row.model_dump(mode="json"))


def _checked(
    path: Path, parse: Callable[[Sequence[tuple[int, str]]], Sequence[SampleRow]]
) -> Iterator[tuple[SampleRow, str]]:
    """Rows of a file, each with its line."""
    lines = read_lines(path, RECORD)
    while some := list(islice(lines, _LINES_AT_ONCE)):
        yield from zip(parse(some), (line for _, line in some), strict=True)


def _parsed(packed: bytes | memoryview) -> list[SampleRow]:
    with uncollected():
        return [SampleRow.model_validate_json(line) for line in zlib.decompress(packed).split(b"\n")]


def _equal(one: Any, other: Any) -> bool:
    return bool(one == other)
