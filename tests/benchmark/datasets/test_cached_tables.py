"""What is kept of a root that was opened before: the same data set with it, without it, and whatever became of it."""

import json
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from benchmark.datasets import cached_tables as kept_tables
from benchmark.datasets import fingerprint as kept_digests
from benchmark.datasets.cached_tables import find_cache_folder
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.scene_tables import read_scene_tables
from benchmark.datasets.schema import FaultList
from benchmark.errors import InputError
from benchmark.machine import user_cache
from tests.benchmark.datasets.nuscenes_tables import VERSION, TinyRoot
from tests.benchmark.datasets.test_scene_tables import everything, shuffled

Opened = Callable[[], tuple[list[object], int]]


@pytest.fixture
def tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TinyRoot:
    """Three scenes whose rows lie in no order; small tables are worth keeping too, and every file is settled."""
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(kept_tables, "WORTH_BYTES", 1)
    monkeypatch.setattr(kept_digests, "WORTH_BYTES", 1)
    monkeypatch.setattr(user_cache, "SETTLED_S", -1e9)
    made = shuffled(tmp_path / "root")
    made.write()
    return made


@pytest.fixture
def opened(tables: TinyRoot, monkeypatch: pytest.MonkeyPatch) -> Opened:
    """Opens the root; gives all that it says, and how often its tables were parsed."""
    parsed: list[Path] = []

    def counted(folder: Path, rates: FaultList) -> object:
        parsed.append(folder)
        return read_scene_tables(folder, rates)

    monkeypatch.setattr(kept_tables, "read_scene_tables", counted)

    def open_it() -> tuple[list[object], int]:
        parsed.clear()
        return list(everything(NuScenesData.open(tables.root))), len(parsed)

    return open_it


@pytest.fixture
def kept(tables: TinyRoot) -> Path:
    """The file in the cache."""
    found = find_cache_folder(tables.root / VERSION)
    assert found is not None
    return found


def test_the_second_opening_parses_nothing_and_says_the_same(opened: Opened) -> None:
    first, parsed_first = opened()
    second, parsed_second = opened()
    assert (parsed_first, parsed_second) == (1, 0)
    assert first == second


def test_a_changed_table_is_noticed_though_its_size_and_times_are_put_back(tables: TinyRoot, opened: Opened) -> None:
    path = tables.root / VERSION / "sample_annotation.json"
    first, _ = opened()
    before = path.stat()
    row = tables.tables["sample_annotation"][0]
    row["size"] = [row["size"][1], row["size"][0], row["size"][2]]
    path.write_text(json.dumps(tables.tables["sample_annotation"]))
    assert path.stat().st_size == before.st_size
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    second, parsed = opened()
    assert parsed == 1
    assert first[-3] != second[-3], "the fingerprint"
    assert first != second


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-1], lambda data: data + b"\0", lambda data: data[: len(data) // 2], lambda data: b"",
        lambda data: data[:-100] + bytes([data[-100] ^ 1]) + data[-99:],
        lambda data: data[:20] + b"\xff" * 8 + data[28:], lambda data: data.replace(b'"sha256":"', b'"sha256":"0', 1),
        lambda data: data.replace(b'"made_of":"', b'"made_of":"0', 1), lambda data: b"kept arrays 1\n\0\0" + data[16:],
    ],
)  # fmt: skip
def test_what_is_damaged_is_made_again(opened: Opened, kept: Path, damage: Callable[[bytes], bytes]) -> None:
    first, _ = opened()
    sound = kept.read_bytes()
    kept.write_bytes(damage(sound))
    second, parsed = opened()
    assert (second, parsed) == (first, 1)
    assert kept.read_bytes() == sound
    assert opened()[1] == 0


@pytest.mark.parametrize("content", ["[1, 2]", "{", '{"x": [[1], "0"]}', ""])
def test_damaged_hashes_are_made_again(opened: Opened, kept: Path, content: str) -> None:
    first, _ = opened()
    hashes = kept.with_suffix(".digests.json")
    assert len(json.loads(hashes.read_text())) == 13
    hashes.write_text(content)
    assert opened()[0] == first
    assert len(json.loads(hashes.read_text())) == 13


def test_two_that_open_at_once_say_the_same(tables: TinyRoot, kept: Path) -> None:
    def open_it(_: int) -> list[object]:
        return list(everything(NuScenesData.open(tables.root)))

    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(open_it, range(8)))
    assert all(each == found[0] for each in found)
    assert open_it(0) == found[0]
    assert sorted(path.name for path in kept.parent.iterdir()) == [kept.name, kept.with_suffix(".digests.json").name]


def test_a_cache_that_cannot_be_written_to_costs_nothing_but_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, opened: Opened
) -> None:
    first, _ = opened()
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "file"))
    assert opened() == (first, 1)
    monkeypatch.setattr("os.fsync", no_room)
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "full"))
    assert opened() == (first, 1)
    assert not list((tmp_path / "full" / "opened").iterdir())


def no_room(descriptor: int) -> None:
    raise OSError(28, "No space left on device")


def test_nothing_is_kept_of_tables_that_may_still_change_without_showing_it(
    opened: Opened, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(user_cache, "SETTLED_S", 3600.0)
    opened()
    assert not kept.parent.exists()
    assert opened()[1] == 1


def test_nothing_is_kept_of_tables_that_are_refused(tables: TinyRoot, opened: Opened, kept: Path) -> None:
    tables.tables["sample"][0]["scene_token"] = "nowhere"
    tables.write()
    for _ in range(2):
        with pytest.raises(InputError, match="nowhere"):
            opened()
    assert not kept.exists()


def test_what_is_kept_of_a_root_that_is_gone_is_removed(tables: TinyRoot, opened: Opened, kept: Path) -> None:
    opened()
    moved = tables.root.with_name("moved")
    tables.root.rename(moved)
    NuScenesData.open(moved).fingerprint()
    new = find_cache_folder(moved / VERSION)
    assert new is not None
    assert not kept.exists() and not kept.with_suffix(".digests.json").exists()
    assert sorted(path.name for path in kept.parent.iterdir()) == [new.name, new.with_suffix(".digests.json").name]


def test_other_checks_are_made_again(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    opened()
    monkeypatch.setattr(kept_tables, "_checks_key", lambda: "of another version")
    assert opened()[1] == 1
