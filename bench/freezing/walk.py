"""The commands of the app that can be imported: each with its help, whether it does something, and its choices.

Run by itself it prints them as JSON; a tree is asked in its own process.
"""

import contextlib
import enum
import io
import json
import typing
from collections.abc import Iterator
from typing import Any

import typer


def walked() -> dict[str, dict[str, Any]]:
    """By the name of the command, ``data export infos`` for example: help, does (no mere group), choices by option."""
    from benchmark.cli.app import app

    top = typer.main.get_command(app)
    return dict(_walk(top, top, []))


def _walk(top: Any, command: Any, words: list[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    with contextlib.redirect_stdout(io.StringIO()) as out:
        top.main([*words, "--help"], prog_name="challenger-bench", standalone_mode=False)
    inner = getattr(command, "commands", {})
    choices = {each.opts[0]: list(_choices(each.type_descriptor.annotation)) for each in command.params}
    does = not inner or (bool(words) and command.invoke_without_command)
    yield " ".join(words), {"help": out.getvalue(), "does": does, "choices": choices}
    for name, each in inner.items():
        yield from _walk(top, each, [*words, name])


def _choices(annotation: Any) -> Iterator[str]:
    if typing.get_origin(annotation) is typing.Literal:
        yield from map(str, typing.get_args(annotation))
        return
    for inner in typing.get_args(annotation):
        yield from _choices(inner)
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        yield from (str(each.value) for each in annotation)


if __name__ == "__main__":
    print(json.dumps(walked()))
