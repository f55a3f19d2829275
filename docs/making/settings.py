"""Tables of ``docs/settings.md``: the settings of commands that help does not list.

``python docs/making/settings.py`` writes them anew.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from benchmark.cli.app import app
from benchmark.cli.settings import list_rare_settings

PAGE = Path(__file__).resolve().parents[1] / "settings.md"
MARK = "<!-- What follows is made by docs/making/settings.py. -->\n"


def with_tables(text: str) -> str:
    """The page with its tables as the commands have them now."""
    head = text.partition(MARK)[0]
    return head + MARK + "\n".join(line for name, command in _commands() for line in _table(name, command))


def _commands(command: Any = None, path: str = "") -> Iterator[tuple[str, Any]]:
    """Commands with rare settings, by the words that lead to them."""
    found = typer.main.get_command(app) if command is None else command
    if list_rare_settings(getattr(found.callback, "settings", object)):
        yield path, found
    for name, inner in getattr(found, "commands", {}).items():
        yield from _commands(inner, f"{path} {name}".strip())


def _table(name: str, command: Any) -> Iterator[str]:
    """Heading and table of one command."""
    yield from ("", f"## {name}", "", "| name | option | what it means |", "|---|---|---|")
    context = command.make_context(name, [], resilient_parsing=True)
    for each in command.params:
        if each.hidden:
            each.hidden = False
            option, text = each.get_help_record(context)
            each.hidden = True
            cells = (each.name, " ".join(option.split()), " ".join(text.split()))
            yield "| `{}` | `{}` | {} |".format(*(cell.replace("|", "\\|") for cell in cells))
    yield ""


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text()))
