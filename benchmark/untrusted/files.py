"""A foreign file before it is read: it is there, is a file, has a name that is text, and is not too long."""

import os
import stat
from io import BufferedReader
from pathlib import Path

from benchmark.errors import InputError
from benchmark.untrusted.limits import Limits, in_words


def open_file(path: Path, limits: Limits) -> BufferedReader:
    """Open a file that a stranger made.

    Args:
        path: The file.
        limits: Of its kind.

    Returns:
        A stream of its bytes, at the beginning.

    Raises:
        InputError: If it is absent, no ordinary file, named in bytes that are no text, or longer than its kind may be.
    """
    require_name(path)
    try:
        # Without waiting: opening a named pipe would wait for somebody to write to it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        kind = "Is a directory" if stat.S_ISDIR(status.st_mode) else "it is no ordinary file"
        raise InputError(f"cannot read {path}: {kind}")
    if status.st_size > limits.file_bytes:
        os.close(descriptor)
        raise InputError(
            f"{path} has {in_words(status.st_size)}, and a {limits.what} has at most {in_words(limits.file_bytes)}; it "
            "is damaged or something else, get it again"
        )
    return os.fdopen(descriptor, "rb")


def read_file(path: Path, limits: Limits) -> bytes:
    """The bytes of a foreign file; arguments and errors as in `open_file`."""
    try:
        with open_file(path, limits) as stream:
            return stream.read()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except MemoryError:
        raise InputError(f"{path} does not fit into the memory of this machine; it is damaged, get it again") from None


def require_name(path: Path) -> None:
    """Refuse a path that could be neither printed nor recorded."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(f"the file name {str(path)!r} is not UTF-8 text; rename the file") from None


def one_line(text: object, longest: int = 160) -> str:
    """What a foreign file or its reader says, fit for a sentence: one line, printable, not long.

    Args:
        text: Anything that can be turned into text.
        longest: Characters.

    Returns:
        The text.
    """
    first = (str(text).splitlines() or [""])[0]
    shown = "".join(letter if letter.isprintable() else "?" for letter in first[: longest + 1])
    return shown if len(shown) <= longest else f"{shown[:longest]}..."
