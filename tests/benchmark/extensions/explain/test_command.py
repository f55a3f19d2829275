"""Where protocols differ, through the command line."""

from pathlib import Path

from tests.benchmark.cli.in_process import run_here
from tests.benchmark.cli.small_path import done, judged_town, small_town


def test_explaining_protocols_prints_a_table_and_draws_cases(tmp_path: Path) -> None:
    town, out = small_town(tmp_path / "small"), tmp_path / "out"
    judged_town(town, out)
    common = ("--model", "constant-velocity", "--data", town, "--split", "adv", "--out", out)
    run = done(run_here("eval", *common, "--explain-protocols", "--protocol", "vad", "--protocol", "exact"))
    pictures = list((out / "explained").rglob("*.png"))
    assert pictures
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
    assert all(text in run.out for text in ("misses", "protocol vad", "protocol exact"))
    unknown = run_here("eval", *common, "--protocol", "guess")
    assert (unknown.code, unknown.err.count("\n")) == (2, 1)
