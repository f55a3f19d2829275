"""Finished work: one store of results under content keys, one way to run what is missing, shards, errors of planners.

A command's work consists of units (a scene planned, a drive, an attempt of the search). The result of a unit depends on
nothing but its content key, and is kept in a file of its own, written whole: so the same command goes on where it
stopped, one process, many and a cluster give the same bytes, and ``--shard 3/40`` does every 40th unit and leaves the
rest, and the record, to the same command without it.
"""

import functools
import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, Self, TypeVar

from pydantic import TypeAdapter, ValidationError

from benchmark.errors import InputError
from benchmark.machine.progress import CountedUnits
from benchmark.machine.storage import canonical_json, sanitise_file_name, write_bytes, write_parts, writing_to
from benchmark.machine.workers import Executor
from benchmark.records.row_schema import SampleRow
from benchmark.records.rows import SampleRows, find_raised_line
from benchmark.untrusted.files import JSON, read_file
from benchmark.untrusted.text_files import parse_json

FAILURES_FILE: Final = "failures.txt"


def write_failures(directory: Path, rows: Sequence[SampleRow]) -> None:
    """Write every traceback below the scene and the sample that it is of; remove the file where there is none."""
    path = directory / FAILURES_FILE
    # Of a compressed record the scenes without a failure are not unpacked.
    candidate_rows = rows.of_failed_scenes() if isinstance(rows, SampleRows) else rows
    failed = [row for row in candidate_rows if row.error is not None]
    if not failed:
        with writing_to(path):
            path.unlink(missing_ok=True)
        return
    parts = [
        f"{row.scene}, sample {row.index} ({row.sample_token})\n\n{(row.error or '').rstrip()}\n" for row in failed
    ]
    head = f"{len(failed)} of {len(rows)} samples failed\n\n"
    write_bytes(path, (head + "\n".join(parts)).encode(errors="backslashreplace"))


def find_first_failure(rows: Sequence[SampleRow]) -> str | None:
    """The last line of the first traceback, which says what was raised; ``None`` if nothing was."""
    error = next((row.error for row in rows if row.error is not None), None)
    return None if error is None else find_raised_line(error)


Value = TypeVar("Value")
Item = TypeVar("Item")
Part = TypeVar("Part")


@dataclass(frozen=True, slots=True)
class ResultStore(Generic[Value]):
    """Results of units of one kind, a file each: its first line is the content key and the hash of the second.

    Pydantic checks a result to be of ``form``: a model, or a type of JSON values.
    """

    folder: Path
    form: Any

    def path(self, name: str) -> Path:
        """File of a unit; its name may hold slashes."""
        return self.folder / f"{sanitise_file_name(name)}.json"

    def get(self, key: str, name: str | None = None) -> Value | None:
        """The result that is kept under a content key, in the file of that name or of the key.

        ``None`` where there is none, another one, or a damaged one: that is unfinished work, and is done again.
        """
        try:
            head, _, body = read_file(self.path(name or key), JSON).partition(b"\n")
            if head + b"\n" != _header(key, body):
                return None
            value: Value = _adapter(self.form).validate_python(parse_json(body))
        except (InputError, ValueError, ValidationError):
            return None
        return value

    def put(self, key: str, value: Value, name: str | None = None) -> None:
        """Keep a result, whole or not at all, as `get` finds it; its numbers must be finite."""
        try:
            plain = _adapter(self.form).dump_python(value, mode="json", by_alias=True)
        except ValueError as error:
            if KeyboardInterrupt.__name__ in str(error):
                # pydantic hides an interruption that comes while a serialiser of ours runs.
                raise KeyboardInterrupt from error
            raise
        body = (canonical_json(plain) + "\n").encode()
        write_parts(self.path(name or key), (_header(key, body), body))

    def tidy(self, names: Collection[str]) -> None:
        """Remove what is kept of other units than these, and what killed commands left."""
        wanted = {self.path(name) for name in names}
        with writing_to(self.folder):
            for path in self.folder.iterdir() if self.folder.is_dir() else ():
                if path not in wanted:
                    path.unlink()


def _header(key: str, body: bytes) -> bytes:
    return (canonical_json({"key": key, "sha256": hashlib.sha256(body).hexdigest()}) + "\n").encode()


@functools.cache
def _adapter(form: Any) -> TypeAdapter[Any]:
    return TypeAdapter(form)


Result = TypeVar("Result")


def run_units(
    work: Callable[[Item], Result],
    units: Iterable[Item],
    executor: Executor,
    *,
    total: int,
    label: str,
    noun: str = "scene",
    before: int = 0,
    of: int | None = None,
) -> Iterator[Result]:
    """Do units of work, or find what is kept of them, saying how far it is; results are in the order of the units.

    Args:
        work: Does one, or several side by side, which it returns as a list; importable, as it is sent to workers.
            Results may say that they are ``kept``: there before, they make the rest look no quicker than it is.
        units: Made lazily, a little ahead of the results.
        noun: What is counted of it.
        before: How many were found finished already and are not among the units.
        of: How many there are in all, where ``units`` are several each.
    """
    count = CountedUnits(noun, before, of, each=_count_units, kept=_all_cached)
    return executor.map(work, units, total=total, label=label, count=count)


def _list_results(result: Any) -> list[Any]:
    return result if isinstance(result, list) else [result]


def _count_units(result: Any) -> int:
    return len(_list_results(result))


def _all_cached(result: Any) -> bool:
    return all(getattr(unit_result, "kept", False) for unit_result in _list_results(result))


@dataclass(frozen=True, slots=True)
class Shard:
    """One of so many parts.

    Attributes:
        number: Which, from 1.
        of: How many there are.
    """

    number: int
    of: int

    @classmethod
    def named(cls, text: str) -> Self:
        """The shard that a user asks for, for example ``3/40``."""
        match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        number, of = map(int, match.groups()) if match else (0, 0)
        if not 1 <= number <= of:
            raise InputError(f"--shard takes INDEX/COUNT, for example 3/40; got {text!r}")
        return cls(number, of)

    def part(self, everything: Sequence[Part]) -> tuple[Part, ...]:
        """This shard's part of a sequence: every n-th, so that shards differ by one at most."""
        return tuple(everything[self.number - 1 :: self.of])

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


@dataclass(frozen=True, slots=True)
class ShardProgress:
    """Number of scenes that a shard did or found done, and of all; kept in the record's or data set's folder."""

    directory: Path
    done: int
    scenes: int
