"""Packages: what is written is read, the same bytes each time; what could harm is one sentence."""

import io
import stat
import struct
import zipfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.untrusted.compressed import encode_package, read_package
from benchmark.untrusted.files import PACKAGE

PARTS = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9._+-]{0,8}", fullmatch=True)
NAMES = st.lists(PARTS, min_size=1, max_size=3).map("/".join)


def written(folder: Path, data: bytes) -> Path:
    path = folder / "p.zip"
    path.write_bytes(data)
    return path


@settings(deadline=None, max_examples=20)
@given(st.dictionaries(NAMES, st.binary(max_size=200), max_size=6))
def test_what_is_packed_is_unpacked(tmp_path_factory: pytest.TempPathFactory, members: dict[str, bytes]) -> None:
    data = encode_package(members)
    assert encode_package(members) == data
    read = read_package(written(tmp_path_factory.mktemp("packed"), data))
    assert read == members and list(read) == list(members)


def zipped(*entries: tuple[str, bytes], kind: int = zipfile.ZIP_STORED, mode: int = 0) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in entries:
            entry = zipfile.ZipInfo(name)
            entry.external_attr = mode << 16
            archive.writestr(entry, data, kind)
    return stream.getvalue()


def claiming(size: int) -> bytes:
    """One stored member that says it is larger than the file."""
    data = bytearray(zipped(("a", b"x" * 10)))
    for signature, offset in ((b"PK\x03\x04", 18), (b"PK\x01\x02", 20)):
        at = data.index(signature) + offset
        data[at : at + 8] = struct.pack("<II", size, size)
    return bytes(data)


def overlapping(count: int) -> bytes:
    """Many names of one piece of data."""
    body = zipped(("a", b"x" * 100_000))
    at = body.index(b"PK\x01\x02")
    end = body.index(b"PK\x05\x06")
    central = b"".join(body[at:end].replace(b"a", bytes([97 + number])) for number in range(count))
    tail = bytearray(body[end:])
    tail[8:12] = struct.pack("<HH", count, count)
    tail[12:16] = struct.pack("<I", len(central))
    return body[:at] + central + bytes(tail)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "cannot be unpacked"),
        (b"PK\x03\x04 and then nothing", "cannot be unpacked"),
        (zipped(("a", b"x" * 5000))[:2000], "cannot be unpacked"),
        (zipped(("../a", b"x")), "not a regular file inside it"),
        (zipped(("/etc/passwd", b"x")), "not a regular file inside it"),
        (zipped(("a/../../b", b"x")), "not a regular file inside it"),
        (zipped(("a\\..\\b", b"x")), "not a regular file inside it"),
        (zipped(("C:a", b"x")), "not a regular file inside it"),
        (zipped(("a/", b"")), "not a regular file inside it"),
        (zipped(("a/./b", b"x")), "not a regular file inside it"),
        (zipped(("a\x1b[2J", b"x")), "not a regular file inside it"),
        (zipped(("x" * 300, b"x")), "not a regular file inside it"),
        (zipped(("a", b"/etc/passwd"), mode=stat.S_IFLNK | 0o777), "not a regular file inside it"),
        (zipped(("a", b"x" * 100), kind=zipfile.ZIP_DEFLATED), "compressed or encrypted"),
        (zipped(("a", b"x" * 100), kind=zipfile.ZIP_LZMA), "compressed or encrypted"),
        (zipped(*((f"{number}", b"") for number in range(PACKAGE.values + 1))), "holds more than 1000 files"),
        (claiming(1 << 30), "claims to hold 1 GB"),
        (overlapping(20), "claims to hold"),
    ],
)  # fmt: skip
def test_what_could_harm_is_one_sentence(tmp_path: Path, data: bytes, message: str) -> None:
    path = written(tmp_path, data)
    with pytest.raises(InputError, match=message) as caught:
        read_package(path)
    said = str(caught.value)
    assert str(path) in said and said.isprintable() and len(said) < 600


@pytest.mark.filterwarnings("ignore:Duplicate name:UserWarning")
def test_a_name_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="occurs twice"):
        read_package(written(tmp_path, zipped(("a", b"1"), ("a", b"2"))))


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_a_damaged_package_is_refused_or_read_but_never_crashes(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    whole = bytearray(encode_package({"a": b"x" * 40, "b/c": b"y" * 40}))
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path = written(tmp_path_factory.mktemp("damaged"), bytes(whole[: data.draw(st.integers(0, len(whole)))]))
    try:
        read_package(path)
    except InputError as error:
        assert str(path) in str(error)
