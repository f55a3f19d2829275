"""Rows of a table that stay in its file: noted in one pass and read where wanted, or counted without the devkit."""

import codecs
import json
import os
import re
from array import array
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.machine.user_cache import Stamp, make_stamp
from benchmark.records.statistics import TableCounts
from benchmark.untrusted.text_files import require_utf8

_CHUNK_BYTES: Final = 1 << 20
_LONGEST_ROW_CHARACTERS: Final = 1 << 24
"""Longest row; a longer one is an error, so that a broken table is not read into memory whole."""
_BATCH_ROWS: Final = 4096
_READ_THROUGH_BYTES: Final = 1 << 14
"""Rows that lie nearer to each other than this are read in one piece."""
_SPACE: Final = " \t\n\r"
_BETWEEN_OBJECTS: Final = re.compile(rf"[{_SPACE}]*,[{_SPACE}]*(?=\{{)")
"""Most objects are followed by another one that begins in what has been read already."""


@dataclass(frozen=True, slots=True)
class TableRowIndex:
    """First byte and length in bytes of each of N rows in a table's file, with its stamp when they were noted."""

    path: Path
    stamp: tuple[int, ...]
    starts: NDArray[np.int64]
    lengths: NDArray[np.int32]

    def read(self, numbers: NDArray[np.int64]) -> list[Row]:
        """M rows by their (M,) increasing numbers; a file that has changed is refused."""
        starts = self.starts[numbers]
        ends = starts + self.lengths[numbers]
        pieces = np.split(np.arange(len(numbers)), np.flatnonzero(starts[1:] > ends[:-1] + _READ_THROUGH_BYTES) + 1)
        rows: list[Row] = []
        try:
            with self.path.open("rb") as stream:
                if _stamp(stream) != self.stamp:
                    raise InputError(f"{self.path} has changed since it was opened; run the command again")
                for piece in pieces if len(numbers) else ():
                    first = int(starts[piece[0]])
                    stream.seek(first)
                    data = stream.read(int(ends[piece[-1]]) - first)
                    places = zip((starts[piece] - first).tolist(), (ends[piece] - first).tolist(), strict=True)
                    rows += [json.loads(data[start:end]) for start, end in places]
        except OSError as error:
            raise InputError(f"cannot read {self.path}: {error.strerror or error}") from error
        return rows


class TableScan:
    """One pass over a table, batch by batch."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stamp: tuple[int, ...] = ()
        self._starts, self._lengths = array("q"), array("i")

    def batches(self) -> Iterator[list[Row]]:
        """The rows in their order, some thousand at a time."""
        batch: list[Row] = []
        try:
            with self._path.open("rb") as stream:
                self._stamp = _stamp(stream)
                for start, length, row in _objects(stream):
                    self._starts.append(start)
                    self._lengths.append(length)
                    batch.append(row)
                    if len(batch) == _BATCH_ROWS:
                        yield batch
                        batch = []
        except OSError as error:
            raise InputError(f"cannot read {self._path}: {error.strerror or error}") from error
        except RecursionError as error:
            raise self._no_list("something in it is nested too deeply") from error
        except ValueError as error:
            raise self._no_list(str(error)) from error
        if batch:
            yield batch

    def _no_list(self, why: str) -> InputError:
        return InputError(
            f"{self._path} is not a JSON list of rows ({why}, after {len(self._starts)} rows); it may be truncated, "
            "fetch or make it again"
        )

    def stored(self) -> TableRowIndex:
        """Places of the rows; call it after the pass."""
        starts, lengths = np.array(self._starts, dtype=np.int64), np.array(self._lengths, dtype=np.int32)
        return TableRowIndex(self._path, self._stamp, starts, lengths)


def drop_inode_time(stamp: Stamp) -> Stamp:
    """Part of a stamp that tells whether a table is still the one that was opened: all but the time of its inode.

    That changes with rights and links too, which do not matter while a command runs.
    """
    return stamp[:-1]


def _stamp(stream: IO[bytes]) -> Stamp:
    return drop_inode_time(make_stamp(os.fstat(stream.fileno())))


class _StreamedText:
    """Text of a file, decoded as it is read, with the place in bytes of the character that is next."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._decoded = codecs.getincrementaldecoder("utf-8")()
        self.ended = False
        first = stream.read(_CHUNK_BYTES)
        self.text, self.at, self.byte = "", 0, require_utf8(first)
        self._first = first[self.byte :]

    def more(self) -> None:
        """Read on; forget what was passed."""
        chunk, self._first = self._first or self._stream.read(_CHUNK_BYTES), b""
        self.ended = not chunk
        self.text, self.at = self.text[self.at :] + self._decoded.decode(chunk, final=self.ended), 0

    def passed(self, end: int) -> int:
        """Go on to a character; gives the number of bytes passed."""
        count = end - self.at if self.text.isascii() else len(self.text[self.at : end].encode())
        self.at, self.byte = end, self.byte + count
        return count

    def next(self) -> str:
        """The next character that is no space, or nothing at the end."""
        while True:
            end = self.at
            while end < len(self.text) and self.text[end] in _SPACE:
                end += 1
            self.passed(end)
            if end < len(self.text) or self.ended:
                return self.text[end : end + 1]
            self.more()


