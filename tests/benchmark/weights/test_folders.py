"""Folders of published weights: fetched in pieces, checked, imported, found; nothing half-done is ever taken."""

import http.server
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256
from benchmark.weights.catalogue import PublishedFile, PublishedWeights
from benchmark.weights.folders import (
    compute_content_hash,
    fetch_folder,
    find_cached_folder,
    find_hub_folder,
    import_folder,
    recognise_weights,
    require_folder_of,
)

BIG = bytes(range(256)) * 20_000
CONTENT = {"config.json": b"{}", "parts/model.bin": BIG}


def entry(root: str | None = "https://nowhere.invalid", **changes: Any) -> PublishedWeights:
    """Weights whose files have addresses below ``root``, or are on the hub."""
    files = (PublishedFile("config.json"), PublishedFile("parts/model.bin"))
    made = PublishedWeights("small", files, "free", "owner/small-model", "abc", "quality", 5, "https://page")
    made = replace(made, **changes)
    addressed = (replace(file, url=root and f"{root}/{file.name}") for file in made.files)
    return replace(made, files=tuple(addressed))


def written(folder: Path) -> Path:
    for name, content in CONTENT.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


class Server:
    """Serves `CONTENT`; may break off, forget what it was, or answer without ranges."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str | None]] = []
        self.stop_after: int | None = None
        self.tag: str | None = '"one"'
        self.content = dict(CONTENT)
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def log_message(self, *args: Any) -> None:
                pass

            def do_GET(self) -> None:
                name, asked = self.path[1:], self.headers.get("Range")
                outer.asked.append((name, asked))
                if name not in outer.content:
                    self.send_error(404)
                    return
                data, start = outer.content[name], 0
                if asked and self.headers.get("If-Range") == outer.tag:
                    start = int(asked.removeprefix("bytes=").removesuffix("-"))
                self.send_response(206 if start else 200)
                self.send_header("Content-Length", str(len(data) - start))
                if outer.tag:
                    self.send_header("ETag", outer.tag)
                self.end_headers()
                self.wfile.write(data[start:][: outer.stop_after])

        self.serving = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.serving.server_port}"
        self.thread = threading.Thread(target=self.serving.serve_forever)
        self.thread.start()


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.serving.shutdown()
    made.thread.join()
    made.serving.server_close()


def test_weights_are_fetched_whole_or_not_at_all_and_goes_on_where_it_broke_off(server: Server, tmp_path: Path) -> None:
    weights = entry(server.url)
    server.stop_after = 3_000_000
    with pytest.raises(InputError, match="broke off after 3000000 of 5120000 bytes; run the command again"):
        fetch_folder(weights, tmp_path)
    with pytest.raises(InputError, match="no weights small found"):
        require_folder_of(weights, None, tmp_path)
    server.stop_after, server.asked = None, []
    folder = fetch_folder(weights, tmp_path)
    assert server.asked == [("parts/model.bin", "bytes=3000000-")]
    assert folder == require_folder_of(weights, None, tmp_path) == find_hub_folder(tmp_path) / "small"
    assert {name: (folder / name).read_bytes() for name in CONTENT} == CONTENT
    assert sorted(path.name for path in folder.rglob("*")) == ["config.json", "model.bin", "parts"]
    assert [path.name for path in find_hub_folder(tmp_path).iterdir()] == ["small"]
    assert fetch_folder(weights, tmp_path) == folder and len(server.asked) == 1


@pytest.mark.parametrize("tag", ['"two"', 'W/"weak"', None])
def test_a_file_that_changed_meanwhile_is_fetched_anew(server: Server, tmp_path: Path, tag: str | None) -> None:
    server.stop_after = 1000
    if tag is None:
        server.tag = None
    with pytest.raises(InputError, match="broke off"):
        fetch_folder(entry(server.url), tmp_path)
    server.stop_after, server.tag = None, tag
    server.content["parts/model.bin"] = BIG[::-1]
    assert (fetch_folder(entry(server.url), tmp_path) / "parts/model.bin").read_bytes() == BIG[::-1]


def test_files_that_are_not_the_published_ones_are_refused(server: Server, tmp_path: Path) -> None:
    sized = (PublishedFile("config.json", size_bytes=3),)
    with pytest.raises(InputError, match="returned 2 bytes instead of 3"):
        fetch_folder(entry(server.url, files=sized), tmp_path)
    with pytest.raises(InputError, match="its SHA-256 differs"):
        fetch_folder(entry(server.url, files=(PublishedFile("config.json", sha256="00000000"),)), tmp_path)
    digest = file_sha256(written(tmp_path / "mine") / "parts/model.bin")
    right = (PublishedFile("parts/model.bin", len(BIG), digest[:8].upper()),)
    assert fetch_folder(entry(server.url, files=right), tmp_path).is_dir()
    with pytest.raises(InputError, match=r"cannot fetch .*[Nn]ot [Ff]ound.* with a browser, then run.*import FOLDER"):
        fetch_folder(entry(server.url, name="other", files=(PublishedFile("absent"),)), tmp_path)


def test_no_connection_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot fetch .* get config\.json, parts/model\.bin from https://page"):
        fetch_folder(entry("http://127.0.0.1:1"), tmp_path)


def test_the_users_folder_is_found_under_any_of_its_names(tmp_path: Path) -> None:
    weights = entry()
    for place, given in (("own", "own"), ("all/small", "all"), ("clones/small-model", "clones")):
        folder = written(tmp_path / place)
        assert require_folder_of(weights, tmp_path / given, tmp_path / "cache") == folder
    (tmp_path / "own" / "config.json").unlink()
    with pytest.raises(
        InputError, match=r"no weights small found in .*own lacks config\.json\).*about 5 MB\) from https://page"
    ):
        require_folder_of(weights, tmp_path / "own", tmp_path / "cache")


def test_folders_are_imported_checked_and_replace_older_ones(tmp_path: Path) -> None:
    cache, source = tmp_path / "cache", written(tmp_path / "mine")
    folder = import_folder(entry(), source, cache)
    assert require_folder_of(entry(), None, cache) == folder
    (source / "config.json").write_bytes(b"[]")
    assert (import_folder(entry(), source, cache) / "config.json").read_bytes() == b"[]"
    assert [path.name for path in find_hub_folder(cache).iterdir()] == ["small"]
    for weights, path, says in (
        (entry(), tmp_path / "none", "does not exist"),
        (entry(files=(PublishedFile("more"),)), source, "lacks more of small"),
        (entry(files=(PublishedFile("config.json", 99),)), source, "has 2 bytes instead of 99"),
        (entry(files=(PublishedFile("config.json", sha256="ab"),)), source, "its SHA-256 differs"),
        (entry(), folder, "already the stored copy"),
    ):
        with pytest.raises(InputError, match=says):
            import_folder(weights, path, cache)
    single = entry(name="one", files=(PublishedFile("config.json"),))
    assert (import_folder(single, source / "config.json", cache) / "config.json").is_file()


def test_a_cache_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file where a folder should be")
    with pytest.raises(InputError, match="cannot write"):
        import_folder(entry(), written(tmp_path / "mine"), tmp_path / "cache")


def test_the_hash_of_the_content_sees_changes_without_reading_everything(tmp_path: Path) -> None:
    folder = written(tmp_path / "mine")
    first = compute_content_hash(entry(), folder)
    assert first == compute_content_hash(entry(), folder) and len(first) == 64
    for name, at in (("config.json", 0), ("parts/model.bin", 0), ("parts/model.bin", len(BIG) - 1)):
        data = bytearray(CONTENT[name])
        data[at] ^= 1
        (folder / name).write_bytes(data)
        assert compute_content_hash(entry(), folder) != first
        (folder / name).write_bytes(CONTENT[name])
    (folder / "config.json").unlink()
    with pytest.raises(InputError, match="cannot read"):
        compute_content_hash(entry(), folder)


def test_what_a_path_holds_is_told_by_its_name_or_asked(tmp_path: Path) -> None:
    clone = written(tmp_path / "small-model")
    entries = (entry(), entry(name="one", repository="owner/one", files=(PublishedFile("one.pth"),)))
    assert recognise_weights(clone, None, entries) == entries[0]
    (tmp_path / "one.pth").touch()
    assert recognise_weights(tmp_path / "one.pth", None, entries) == entries[1]
    assert recognise_weights(tmp_path / "VAD_tiny.pth", "vad-tiny", entries) is None
    assert recognise_weights(tmp_path / "VAD_tiny.pth", None, entries) is None
    assert recognise_weights(tmp_path, "small", entries) == entries[0]
    with pytest.raises(InputError, match=r"cannot tell which weights .* holds; give --model, one of small, one"):
        recognise_weights(tmp_path, None, entries)


def test_names_that_leave_the_folder_are_a_mistake_of_the_program() -> None:
    for name in ("../a", "/a", "", "a/../../b"):
        with pytest.raises(ValueError, match="not a file inside"):
            entry(files=(PublishedFile(name),))


def test_folders_of_the_hub_come_by_its_own_client_and_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[dict[str, Any]] = []

    def snapshot(repository: str, *, revision: str, allow_patterns: list[str], local_dir: Path) -> None:
        asked.append({"repository": repository, "revision": revision, "names": allow_patterns})
        for name in allow_patterns:
            (local_dir / name).parent.mkdir(parents=True, exist_ok=True)
            (local_dir / name).write_bytes(CONTENT[name])
        (local_dir / ".cache" / "huggingface").mkdir(parents=True)

    monkeypatch.setattr("huggingface_hub.snapshot_download", snapshot)
    wrong = (PublishedFile("config.json", sha256="00000000"), PublishedFile("parts/model.bin"))
    with pytest.raises(InputError, match="its SHA-256 differs"):
        fetch_folder(entry(None, files=wrong), tmp_path)
    assert find_cached_folder(entry(None), tmp_path) is None
    folder = fetch_folder(entry(None), tmp_path)
    assert asked[-1] == {"repository": "owner/small-model", "revision": "abc", "names": list(CONTENT)}
    assert sorted(path.name for path in folder.rglob("*")) == ["config.json", "model.bin", "parts"]
    assert fetch_folder(entry(None), tmp_path) == folder and len(asked) == 2


def test_a_hub_out_of_reach_and_an_absent_client_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreachable(*_: Any, **__: Any) -> None:
        raise OSError("no route to host\nand much more")

    monkeypatch.setattr("huggingface_hub.snapshot_download", unreachable)
    with pytest.raises(InputError, match=r"cannot fetch https://page \(no route to host\); get config\.json, "):
        fetch_folder(entry(None), tmp_path)
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(InputError, match=r"needs the package huggingface_hub; .*'challenger-bench\[quality\]'"):
        fetch_folder(entry(None), tmp_path)
