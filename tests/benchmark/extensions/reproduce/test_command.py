"""``reproduce`` from end to end: a miniature gives the values that are stored of it, with other weights it does not."""

import json
from pathlib import Path
from typing import Any

import pytest
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from adapters.models import MODELS
from benchmark.records.reproduction import find_reproductions
from tests.benchmark.cli.in_process import Done, run_here
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

MODEL = "vad-mini"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root") / "recordings"
    write_root(root, [short_scene("scene-0003", seconds=4.5)])
    return root


@pytest.fixture(scope="module")
def stored(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Done]:
    """A first run, whose numbers are stored: out folder, file, and what it printed."""
    out = tmp_path_factory.mktemp("first")
    file, wrong = out / "values.json", out / "of-another-run.json"
    values = {"collision": {"1s": 0.0}, "l2": {"1s": 900.0, "2s": 0.1}}
    first = {"model": MODEL, "protocol": "vad", "split": "val", "source": "nobody", "samples": 3}
    wrong.write_text(json.dumps({**first, "values": values, "allowed": {"collision": 1.0, "l2": 0.02}}))
    return out, file, run_here(*_call(root, out), "--expected", wrong, "--store", file)


def _call(root: Path, out: Path) -> tuple[Any, ...]:
    return ("reproduce", "--model", MODEL, "--data", root, "--out", out)


def test_values_of_another_run_are_not_reproduced(stored: tuple[Path, Path, Done]) -> None:
    _, _, done = stored
    assert done.code == 1
    assert "Verdict: not reproduced" in done.out and "FAIL" in done.out and "1: nobody." in done.out


def test_values_that_were_stored_are_reproduced_and_mark_later_runs(
    root: Path, stored: tuple[Path, Path, Done], tmp_path: Path
) -> None:
    out, file, _ = stored
    done = run_here(*_call(root, out), "--expected", file)
    assert done.code == 0, done.err
    assert "Verdict: reproduced." in done.out and "FAIL" not in done.out
    (found,) = find_reproductions([out / "runs"])
    assert found.planner.settings["as_published"] == "can-after" and found.reproduced
    same = run_here("eval", "--model", MODEL, "--as-published", "all", "--data", root, "--out", out)
    assert "vad-mini (as_published" not in same.out and "§ ✓" in same.out
    assert "the same weights, code and options gave a run of vad-mini" in " ".join(same.out.split())
    other = run_here("eval", "--model", MODEL, "--data", root, "--out", out)
    assert "✓" not in other.out, "without the options of the run it is another version"
    board = run_here("leaderboard", "--out", out, "--to", tmp_path / "board")
    assert board.code == 0
    pages = [path.read_text() for path in (tmp_path / "board").rglob("*.md")]
    assert any("✓" in page for page in pages)


def test_other_weights_are_caught(root: Path, stored: tuple[Path, Path, Done], tmp_path: Path) -> None:
    _, file, _ = stored
    packaged = MODELS[MODEL].packaged
    tensors = load_file(packaged)
    name = next(name for name in tensors if name.endswith("ego_fut_decoder.4.bias"))
    tensors[name] = tensors[name] + 0.1
    other = tmp_path / "other.safetensors"
    with safe_open(packaged, "pt") as opened:
        save_file(tensors, other, opened.metadata())
    done = run_here(*_call(root, tmp_path), "--expected", file, "--checkpoint", other, "--json")
    said = json.loads(done.out)
    assert done.code == 1 and said["reproduced"] is False
    assert [number["horizon"] for number in said["numbers"] if number["column"] == "l2" and not number["ok"]]


def test_a_dry_run_says_what_would_be_compared(root: Path, stored: tuple[Path, Path, Done], tmp_path: Path) -> None:
    _, file, _ = stored
    done = run_here(*_call(root, tmp_path), "--expected", file, "--dry-run")
    assert done.code == 0 and "run vad-mini on 1 scene of val with --as-published can-after" in done.out
    plain = run_here(*_call(root, tmp_path), "--expected", file, "--plain", "--dry-run")
    assert "as eval does by default" in plain.out
    assert not list(tmp_path.iterdir())
