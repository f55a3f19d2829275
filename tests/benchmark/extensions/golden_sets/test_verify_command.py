"""`challenger-bench verify` as a user runs it: lines, exit codes, JSON."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from generation.extensions.golden_sets.built_in import BUILT_IN
from tests.benchmark.cli.cli_runs import challenger_bench


@pytest.mark.parametrize("kind", ["physics", "scoring", "protocols", "pdm", "results"])
def test_built_in_set_agrees(kind: str) -> None:
    run = challenger_bench("verify", kind)
    assert run.code == 0, run
    lines = run.out.splitlines()
    agree = sum(line.startswith("ok ") for line in lines)
    assert agree > 3 and lines[-1] == f"{agree} of {agree} quantities agree"


def test_wrong_numbers_are_exit_code_1_with_the_lines_that_are_wrong(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(BUILT_IN / "physics", tmp_path / "physics"))
    with np.load(folder / "physics.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    arrays["center_pose"][2, 10, 0] += 1.0
    np.savez_compressed(folder / "physics.npz", **arrays)
    run = challenger_bench("verify", "physics", "--golden", folder)
    assert run.code == 1, run
    failed = [line for line in run.out.splitlines() if line.startswith("FAIL")]
    assert len(failed) == 1 and "centre position (m)" in failed[0]
    as_json = challenger_bench("verify", "physics", "--golden", folder, "--json")
    assert as_json.code == 1
    assert [check["quantity"] for check in as_json.json if not check["ok"]] == ["centre position (m)"]


def test_what_is_no_golden_set_is_one_sentence_and_exit_code_2(tmp_path: Path) -> None:
    for arguments in (
        ("physics", "--golden", tmp_path / "nowhere"),
        ("scoring", "--golden", tmp_path),
        ("denoiser", "--golden", tmp_path),
        ("protocols", "--golden", tmp_path),
        ("pdm", "--golden", tmp_path),
        ("chemistry",),
        ("model",),
        ("model", "--model", "vad-tiny"),
        ("model", "--model", "no-such-model", "--golden", tmp_path),
        ("model", "--model", "vad-tiny", "--golden", tmp_path),
        ("physics", "--model", "vad-tiny"),
    ):
        run = challenger_bench("verify", *arguments)
        assert run.code == 2, run
        assert run.out == ""
        assert run.err.startswith("error: ") and run.err.count("\n") == 1, run.err
