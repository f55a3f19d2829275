"""Foreign checkpoints: read without trust, matched to a model, kept as safetensors that say where they come from."""

import http.server
import os
import pickle
import threading
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch
from torch import Tensor, nn

from adapters.checkpoints.cache import cached_weights, known_weights, load_weights, read_provenance
from adapters.checkpoints.checkpoint_import import fetch_checkpoint, import_checkpoint, resolve_checkpoint
from adapters.models import Model, Network, published_models
from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256
from benchmark.weights.catalogue import CHECKPOINTS, PublishedFile, PublishedWeights, find_checkpoint
from benchmark.weights.folders import read_checkpoint


def network(width: int = 4, layers: int = 2) -> nn.Module:
    return nn.Sequential(*(nn.Linear(width, width) for _ in range(layers)), nn.BatchNorm1d(width))


def sized(layers: int) -> nn.Module:
    """What the table's entries build of their configuration."""
    return network(layers=layers)


HERE = "tests.adapters.checkpoints.test_checkpoints"
TWO, THREE = (lambda: 2), (lambda: 3)
SMALL = Network(f"{HERE}:sized", f"{HERE}:TWO", "", "bgr-mean", renamed=(("_offset$", ""),), ignored=("^unused",))
LARGE = Network(f"{HERE}:sized", f"{HERE}:THREE", "", "rgb-mean-std")


@pytest.fixture(autouse=True)
def two_models(monkeypatch: pytest.MonkeyPatch) -> None:
    made = {"small": SMALL, "large": LARGE}
    table = {name: Model(name, "", network, weights=name) for name, network in made.items()}
    monkeypatch.setattr("adapters.models.MODELS", table)


def weights(**kwargs: int) -> dict[str, Tensor]:
    torch.manual_seed(1)
    return dict(network(**kwargs).state_dict())


def saved(path: Path, content: Any, **kwargs: Any) -> Path:
    torch.save(content, path, **kwargs)
    return path


def as_mmcv(tensors: dict[str, Tensor], config: str = "") -> dict[str, Any]:
    meta = {"epoch": 60, "mmcv_version": "1.4.0", "config": config, "lr": np.float64(2e-4), "CLASSES": ["car"]}
    state = {0: {"step": 1, "exp_avg": torch.ones(3)}}
    optimizer = {"state": state, "param_groups": [{"lr": np.float32(1e-4), "params": [0]}]}
    return {"meta": meta, "state_dict": OrderedDict(tensors), "optimizer": optimizer}


BGR = {"mean": "103.53, 116.28, 123.675", "std": "1.0, 1.0, 1.0", "rgb": False}
RGB = {"mean": "123.675, 116.28, 103.53", "std": "58.395, 57.12, 57.375", "rgb": True}
CONFIG = "img_norm_cfg = dict(\n    mean=[{mean}], std=[{std}], to_rgb={rgb})\nmodel = dict(type='VAD')\n"


# --- what is read


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("form", [lambda held: held, as_mmcv, lambda held: {"state_dict": held}])
@pytest.mark.parametrize("prefix", ["", "module."])
def test_every_usual_form_of_a_checkpoint_is_read(
    tmp_path: Path, form: Callable[[Any], Any], prefix: str, legacy: bool
) -> None:
    tensors = weights()
    content = form({prefix + name: tensor for name, tensor in tensors.items()})
    path = saved(tmp_path / "a.pth", content, _use_new_zipfile_serialization=not legacy)
    found = read_checkpoint(path).tensors
    assert list(found) == list(tensors)
    assert all(torch.equal(found[name], tensor) for name, tensor in tensors.items())


class RunsCode:
    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.trace}",)