def _objects(stream: IO[bytes]) -> Iterator[tuple[int, int, Row]]:
    """First byte, bytes and value of each object of a JSON list, as strict as `json.load`."""
    text, decoder = _StreamedText(stream), json.JSONDecoder()
    if text.next() != "[":
        raise ValueError("it does not begin with [")
    text.passed(text.at + 1)
    mark = text.next()
    while mark != "]":
        if mark != "{":
            raise ValueError("a row is no object")
        start = text.byte
        value, end = _object(text, decoder)
        yield start, text.passed(end), value
        if between := _BETWEEN_OBJECTS.match(text.text, text.at):
            text.passed(between.end())
            continue
        mark = text.next()
        if mark == ",":
            text.passed(text.at + 1)
            mark = text.next()
            if mark != "{":
                raise ValueError("a row is no object")
        elif mark != "]":
            raise ValueError("no comma after an object")
    text.passed(text.at + 1)
    if text.next():
        raise ValueError("more than one JSON value")


def _object(text: _StreamedText, decoder: json.JSONDecoder) -> tuple[Any, int]:
    """The object that begins here, and the character where it ends."""
    while True:
        try:
            return decoder.raw_decode(text.text, text.at)
        except ValueError:
            if text.ended or len(text.text) - text.at > _LONGEST_ROW_CHARACTERS:
                raise
            text.more()


def count_rows(folder: Path, names: Collection[str] | None) -> TableCounts:
    """Count the rows that belong to some scenes; ``None`` counts every row of the tables, linked to a scene or not."""
    all_scenes = names is None
    named, scene_count = _collect_linked(folder / "scene.json", "name", names, "token")
    samples, sample_count = _collect_linked(
        folder / "sample.json", "scene_token", None if all_scenes else named, "token"
    )
    wanted = None if all_scenes else samples
    poses, data_count = _collect_linked(folder / "sample_data.json", "sample_token", wanted, "ego_pose_token")
    instances, annotation_count = _collect_linked(
        folder / "sample_annotation.json", "sample_token", wanted, "instance_token"
    )
    return TableCounts(
        instances=_collect_linked(folder / "instance.json", "token", None if all_scenes else instances, "token")[1],
        ego_poses=_collect_linked(folder / "ego_pose.json", "token", None if all_scenes else poses, "token")[1],
        scenes=scene_count,
        samples=sample_count,
        sample_data=data_count,
        annotations=annotation_count,
    )


def _collect_linked(path: Path, field: str, wanted: Collection[str] | None, gives: str) -> tuple[set[str], int]:
    """Values of one field in the rows whose other field is wanted (``None``: all rows), and how many rows these are."""
    linked, count = set(), 0
    tokens = array("q")
    for row in iterate_rows(path, *dict.fromkeys(("token", field, gives))):
        tokens.append(hash(row["token"]))
        if wanted is None or row[field] in wanted:
            count += 1
            linked.add(row[gives])
    # Eight bytes a row, as a table of trainval has millions; one in a million such tables has two tokens of one hash.
    if len(np.unique(tokens)) < len(tokens):
        raise InputError(f"{path} has two rows with the same token; challenger-bench data check lists them")
    return linked, count


def iterate_rows(path: Path, *needed: str) -> Iterator[Row]:
    """Rows of one table as the file is read; the ``needed`` fields must be there and be text."""
    for number, row in enumerate(chain.from_iterable(TableScan(path).batches())):
        if not all(isinstance(row.get(field), str) for field in needed):
            raise InputError(f"{path} row {number} is not an object with {' and '.join(needed)}; make the table again")
        yield row
