"""A split as one file and back: the same bytes, every file checked, built again with its verdicts."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.split_reviews import record_verdicts, scene_tokens
from benchmark.errors import InputError
from benchmark.machine.workers import LocalProcesses
from benchmark.records.review import Verdict, read_review
from benchmark.untrusted.compressed import encode_package, read_package
from generation.splits.building import build_frozen
from generation.splits.packaged import NamedSplit
from generation.splits.packing import PackageContents, WrittenPackage, pack_split
from generation.splits.rebuilding import rebuild
from generation.splits.unpacking import read_split_package, write_package_files
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.records.test_drives import row, written
from tests.generation.splits.frozen_files import BUILT, drifting_split, recordings

HERE = LocalProcesses(1)
PLAIN = replace(BUILT, renderer=None)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return recordings(tmp_path_factory.mktemp("recorded"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("packed")


@pytest.fixture(scope="module")
def split(source: DataSet, folder: Path) -> NamedSplit:
    return drifting_split(source, folder / "road-adv-1.json")


@pytest.fixture(scope="module")
def built(source: DataSet, split: NamedSplit, folder: Path) -> DataSet:
    build_frozen(source, split, replace(PLAIN, out=folder / "built"))
    root = folder / "built"
    name = split.frozen.scenes[0].name
    said = Verdict(verdict="rejected", reason="drives over a kerb", token=scene_tokens(root)[name])
    record_verdicts(root, {name: said})
    return open_data(root)


@pytest.fixture(scope="module")
def contents(split: NamedSplit, built: DataSet, folder: Path) -> PackageContents:
    names = [scene.name for scene in split.frozen.scenes]
    drives = written(folder / "drives", row(names[0]), scenes=names[:1], frozen_split=split.name)
    return PackageContents((split,), built, (drives,))


@pytest.fixture(scope="module")
def packed(contents: PackageContents, folder: Path) -> WrittenPackage:
    return pack_split(folder / "road.zip", contents, HERE)


def test_a_package_is_the_same_bytes_and_holds_what_belongs_to_the_split(
    packed: WrittenPackage, contents: PackageContents, split: NamedSplit, tmp_path: Path
) -> None:
    again = pack_split(tmp_path / "again.zip", contents, HERE)
    assert again.sha256 == packed.sha256 and again.path.read_bytes() == packed.path.read_bytes()
    pack_split(packed.path, contents, HERE)
    members = read_package(packed.path)
    assert next(iter(members)) == "manifest.json"
    kinds = sorted(file.kind for file in packed.manifest.files.values())
    assert kinds == ["drive", "split", "statistics", "verdicts"]
    assert members[f"splits/{split.name}.json"].decode() == split.frozen.text()
    counts = json.loads(members["statistics/split.json"])
    assert counts["counts"]["scenes"] == len(split.frozen.scenes) and counts["judgement"]["scenes"]
    drive = next(json.loads(data) for name, data in members.items() if name.startswith("drives/"))
    assert (
        drive["measured"]["engine"]
        and drive["planner"]["name"]
        and not {"environment", "config", "rows"} & drive.keys()
    )


def test_no_recording_and_no_place_of_this_machine_is_in_it(
    packed: WrittenPackage, source: DataSet, split: NamedSplit, folder: Path
) -> None:
    adversaries = {each.instance for scene in split.frozen.scenes for each in scene.adversaries}
    others = {name for scene in source.scene_names(None) for name in source.scene(scene).agents.ids} - adversaries
    text = b"".join(read_package(packed.path).values()).decode()
    assert others and not [name for name in others if name in text]
    assert str(folder) not in text and str(source.root) not in text
    assert all(str(path) not in text for path in (Path.home(), Path.cwd()))


def test_it_is_unpacked_and_built_again_with_its_verdicts(
    packed: WrittenPackage, source: DataSet, split: NamedSplit, built: DataSet, tmp_path: Path
) -> None:
    package = read_split_package(packed.path)
    files = write_package_files(package, tmp_path / "files")
    assert write_package_files(package, tmp_path / "files") == files and len(files) == len(package.files) + 1
    report = rebuild(source, package, package.split(None), replace(PLAIN, out=tmp_path / "adv"))
    assert report.other_tables == ()
    assert read_review(tmp_path / "adv") == read_review(built.root)
    again = open_data(tmp_path / "adv")
    assert again.scene_names("adv") == built.scene_names("adv")
    assert len(again.scene_names("adv")) == len(split.frozen.scenes) - 1
    assert again.fingerprint() == built.fingerprint()
    # Statistics of what was built are those that were packed.
    whole = pack_split(tmp_path / "again.zip", PackageContents((split,), again), HERE)
    assert read_package(whole.path)["statistics/split.json"] == package.files["statistics/split.json"]


def test_the_commands_of_the_page(
    source: DataSet, packed: WrittenPackage, contents: PackageContents, tmp_path: Path
) -> None:
    folder = packed.path.parent
    done = run_here(
        "data", "pack", folder / "road-adv-1.json", "--root", folder / "built", "--drives", folder / "drives",
        "--to", tmp_path / "road.zip", "--workers", "1",
    )  # fmt: skip
    assert done.code == 0 and packed.sha256 in done.out and "settings of 1 drive record" in done.out, done.err
    done = run_here("data", "unpack", tmp_path / "road.zip", "--to", tmp_path / "files")
    assert done.code == 0 and "is intact: 4 files" in done.out and "generate --from" in done.out, done.err
    done = run_here(
        "data", "unpack", tmp_path / "road.zip", "--to", tmp_path / "files", "--data", source.root, "--out",
        tmp_path / "out", "--renderer", "none", "--frames", "keyframes", "--workers", "1", "--json",
    )  # fmt: skip
    said = json.loads(done.out)
    assert done.code == 0 and said["built"]["other_tables"] == [], done.err
    assert read_review(Path(said["built"]["root"])) == read_review(folder / "built")
    before = bytes_below(tmp_path)
    done = run_here(
        "data", "unpack", tmp_path / "road.zip", "--to", tmp_path / "more", "--data", source.root, "--dry-run"
    )
    assert done.code == 0 and "would build" in done.out and bytes_below(tmp_path) == before


def changed(packed: WrittenPackage, folder: Path, change: Any) -> Path:
    members = read_package(packed.path)
    change(members)
    path = folder / "changed.zip"
    path.write_bytes(encode_package(members))
    return path


def edit(name: str, **changes: Any) -> Any:
    def change(members: dict[str, bytes]) -> None:
        key = next(each for each in members if each.startswith(name))
        members[key] = json.dumps({**json.loads(members[key]), **changes}).encode()

    return change


def replaced(name: str, data: bytes) -> Any:
    def change(members: dict[str, bytes]) -> None:
        members[next(each for each in members if each.startswith(name))] = data

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda members: members.pop("manifest.json"), "is not a split"),
        (lambda members: members.pop("statistics/split.json"), "lacks statistics/split.json"),
        (lambda members: members.update({"more.txt": b"x"}), "holds more.txt, which is not in its manifest"),
        (edit("manifest.json", format="other"), "is not a split"),
        (edit("manifest.json", schema=2), "has version 2 of the format"),
        (edit("manifest.json", splits=[]), "manifest.json is damaged"),
        (edit("manifest.json", more=1), "manifest.json is damaged"),
        (replaced("manifest.json", b"{" * 10_000), "manifest.json is not JSON"),
        (replaced("statistics", b"{}"), "does not match the manifest"),
        (edit("splits", split="val"), "does not match the manifest"),
        (edit("statistics", more=1), "does not match the manifest"),
    ],
)  # fmt: skip
def test_what_was_tampered_with_is_refused(packed: WrittenPackage, tmp_path: Path, change: Any, message: str) -> None:
    path = changed(packed, tmp_path, change)
    done = run_here("data", "unpack", path, "--to", tmp_path / "files")
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1
    assert not (tmp_path / "files").exists()


def test_a_split_that_names_itself_otherwise_is_refused(packed: WrittenPackage, tmp_path: Path) -> None:
    def change(members: dict[str, bytes]) -> None:
        manifest = json.loads(members["manifest.json"])
        manifest["splits"][0]["content"] = "0" * 64
        members["manifest.json"] = json.dumps(manifest).encode()

    with pytest.raises(InputError, match="is not the one named in the manifest"):
        read_split_package(changed(packed, tmp_path, change))


def test_what_does_not_belong_together_is_not_packed(
    packed: WrittenPackage, contents: PackageContents, split: NamedSplit, source: DataSet, tmp_path: Path
) -> None:
    other = written(tmp_path / "other", row("scene-1"), scenes=["scene-1"])
    (tmp_path / "taken.zip").write_bytes(b"something")
    for wrong, message in (
        (replace(contents, root=source), "was not built from the packed frozen splits"),
        (replace(contents, drives=(other,)), "drives scenes that are not in the packed splits, such as scene-1"),
        (replace(contents, splits=(split, split)), "is listed twice"),
        (replace(contents, splits=(NamedSplit("../up", split.frozen),)), "is not a plain file name"),
    ):
        with pytest.raises(InputError, match=message):
            pack_split(tmp_path / "wrong.zip", wrong, HERE)
    assert not (tmp_path / "wrong.zip").exists()
    with pytest.raises(InputError, match="exists with other content"):
        pack_split(tmp_path / "taken.zip", contents, HERE)
    with pytest.raises(InputError, match="has no split 'more'"):
        read_split_package(packed.path).split("more")


def test_files_that_are_there_are_never_replaced(packed: WrittenPackage, tmp_path: Path) -> None:
    mine = tmp_path / "statistics" / "split.json"
    mine.parent.mkdir()
    mine.write_text("mine")
    with pytest.raises(InputError, match="exists with other content"):
        write_package_files(read_split_package(packed.path), tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [mine]
