"""Arguments that nobody means: one sentence in one line that can be read, exit code 2."""

import os
import sys
from pathlib import Path

import pytest

from benchmark.cli.app import main


def said(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> str:
    monkeypatch.setattr(sys, "argv", ["challenger-bench", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    text = capsys.readouterr().err
    assert ended.value.code == 2 and text.startswith("error: ") and text.count("\n") == 1, text
    assert text[:-1].isprintable() and len(text) < 1100
    return text


@pytest.mark.parametrize("value", ["9" * 400, "x" * 5000])
def test_names_that_no_file_system_has(
    value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for given in (("data", "check", str(tmp_path / value)), ("transfer", "--out", str(tmp_path / value))):
        assert "File name too long; choose another path" in said(capsys, monkeypatch, *given)
    assert not list(tmp_path.iterdir())


def test_bytes_that_are_no_text(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = said(capsys, monkeypatch, "data", "check", f"{tmp_path}/\udcff")
    assert r"\udcff is not UTF-8 text" in text
    # Text of any script is text.
    assert "is not UTF-8 text" not in said(capsys, monkeypatch, "data", "check", f"{tmp_path}/данные-資料")


@pytest.mark.parametrize("name", ["two\nlines", "red\x1b[31m", "right\u202eleft"])
def test_what_a_terminal_would_obey_is_spelt_out(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert name not in said(capsys, monkeypatch, "data", "check", str(tmp_path / name))


def test_the_debug_option_shows_where_it_came_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["challenger-bench", "--debug", "data", "check", str(tmp_path / ("x" * 300))])
    with pytest.raises(OSError, match="too long"):
        main()


def test_links_that_lead_in_a_circle_pipes_and_numbers_beyond_machines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, pipe, huge = tmp_path / "loop", tmp_path / "pipe", "9" * 400
    loop.symlink_to("loop")
    os.mkfifo(pipe)
    assert "loop; choose another path" in said(capsys, monkeypatch, "doctor", "--out", str(loop))
    generate = ("generate", "--out", str(tmp_path / "out"), "--dry-run")
    assert "a pipe or a device; name a file" in said(capsys, monkeypatch, *generate, "--freeze", str(pipe))
    assert "at most 10,000" in said(capsys, monkeypatch, *generate, "--workers", huge)
