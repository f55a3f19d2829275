"""Arguments that nobody means: one sentence in one line that can be read, exit code 2."""

import os
import re
from pathlib import Path

import pytest

from tests.benchmark.cli.cli_runs import run_main


def said(*arguments: str) -> str:
    run = run_main(*arguments)
    assert run.code == 2 and run.err.startswith("error: ") and run.err.count("\n") == 1, run
    assert run.err[:-1].isprintable() and len(run.err) < 1100
    return run.err


@pytest.mark.parametrize("value", ["9" * 400, "x" * 5000])
def test_names_that_no_file_system_has(value: str, tmp_path: Path) -> None:
    for given in (("data", "check", str(tmp_path / value)), ("transfer", "--out", str(tmp_path / value))):
        assert "File name too long; choose another path" in said(*given)
    assert not list(tmp_path.iterdir())


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    text = said("data", "check", f"{tmp_path}/\udcff")
    assert r"\udcff is not UTF-8 text" in text
    # Text of any script is text.
    assert "is not UTF-8 text" not in said("data", "check", f"{tmp_path}/данные-資料")


@pytest.mark.parametrize("name", ["two\nlines", "red\x1b[31m", "right\u202eleft"])
def test_what_a_terminal_would_obey_is_spelt_out(name: str, tmp_path: Path) -> None:
    assert name not in said("data", "check", str(tmp_path / name))


def test_the_debug_option_shows_where_it_came_from(tmp_path: Path) -> None:
    run = run_main("--debug", "data", "check", str(tmp_path / ("x" * 300)))
    assert run.code == 2 and run.err.startswith("Traceback") and "OSError" in run.err
    assert run.err.splitlines()[-1].startswith("error: cannot use")


def test_the_timings_option_ends_any_command_with_its_seconds(tmp_path: Path) -> None:
    run = run_main("data", "check", str(tmp_path / "none"), "--timings")
    assert run.code == 2 and run.err.startswith("error: ")
    seconds = r"[\d.]+ s on the clock, [\d.]+ s of CPU, [\d.]+ s of them in workers and other processes"
    assert re.fullmatch(seconds, run.err.splitlines()[-1])


def test_links_that_lead_in_a_circle_pipes_and_numbers_beyond_machines(tmp_path: Path) -> None:
    loop, pipe, huge = tmp_path / "loop", tmp_path / "pipe", "9" * 400
    loop.symlink_to("loop")
    os.mkfifo(pipe)
    assert "loop; choose another path" in said("doctor", "--out", str(loop))
    generate = ("generate", "--out", str(tmp_path / "out"), "--dry-run")
    assert "a pipe or a device; name a file" in said(*generate, "--freeze", str(pipe))
    assert "at most 10,000" in said(*generate, "--workers", huge)
