"""Foreign archives of small text files: zip files whose members are stored as they are, so that none grows."""

import io
import stat
import zipfile
from pathlib import Path
from typing import Final

from benchmark.errors import InputError
from benchmark.untrusted.files import one_line, open_file
from benchmark.untrusted.limits import PACKAGE, Limits, in_words

_EARLIEST: Final = (1980, 1, 1, 0, 0, 0)
"""The first time that the format can hold: the same bytes whenever it is written."""


def package_bytes(members: dict[str, bytes]) -> bytes:
    """A package: the same bytes for the same members.

    Args:
        members: Content by name, such as ``splits/mini-adv-3.json``; the first stays the first.

    Returns:
        A zip file without compression, whose bytes would depend on the library.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, _EARLIEST)
            entry.create_system, entry.external_attr = 3, (stat.S_IFREG | 0o644) << 16
            archive.writestr(entry, data)
    return stream.getvalue()


def read_package(path: Path, limits: Limits = PACKAGE) -> dict[str, bytes]:
    """Read a package without trusting it.

    Args:
        path: The file.
        limits: How large it may be, and how many members it may have.

    Returns:
        Content by name.

    Raises:
        InputError: If it is absent, damaged or too large; if a member is compressed, encrypted, a link, twice there, or
            has a name that leads out of a folder; or if members claim more than the file has.
    """
    with open_file(path, limits) as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                entries = archive.infolist()
                _require_harmless(path, entries, path.stat().st_size, limits)
                return {entry.filename: archive.read(entry) for entry in entries}
        except (zipfile.BadZipFile, EOFError, OSError, ValueError, NotImplementedError, RuntimeError) as error:
            reason = one_line(error) or type(error).__name__
            raise InputError(f"{path} cannot be unpacked ({reason}); it may be truncated, fetch it again") from error


def _require_harmless(path: Path, entries: list[zipfile.ZipInfo], size: int, limits: Limits) -> None:
    if len(entries) > limits.values:
        raise InputError(f"{path} holds more than {limits.values} files; it is no package, fetch it again")
    names: set[str] = set()
    for entry in entries:
        name = entry.filename
        kind = stat.S_IFMT(entry.external_attr >> 16)
        if not _stays_inside(name, limits) or kind not in (0, stat.S_IFREG) or name in names:
            raise InputError(
                f"{path} holds {one_line(name, 80)!r}, which is no plain file inside it or is there twice; it is "
                "damaged or made to harm, get it from a source that you trust"
            )
        packed = entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size
        if packed or entry.flag_bits & 0x1:
            raise InputError(
                f"{path} holds {one_line(name, 80)} compressed or encrypted, and packages hold files as they are; "
                "fetch the package itself again"
            )
        names.add(name)
    claimed = sum(entry.file_size for entry in entries)
    if claimed > min(size, limits.content_bytes):
        raise InputError(
            f"{path} claims to hold {in_words(claimed)} in a file of {in_words(size)}; it is damaged or made to harm, "
            "get it from a source that you trust"
        )


def _stays_inside(name: str, limits: Limits) -> bool:
    """Whether a name is that of a file below a folder, on every system: no drive, no backslash, no ``..``."""
    parts = name.split("/")
    plain = name.isprintable() and name.isascii() and not set(name) & set('\\:*?"<>|')
    return plain and len(name) <= limits.name_characters and len(parts) <= 4 and all(part.strip(".") for part in parts)
