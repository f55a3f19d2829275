import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from benchmark.errors import InputError
from benchmark.machine import storage
from benchmark.machine.storage import is_leftover, lock_folder, read_cached_json, write_bytes

ROOT = Path(__file__).resolve().parents[3]


def test_only_one_writer_at_a_time(tmp_path: Path) -> None:
    second = lock_folder(tmp_path / "new")
    with lock_folder(tmp_path / "new"), pytest.raises(InputError, match="another command is writing"):
        second.__enter__()
    with lock_folder(tmp_path / "new"):
        assert not list((tmp_path / "new").iterdir())


@pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe", None])
def test_damaged_work_is_as_good_as_none(tmp_path: Path, data: bytes | None) -> None:
    if data is not None:
        (tmp_path / "kept.json").write_bytes(data)
    assert read_cached_json(tmp_path / "kept.json") is None


def test_files_are_whole_and_nothing_else_is_there(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file"
    for content in (b"first", b"second", b""):
        write_bytes(path, content)
        assert path.read_bytes() == content and list(path.parent.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o666 & ~_umask()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("there", [False, True])
def test_who_is_killed_while_writing_leaves_nothing(tmp_path: Path, there: bool) -> None:
    path = tmp_path / "file"
    if there:
        path.write_bytes(b"before")
    script = (
        "import os, signal, sys; from pathlib import Path; from benchmark.machine import storage;"
        "storage.os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL);"
        f"storage.write_bytes(Path({str(path)!r}), b'x' * 100_000)"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=False)
    assert done.returncode == -signal.SIGKILL
    left = {each.name: each.read_bytes() for each in tmp_path.iterdir() if not _is_named_first(tmp_path, each)}
    assert left == ({"file": b"before"} if there else {})


def _is_named_first(folder: Path, path: Path) -> bool:
    """Whether a file is one that is left where files without a name cannot be had."""
    return is_leftover(path) and storage._nameless(folder) is None


def test_what_a_killed_process_left_is_taken_away_by_the_next(tmp_path: Path) -> None:
    path, left = tmp_path / "file", tmp_path / ".file.part"
    path.write_bytes(b"before")
    left.write_bytes(b"of somebody killed")
    write_bytes(path, b"after")
    assert path.read_bytes() == b"after"
    assert list(tmp_path.iterdir()) == [path] or storage._nameless(tmp_path) is None


def test_where_files_have_names_from_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "_nameless", lambda _: None)
    write_bytes(tmp_path / "file", b"first")
    write_bytes(tmp_path / "file", b"second", durable=False)
    assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"second"]
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot write"):
        write_bytes(tmp_path / "folder", b"")
    assert {each.name for each in tmp_path.iterdir()} == {"file", "folder"}


def test_many_write_the_same_file_at_once(tmp_path: Path) -> None:
    contents = [bytes([number]) * 5000 for number in range(8)]
    with ThreadPoolExecutor(8) as pool:
        for _ in range(10):
            list(pool.map(lambda content: write_bytes(tmp_path / "file", content, durable=False), contents))
            assert [path.name for path in tmp_path.iterdir()] == ["file"]
            assert (tmp_path / "file").read_bytes() in contents