@pytest.mark.parametrize("where", ["state_dict", "meta", "optimizer"])
@pytest.mark.parametrize("legacy", [False, True])
def test_a_checkpoint_that_runs_code_is_refused_and_its_code_never_runs(
    tmp_path: Path, where: str, legacy: bool
) -> None:
    trace = tmp_path / "trace"
    content = as_mmcv(weights())
    content[where]["extra"] = RunsCode(trace)
    path = saved(tmp_path / "a.pth", content, _use_new_zipfile_serialization=not legacy)
    with pytest.raises(InputError, match=r"is refused: it uses (posix|nt)\.system") as refusal:
        import_checkpoint(path, cache=tmp_path / "cache")
    assert not trace.exists() and "weights_only" not in str(refusal.value)
    assert not (tmp_path / "cache").exists()


def test_a_bare_pickle_that_runs_code_is_refused(tmp_path: Path) -> None:
    trace, path = tmp_path / "trace", tmp_path / "a.pth"
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        path.write_bytes(pickle.dumps({"state_dict": RunsCode(trace)}, protocol=protocol))
        with pytest.raises(InputError, match=r"refused|without running code|cannot be read"):
            read_checkpoint(path)
    assert not trace.exists()


class Configuration(dict[str, Any]):
    """What some trainers leave in ``meta``."""


