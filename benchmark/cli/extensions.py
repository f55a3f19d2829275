"""Commands of extensions: our own from the table of offers, those of other packages by an entry point.

A command whose extension is not there says so; one of another package that is broken costs its own commands alone.
"""

import sys
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from typing import Any, Final, NoReturn

import typer

from benchmark.cli.settings import add_command
from benchmark.errors import InputError
from benchmark.machine.extension import OFFERS, AbsentExtensionError, extension_of, from_extension
from benchmark.untrusted.files import one_line

Groups = Mapping[str, typer.Typer]
"""Groups of commands by name: the top one is ``""``, then ``data``, ``data export`` and ``leaderboard``."""
Offered = Mapping[str, typer.Typer | Callable[..., Any]]
"""Commands by the words that they are called with: an application, or a function that one makes a command of."""
ENTRY_POINTS: Final = "challenger_bench.extensions"
"""Group in which other packages name an `Offered`."""


def add_command_of_extension(words: str, groups: Groups) -> None:
    """Add a command of one of our extensions, or one that says that the extension is absent.

    ``words`` are as the table of offers has them, ``data card``.
    """
    try:
        _add(words, from_extension("command", words), groups)
    except AbsentExtensionError:
        _add_absent(words, extension_of(OFFERS["command"][words]), groups)


def add_commands_of_others(groups: Groups) -> None:
    """Add the commands of other packages; one that fails is named on standard error."""
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            offered: Offered = entry.load()
            for words, command in offered.items():
                _add(words, command, groups)
        except Exception as error:
            print(f"warning: the extension {entry.name} adds no commands: {one_line(error)}", file=sys.stderr)


def _add(words: str, command: typer.Typer | Callable[..., Any], groups: Groups) -> None:
    group, _, last = words.rpartition(" ")
    if isinstance(command, typer.Typer):
        groups[group].add_typer(command, name=last)
    else:
        add_command(groups[group], last, command)


def _add_absent(words: str, name: str, groups: Groups) -> None:
    group, _, last = words.rpartition(" ")
    sentence = f"{words} belongs to the extension {name}, which is not installed here; install it to use the command"

    def say() -> NoReturn:
        raise InputError(sentence)

    anything = {"allow_extra_args": True, "ignore_unknown_options": True}
    groups[group].command(last, help=f"Not installed: extension {name}.", context_settings=anything)(say)
