"""Foreign files compressed with xz: pickles, and archives of plain files. What they unpack to is counted on the way."""

import lzma
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, Final

from benchmark.errors import InputError
from benchmark.untrusted.files import one_line, open_file
from benchmark.untrusted.limits import ARCHIVE, COMPRESSED_PICKLE, MIB, PICKLE, Limits, in_words
from benchmark.untrusted.pickles import read_pickle

_DECODER_BYTES: Final = 256 * MIB
"""Memory that unpacking may take; xz at its highest level takes 65 MB."""


def read_compressed_pickle(path: Path, limits: Limits = COMPRESSED_PICKLE) -> Any:
    """Read a pickle of arrays and plain containers out of an xz file (see `benchmark.untrusted.pickles.read_pickle`).

    Args:
        path: The file.
        limits: How large it may be, and what it may unpack to.

    Returns:
        The value of the pickle.

    Raises:
        InputError: If the file is absent, damaged or too large, or its pickle is refused.
    """
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / path.stem
        with plain.open("wb") as stream:
            _unpack(path, stream, limits)
        try:
            return read_pickle(plain, PICKLE)
        except InputError as error:
            raise InputError(str(error).replace(str(plain), str(path))) from None


def unpack_archive(path: Path, folder: Path, limits: Limits = ARCHIVE) -> None:
    """Unpack the plain files of a tar archive that is compressed with xz.

    Args:
        path: The archive.
        folder: Where to.
        limits: How large it may be, what it may unpack to, and how many files it may have.

    Raises:
        InputError: If it is absent, damaged or too large, or holds links, devices, or names that lead out of it.
    """
    with tempfile.TemporaryFile() as plain:
        _unpack(path, plain, limits)
        plain.seek(0)
        with _damaged(path), tarfile.open(fileobj=plain, mode="r:") as archive:
            for number, member in enumerate(archive):
                if number >= limits.values:
                    raise InputError(f"{path} holds more than {limits.values} files; it is damaged, get it again")
                if member.isdir():
                    continue
                name = PurePosixPath(member.name)
                content = archive.extractfile(member) if member.isreg() else None
                if content is None or name.is_absolute() or ".." in name.parts or not member.name.isprintable():
                    raise InputError(
                        f"{path} holds {one_line(member.name, 80)}, which is no plain file inside it; it is damaged or "
                        "made to harm, get it from a source that you trust"
                    )
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content.read())


def _unpack(path: Path, target: BinaryIO, limits: Limits) -> None:
    decoder = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_DECODER_BYTES)
    total = 0
    with open_file(path, limits) as stream, _damaged(path):
        while not decoder.eof:
            data = stream.read(MIB) if decoder.needs_input else b""
            if decoder.needs_input and not data:
                raise EOFError("it ends too early")
            piece = decoder.decompress(data, MIB)
            total += len(piece)
            if total > limits.content_bytes:
                raise InputError(
                    f"{path} unpacks to more than {in_words(limits.content_bytes)}; it is damaged, get it again"
                )
            target.write(piece)


@contextmanager
def _damaged(path: Path) -> Iterator[None]:
    try:
        yield
    except (lzma.LZMAError, tarfile.TarError, EOFError, OSError, ValueError) as error:
        reason = one_line(error) or type(error).__name__
        raise InputError(f"{path} cannot be unpacked ({reason}); it may be truncated, fetch it again") from error
