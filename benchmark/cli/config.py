"""Settings that stand for flags which are not given: of the file of ``--config``, and of ``--set NAME=VALUE``."""

from collections.abc import Callable, Mapping, MutableMapping
from pathlib import Path
from typing import Any, Final

import typer

from benchmark.cli.fields import SETTINGS_PAGE, Field, fields_of
from benchmark.errors import InputError, did_you_mean

SET: Final = "--set"
SAID_BY_SET: Final = "benchmark.cli.config"
"""Key of a command's context: names that ``--set`` gave."""


def taking_file(settings: type) -> Callable[..., Any]:
    """Callback of ``--config``: what the file says stands for what neither flags nor ``--set`` give."""

    def take(context: typer.Context, value: Path | None) -> Path | None:
        if value is not None and not context.resilient_parsing:
            known = _defaults(context)
            known.update({**_of_file(context, settings, value), **known})
        return value

    return take


def taking_settings(settings: type) -> Callable[..., Any]:
    """Callback of ``--set``: settings of the command are taken, and what is the command's own is left to it."""

    def take(context: typer.Context, value: list[str] | None) -> list[str] | None:
        if not value or context.resilient_parsing:
            return value
        own = settings.reserved() if hasattr(settings, "reserved") else None
        known, left, said = _by_name(settings), [], {}
        for each in value:
            name, equals, text = each.partition("=")
            if own is not None and (name in own or _key(name) not in known):
                left.append(each)
                continue
            field = _named(known, name, SET, context)
            if not equals:
                raise InputError(f"{SET} {each} is not NAME=VALUE; write {SET} {each}=VALUE")
            said[field.name] = _checked(context, field, text.split(",") if field.repeated else text, SET, name)
        _defaults(context).update(said)
        context.meta[SAID_BY_SET] = tuple(said)
        return left or None

    return take


def _defaults(context: typer.Context) -> MutableMapping[str, Any]:
    """Values of options that are not given on the command line."""
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
    known, said = _by_name(settings), {}
    for name, value in _of_record(context, settings, path, members).items():
        field = _named(known, str(name), str(path), context)
        if value is None:
            continue
        if isinstance(value, Mapping) and field.flag == SET:
            value = [f"{key}={str(each).lower() if isinstance(each, bool) else each}" for key, each in value.items()]
        if isinstance(value, list) and field.option.separated:
            value = ",".join(map(str, value))
        _require_kind(field, value, str(path), str(name))
        several = [value] if field.repeated and not isinstance(value, list) else value
        said[field.name] = _checked(context, field, several, str(path), str(name))
    return said


def _of_record(context: typer.Context, settings: type, path: Path, members: Mapping[str, Any]) -> Mapping[str, Any]:
    """Settings of a record; a file of settings gives its members as they are."""
    from_record = getattr(settings, "from_record", None)
    try:
        recorded: Mapping[str, Any] | None = None if from_record is None else from_record(members)
    except (LookupError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is a damaged record ({type(error).__name__}: {error}); name another") from error
    if recorded is None and "schema" in members:
        raise InputError(f"{path} is no record that {context.info_name} could take settings from; name another")
    return members if recorded is None else recorded


def _by_name(settings: type) -> dict[str, Field]:
    """Fields by each name that a file may use: their own, and the option's."""
    fields = fields_of(settings)
    return {_key(each.flag): each for each in fields if each.flag} | {each.name: each for each in fields}


def _key(name: str) -> str:
    return name.strip().lstrip("-").replace("-", "_")


def _named(known: Mapping[str, Field], name: str, where: str, context: typer.Context) -> Field:
    found = known.get(_key(name))
    if found is None:
        close = did_you_mean(_key(name), known)
        raise InputError(
            f"{where} names {name!r}, and {context.info_name} has no such setting; {close}{SETTINGS_PAGE} lists them"
        )
    return found


def _require_kind(field: Field, value: Any, where: str, name: str) -> None:
    """Refuse values of a file that are of another kind than the setting's."""
    kinds = field.leaves
    if bool in kinds:
        right, what = isinstance(value, bool), "true or false"
    elif kinds & {int, float}:
        right, what = isinstance(value, int | float | str) and not isinstance(value, bool), "a number"
    else:
        every = value if isinstance(value, list) and field.repeated else [value]
        right, what = all(isinstance(each, str) for each in every), "text, in quotes if need be"
    if not right:
        raise InputError(f"{where} gives {name} as {value!r}, and it has to be {what}; correct it")


def _checked(context: typer.Context, field: Field, value: Any, where: str, name: str) -> Any:
    """A value as the option would take it; raises `InputError` for one that it refuses."""
    parameter: Any = next(each for each in context.command.params if each.name == field.name)
    try:
        return parameter.process_value(context, value)
    except typer.BadParameter as error:
        said = " ".join(error.message.removeprefix("Value error, ").split())
        raise InputError(f"{where} gives {name} as {value!r}, and that does not fit: {said}") from error
