"""A day with a GPU, tried on a processor: pieces measure, are kept, skipped, ended, gone on with, and listed."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bench.gpu import PIECES, main
from bench.gpu_day import networks, pieces, training
from bench.gpu_day.pieces import Setting, cached_outcome, cached_path, find_piece, markdown, run_piece
from tests.bench.made_up_pieces import BREAKS, COUNT, LONG, WHOLE
from tests.generation.extensions.denoiser_training.test_loop import tracks as made_up_tracks

TRIAL = ("--device", "cpu", "--tiny", "--folder")
tracks = made_up_tracks


def trial(folder: Path) -> Setting:
    return Setting(folder, "cpu", tiny=True)


def test_pieces_are_run_once_and_what_failed_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    two, setting = (COUNT, BREAKS), trial(tmp_path)
    assert main([*TRIAL, str(tmp_path)], two) == 1
    assert "count: counted 3" in (said := capsys.readouterr().out) and "breaks: failed: ValueError: no memory (" in said
    kept = json.loads(cached_path(setting, COUNT).read_text())
    assert kept["machine"].keys() >= {"card", "driver", "torch", "commit", "processor", "device", "tiny"}
    before = cached_path(setting, COUNT).stat().st_mtime_ns
    assert main([*TRIAL, str(tmp_path)], two) == 1
    assert "counted" not in capsys.readouterr().out and cached_path(setting, COUNT).stat().st_mtime_ns == before
    assert main([*TRIAL, str(tmp_path), "--list"], two) == 0
    assert capsys.readouterr().out.splitlines()[0].endswith("done: counted 3, no GPU")
    cached_path(setting, COUNT).write_text("{")
    assert cached_outcome(setting, COUNT) is None
    assert "| count | not run | | | |" in markdown(setting, two)


def test_a_piece_that_takes_too_long_is_ended_and_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    setting = trial(tmp_path)
    outcome = run_piece(setting, LONG, 0.5)
    assert outcome.unfinished and not outcome.finished and outcome.figures == {"step": 7}
    assert "unfinished: step 7 |" in markdown(setting, (LONG,))
    assert run_piece(setting, WHOLE, 0.5).failure == "ended after 0 s" and cached_outcome(setting, WHOLE) is None
    monkeypatch.setattr(pieces, "PIECE_LIMIT_S", 0.5)
    run_piece(setting, WHOLE, 0.5)
    kept = cached_outcome(setting, WHOLE)
    assert kept is not None and not kept[0].finished


def test_a_day_that_is_killed_leaves_no_piece_on_the_card(tmp_path: Path) -> None:
    day = (
        "import sys; from pathlib import Path; from bench.gpu_day.pieces import Setting, run_piece;"
        "from tests.bench.made_up_pieces import WHOLE; run_piece(Setting(Path(sys.argv[1]), 'cpu'), WHOLE)"
    )
    running = subprocess.Popen([sys.executable, "-c", day, str(tmp_path)])
    while not (tmp_path / "process.json").exists():
        assert running.poll() is None
        time.sleep(0.1)
    running.kill()
    running.wait()
    piece = Path("/proc", (tmp_path / "process.json").read_text().strip())
    # Nobody may be there to wait for it, so that it stays as a name.
    for _ in range(600):
        if not piece.exists() or " Z " in (piece / "stat").read_text():
            return
        time.sleep(0.1)
    pytest.fail("the piece runs on")


def test_a_network_is_timed_and_agrees_with_itself(tmp_path: Path) -> None:
    setting = trial(tmp_path)
    piece = find_piece(PIECES, "vad-tiny-bfloat16")
    figures = piece.work(setting)
    assert figures["frames_per_s"] > 0 and "random weights" in piece.said(figures)
    piece = find_piece(PIECES, "sparsedrive-agreement")
    figures = piece.work(setting)
    assert figures["plan_m"] == 0.0 and figures["frames"] == networks.COMPARED_FRAMES
    assert "against the processor" in piece.said(figures)


@pytest.mark.slow
def test_the_photorealistic_network_is_timed(tmp_path: Path) -> None:
    for piece in (find_piece(PIECES, f"magicdrive-{mode}-224x400") for mode in ("kept", "decoder")):
        figures = piece.work(trial(tmp_path))
        assert figures["scene_s"] > 0 and figures["frames"] == 9 and "random weights" in piece.said(figures)


@pytest.mark.slow
def test_the_prior_is_timed_and_trained_to_the_end(tracks: Path, tmp_path: Path) -> None:
    setting = Setting(tmp_path / "gpu", "cpu", tiny=True, tracks=tracks)
    assert training.read_prior_progress(setting)["step"] == 0
    timed = training.prior_speed(setting)
    assert timed["tracks"] == "given" and timed.get("step_ms", 1.0) > 0 and timed["parameters"] > 1000
    for known, says in (({"step_ms": 5.0, "whole_s": 90.0}, "5.0 ms a step (of 2 steps)"), ({}, "too few steps")):
        unknown = {name: value for name, value in timed.items() if name not in ("step_ms", "whole_s")}
        assert says in training.describe_timing(unknown | known)
    done = training.finish_prior(setting)
    assert (done["step"], done["of"]) == (4, 4) and "4 of 4 steps" in training.describe_training(done)
    assert sorted(path.name for path in setting.kept.iterdir()) == ["prior.log.jsonl", "prior.safetensors"]


@pytest.mark.slow
def test_a_miniature_is_timed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    figures = training.miniature_speed(trial(tmp_path))
    assert figures.get("whole_s", 1.0) > 0 and figures["steps"] > 100 and figures["timed_steps"] == 2
