"""Settings of a command, declared once: a frozen dataclass is its options and what ``--config`` may hold.

A field is ``Annotated[type, Option(...)]`` with a default, or without one where it has to be given. Values come from
the command line, ``--set NAME=VALUE``, the file of ``--config`` and the defaults; the first that has one wins.
"""

import dataclasses
import enum
import inspect
import shlex
import types
import typing
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, MutableMapping
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar, cast

import typer

from benchmark.cli.help import ARGUMENTS, CommandPanel, SettingsCommand
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.extension import (
    AbsentExtensionError,
    find_owner,
    import_from_extension,
    list_offers,
    warn,
)

Panel = Literal["Input", "Output", "Planner", "Search", "Execution", "Advanced"]
SETTINGS_PAGE: Final = "docs/settings.md"


@dataclass(frozen=True, slots=True)
class Option:
    """Presentation of a field on the command line.

    ``names`` is ``--format`` or ``--site/--no-site``; the field's name by default, empty for an argument. ``short`` is
    another name, ``-v``. If ``separated``, several values are one text with commas; a file may give a list. ``metavar``
    stands for the value in place of its type. Where it ``offers`` what extensions have of a kind, their names are
    choices beside the core's.
    """

    help: str
    panel: Panel = "Advanced"
    names: str | None = None
    short: str | None = None
    separated: bool = False
    min: float | None = None
    max: float | None = None
    metavar: str | None = None
    offers: tuple[str, tuple[str, ...]] | None = None

    def for_typer(self, kind: Any, callback: Callable[..., Any] | None = None, *, hidden: bool = False) -> Any:
        """The field as typer takes it."""
        shared: dict[str, Any] = {"help": self.help, "min": self.min, "max": self.max, "metavar": self.metavar}
        shared |= {"rich_help_panel": self.panel, "hidden": hidden}
        if not self.names:
            return Annotated[kind, typer.Argument(**shared)]
        if self.metavar is None and typing.get_origin(kind) is not Literal:
            # For repeated values it would show the type as a list.
            names = {
                types.GenericAlias(list, candidate): f"<{candidate.__name__.lower()}>" for candidate in (str, Path)
            }
            shared["metavar"] = next(
                (names[candidate] for candidate in (kind, *typing.get_args(kind)) if candidate in names), None
            )
        flags = (self.names,) if self.short is None else (self.names, self.short)
        option = typer.Option(*flags, callback=callback, is_eager=callback is not None, **shared)
        return Annotated[kind, option]


@dataclass(frozen=True, slots=True)
class SettingField:
    """A field of settings; the default is ``...`` where it has to be given, and help leaves out rare ones.

    One that an extension adds to a command names what it is ``of``, ``renderer NAME``.
    """

    name: str
    kind: Any
    option: Option
    default: Any
    rare: bool
    of: str = ""

    @property
    def repeated(self) -> bool:
        """Whether it has any number of values."""
        return any(typing.get_origin(candidate) is tuple for candidate in (self.kind, *typing.get_args(self.kind)))

    @property
    def flag(self) -> str:
        """The option, or nothing of an argument; ``--site`` of ``--site/--no-site``."""
        return (self.option.names or "").partition("/")[0]

    @property
    def leaves(self) -> set[Any]:
        """The types of a value, without what makes it optional or repeated; `str` of a choice."""
        inner = {leaf for kind in typing.get_args(self.kind) for leaf in (kind, *typing.get_args(kind))}
        return {leaf for leaf in (self.kind, *inner) if leaf in (bool, int, float, str, Path)} or {str}

    def for_typer(self, callback: Callable[..., Any] | None = None) -> tuple[Any, Any]:
        """Annotation and default as typer takes them."""
        annotation = self.option.for_typer(_for_typer(self.kind), callback, hidden=self.rare)
        return annotation, list(self.default) if isinstance(self.default, tuple) else self.default


def list_fields(settings: Any) -> tuple[SettingField, ...]:
    """Fields of a dataclass of settings, in their order."""
    return _list_fields(settings)


