"""The commands of the page on own recordings, in their order, on the root of its script."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmark.cli.cli_runs import run_main
from tests.benchmark.extensions.own_recordings.made_root import ROOT, SCRIPT
from tests.documentation.lines_of_code import typed_lines

PAGE = ROOT / "docs" / "how-to" / "own-data.md"
QUICKLY = {"generate": ("--limit", "1", "--workers", "1"), "eval": ("--workers", "1"), "drive": ("--workers", "1")}


def test_the_script_is_short() -> None:
    assert len(SCRIPT.read_text().splitlines()) <= 80
    assert "nuscenes" not in [
        line.split()[1].split(".")[0] for line in SCRIPT.read_text().splitlines() if "import" in line
    ]


def test_from_the_script_to_the_first_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    lines = [shlex.split(line.text, comments=True) for line in typed_lines(PAGE)]
    script, *commands = (words for words in lines if words[:1] == ["python"] or "mine" in words)
    assert script == ["python", "examples/own_recordings/make_root.py", "mine"]
    subprocess.run([sys.executable, *script[1:]], check=True, env=os.environ)
    said = {}
    for words in commands:
        assert words[0] == "challenger-bench"
        run = run_main(*words[1:], *QUICKLY.get(words[1], ()))
        assert run.code == 0, (words, run.err)
        said.setdefault(" ".join(words[1:3]), run)
    assert said["data check"].out.startswith("0 errors, 0 warnings")
    assert len([*(tmp_path / "look").iterdir()]) == 2
    records = sorted(path.parent.name for path in tmp_path.glob("challenger-out/runs/mine/*/*/run.json"))
    assert records == ["constant-velocity", "constant-velocity", "idm", "idm", "uniad-mini"]
    assert len([*tmp_path.glob("films/*/*.png")]) > 100