NO_WEIGHTS = "weights must be a state dict"
NOT_DENSE = "dense tensor of real numbers"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        *(([1], NO_WEIGHTS), ({}, NO_WEIGHTS), ({"state_dict": {}}, NO_WEIGHTS), ({"epoch": 3}, NO_WEIGHTS)),
        *(({"state_dict": {"a": 1}}, NO_WEIGHTS), ({1: 2}, NO_WEIGHTS)),
        ({"a": torch.eye(2).to_sparse()}, NOT_DENSE),
        ({"a": torch.zeros(2, dtype=torch.complex64)}, NOT_DENSE),
        ({"a": torch.zeros(2, device="meta")}, NOT_DENSE),
        ({"meta": {"cfg": Configuration(lr=1)}}, r"it uses [\w.]*Configuration, .*save its state_dict alone"),
        ({"meta": np.array([None, {}], dtype=object)}, "is refused: it uses numpy"),
    ],
)
def test_content_that_is_no_state_dict_is_refused(tmp_path: Path, content: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_checkpoint(saved(tmp_path / "a.pth", content))


@pytest.mark.parametrize("keep", [0, 1, 3, 100, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("legacy", [False, True])
def test_a_truncated_file_is_refused(tmp_path: Path, keep: float, legacy: bool) -> None:
    path = saved(tmp_path / "a.pth", as_mmcv(weights()), _use_new_zipfile_serialization=not legacy)
    data = path.read_bytes()
    path.write_bytes(data[: int(keep if keep >= 1 else keep * len(data))])
    with pytest.raises(InputError, match=r"a\.pth (is|cannot be).*fetch it again"):
        read_checkpoint(path)


def test_flipped_bytes_are_refused_or_change_numbers_only(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.pth", weights())
    data = path.read_bytes()
    for position in np.random.default_rng(0).integers(0, len(data), 20).tolist():
        path.write_bytes(data[:position] + bytes([data[position] ^ 0xFF]) + data[position + 1 :])
        try:
            import_checkpoint(path, cache=tmp_path / "cache")
        except InputError as error:
            assert len(str(error).splitlines()) == 1
    numbers = torch.full((64,), 3.0)
    data = saved(path, {"a": numbers}).read_bytes()
    at = data.index(numbers.numpy().tobytes())
    path.write_bytes(data[:at] + b"\x01" + data[at + 1 :])
    with pytest.raises(InputError, match="fails its checksum"):
        read_checkpoint(path)


DAMAGED = "damaged or not a checkpoint"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"<!DOCTYPE html><title>Google Drive</title>", "is a web page"),
        (b"\n  <html>", "is a web page"),
        (b"version https://git-lfs.github.com/spec/v1\n", DAMAGED),
        (b"\x00" * 5000, DAMAGED),
        (pickle.dumps([1, 2], protocol=2), DAMAGED),
    ],
)
def test_what_is_no_checkpoint_is_one_sentence(tmp_path: Path, content: bytes, says: str) -> None:
    path, bomb = tmp_path / "a.pth", tmp_path / "bomb.pth"
    path.write_bytes(content)
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", b"\x00" * 10_000_000)
    for file, sentence in ((path, says), (bomb, "claims to hold more bytes"), (tmp_path / "none.pth", "cannot read")):
        with pytest.raises(InputError, match=sentence):
            read_checkpoint(file)


# --- which model


def test_an_import_says_what_it_is_and_gives_the_same_bytes_again(tmp_path: Path) -> None:
    tensors = weights()
    path = saved(tmp_path / "official.pth", as_mmcv(tensors))
    found = import_checkpoint(path, cache=tmp_path / "cache")
    assert found.provenance.model == "small" and found.tensors == len(tensors)
    assert found.parameters == sum(tensor.numel() for tensor in tensors.values())
    assert found.provenance.source == "official.pth" and found.provenance.source_sha256 == file_sha256(path)
    first = found.path.read_bytes()
    again = import_checkpoint(path, "small", tmp_path / "cache")
    assert again.path == found.path and again.path.read_bytes() == first
    loaded = network()
    assert load_weights(loaded, found.path) == found.provenance
    assert all(torch.equal(tensor, tensors[name]) for name, tensor in loaded.state_dict().items())


def test_half_precision_shared_storage_and_old_names_become_plain_weights(tmp_path: Path) -> None:
    tensors = weights()
    block = torch.randn(8, 4, dtype=torch.float16)
    tensors |= {"0.weight": block[:4], "1.weight": block[4:], "1.bias": torch.zeros(1).expand(4)}
    old = {f"{name}_offset": tensor for name, tensor in tensors.items()} | {"unused.a": torch.zeros(3)}
    for number, given in enumerate((tensors, old)):
        found = import_checkpoint(saved(tmp_path / f"{number}.pth", given), cache=tmp_path / str(number))
        assert found.provenance.number_types == ("float16", "float32", "int64")
        held = safetensors.torch.load_file(found.path)
        assert set(held) == set(tensors) and held["0.weight"].dtype == torch.float32
        assert torch.equal(held["1.weight"], block[4:].float()) and torch.equal(held["1.bias"], torch.zeros(4))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda held: held.pop("0.bias"), r"small, which it resembles most: .*1 missing \(first: 0\.bias\)"),
        (lambda held: held.update(loss=torch.zeros(1)), r"1 too many \(first: loss\)"),
        (lambda held: held.update({"0.bias": torch.zeros(5)}), r"0\.bias \(5,\) instead of \(4,\)"),
        (lambda held: held.update({"0.bias": torch.zeros(4, dtype=torch.int64)}), "another kind of number"),
        (lambda held: held.update({"0.bias": torch.full((4,), torch.nan)}), "hold NaN or infinity"),
    ],
)
def test_weights_that_do_not_fit_are_refused_with_the_difference(
    tmp_path: Path, change: Callable[[dict[str, Tensor]], Any], says: str
) -> None:
    tensors = weights()
    change(tensors)
    with pytest.raises(InputError, match=says):
        import_checkpoint(saved(tmp_path / "a.pth", tensors), cache=tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_weights_of_another_model_are_named(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.pth", weights(layers=3))
    assert import_checkpoint(path, cache=tmp_path / "cache").provenance.model == "large"
    with pytest.raises(InputError, match="holds the weights of large, not of small; use it with --model large"):
        import_checkpoint(path, "small", tmp_path / "cache")
    with pytest.raises(InputError, match="is not a model with weights; choose small, large"):
        import_checkpoint(path, "huge", tmp_path / "cache")
    with pytest.raises(InputError, match="checkpoint of one"):
        import_checkpoint(saved(tmp_path / "b.pth", {"a": torch.zeros(1)}), cache=tmp_path / "cache")


# --- normalisation


@pytest.mark.parametrize(
    ("config", "asked", "wanted", "said_by"),
    [
        ("", None, "bgr-mean", "publication"),
        ("model = dict()", None, "bgr-mean", "publication"),
        (CONFIG.format(**BGR), None, "bgr-mean", "configuration"),
        (CONFIG.format(**RGB), None, "rgb-mean-std", "configuration"),
        (CONFIG.format(**{**BGR, "mean": "103.530,116.280,123.675"}), "rgb-mean-std", "rgb-mean-std", "user"),
    ],
)
def test_the_normalisation_is_that_of_the_training(
    tmp_path: Path, config: str, asked: str | None, wanted: str, said_by: str
) -> None:
    path = saved(tmp_path / "a.pth", as_mmcv(weights(), config))
    found = import_checkpoint(path, cache=tmp_path / "cache", normalisation=asked).provenance
    assert (found.normalisation, found.normalisation_from) == (wanted, said_by)
    odd = saved(tmp_path / "b.pth", as_mmcv(weights(), CONFIG.format(mean="1, 2, 3", std="1, 1, 1", rgb=True)))
    for name, says in (
        (None, "choose one with --normalisation: bgr-mean, rgb-"),
        ("grey", "unknown normalisation 'grey'"),
    ):
        with pytest.raises(InputError, match=says):
            import_checkpoint(odd, cache=tmp_path / "cache", normalisation=name)


# --- what is kept, found and fetched


def test_checkpoints_of_either_form_are_resolved(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    path = saved(tmp_path / "a.pth", weights())
    found = resolve_checkpoint("small", path, cache)
    written = found.stat().st_mtime_ns
    assert resolve_checkpoint("small", path, cache) == found and found.stat().st_mtime_ns == written
    assert resolve_checkpoint("small", found, cache) == found
    assert resolve_checkpoint("small", None, cache) == found
    with pytest.raises(InputError, match="holds the weights of small, not of large"):
        resolve_checkpoint("large", found, cache)
    with pytest.raises(InputError, match="there is no checkpoint"):
        resolve_checkpoint("small", tmp_path / "none.pth", cache)
    torch.manual_seed(2)
    import_checkpoint(saved(tmp_path / "b.pth", network().state_dict()), cache=cache)
    with pytest.raises(InputError, match=r"several weights for small: .*choose one with --checkpoint"):
        resolve_checkpoint("small", None, cache)


@pytest.mark.parametrize("model", ["vad-tiny", "vad-base"])
def test_without_weights_one_sentence_says_what_to_get_and_where(tmp_path: Path, model: str) -> None:
    with pytest.raises(InputError, match=rf"no weights for {model}; get VAD_\w+\.pth from https://.*import VAD"):
        resolve_checkpoint(model, None, tmp_path)


def test_damaged_weights_are_made_again(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    path = saved(tmp_path / "a.pth", weights())
    found = resolve_checkpoint("small", path, cache)
    whole = found.read_bytes()
    for damage in (b"", whole[:40], whole[:-10]):
        found.write_bytes(damage)
        assert resolve_checkpoint("small", path, cache).read_bytes() == whole
    strange = cache / "strange.safetensors"
    safetensors.torch.save_file({"a": torch.zeros(1)}, strange)
    assert list(cached_weights(cache)) == [found]
    with pytest.raises(InputError, match="does not name the model"):
        read_provenance(strange)


def test_a_cache_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file where a folder should be")
    with pytest.raises(InputError, match="cannot write"):
        import_checkpoint(saved(tmp_path / "a.pth", weights()), cache=tmp_path / "cache")


def test_official_files_are_found_by_either_name() -> None:
    assert len({entry.files[0].name for entry in CHECKPOINTS}) == len(CHECKPOINTS)
    for entry in CHECKPOINTS:
        assert find_checkpoint(entry.files[0].name) is entry and find_checkpoint(entry.name) is entry
        assert "nuScenes" in entry.licence and not entry.is_folder
        assert all(entry.url(file).startswith("https://") and file.page for file in entry.files)
    with pytest.raises(InputError, match="choose from vad-tiny"):
        find_checkpoint("nonsense")


def test_the_list_says_what_there_is_and_what_is_here(tmp_path: Path) -> None:
    file = PublishedFile("a.pth", 3_000_000, "ab" * 32, "https://url", "https://page")
    entries = tuple(
        PublishedWeights(name, (made,), "free")
        for name, made in (("small", file), ("large", replace(file, sha256=None)))
    )
    imported = import_checkpoint(saved(tmp_path / "mine.pth", weights()), cache=tmp_path / "cache")
    small, large = known_weights(tmp_path / "cache", entries)
    text = " ".join(small.plain().split())
    assert f"a.pth, 3 MB, SHA-256 {'ab' * 32}" in text
    assert f"mine.pth ({imported.provenance.source_sha256[:16]})" in text
    assert str(imported.path) in small.plain() and small.as_json()["imported"][0]["source"] == "mine.pth"
    assert "SHA-256 unknown" in large.plain() and "not imported" in large.plain() and not large.as_json()["imported"]


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    folder = tmp_path / "served"
    folder.mkdir()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args, directory=str(folder))

        def log_message(self, *args: Any) -> None:
            pass

        def do_GET(self) -> None:
            if self.path == "/short.pth":
                self.send_response(200)
                self.send_header("Content-Length", "100000")
                self.end_headers()
                self.wfile.write(b"PK only this")
            else:
                super().do_GET()

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as serving:
        thread = threading.Thread(target=serving.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{serving.server_port}"
        serving.shutdown()
        thread.join()


def test_official_files_are_fetched_checked_and_imported(tmp_path: Path, server: str) -> None:
    cache = tmp_path / "cache"
    path = saved(tmp_path / "served" / "a.pth", as_mmcv(weights()))
    (tmp_path / "served" / "page.pth").write_text("<!doctype html>")

    def file(name: str, **known: Any) -> PublishedWeights:
        made = PublishedFile(name, url=f"{server}/{name}", page=f"{server}/page", **known)
        return PublishedWeights("small", (made,), "free")

    found = fetch_checkpoint(file("a.pth", sha256=file_sha256(path), size_bytes=path.stat().st_size), cache)
    assert found.provenance.source == "a.pth" and found.provenance.source_sha256 == file_sha256(path)
    for wrong, says in (
        (file("a.pth", sha256="0" * 64), "its SHA-256 differs"),
        (file("a.pth", size_bytes=3), "instead of 3"),
        (file("absent.pth"), "cannot fetch .*[Nn]ot found.*with a browser"),
        (file("short.pth"), "broke off after 12 of 100000 bytes"),
        (file("page.pth"), "is a web page"),
        (
            PublishedWeights(
                "small", (PublishedFile("a.pth", url="http://127.0.0.1:1/a.pth", page="https://page"),), ""
            ),
            r"cannot fetch .* get a\.pth from https://page",
        ),
    ):
        with pytest.raises(InputError, match=says):
            fetch_checkpoint(wrong, cache)
    assert [entry.name for entry in cache.glob("[!.]*")] == [found.path.name]


def test_what_was_fetched_before_a_download_broke_off_is_not_fetched_again(tmp_path: Path, server: str) -> None:
    cache, fetching = tmp_path / "cache", tmp_path / "cache" / ".fetching-small"
    path = saved(tmp_path / "served" / "a.pth", as_mmcv(weights()))
    (tmp_path / "served" / "beside.bin").write_bytes(b"companion")

    def with_companion(*names: str) -> PublishedWeights:
        files = (PublishedFile(name, url=f"{server}/{name}", page=f"{server}/page") for name in names)
        return PublishedWeights("small", tuple(files), "free")

    with pytest.raises(InputError, match="broke off after 12 of 100000 bytes"):
        fetch_checkpoint(with_companion("a.pth", "short.pth"), cache)
    assert (fetching / "a.pth").read_bytes() == path.read_bytes() and not (fetching / "short.pth").exists()
    path.unlink()
    assert fetch_checkpoint(with_companion("a.pth", "beside.bin"), cache).path.is_file() and not fetching.exists()


@pytest.mark.parametrize("name", [entry.name for entry in CHECKPOINTS])
def test_every_official_file_is_for_a_model_that_exists(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    assert name in published_models()