@cache
def _list_fields(settings: Any) -> tuple[SettingField, ...]:
    hints, rare = typing.get_type_hints(settings, include_extras=True), getattr(settings, "RARE", ())
    setting_fields = []
    for field in dataclasses.fields(settings):
        kind, option = typing.get_args(hints[field.name])
        if option.names is None:
            option = dataclasses.replace(option, names=f"--{field.name.replace('_', '-')}")
        if option.offers is not None:
            kind = Literal[tuple(dict.fromkeys([*typing.get_args(kind), *list_offers(*option.offers)]))]
        default = ... if field.default is dataclasses.MISSING else field.default
        setting_fields.append(SettingField(field.name, kind, option, default, field.name in rare))
    return (*setting_fields, *_list_extension_fields(getattr(settings, "EXTENDED", ()), setting_fields))


def _list_extension_fields(kinds: Collection[str], core: Iterable[SettingField]) -> Iterator[SettingField]:
    """Fields that extensions add for what they offer of some kinds, in panels with the extensions' names."""
    taken = {name for field in core for name in (field.name, field.flag)}
    for of in list_offers("options") if kinds else ():
        if of.partition(" ")[0] not in kinds:
            continue
        owner = find_owner("options", of)
        try:
            fields = list_fields(import_from_extension("options", of))
        except AbsentExtensionError:
            continue
        except (InputError, TypeError, ValueError) as error:
            warn(f"the options of {of}, of the extension {owner}, are left out: {error}")
            continue
        names = {name for field in fields for name in (field.name, field.flag)}
        if names & taken:
            warn(f"the options of {of}, of the extension {owner}, are left out: {min(names & taken)} is taken")
            continue
        taken |= names
        for field in fields:
            option = dataclasses.replace(field.option, panel=cast("Panel", owner))
            yield dataclasses.replace(field, option=option, of=of)


def _for_typer(kind: Any) -> Any:
    """A type with lists for tuples, which typer reads as so many values of an option."""
    repeated = next(
        (candidate for candidate in (kind, *typing.get_args(kind)) if typing.get_origin(candidate) is tuple), None
    )
    if repeated is None:
        return kind
    value: Any = typing.get_args(repeated)[0]
    if typing.get_origin(value) is Literal:
        # Typer has no lists of literals.
        choices: Any = enum.StrEnum
        value = choices("Choice", {candidate: candidate for candidate in typing.get_args(value)})
    several: Any = types.GenericAlias(list, value)
    return several if repeated is kind else several | None


SET: Final = "--set"
NAMES_GIVEN_BY_SET: Final = "benchmark.cli.settings"
"""Key of a command's context: names that ``--set`` gave."""


def make_file_callback(settings: type) -> Callable[..., Any]:
    """Callback of ``--config``: what the file says stands for what neither flags nor ``--set`` give."""

    def take(context: typer.Context, value: Path | None) -> Path | None:
        if value is not None and not context.resilient_parsing:
            known = _defaults(context)
            known.update({**_read_settings_file(context, settings, value), **known})
        return value

    return take


def make_settings_callback(settings: type) -> Callable[..., Any]:
    """Callback of ``--set``: settings of the command are taken, and what is the command's own is left to it."""

    def take(context: typer.Context, value: list[str] | None) -> list[str] | None:
        if not value or context.resilient_parsing:
            return value
        reserved_names = settings.reserved() if hasattr(settings, "reserved") else None
        known, left, values = _index_fields(settings), [], {}
        for assignment in value:
            name, equals, text = assignment.partition("=")
            if reserved_names is not None and (name in reserved_names or _key(name) not in known):
                left.append(assignment)
                continue
            field = _find_field(known, name, SET, context)
            if not equals:
                raise InputError(f"{SET} {assignment} is not NAME=VALUE; write {SET} {assignment}=VALUE")
            values[field.name] = _convert_value(context, field, text.split(",") if field.repeated else text, SET, name)
        _defaults(context).update(values)
        context.meta[NAMES_GIVEN_BY_SET] = tuple(values)
        return left or None

    return take


def _defaults(context: typer.Context) -> MutableMapping[str, Any]:
    if context.default_map is None:
        context.default_map = {}
    return context.default_map


