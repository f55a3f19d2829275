"""The public face and the command line as lists of lines, one for each name, parameter, option and choice."""

import dataclasses
import enum
import inspect
import typing
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import typer

import benchmark
from benchmark.cli.app import app

OWN = ("benchmark", "adapters", "generation", "leaderboard")
NAMED = {"splits", "protocols", "columns", "scene_facts"}
"""Members of JSON whose own members are names of things: any name stands for all of them."""
DEEP = {"columns": 2}
"""How many levels of names, where there is more than one."""


def face() -> list[str]:
    """The names of ``benchmark``: functions with their parameters, classes with what they are made of and offer."""
    lines: list[str] = []
    for name in ("__version__", *vars(benchmark)["_PLACES"]):
        found = getattr(benchmark, name)
        if inspect.isclass(found):
            lines += [f"{name} class", *(f"{name}.{member}" for member in class_members(found))]
        elif callable(found):
            lines += [f"{name} function", *(f"{name}({each})" for each in parameters(found))]
        else:
            lines.append(f"{name} {type(found).__name__}")
    return sorted(set(lines))


def parameters(function: Callable[..., Any]) -> Iterator[str]:
    """Parameters in their order, which counts where they may be given without a name."""
    for index, each in enumerate(inspect.signature(function).parameters.values()):
        if each.name == "self":
            continue
        by_name = each.kind in (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.VAR_KEYWORD)
        place = "by name" if by_name else str(index)
        needed = ", required" if each.default is inspect.Parameter.empty else f" = {plain(each.default)}"
        yield f"{each.name}: {place}{needed}"


def class_members(found: type) -> Iterator[str]:
    """Fields, then what the class and those of this project that it is made from define in public."""
    if issubclass(found, enum.Enum):
        yield from (member.name for member in found)
        return
    if dataclasses.is_dataclass(found):
        yield from (f"{each.name} field" for each in dataclasses.fields(found) if not each.name.startswith("_"))
    for base in found.__mro__:
        if base.__module__.split(".")[0] not in OWN:
            continue
        hints = inspect.get_annotations(base)
        yield from (f"{name} field" for name in hints if not name.startswith("_"))
        for name, value in vars(base).items():
            if name.startswith("_") or name in hints or name in ("model_config", "model_fields"):
                continue
            called = value.__func__ if isinstance(value, classmethod | staticmethod) else value
            if inspect.isfunction(called):
                yield f"{name} method"
                yield from (f"{name}({each})" for each in parameters(called))
            elif isinstance(value, property):
                yield f"{name} property"


def options() -> list[str]:
    """Commands, their arguments and options with type and default, and the choices of each."""
    return sorted(set(_options(typer.main.get_command(app), "challenger-bench")))


def _options(command: Any, name: str) -> Iterator[str]:
    yield f"{name} | command"
    for each in command.params:
        called = "/".join((*each.opts, *each.secondary_opts))
        kinds = list(kinds_of(each.type_descriptor.annotation))
        choices = [
            choice.value if isinstance(choice, enum.Enum) else choice
            for kind in kinds
            for choice in (kind if isinstance(kind, enum.EnumType) else typing.get_args(kind))
        ]
        kind = "choice" if choices else " or ".join(sorted(kind.__name__ for kind in kinds))
        repeated = ", may be repeated" if getattr(each, "multiple", False) or each.nargs == -1 else ""
        default = "required" if each.required else f"default {each.default if choices else plain(each.default)}"
        yield f"{name} | {called} | {kind}, {default}{repeated}"
        yield from (f"{name} | {called} | {choice}" for choice in choices)
    for part, inner in getattr(command, "commands", {}).items():
        yield from _options(inner, f"{name} {part}")


def kinds_of(annotation: Any) -> Iterator[type]:
    """The types that a value of an option has, without what makes it optional or repeated."""
    inner = [each for each in typing.get_args(annotation) if each not in (type(None), Ellipsis)]
    if not inner or typing.get_origin(annotation) is typing.Literal:
        yield annotation
        return
    for each in inner:
        yield from kinds_of(each)


def plain(value: Any) -> str:
    """A default that is a plain value, or the kind of what it is."""
    if isinstance(value, enum.Enum):
        return str(value.value)
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    if isinstance(value, Path):
        return repr(value.as_posix())
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(plain, value))}]"
    return f"a {type(value).__name__}" if not inspect.isroutine(value) else value.__name__


def members(value: Any, path: str = "", names: int = 0) -> set[str]:
    """Paths of all members of a JSON value; ``*`` for a name, ``[]`` for an item.

    So many levels from here on as ``names`` says have names of things as their members.
    """
    found = {path} if path else set()
    if isinstance(value, dict):
        for name, inner in value.items():
            below = names - 1 if names else DEEP.get(name, int(name in NAMED))
            found |= members(inner, f"{path}.{'*' if names else name}".removeprefix("."), below)
    elif isinstance(value, list):
        for inner in value:
            found |= members(inner, f"{path}[]")
    return found


def joined(lines: Iterable[str]) -> str:
    """Lines of a snapshot."""
    return "".join(f"{line}\n" for line in lines)
