"""Roots whose key frames are not half a second apart, as copies of the embedded town's with edited tables."""

from pathlib import Path

import pytest

from tests.benchmark.cli.cli_runs import refusal, run_main
from tests.benchmark.edited_roots import copy_of, small_town
from tests.benchmark.irregular_time import at_rate, without_sample

EVAL = ("eval", "--split", "val", "--model", "constant-velocity", "--workers", "1")


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("town") / "root")


def test_a_missing_key_frame_is_named_by_the_check_the_command_and_the_table(town: Path, tmp_path: Path) -> None:
    root = copy_of(town, tmp_path / "root")
    without_sample(root, "scene-8000", 20)
    check = run_main("data", "check", root)
    assert check.code == 0, check.out
    assert "keyframes 19 and 20 of scene-8000 are 1 s apart" in check.out + check.err
    run = run_main(*EVAL, "--data", root, "--out", tmp_path / "out")
    assert run.code == 0
    warnings = [line for line in run.err.splitlines() if line.startswith("warning:")]
    assert len(warnings) == 1 and "6 samples of 1 scene have key frames ahead" in warnings[0]
    assert "constant-velocity ¶" in run.out
    table = run_main("rescore", "--data", root, "--out", tmp_path / "out")
    assert table.code == 0


def test_another_rate_is_evaluated_and_not_driven(town: Path, tmp_path: Path) -> None:
    root = copy_of(town, tmp_path / "root")
    at_rate(root, 0.2)
    out = tmp_path / "out"
    run = run_main(*EVAL, "--data", root, "--out", out, "--protocol", "exact", "--protocol", "vad", "--json")
    assert run.code == 0, run.err
    assert "the key frames of 1 scene are 0.1 s apart, not 0.5 s" in run.err
    said = refusal("drive", "--split", "val", "--model", "stop", "--data", root, "--out", out, "--workers", "1")
    assert "key frames of scene-8000 are 0.1 s apart (median), and a drive needs one every 0.5 s" in said
