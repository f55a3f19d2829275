"""Settings of a command, declared once: a frozen dataclass is its options and what ``--config`` may hold.

A field is ``Annotated[type, Option(...)]`` with a default, or without one where it has to be given. Values come from
the command line, ``--set NAME=VALUE``, the file of ``--config`` and the defaults; the first that has one wins.
"""

import dataclasses
import enum
import inspect
import types
import typing
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import typer

from benchmark.cli.help import SettingsCommand
from benchmark.errors import InputError, did_you_mean

Panel = Literal["Input", "Output", "Planner", "Search", "Execution", "Advanced"]
SETTINGS_PAGE: Final = "docs/settings.md"
_SET: Final = "--set"
_SAID_BY_SET: Final = "benchmark.cli.settings"
"""Key of a command's context: names that ``--set`` gave."""
_given: ContextVar[frozenset[str]] = ContextVar("given", default=frozenset())
S = TypeVar("S")


@dataclass(frozen=True, slots=True)
class Option:
    """What the command line says of a field.

    Attributes:
        help: One sentence or two.
        panel: Group in the help.
        names: ``--format`` or ``--site/--no-site``; the field's name by default, empty for an argument.
        separated: Whether several values are one text, separated by commas; a file may give a list.
        min: Least value of a number.
        max: Largest value.
        metavar: Shown for the value, if not its type.
    """

    help: str
    panel: Panel = "Advanced"
    names: str | None = None
    separated: bool = False
    min: float | None = None
    max: float | None = None
    metavar: str | None = None

    def for_typer(self, kind: Any, callback: Callable[..., Any] | None = None, *, hidden: bool = False) -> Any:
        """The field as typer takes it."""
        shared: dict[str, Any] = {"help": self.help, "min": self.min, "max": self.max, "metavar": self.metavar}
        shared |= {"rich_help_panel": self.panel, "hidden": hidden}
        if not self.names:
            return Annotated[kind, typer.Argument(**shared)]
        if self.metavar is None and typing.get_origin(kind) is not Literal:
            # Of repeated values it would say that they are a list.
            names = {types.GenericAlias(list, each): f"<{each.__name__.lower()}>" for each in (str, Path)}
            shared["metavar"] = next((names[each] for each in (kind, *typing.get_args(kind)) if each in names), None)
        option = typer.Option(self.names, callback=callback, is_eager=callback is not None, **shared)
        return Annotated[kind, option]


def fields_of(settings: type) -> Iterator[tuple[str, Any, Option, Any]]:
    """Name, type, option and default of each field; the default is ``...`` where there is none."""
    hints = typing.get_type_hints(settings, include_extras=True)
    for field in dataclasses.fields(settings):
        kind, option = typing.get_args(hints[field.name])
        names = f"--{field.name.replace('_', '-')}" if option.names is None else option.names
        option = dataclasses.replace(option, names=names)
        yield field.name, kind, option, ... if field.default is dataclasses.MISSING else field.default


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
        for name in context.meta.get(_SAID_BY_SET, ()):
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

    names, rare = {name for name, *_ in fields_of(settings)}, rare_settings(settings)
    parameters = [_parameter("context", typer.Context)]
    for name, kind, option, default in fields_of(settings):
        callback = _taking_settings(settings) if option.names == _SET and hasattr(settings, "reserved") else None
        annotation = option.for_typer(_for_typer(kind), callback, hidden=name in rare)
        parameters.append(_parameter(name, annotation, list(default) if isinstance(default, tuple) else default))
    config = Option("Settings from a YAML or JSON file, or from a record; flags win.", names="--config")
    taking_file = config.for_typer(Path | None, _taking_file(settings))
    parameters.append(_parameter("config_file", taking_file, None))
    if rare and "changes" not in names:
        text = f"A setting that help does not list, NAME=VALUE ({SETTINGS_PAGE})."
        changed = Option(text, names=_SET).for_typer(list[str] | None, _taking_settings(settings))
        parameters.append(_parameter("changed_settings", changed, None))
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
    """What help says of them at its end."""
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


def _for_typer(kind: Any) -> Any:
    """A type with lists for tuples, which typer reads as so many values of an option."""
    repeated = next((each for each in (kind, *typing.get_args(kind)) if typing.get_origin(each) is tuple), None)
    if repeated is None:
        return kind
    value: Any = typing.get_args(repeated)[0]
    if typing.get_origin(value) is Literal:
        # Typer has no lists of literals.
        choices: Any = enum.StrEnum
        value = choices("Choice", {each: each for each in typing.get_args(value)})
    several: Any = types.GenericAlias(list, value)
    return several if repeated is kind else several | None


def _taking_file(settings: type) -> Callable[..., Any]:
    def take(context: typer.Context, value: Path | None) -> Path | None:
        if value is not None and not context.resilient_parsing:
            known = _defaults(context)
            known.update({**_of_file(context, settings, value), **known})
        return value

    return take


