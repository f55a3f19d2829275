"""What README and docs/ tell a reader to type, and where they send one."""

import re
import shlex
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import typer

import benchmark
from benchmark.cli.app import app
from generation.sources.mini import TownSettings
from tests.benchmark.cli.cli_runs import run_main
from tests.documentation.lines_of_code import PAGES, ROOT, typed_lines


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_on_a_page_is_one(page: Path) -> None:
    for line in (line for line in typed_lines(page) if line.text.startswith("challenger-bench ")):
        command: Any = typer.main.get_command(app)
        rest = [word for word in shlex.split(line.text)[1:] if word != "..."]
        while rest and rest[0] in getattr(command, "commands", {}):
            command = command.commands[rest.pop(0)]
        # After a group come options alone: any other word would be a command that there is not.
        assert not hasattr(command, "commands") or not rest or rest[0].startswith("-"), line.text
        # Reads the words as the command would, and does nothing.
        command.make_context("challenger-bench", rest)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_page_and_picture_that_a_page_names_is_there(page: Path) -> None:
    text = page.read_text()
    # A badge leads to the page of a workflow, beside the tree on the server.
    badge = re.compile(r"(?:\.\./){2}actions/workflows/([\w-]+\.yml)(?:/badge\.svg)?")
    named = [badge.sub(r".github/workflows/\1", name) for name in re.findall(r"\]\(([^)#:]+)\)", text)]
    assert not [name for name in named if not (page.parent / name).exists()]
    docs = re.findall(r"`(docs/[\w./-]+\.md)`", text)
    assert not [name for name in docs if not (ROOT / name).exists()]


def test_the_planner_of_the_readme_drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n# (\w+\.py)\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert [name for name, _ in blocks] == ["my_planner.py"]
    (tmp_path / "my_planner.py").write_text(blocks[0][1])
    tiny = partial(TownSettings, val_scenes=1, width=96, height=54, frames="keyframes")
    town = benchmark.build_town(tmp_path / "town", tiny(), workers=1)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    said = run_main(
        "eval", "--data", town, "--split", "val", "--model", "my_planner:MyPlanner", "--json", "--workers", "1"
    )
    assert said.code == 0, said.err
    summary = said.json[0]
    assert summary["failed"] == 0 and summary["samples"] > 0
