"""Rules that go along with a split in one file."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.untrusted.compressed import read_package
from generation.splits.building import build_frozen
from generation.splits.packing import PackageContents, WrittenPackage, pack_split
from generation.splits.unpacking import read_split_package, write_package_files
from tests.benchmark.cli.in_process import run_here
from tests.generation.splits.frozen_files import drifting_split, recordings
from tests.generation.splits.test_packing import HERE, PLAIN, changed, replaced

RULES = b"[changed]\nmost = 2\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("packed")


@pytest.fixture(scope="module")
def contents(folder: Path) -> PackageContents:
    source = recordings(folder / "recorded")
    split = drifting_split(source, folder / "road-adv-1.json")
    build_frozen(source, split, replace(PLAIN, out=folder / "built"))
    (folder / "rules.toml").write_bytes(RULES)
    return PackageContents((split,), open_data(folder / "built"), (), folder / "rules.toml")


@pytest.fixture(scope="module")
def packed(contents: PackageContents, folder: Path) -> WrittenPackage:
    return pack_split(folder / "road.zip", contents, HERE)


def test_rules_are_in_the_package_byte_for_byte(
    packed: WrittenPackage, contents: PackageContents, tmp_path: Path
) -> None:
    assert pack_split(tmp_path / "again.zip", contents, HERE).sha256 == packed.sha256
    assert sorted(file.kind for file in packed.manifest.files.values()) == ["rules", "split", "statistics"]
    assert read_package(packed.path)["rules/rules.toml"] == RULES
    write_package_files(read_split_package(packed.path), tmp_path / "files")
    assert (tmp_path / "files" / "rules" / "rules.toml").read_bytes() == RULES


def test_the_commands_of_the_page(packed: WrittenPackage, folder: Path, tmp_path: Path) -> None:
    done = run_here(
        "data", "pack", folder / "road-adv-1.json", "--root", folder / "built", "--rules", folder / "rules.toml",
        "--to", tmp_path / "road.zip", "--workers", "1",
    )  # fmt: skip
    assert done.code == 0 and packed.sha256 in done.out, done.err
    done = run_here("data", "unpack", tmp_path / "road.zip", "--to", tmp_path / "files")
    assert done.code == 0 and "is intact: 3 files" in done.out, done.err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda members: members.pop("rules/rules.toml"), "lacks rules/rules.toml"),
        (replaced("rules", b"[changed]\nmost = 9\n"), "does not match the manifest"),
    ],
)  # fmt: skip
def test_what_was_tampered_with_is_refused(packed: WrittenPackage, tmp_path: Path, change: Any, message: str) -> None:
    done = run_here("data", "unpack", changed(packed, tmp_path, change), "--to", tmp_path / "files")
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1
    assert not (tmp_path / "files").exists()


def test_what_are_no_rules_is_not_packed(contents: PackageContents, tmp_path: Path) -> None:
    (tmp_path / "rules.toml").write_text("most = = 1")
    (tmp_path / "more.toml").write_text("[changed]\nwheels = 3")
    for name, message in (
        ("rules", "is not valid TOML"),
        ("more", "changed.wheels: .*; see docs/extensions/challenge.md"),
    ):
        with pytest.raises(InputError, match=message):
            pack_split(tmp_path / "wrong.zip", replace(contents, rules=tmp_path / f"{name}.toml"), HERE)
    assert not (tmp_path / "wrong.zip").exists()


def test_rules_that_are_there_are_never_replaced(packed: WrittenPackage, tmp_path: Path) -> None:
    (tmp_path / "rules").mkdir()
    (tmp_path / "rules" / "rules.toml").write_text("mine = 1")
    with pytest.raises(InputError, match="exists with other content"):
        write_package_files(read_split_package(packed.path), tmp_path)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["rules.toml"]
