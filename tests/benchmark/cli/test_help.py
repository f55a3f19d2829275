"""Help: summaries of commands are whole sentences, at 80 columns and uncut."""

from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.cli.help import first_paragraph


def groups(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every group of commands with the words that lead to it."""
    if hasattr(command, "commands"):
        yield path, command
        for name, inner in command.commands.items():
            yield from groups(inner, (*path, name))


GROUPS = list(groups(typer.main.get_command(app)))


@pytest.mark.parametrize(("path", "group"), GROUPS, ids=["-".join(path) or "top" for path, _ in GROUPS])
def test_summaries_are_whole_sentences(path: tuple[str, ...], group: Any) -> None:
    said = CliRunner().invoke(app, [*path, "--help"], terminal_width=80, color=False).stdout
    assert all(len(line) <= 80 for line in said.splitlines())
    listed = " ".join(said[said.index("Commands:") :].split())
    assert "..." not in listed
    for name, command in group.commands.items():
        sentence = first_paragraph(command.help or "")
        assert sentence.endswith(".") and sentence[0].isupper() and len(sentence.split()) > 3, name
        assert f"{name} {sentence}" in listed


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
