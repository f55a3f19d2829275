"""Settings of a command, declared once: a frozen dataclass is its options and what ``--config`` may hold.

A field is ``Annotated[type, Option(...)]`` with a default, or without one where it has to be given. Values come from
the command line, ``--set NAME=VALUE``, the file of ``--config`` and the defaults; the first that has one wins.
"""

import enum
import inspect
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

import typer

from benchmark.cli.config import SAID_BY_SET, SET, taking_file, taking_settings
from benchmark.cli.fields import SETTINGS_PAGE, fields_of
from benchmark.cli.fields import Option as Option
from benchmark.cli.help import SettingsCommand
from benchmark.errors import InputError

_given: ContextVar[frozenset[str]] = ContextVar("given", default=frozenset())
S = TypeVar("S")


def command_function(settings: type[S], run: Callable[[S], None]) -> Callable[..., None]:
    """A function that typer makes a command of.

    Args:
        settings: Dataclass of the settings; ``RARE`` of it names those that help does not list,
            ``from_record(members)`` reads a record, and ``reserved()`` names what ``--set`` leaves to the command.
        run: Does the work; its docstring is the help.

    Returns:
        The function, whose parameters are the fields, ``--config`` and, where fields are rare, ``--set``.
    """

    def command(context: typer.Context, **values: Any) -> None:
        if context.invoked_subcommand is not None:
            return
        given = {name: _source(context, name) for name in values}
        for name in context.meta.get(SAID_BY_SET, ()):
            if given.get(name) == "COMMANDLINE":
                raise InputError(f"--set {name} and the option of that name say one thing twice; leave one out")
        of_fields = {
            each: tuple(map(_plain, value)) if isinstance(value, list) else value
            for each, value in values.items()
            if each in names
        }
        token = _given.set(frozenset(name for name, source in given.items() if source != "DEFAULT"))
        try:
            run(settings(**of_fields))
        finally:
            _given.reset(token)

    fields, changes = fields_of(settings), hasattr(settings, "reserved")
    names, parameters = {each.name for each in fields}, [_parameter("context", typer.Context)]
    for each in fields:
        callback = taking_settings(settings) if each.flag == SET and changes else None
        parameters.append(_parameter(each.name, *each.for_typer(callback)))
    config = Option("Settings from a YAML or JSON file, or from a record; flags win.", names="--config")
    parameters.append(_parameter("config_file", config.for_typer(Path | None, taking_file(settings)), None))
    if rare_settings(settings) and not changes:
        change = Option(f"A setting that help does not list, NAME=VALUE ({SETTINGS_PAGE}).", names=SET)
        annotation = change.for_typer(list[str] | None, taking_settings(settings))
        parameters.append(_parameter("changed_settings", annotation, None))
    vars(command).update(__signature__=inspect.Signature(parameters), settings=settings)
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    command.__doc__ = run.__doc__
    return command


def command(
    settings: type[S], app: typer.Typer | None = None, name: str = ""
) -> Callable[[Callable[[S], None]], Callable[..., None]]:
    """Make a command of a function of its settings.

    Args:
        settings: As in `command_function`.
        app: Application that gets it, if `add_command` does not add it later.
        name: What it is called there.

    Returns:
        A decorator.
    """

    def made(run: Callable[[S], None]) -> Callable[..., None]:
        function = command_function(settings, run)
        if app is not None:
            add_command(app, name, function)
        return function

    return made


def add_command(app: typer.Typer, name: str, function: Callable[..., Any]) -> None:
    """Add what `command` made, or a plain function with options of typer, to an application."""
    settings = getattr(function, "settings", None)
    epilog = None if settings is None else rare_sentence(settings)
    app.command(name, cls=SettingsCommand, epilog=epilog)(function)


def rare_settings(settings: type) -> list[str]:
    """Names of the settings that help does not list."""
    return list(getattr(settings, "RARE", ()))


def rare_sentence(settings: type) -> str | None:
    """Sentence at the end of help about rare settings."""
    count = len(rare_settings(settings))
    each = "one rare setting is" if count == 1 else f"{count} rare settings are"
    return f"{each.capitalize()} not listed: --set and --config take them ({SETTINGS_PAGE})." if count else None


def is_given(name: str) -> bool:
    """Whether the running command was given a setting, rather than taking its default."""
    return name in _given.get()


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, enum.Enum) else value


def _source(context: typer.Context, name: str) -> str:
    source = context.get_parameter_source(name)
    return "DEFAULT" if source is None else source.name


def _parameter(name: str, annotation: Any, default: Any = ...) -> inspect.Parameter:
    given = inspect.Parameter.empty if default is ... else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=given, annotation=annotation)
