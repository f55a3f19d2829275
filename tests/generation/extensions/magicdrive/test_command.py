"""Photorealistic rendering through the command line."""

from pathlib import Path

from tests.benchmark.cli.cli_runs import challenger_bench
from tests.benchmark.cli.small_path import small_town


def test_photorealistic_rendering_says_what_it_costs_and_what_is_missing(tmp_path: Path) -> None:
    town = small_town(tmp_path / "small")
    common = ("--data", town, "--split", "val-r", "--renderer", "magicdrive", "--out", tmp_path, "--workers", "1")
    on_gpu = ("--render-device", "cuda", "--tflops", "400", "--dry-run")
    said = challenger_bench("generate", *common, *on_gpu, cache=tmp_path)
    assert said.code == 0 and "a GPU at 400 TFLOP/s" in said.err and "transformer" in said.err
    missing = challenger_bench("generate", *common, cache=tmp_path)
    assert missing.code == 2 and "no weights magicdrive-dit found" in missing.err and missing.err.count("\n") == 1
