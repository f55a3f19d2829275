"""Extensions that are not there, and those of other packages that are broken."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer

from benchmark.cli import app as extensions
from benchmark.cli.app import OfferedCommands, add_commands_of_others

ROOT = Path(__file__).resolve().parents[3]
WITHOUT = """
import sys

package = sys.argv.pop(1)

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name == package or name.startswith(package + "."):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
from benchmark.cli.app import main
main()
"""


def run_without(package: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, package, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_command_of_an_extension_that_is_not_there_says_so_whatever_its_arguments() -> None:
    asked = run_without("benchmark.extensions.cards", "data", "card", "--some", "thing")
    assert asked.returncode == 2, asked.stderr
    (line,) = asked.stderr.splitlines()
    assert line.startswith("error: data card belongs to the extension cards, which is not installed here; ")


def test_a_command_of_the_core_that_asks_for_an_extension_says_which(tmp_path: Path) -> None:
    for package, name, arguments in (
        ("benchmark.extensions.golden_sets", "golden_sets", ("verify", "protocols")),
        ("leaderboard.extensions.publishing", "publishing", ("leaderboard", "--publish-check", str(tmp_path))),
    ):
        done = run_without(package, *arguments)
        assert done.returncode == 2, done.stderr
        assert done.stderr.splitlines()[-1] == (
            f"error: this needs the extension {name}, which is not installed; install it"
        )


@dataclass
class Entry:
    """An entry point of another package."""

    name: str
    loaded: OfferedCommands | None

    def load(self) -> OfferedCommands:
        if self.loaded is None:
            raise ImportError("no such\nmodule")
        return self.loaded


def test_a_broken_extension_of_another_package_costs_its_own_commands_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sound = Entry("sound", {"theirs": lambda: None, "data more": typer.Typer()})
    found = {extensions.ENTRY_POINTS: [Entry("broken", None), sound]}
    monkeypatch.setattr(extensions, "entry_points", lambda group: found[group])
    app, data = typer.Typer(), typer.Typer()
    add_commands_of_others({"": app, "data": data})
    assert [command.name for command in app.registered_commands] == ["theirs"]
    assert [group.name for group in data.registered_groups] == ["more"]
    said = capsys.readouterr().err
    assert said.startswith("warning: the extension broken adds no commands: no such") and said.count("\n") == 1
