"""The commands of the page on own recordings, in their order, on the root of its script."""

import shlex
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.benchmark.cli.cli_runs import Run, run_main
from tests.benchmark.extensions.own_recordings.made_root import ROOT, SCRIPT
from tests.documentation.lines_of_code import typed_lines

PAGE = ROOT / "docs" / "how-to" / "own-data.md"
QUICKLY = {"generate": ("--limit", "1", "--workers", "1"), "eval": ("--workers", "1"), "drive": ("--workers", "1")}


def test_the_script_is_short() -> None:
    assert len(SCRIPT.read_text().splitlines()) <= 80
    assert "nuscenes" not in [
        line.split()[1].split(".")[0] for line in SCRIPT.read_text().splitlines() if "import" in line
    ]


@pytest.fixture
def commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The page's commands on the root, which its first line has made."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    lines = [shlex.split(line.text, comments=True) for line in typed_lines(PAGE)]
    script, *rest = (words for words in lines if words[:1] == ["python"] or "mine" in words)
    assert script == ["python", "examples/own_recordings/make_root.py", "mine"]
    subprocess.run([sys.executable, *script[1:]], check=True)
    return rest


def run_all(commands: Iterable[list[str]]) -> dict[str, Run]:
    """What commands said, by their names; the last of each."""
    said = {}
    for program, *words in commands:
        run = run_main(*words, *QUICKLY.get(words[0], ()))
        assert (program, run.code) == ("challenger-bench", 0), (words, run.err)
        said[" ".join(words[:2] if words[0] == "data" else words[:1])] = run
    return said


@pytest.mark.path
def test_the_first_commands_of_the_page_end_in_a_table(commands: list[list[str]]) -> None:
    said = run_all(words for words in commands if words[1:3] == ["data", "check"] or words[-2:] == ["--split", "val"])
    assert said["data check"].out.startswith("0 errors, 0 warnings")
    assert all(name in said["eval"].out for name in ("constant-velocity", "uniad-mini"))


@pytest.mark.slow
def test_all_commands_of_the_page_as_they_stand(commands: list[list[str]], tmp_path: Path) -> None:
    said = run_all(commands)
    assert [*said] == ["data check", "data show", "data stats", "eval", "generate", "drive", "sheets", "film"]
    assert len([*(tmp_path / "look").iterdir()]) == 2
    records = sorted(path.parent.name for path in tmp_path.glob("challenger-out/runs/mine/*/*/run.json"))
    assert records == ["constant-velocity", "constant-velocity", "idm", "idm", "uniad-mini"]
    assert len([*tmp_path.glob("films/*/*.png")]) > 100
