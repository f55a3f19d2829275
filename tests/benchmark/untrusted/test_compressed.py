"""Foreign xz files: pickles and archives, and what is made to harm."""

import io
import lzma
import pickle
import tarfile
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.errors import InputError
from benchmark.untrusted.compressed import read_compressed_pickle, unpack_archive
from benchmark.untrusted.files import ARCHIVE, COMPRESSED_PICKLE


def archive_of(path: Path, *members: tarfile.TarInfo, content: bytes = b"text") -> Path:
    with tarfile.open(path, "w:xz") as archive:
        for member in members:
            member.size = len(content) if member.isreg() else 0
            archive.addfile(member, io.BytesIO(content))
    return path


def link(name: str, to: str) -> tarfile.TarInfo:
    found = tarfile.TarInfo(name)
    found.type, found.linkname = tarfile.SYMTYPE, to
    return found


def test_plain_files_are_unpacked(tmp_path: Path) -> None:
    path = archive_of(tmp_path / "a.tar.xz", tarfile.TarInfo("root/tables/scene.json"), tarfile.TarInfo("root/b"))
    unpack_archive(path, tmp_path / "to")
    assert (tmp_path / "to/root/tables/scene.json").read_bytes() == (tmp_path / "to/root/b").read_bytes() == b"text"


@pytest.mark.parametrize(
    "member",
    [tarfile.TarInfo("../out"), tarfile.TarInfo("/out"), tarfile.TarInfo("a/../../out"), link("root", "/")],
    ids=lambda member: str(member.name),
)
def test_what_leads_out_is_refused(member: tarfile.TarInfo, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no plain file inside it"):
        unpack_archive(archive_of(tmp_path / "a.tar.xz", member), tmp_path / "to")
    assert not (tmp_path / "out").exists() and not (tmp_path / "to").exists()


def test_what_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    path = archive_of(tmp_path / "a.tar.xz", tarfile.TarInfo("a"), content=bytes(1 << 22))
    assert path.stat().st_size < 10_000
    with pytest.raises(InputError, match="unpacks to more than 1 MB"):
        unpack_archive(path, tmp_path / "to", replace(ARCHIVE, content_bytes=1 << 20))
    path = archive_of(tmp_path / "b.tar.xz", *(tarfile.TarInfo(str(number)) for number in range(4)))
    with pytest.raises(InputError, match="more than 3 files"):
        unpack_archive(path, tmp_path / "to", replace(ARCHIVE, values=3))
    (tmp_path / "bomb.pkl.xz").write_bytes(lzma.compress(pickle.dumps(bytes(1 << 22))))
    with pytest.raises(InputError, match="unpacks to more than 1 MB"):
        read_compressed_pickle(tmp_path / "bomb.pkl.xz", replace(COMPRESSED_PICKLE, content_bytes=1 << 20))


@pytest.mark.parametrize("data", [b"", b"no archive", lzma.compress(b"no tar file, but long enough for one" * 40)])
def test_what_is_no_archive_is_one_sentence(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.tar.xz").write_bytes(data)
    with pytest.raises(InputError, match="cannot be unpacked"):
        unpack_archive(tmp_path / "a.tar.xz", tmp_path / "to")


def test_pickles_come_through_the_one_door(tmp_path: Path) -> None:
    path = tmp_path / "infos.pkl.xz"
    path.write_bytes(lzma.compress(pickle.dumps({"infos": [1.5, "text"]}, protocol=2)))
    assert read_compressed_pickle(path) == {"infos": [1.5, "text"]}
    path.write_bytes(lzma.compress(b"cos\nsystem\n(S'true'\ntR."))
    with pytest.raises(InputError, match=r"infos\.pkl\.xz is refused: its pickle uses os\.system"):
        read_compressed_pickle(path)
    path.write_bytes(lzma.compress(pickle.dumps([1] * 99))[:-5])
    with pytest.raises(InputError, match="cannot be unpacked"):
        read_compressed_pickle(path)
