"""Commands of extensions: our own by one table, those of other packages by an entry point.

``cli.py`` of an extension has ``add_commands(groups)``. An extension that is not there leaves commands behind that say
so; one of another package that is broken costs its own commands alone.
"""

import importlib
import sys
from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Final, NoReturn

import typer

from benchmark.errors import InputError
from benchmark.machine.extension import absent_extension
from benchmark.untrusted.files import one_line

Groups = Mapping[str, typer.Typer]
"""Groups of commands by name: the top one is ``""``, then ``data``, ``data export`` and ``leaderboard``."""
OWN: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "cards": ("benchmark.extensions.cards", ("data card", "leaderboard card")),
    "challenge": ("benchmark.extensions.challenge", ("challenge",)),
    "exchange": ("benchmark.extensions.exchange", ("data export scenarionet", "data export openscenario")),
    "films": ("leaderboard.extensions.films", ("film",)),
    "http": ("benchmark.extensions.http", ("serve",)),
    "infos": ("benchmark.extensions.infos", ("data export infos",)),
    "quality": ("benchmark.extensions.quality", ("quality",)),
    "reproduce": ("benchmark.extensions.reproduce", ("reproduce",)),
    "review": ("benchmark.extensions.review", ("data review",)),
    "submissions": ("benchmark.extensions.submissions", ("leaderboard submit-check",)),
    "training": ("adapters.extensions.training", ("train",)),
}
"""Of each extension that has commands: its package, and what it adds."""
ENTRY_POINTS: Final = "challenger_bench.extensions"
"""Group in which other packages name a function that takes `Groups`."""


def add_own_commands(name: str, groups: Groups) -> None:
    """Add the commands of one of our extensions, or commands that say that it is not there.

    Args:
        name: Of the extension.
        groups: Where its commands go.
    """
    package, commands = OWN[name]
    try:
        module = importlib.import_module(f"{package}.cli")
    except ModuleNotFoundError as error:
        if absent_extension(error) is None:
            raise
        for command in commands:
            _add_absent(name, command, groups)
        return
    module.add_commands(groups)


def add_commands_of_others(groups: Groups) -> None:
    """Add the commands of other packages; one that fails is named on standard error.

    Args:
        groups: Where its commands go.
    """
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            entry.load()(groups)
        except Exception as error:
            print(f"warning: the extension {entry.name} adds no commands: {one_line(error)}", file=sys.stderr)


def _add_absent(name: str, command: str, groups: Groups) -> None:
    group, _, last = command.rpartition(" ")
    sentence = f"{command} belongs to the extension {name}, which is not installed here; install it to use the command"

    def say() -> NoReturn:
        raise InputError(sentence)

    anything = {"allow_extra_args": True, "ignore_unknown_options": True}
    groups[group].command(last, help=f"Not installed: extension {name}.", context_settings=anything)(say)
