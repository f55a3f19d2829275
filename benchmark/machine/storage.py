"""Files that are either whole or absent, and keys made of content.

Everything the project writes goes through here: a file without a name, flushed to disk, then given its name. A process
killed in between leaves nothing behind. All JSON, even our own, is read through `benchmark.untrusted`.
"""

import contextlib
import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final
from urllib.parse import quote

from benchmark.errors import InputError
from benchmark.untrusted.text_files import parse_json as parse_json
from benchmark.untrusted.text_files import read_json as read_json
from benchmark.untrusted.text_files import read_json_lines as read_json_lines

_PROC: Final = Path("/proc/self/fd")
"""Where files without a name are found, to be given one."""


def canonical_json(value: Any, *, indent: int | None = None) -> str:
    """JSON text with sorted keys that is the same for the same value; NaN and infinity raise `ValueError`."""
    separators = (",", ":") if indent is None else (",", ": ")
    return json.dumps(value, sort_keys=True, allow_nan=False, indent=indent, separators=separators)


def content_key(*parts: Any) -> str:
    """SHA-256 of the canonical JSON of ``parts``, 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(parts).encode()).hexdigest()


def make_token(*parts: Any) -> str:
    """A nuScenes-style token, 32 hexadecimal digits, made of content and never of chance."""
    return content_key(*parts)[:32]


def content_seed(*parts: Any) -> int:
    """A 63-bit seed made of content, so that results do not depend on the order of work."""
    return int(content_key(*parts)[:16], 16) >> 1


def sanitise_file_name(name: str) -> str:
    """A name from a stranger's data as the name of one file or folder: no separators, never ``.`` or ``..``.

    Percent-encoded where needed; ordinary names stay as they are.
    """
    quoted = quote(name, safe="", errors="backslashreplace")
    return f"%2E{quoted[1:]}" if quoted.startswith(".") else quoted


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextlib.contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Turn the operating system's refusal to write to a path into an `InputError` that names it."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        advice = "free some space" if full else "choose a writable location with --out"
        raise InputError(
            f"cannot write {path}: {error.strerror or error}; {advice}, then run the same command again (finished work "
            "is kept)"
        ) from error


@contextlib.contextmanager
def lock_folder(folder: Path, *, wait: bool = False) -> Iterator[None]:
    """Keep two commands from writing to one folder, which is made, at the same time; a killed command locks none out.

    `InputError` if another command is writing to it, unless one can ``wait`` for that, or it cannot be made.
    """
    with writing_to(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(
                f"another command is writing to {folder}; wait until it has ended, then run this one again, or choose "
                "another location with --out"
            ) from error
        except OSError:
            # Some network file systems have no locks; every file is still written whole.
            pass
        yield
    finally:
        os.close(descriptor)


def write_bytes(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Write a file whole or not at all; its folder is made.

    With ``durable`` it waits until the disk has it. Without, a power failure (not a killed process) may lose or empty
    the file: for the many images of a scene, whose sizes are checked when work resumes.
    """
    write_parts(path, (data,), durable=durable)


def write_parts(path: Path, parts: Sequence[bytes | memoryview], *, durable: bool = True) -> None:
    """`write_bytes` of a file in parts, which are not put together in memory; arguments and errors as there."""
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _nameless(path.parent)
        if descriptor is None:
            _write_named(path, parts, durable=durable)
            return
        with os.fdopen(descriptor, "wb") as stream:
            _fill(stream, parts, durable=durable)
            _name(stream.fileno(), path)


def _nameless(folder: Path) -> int | None:
    """A file without a name in a folder; ``None`` on systems and file systems that have none."""
    try:
        return os.open(folder, os.O_WRONLY | os.O_TMPFILE, 0o666) if _PROC.exists() else None
    except (OSError, AttributeError):
        return None


def _fill(stream: BinaryIO, parts: Sequence[bytes | memoryview], *, durable: bool) -> None:
    for part in parts:
        stream.write(part)
    stream.flush()
    if durable:
        os.fsync(stream.fileno())


def _name(descriptor: int, path: Path) -> None:
    """Give a file without a name its name; what has that name is replaced.

    Where there is something to replace, the file is called ``.<name>.part`` for a moment. It is whole then: a
    process that finds it, left by a killed process or by one that writes the same file now, moves it into place.
    """
    nameless, temporary = _PROC / str(descriptor), path.with_name(f".{path.name}.part")
    if not path.exists():
        with contextlib.suppress(FileExistsError):
            # A directory has to be given, or Python links the link in /proc and not the file.
            os.link(nameless, path, src_dir_fd=descriptor, follow_symlinks=True)
            return
    while True:
        try:
            os.link(nameless, temporary, src_dir_fd=descriptor, follow_symlinks=True)
            break
        except FileExistsError:
            _put_in_place(temporary, path)
    _put_in_place(temporary, path)


def _put_in_place(temporary: Path, path: Path) -> None:
    try:
        temporary.replace(path)
    except FileNotFoundError:
        # Another process has moved it into place.
        return
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def _write_named(path: Path, parts: Sequence[bytes | memoryview], *, durable: bool) -> None:
    """Write a temporary file beside the target, then rename it."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with temporary.open("wb") as stream:
            _fill(stream, parts, durable=durable)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def write_json(path: Path, value: Any, *, indent: int | None = 1) -> None:
    """Write canonical JSON with a final newline, whole or not at all (see `write_bytes`)."""
    write_bytes(path, (canonical_json(value, indent=indent) + "\n").encode())


def write_json_lines(path: Path, rows: list[Any]) -> None:
    """Write one canonical JSON value a line, whole or not at all (see `write_bytes`)."""
    write_bytes(path, "".join(canonical_json(row) + "\n" for row in rows).encode())


def is_leftover(path: Path) -> bool:
    """Whether a file is one that a process was killed over (`write_bytes`)."""
    return path.name.startswith(".") and path.suffix == ".part"


def read_cached_json(path: Path) -> Any | None:
    """Read a JSON file that work resumes from; ``None`` if it is absent or damaged, so that it is made again."""
    try:
        return read_json(path)
    except InputError:
        return None