def _read_settings_file(context: typer.Context, settings: type, path: Path) -> dict[str, Any]:
    """Checked settings of a file, by field."""
    from benchmark.untrusted.text_files import read_json, read_yaml

    members = read_json(path) if path.suffix.lower() == ".json" else read_yaml(path)
    if not isinstance(members, Mapping):
        raise InputError(f"{path} holds no settings; write NAME: VALUE lines, or give a record")
    known, values = _index_fields(settings), {}
    for name, value in _read_record_settings(context, settings, path, members).items():
        field = _find_field(known, str(name), str(path), context)
        if value is None:
            continue
        if isinstance(value, Mapping) and field.flag == SET:
            value = [
                f"{key}={str(member).lower() if isinstance(member, bool) else member}" for key, member in value.items()
            ]
        if isinstance(value, list) and field.option.separated:
            value = ",".join(map(str, value))
        _require_kind(field, value, str(path), str(name))
        several = [value] if field.repeated and not isinstance(value, list) else value
        values[field.name] = _convert_value(context, field, several, str(path), str(name))
    return values


def _read_record_settings(
    context: typer.Context, settings: type, path: Path, members: Mapping[str, Any]
) -> Mapping[str, Any]:
    """Settings of a record; a file of settings gives its members as they are."""
    from_record = getattr(settings, "from_record", None)
    try:
        recorded: Mapping[str, Any] | None = None if from_record is None else from_record(members)
    except (LookupError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is a damaged record ({type(error).__name__}: {error}); choose another") from error
    if recorded is None and "schema" in members:
        raise InputError(f"{path} is not a record that {context.info_name} can read settings from; choose another")
    return members if recorded is None else recorded


def _index_fields(settings: type) -> dict[str, SettingField]:
    """Fields by each name that a file may use: their own, and the option's."""
    fields = list_fields(settings)
    return {_key(field.flag): field for field in fields if field.flag} | {field.name: field for field in fields}


def _key(name: str) -> str:
    return name.strip().lstrip("-").replace("-", "_")


def _find_field(known: Mapping[str, SettingField], name: str, where: str, context: typer.Context) -> SettingField:
    field = known.get(_key(name))
    if field is None:
        close = did_you_mean(_key(name), known)
        raise InputError(
            f"{where} names {name!r}, and {context.info_name} has no such setting; {close}{SETTINGS_PAGE} lists them"
        )
    return field


def _require_kind(field: SettingField, value: Any, where: str, name: str) -> None:
    """Refuse values of a file that are of another kind than the setting's."""
    kinds = field.leaves
    if bool in kinds:
        right, kind_text = isinstance(value, bool), "true or false"
    elif kinds & {int, float}:
        right, kind_text = isinstance(value, int | float | str) and not isinstance(value, bool), "a number"
    else:
        elements = value if isinstance(value, list) and field.repeated else [value]
        right, kind_text = all(isinstance(element, str) for element in elements), "text, quoted if necessary"
    if not right:
        raise InputError(f"{where} sets {name} to {value!r}, which must be {kind_text}; correct it")


def _convert_value(context: typer.Context, field: SettingField, value: Any, where: str, name: str) -> Any:
    """A value as the option would take it; raises `InputError` for one that it refuses."""
    parameter: Any = next(candidate for candidate in context.command.params if candidate.name == field.name)
    try:
        return parameter.process_value(context, value)
    except typer.BadParameter as error:
        reason = " ".join(error.message.removeprefix("Value error, ").split())
        raise InputError(f"{where} sets {name} to {value!r}, which is not valid: {reason}") from error


_words: ContextVar[tuple[str, ...]] = ContextVar("words", default=())
_given: ContextVar[frozenset[str]] = ContextVar("given", default=frozenset())
_of_extensions: ContextVar[Mapping[SettingField, Any]] = ContextVar("of_extensions")
S = TypeVar("S")


def command_function(settings: type[S], run: Callable[[S], None]) -> Callable[..., None]:
    """A function for typer, whose parameters are the fields, ``--config`` and, where fields are rare, ``--set``.

    Args:
        settings: Dataclass of the settings; ``RARE`` of it names those that help does not list,
            ``from_record(members)`` reads a record, and ``reserved()`` names what ``--set`` leaves to the command.
        run: Does the work; its docstring is the help.
    """

    def command(context: typer.Context, **values: Any) -> None:
        if context.invoked_subcommand is not None:
            return
        given = {name: _source(context, name) for name in values}
        for name in context.meta.get(NAMES_GIVEN_BY_SET, ()):
            if given.get(name) == "COMMANDLINE":
                raise InputError(f"--set {name} and the option of that name set the same thing; give only one")
        of_fields = {
            field: tuple(map(_plain, value)) if isinstance(value := values[field.name], list) else value
            for field in fields
        }
        token = _given.set(frozenset(name for name, source in given.items() if source != "DEFAULT"))
        others = _of_extensions.set({field: value for field, value in of_fields.items() if field.of})
        words = _words.set((*context.command_path.split()[1:], *context.meta.get(ARGUMENTS, ())))
        try:
            run(settings(**{field.name: value for field, value in of_fields.items() if not field.of}))
        finally:
            _given.reset(token)
            _of_extensions.reset(others)
            _words.reset(words)

    fields, changes = list_fields(settings), hasattr(settings, "reserved")
    parameters = [_parameter("context", typer.Context)]
    for field in fields:
        callback = make_settings_callback(settings) if field.flag == SET and changes else None
        parameters.append(_parameter(field.name, *field.for_typer(callback)))
    config = Option("Settings from a YAML or JSON file, or from a record; flags win.", names="--config")
    parameters.append(_parameter("config_file", config.for_typer(Path | None, make_file_callback(settings)), None))
    if list_rare_settings(settings) and not changes:
        change = Option(f"A setting that help does not list, NAME=VALUE ({SETTINGS_PAGE}).", names=SET)
        annotation = change.for_typer(list[str] | None, make_settings_callback(settings))
        parameters.append(_parameter("changed_settings", annotation, None))
    vars(command).update(__signature__=inspect.Signature(parameters), settings=settings)
    command.__annotations__ = {field.name: field.annotation for field in parameters}
    command.__doc__ = run.__doc__
    return command


def command(
    settings: type[S], app: typer.Typer | None = None, name: str = "", *, panel: CommandPanel | None = None
) -> Callable[[Callable[[S], None]], Callable[..., None]]:
    """Decorator that makes a command of a function, as `command_function`, in ``app`` or later (`add_command`).

    ``panel`` is where the list of commands has it.
    """

    def made(run: Callable[[S], None]) -> Callable[..., None]:
        function = command_function(settings, run)
        vars(function)["panel"] = panel
        if app is not None:
            add_command(app, name, function)
        return function

    return made


def add_command(app: typer.Typer, name: str, function: Callable[..., Any]) -> None:
    """Add what `command` made, or a plain function with options of typer, to an application."""
    settings = getattr(function, "settings", None)
    epilog = None if settings is None else format_rare_settings(settings)
    panel = getattr(function, "panel", None)
    app.command(name, cls=SettingsCommand, epilog=epilog, rich_help_panel=panel)(function)


def list_rare_settings(settings: type) -> list[str]:
    """Names of the settings that help does not list."""
    return list(getattr(settings, "RARE", ()))


def format_rare_settings(settings: type) -> str | None:
    """Sentence at the end of help about rare settings."""
    count = len(list_rare_settings(settings))
    subject = "one rare setting is" if count == 1 else f"{count} rare settings are"
    return f"{subject.capitalize()} not listed: --set and --config take them ({SETTINGS_PAGE})." if count else None


def is_given(name: str) -> bool:
    """Whether the user set an option of the running command, rather than leaving its default."""
    return name in _given.get()


def repeat_command(without: str = "") -> str:
    """The running command with the words that it was given, quoted for a shell, but for one option and its value."""
    kept: list[str] = []
    words = iter(_words.get())
    for word in words:
        if word == without:
            next(words, None)
        elif not word.startswith(f"{without}="):
            kept.append(word)
    return shlex.join(kept)


def take_options(kind: str, used: Collection[str]) -> dict[str, dict[str, Any]]:
    """Values of the options that extensions add to the running command for what they offer of a kind, by its name.

    `InputError` for an option of something that is not ``used``.
    """
    taken: dict[str, dict[str, Any]] = {}
    for field, value in _of_extensions.get({}).items():
        of, _, name = field.of.partition(" ")
        if of == kind and name in used:
            taken.setdefault(name, {})[field.name] = value
        elif of == kind and is_given(field.name):
            raise InputError(f"{field.flag} is only for the {kind} {name}; name that, or leave {field.flag} out")
    return taken


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, enum.Enum) else value


def _source(context: typer.Context, name: str) -> str:
    source = context.get_parameter_source(name)
    return "DEFAULT" if source is None else source.name


def _parameter(name: str, annotation: Any, default: Any = ...) -> inspect.Parameter:
    given = inspect.Parameter.empty if default is ... else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=given, annotation=annotation)
