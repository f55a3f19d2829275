"""Official weights and native models through the command line; random weights stand in for the official ones."""

from pathlib import Path

import pytest
import torch

from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from tests.benchmark.cli.cli_runs import run_main


@pytest.fixture(scope="module")
def official(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("official") / "VAD_tiny.pth"
    torch.save({"meta": {"epoch": 60}, "state_dict": VAD(VADConfig.tiny()).state_dict(), "optimizer": {}}, path)
    return path


def test_weights_are_listed_imported_and_then_known(official: Path, tmp_path: Path) -> None:
    before = run_main("weights", "list", "--json", cache=tmp_path)
    assert before.code == 0, before
    assert {entry["model"] for entry in before.json} >= {"vad-tiny", "vad-base"}
    assert not any(entry["imported"] for entry in before.json)
    run = run_main("weights", "import", official, "--json", cache=tmp_path)
    assert run.code == 0, run
    assert (run.json["model"], run.json["normalisation"]) == ("vad-tiny", "bgr-mean")
    after = run_main("weights", "list", "--json", cache=tmp_path).json
    assert [entry["model"] for entry in after if entry["imported"]] == ["vad-tiny"]


def test_bad_weights_and_options_are_one_sentence_and_exit_code_2(official: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.pth"
    broken.write_bytes(official.read_bytes()[:100_000])
    for arguments in (
        ("weights", "import", broken),
        ("weights", "import", tmp_path / "nowhere.pth"),
        ("weights", "import", official, "--model", "vad-base"),
        ("weights", "fetch", "no-such-model"),
    ):
        run = run_main(*arguments, cache=tmp_path / "cache")
        assert run.code == 2, run
        assert run.out == ""
        assert run.err.startswith("error: ") and run.err.count("\n") == 1, run.err
