"""Fields of settings: what the command line says of each, and as what typer takes it."""

import dataclasses
import enum
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import typer

Panel = Literal["Input", "Output", "Planner", "Search", "Execution", "Advanced"]
SETTINGS_PAGE: Final = "docs/settings.md"


@dataclass(frozen=True, slots=True)
class Option:
    """Presentation of a field on the command line.

    Attributes:
        names: ``--format`` or ``--site/--no-site``; the field's name by default, empty for an argument.
        separated: Whether several values are one text, separated by commas; a file may give a list.
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


@dataclass(frozen=True, slots=True)
class Field:
    """A field of settings; the default is ``...`` where it has to be given, and help leaves out rare ones."""

    name: str
    kind: Any
    option: Option
    default: Any
    rare: bool

    @property
    def repeated(self) -> bool:
        """Whether it has any number of values."""
        return any(typing.get_origin(each) is tuple for each in (self.kind, *typing.get_args(self.kind)))

    @property
    def flag(self) -> str:
        """The option, or nothing of an argument; ``--site`` of ``--site/--no-site``."""
        return (self.option.names or "").partition("/")[0]

    @property
    def leaves(self) -> set[Any]:
        """The types of a value, without what makes it optional or repeated; `str` of a choice."""
        inner = {each for kind in typing.get_args(self.kind) for each in (kind, *typing.get_args(kind))}
        return {each for each in (self.kind, *inner) if each in (bool, int, float, str, Path)} or {str}

    def for_typer(self, callback: Callable[..., Any] | None = None) -> tuple[Any, Any]:
        """Annotation and default as typer takes them."""
        annotation = self.option.for_typer(_for_typer(self.kind), callback, hidden=self.rare)
        return annotation, list(self.default) if isinstance(self.default, tuple) else self.default


def fields_of(settings: Any) -> tuple[Field, ...]:
    """Fields of a dataclass of settings, in their order."""
    return _fields_of(settings)


@cache
def _fields_of(settings: Any) -> tuple[Field, ...]:
    hints, rare = typing.get_type_hints(settings, include_extras=True), getattr(settings, "RARE", ())
    found = []
    for each in dataclasses.fields(settings):
        kind, option = typing.get_args(hints[each.name])
        if option.names is None:
            option = dataclasses.replace(option, names=f"--{each.name.replace('_', '-')}")
        default = ... if each.default is dataclasses.MISSING else each.default
        found.append(Field(each.name, kind, option, default, each.name in rare))
    return tuple(found)


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
