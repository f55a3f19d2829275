"""Files that are read, and places that are written to."""

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmark.errors import InputError


def require_file(path: Path | None, option: str, endings: Sequence[str] = ()) -> None:
    """Refuse a file that is not there or of another kind; ``None`` is no file, which is fine."""
    if path is None:
        return
    if endings and path.suffix.lower() not in endings:
        raise InputError(f"{option} {path} must end in {' or '.join(endings)}; choose another file")
    if not path.is_file():
        problem = "is a folder, not a file" if path.is_dir() else "does not exist"
        raise InputError(f"{option} {path} {problem}; give an existing file")


def require_folder(path: Path | None, option: str) -> None:
    """Raise `InputError` for a folder to read from that is not there; ``None`` is none, which is fine."""
    if path is not None and not path.is_dir():
        problem = "is a file, not a folder" if path.is_file() else "does not exist"
        raise InputError(f"{option} {path} {problem}; give an existing folder")


def require_place(path: Path, option: str) -> None:
    """Refuse a folder that could not be written to: a file is opened in the nearest one there is, without a name."""
    nearest = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise InputError(f"{option} {path} cannot be a folder: {nearest} is a file; choose another path")
    try:
        with tempfile.TemporaryFile(dir=nearest) as file:
            file.write(bytes(4096))
    except OSError as error:
        raise InputError(
            f"cannot write below {nearest}: {error.strerror or error}; free some space or choose another path with "
            f"{option}"
        ) from error


def require_output_file(path: Path | None, option: str, endings: Sequence[str] = ()) -> None:
    """Refuse a file that could not be written or replaced, or would not end as it must; ``None`` is fine."""
    if path is None:
        return
    if endings and path.suffix.lower() not in endings:
        raise InputError(f"{option} {path} must end in {' or '.join(endings)}; choose another file")
    if path.is_dir():
        raise InputError(f"{option} {path} is a folder; give a file in it")
    if path.exists() and not path.is_file():
        raise InputError(f"{option} {path} is a pipe or a device; give a regular file")
    require_place(path.parent, option)


def require_room(folder: Path, needed: int, what: str, option: str) -> None:
    """Refuse to begin what a disk has no room for, in bytes at least; ``folder`` need not exist.

    ``what`` is for the message, ``option`` what would name another place.
    """
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    free = shutil.disk_usage(nearest).free
    if free < needed:
        raise InputError(
            f"{what} needs about {format_gigabytes(needed)} in {folder} and {format_gigabytes(free)} are free; free "
            f"some space or choose another path with {option}"
        )


def format_gigabytes(count: int) -> str:
    """A number of bytes for people."""
    return f"{count / 1e9:.2g} GB" if count < 1e10 else f"{count / 1e9:.0f} GB"
