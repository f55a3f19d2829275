"""Foreign archives: xz pickles and files, counted as they unpack, and zip files stored as is, so that none grows."""

import io
import lzma
import stat
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, Final

from benchmark.errors import InputError
from benchmark.untrusted.children import read_pickle
from benchmark.untrusted.files import (
    ARCHIVE,
    COMPRESSED_PICKLE,
    MIB,
    PACKAGE,
    PICKLE,
    Limits,
    format_bytes,
    open_file,
    to_one_line,
)

_EARLIEST: Final = (1980, 1, 1, 0, 0, 0)
"""The first time that the format can hold: the same bytes whenever it is written."""


def encode_package(members: dict[str, bytes]) -> bytes:
    """A package: a zip file without compression, the same bytes for the same members; the first stays the first."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, _EARLIEST)
            entry.create_system, entry.external_attr = 3, (stat.S_IFREG | 0o644) << 16
            archive.writestr(entry, data)
    return stream.getvalue()


def read_package(path: Path, limits: Limits = PACKAGE) -> dict[str, bytes]:
    """Members of a package by name, read without trusting it.

    Raises `InputError` if it is absent, damaged or too large; if a member is compressed, encrypted, a link, repeated,
    or has a name that leads out of a folder; or if members claim more than the file has.
    """
    with open_file(path, limits) as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                entries = archive.infolist()
                _require_harmless(path, entries, path.stat().st_size, limits)
                return {entry.filename: archive.read(entry) for entry in entries}
        except (zipfile.BadZipFile, EOFError, OSError, ValueError, NotImplementedError, RuntimeError) as error:
            reason = to_one_line(error) or type(error).__name__
            raise InputError(f"{path} cannot be unpacked ({reason}); it may be truncated, fetch it again") from error


def _require_harmless(path: Path, entries: list[zipfile.ZipInfo], size: int, limits: Limits) -> None:
    if len(entries) > limits.values:
        raise InputError(f"{path} holds more than {limits.values} files; it is not a package, fetch it again")
    names: set[str] = set()
    for entry in entries:
        name = entry.filename
        kind = stat.S_IFMT(entry.external_attr >> 16)
        if not _stays_inside(name, limits) or kind not in (0, stat.S_IFREG) or name in names:
            raise InputError(
                f"{path} holds {to_one_line(name, 80)!r}, which is not a regular file inside it or occurs twice; it is "
                "damaged or malicious, get it from a source that you trust"
            )
        packed = entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size
        if packed or entry.flag_bits & 0x1:
            raise InputError(
                f"{path} holds {to_one_line(name, 80)} compressed or encrypted, but packages store files unchanged; "
                "fetch the package itself again"
            )
        names.add(name)
    claimed = sum(entry.file_size for entry in entries)
    if claimed > min(size, limits.content_bytes):
        raise InputError(
            f"{path} claims to hold {format_bytes(claimed)} in a file of {format_bytes(size)}; it is damaged or made "
            "to harm, get it from a source that you trust"
        )


def _stays_inside(name: str, limits: Limits) -> bool:
    """Whether a name is that of a file below a folder, on every system: no drive, no backslash, no ``..``."""
    parts = name.split("/")
    plain = name.isprintable() and name.isascii() and not set(name) & set('\\:*?"<>|')
    return plain and len(name) <= limits.name_characters and len(parts) <= 4 and all(part.strip(".") for part in parts)


_DECODER_BYTES: Final = 256 * MIB
"""Memory that unpacking may take; xz at its highest level takes 65 MB."""


def read_compressed_pickle(path: Path, limits: Limits = COMPRESSED_PICKLE) -> Any:
    """Read a pickle out of an xz file, as `benchmark.untrusted.children.read_pickle` does."""
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / path.stem
        with plain.open("wb") as stream:
            _unpack(path, stream, limits)
        try:
            return read_pickle(plain, PICKLE)
        except InputError as error:
            raise InputError(str(error).replace(str(plain), str(path))) from None


def unpack_archive(path: Path, folder: Path, limits: Limits = ARCHIVE) -> None:
    """Unpack the plain files of an xz-compressed tar archive into a folder.

    Raises `InputError` if it is absent, damaged or too large, or holds links, devices, or names that lead out of it.
    """
    with tempfile.TemporaryFile() as plain:
        _unpack(path, plain, limits)
        plain.seek(0)
        with _as_damaged_file(path), tarfile.open(fileobj=plain, mode="r:") as archive:
            for number, member in enumerate(archive):
                if number >= limits.values:
                    raise InputError(f"{path} holds more than {limits.values} files; it is damaged, get it again")
                if member.isdir():
                    continue
                name = PurePosixPath(member.name)
                content = archive.extractfile(member) if member.isreg() else None
                if content is None or name.is_absolute() or ".." in name.parts or not member.name.isprintable():
                    raise InputError(
                        f"{path} holds {to_one_line(member.name, 80)}, which is no plain file inside it; it is damaged "
                        "or made to harm, get it from a source that you trust"
                    )
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content.read())


def _unpack(path: Path, target: BinaryIO, limits: Limits) -> None:
    decoder = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_DECODER_BYTES)
    total = 0
    with open_file(path, limits) as stream, _as_damaged_file(path):
        while not decoder.eof:
            data = stream.read(MIB) if decoder.needs_input else b""
            if decoder.needs_input and not data:
                raise EOFError("it ends too early")
            piece = decoder.decompress(data, MIB)
            total += len(piece)
            if total > limits.content_bytes:
                raise InputError(
                    f"{path} unpacks to more than {format_bytes(limits.content_bytes)}; it is damaged, get it again"
                )
            target.write(piece)


@contextmanager
def _as_damaged_file(path: Path) -> Iterator[None]:
    try:
        yield
    except (lzma.LZMAError, tarfile.TarError, EOFError, OSError, ValueError) as error:
        reason = to_one_line(error) or type(error).__name__
        raise InputError(f"{path} cannot be unpacked ({reason}); it may be truncated, fetch it again") from error