def _taking_settings(settings: type) -> Callable[..., Any]:
    def take(context: typer.Context, value: list[str] | None) -> list[str] | None:
        if not value or context.resilient_parsing:
            return value
        own = settings.reserved() if hasattr(settings, "reserved") else None
        left, said = [], {}
        parameters = _parameters(context, settings)
        for each in value:
            name, _, text = each.partition("=")
            if own is not None and (name in own or _key(name) not in parameters):
                left.append(each)
                continue
            parameter = _named(parameters, name, "--set", context)
            many = parameter.multiple or parameter.nargs == -1
            said[parameter.name] = _checked(context, parameter, text.split(",") if many else text, "--set", name)
        _defaults(context).update(said)
        context.meta[_SAID_BY_SET] = tuple(said)
        return left or None

    return take


def _defaults(context: typer.Context) -> MutableMapping[str, Any]:
    """What stands for options that are not given on the command line."""
    if context.default_map is None:
        context.default_map = {}
    return context.default_map


def _of_file(context: typer.Context, settings: type, path: Path) -> dict[str, Any]:
    """Checked settings of a file, by field."""
    from benchmark.untrusted.json_text import read_json
    from benchmark.untrusted.yaml_text import read_yaml

    members = read_json(path) if path.suffix.lower() == ".json" else read_yaml(path)
    if not isinstance(members, Mapping):
        raise InputError(f"{path} holds no settings; write NAME: VALUE lines, or name a record")
    from_record = getattr(settings, "from_record", None)
    if "schema" in members or from_record is not None:
        recorded = None if from_record is None else from_record(members)
        if recorded is None and "schema" in members:
            raise InputError(f"{path} is no record that {context.info_name} could take settings from; name another")
        members = members if recorded is None else recorded
    parameters, said = _parameters(context, settings), {}
    options = {name: option for name, _, option, _ in fields_of(settings)}
    for name, value in members.items():
        parameter = _named(parameters, str(name), str(path), context)
        if value is None:
            continue
        if isinstance(value, Mapping) and options[parameter.name].names == _SET:
            value = [f"{key}={str(each).lower() if isinstance(each, bool) else each}" for key, each in value.items()]
        if isinstance(value, list) and options[parameter.name].separated:
            value = ",".join(map(str, value))
        _require_kind(parameter, value, str(path), str(name))
        many = (parameter.multiple or parameter.nargs == -1) and not isinstance(value, list)
        said[parameter.name] = _checked(context, parameter, [value] if many else value, str(path), str(name))
    return said


def _parameters(context: typer.Context, settings: type) -> dict[str, Any]:
    """Parameters of a command by each name that a file may use: the field's, the option's."""
    fields = {name: option for name, _, option, _ in fields_of(settings)}
    known: dict[str, Any] = {}
    for parameter in context.command.params:
        option = fields.get(parameter.name)
        if option is not None:
            known[_key((option.names or "").partition("/")[0])] = parameter
    return {key: each for key, each in known.items() if key} | {each.name: each for each in known.values()}


def _key(name: str) -> str:
    return name.strip().lstrip("-").replace("-", "_")


def _named(parameters: Mapping[str, Any], name: str, where: str, context: typer.Context) -> Any:
    found = parameters.get(_key(name))
    if found is None:
        close = did_you_mean(_key(name), parameters)
        raise InputError(
            f"{where} names {name!r}, and {context.info_name} has no such setting; {close}{SETTINGS_PAGE} lists them"
        )
    return found


def _require_kind(parameter: Any, value: Any, where: str, name: str) -> None:
    """Refuse values of a file that are of another kind than the setting's."""
    kinds = [*_leaves(parameter.type_descriptor.annotation)]
    if bool in kinds:
        right, what = isinstance(value, bool), "true or false"
    elif int in kinds or float in kinds:
        right, what = isinstance(value, int | float | str) and not isinstance(value, bool), "a number"
    else:
        every = value if isinstance(value, list) and (parameter.multiple or parameter.nargs == -1) else [value]
        right, what = all(isinstance(each, str) for each in every), "text, in quotes if need be"
    if not right:
        raise InputError(f"{where} gives {name} as {value!r}, and it has to be {what}; correct it")


def _leaves(kind: Any) -> Iterator[Any]:
    """The types in a type, without what makes it optional or repeated."""
    inner = typing.get_args(kind) if typing.get_origin(kind) is not Literal else ()
    if not inner:
        yield kind
    for each in inner:
        yield from _leaves(each)


def _checked(context: typer.Context, parameter: Any, value: Any, where: str, name: str) -> Any:
    """A value as the option would take it; raises `InputError` for one that it refuses."""
    try:
        return parameter.process_value(context, value)
    except typer.BadParameter as error:
        said = " ".join(error.message.removeprefix("Value error, ").split())
        raise InputError(f"{where} gives {name} as {value!r}, and that does not fit: {said}") from error
