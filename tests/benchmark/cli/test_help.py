"""Help: summaries of commands are whole sentences, at 80 columns and uncut; the help of each fits a screen."""

from collections.abc import Iterator
from typing import Any, get_args

import pytest
import typer
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.cli.help import CommandPanel, FullSummaryGroup, first_paragraph
from benchmark.cli.settings import add_command
from tests.benchmark.cli.in_process import run_here


def commands(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command and group with the words that lead to it."""
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*path, name))


COMMANDS = list(commands(typer.main.get_command(app)))
GROUPS = [(path, command) for path, command in COMMANDS if hasattr(command, "commands")]


@pytest.mark.parametrize(("path", "group"), GROUPS, ids=["-".join(path) or "top" for path, _ in GROUPS])
def test_summaries_are_whole_sentences(path: tuple[str, ...], group: Any) -> None:
    said = CliRunner().invoke(app, [*path, "--help"], terminal_width=80, color=False).stdout
    assert all(len(line) <= 80 for line in said.splitlines())
    listed = " ".join(said[said.index("Commands:" if path else "Run:") :].split())
    assert "..." not in listed
    for name, command in group.commands.items():
        sentence = first_paragraph(command.help or "")
        assert sentence.endswith(".") and sentence[0].isupper() and len(sentence.split()) > 3, name
        assert f"{name} {sentence}" in listed


@pytest.mark.parametrize("path", [path for path, _ in COMMANDS], ids=["-".join(path) or "top" for path, _ in COMMANDS])
def test_help_fits_sixty_lines_of_a_hundred_columns(path: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    lines = run_here(*path, "--help").out.splitlines()
    assert len(lines) <= 60 and max(map(len, lines)) <= 100
    assert max(map(len, lines)) > 80 or len(lines) < 40, "help takes the room that it is given"


def panels(said: str) -> dict[str, list[str]]:
    """Names of commands by panel."""
    found: dict[str, list[str]] = {}
    for line in said.splitlines():
        if line.endswith(":") and not line.startswith(" "):
            found[line[:-1]] = []
        elif line.startswith("  ") and line[2] not in " -" and found:
            found[[*found][-1]].append(line.split()[0])
    return found


def test_commands_are_listed_in_groups() -> None:
    listed = panels(run_here("--help").out)
    assert [name for name in listed if name != "Options"] == list(get_args(CommandPanel))
    assert listed["Run"] == ["demo", "generate", "eval", "drive", "models"]
    assert {"data", "challenge"} <= {*listed["Data"]} and {"leaderboard", "film"} <= {*listed["Results"]}


def test_a_command_of_another_package_that_names_no_group_is_advanced() -> None:
    other = typer.Typer(cls=FullSummaryGroup, rich_markup_mode=None)

    @other.command(rich_help_panel="Run")
    def walk() -> None:
        """Walk on."""

    def hop() -> None:
        """Hop on."""

    add_command(other, "hop", hop)
    said = CliRunner().invoke(other, ["--help"]).stdout
    assert {name: panels(said)[name] for name in ("Run", "Advanced")} == {"Run": ["walk"], "Advanced": ["hop"]}


def options(command: Any) -> Iterator[Any]:
    yield from command.params
    for inner in getattr(command, "commands", {}).values():
        yield from options(inner)


def test_every_option_says_what_it_is_for() -> None:
    for option in options(typer.main.get_command(app)):
        text = option.help or ""
        assert text.endswith(".") and text[0] != " ", option.name


def test_the_same_option_means_the_same_everywhere() -> None:
    for name in ("limit", "seed", "json_output", "dry_run", "wide"):
        found = {option.help for option in options(typer.main.get_command(app)) if option.name == name}
        assert len(found) == 1, name
