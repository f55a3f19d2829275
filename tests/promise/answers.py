"""Whether what was promised still answers: each name is looked up in the face, each option is parsed by its command."""

import contextlib
import dataclasses
import inspect
import io
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final
from unittest import mock

import typer

import benchmark
from benchmark.cli import app as command_line
from tests.promise import surface

RENAMED: Final[dict[str, str]] = {}
"""What refuses that was promised, and the new name that its refusal must say; what answers as before needs no line.

The old name is a line of a snapshot, of an option without its kind and of a name without kind, place and default.
"""
_NAME: Final = re.compile(r"(\w+)(?:\.(\w+))?(?:\((\*{0,2}\w+): (by name|\d+)(.*)\)| (\w+))?")
_IMPORT: Final = "challenger-bench data import"
"""Its form was an argument and is a command now: typed first, as the manual always had it."""
_VALUES: Final = {"int": "4", "float": "1.0", "str": "x", "Path": "x"}
_ENDS_AT_ONCE: Final = ("--install-completion", "--show-completion")
"""Options that do their work while they are parsed; it is enough that they are there."""


def unanswered(
    lines: Iterable[str], answer: Callable[[str], str | None], renamed: Mapping[str, str] = RENAMED
) -> list[str]:
    """A sentence for each line of a snapshot that neither answers nor refuses with one sentence that says the new name.

    ``answer`` says of a line ``None`` if it answers as before, else how it is refused.
    """
    found = []
    for line in lines:
        refusal = answer(line)
        if refusal is None:
            continue
        gone = _old_name(line)
        new = renamed.get(gone)
        if new is None:
            found.append(f"{gone} is gone, and RENAMED in tests/promise/answers.py has no new name: {refusal}")
        elif new not in refusal or len(refusal.strip().splitlines()) != 1:
            found.append(f"{gone} does not say in one sentence that it is {new} now: {refusal}")
    return found


def _old_name(line: str) -> str:
    if " | " not in line:
        return f"{line.partition(': ')[0]})" if "(" in line else line.partition(" ")[0]
    head, _, kind = line.rpartition(" | ")
    return head if ", " in kind else line


def of_face(line: str) -> str | None:
    """Whether a name of the face, a member or a parameter answers; else what is said to who uses it."""
    match = _NAME.fullmatch(line)
    assert match, line
    name, member, parameter, place, rest, kind = match.groups()
    try:
        found: Any = getattr(benchmark, name)
        if member is not None and (parameter or kind == "method" or member not in _members(found)):
            getattr(found, member)
        if parameter is not None:
            owner, called = (benchmark, name) if member is None else (found, member)
            return _refused_parameter(owner, called, parameter, place, required=rest.startswith(", required"))
    except (AttributeError, ImportError) as error:
        return str(error)
    found = getattr(found, member) if kind == "method" else found
    right = inspect.isclass(found) if kind == "class" else kind not in ("function", "method") or callable(found)
    return None if right else f"{line.rpartition(' ')[0]} is no {kind} any more"


def _members(found: Any) -> set[str]:
    """What instances have: fields without a default are no attributes of their class."""
    fields = {each.name for each in dataclasses.fields(found)} if dataclasses.is_dataclass(found) else set()
    return fields.union(*({*vars(base), *inspect.get_annotations(base)} for base in found.__mro__))


def _refused_parameter(owner: Any, name: str, parameter: str, place: str, *, required: bool) -> str | None:
    raw = inspect.getattr_static(owner, name)
    raw = raw.__func__ if isinstance(raw, classmethod | staticmethod) else raw
    now = {each.partition(":")[0]: each for each in surface.parameters(raw)}
    said = now.get(parameter)
    if said is None:
        try:
            getattr(owner, name)(**{parameter: None})
        except Exception as error:  # whatever is raised is what the user reads
            return str(error)
        return f"{parameter} is taken and ignored"
    if place != "by name" and f": {place}" not in said:
        return f"{parameter} stood in place {place}: {said}"
    return f"{parameter} has to be given" if ", required" in said and not required else None


class Options:
    """The options of a snapshot, each tried with what its command asked for when the snapshot was made."""

    def __init__(self, lines: Iterable[str]) -> None:
        rows = [line.split(" | ") for line in lines]
        self.choices = {(row[0], row[1]): row[2] for row in rows if len(row) == 3 and ", " not in row[2]}
        self.choices[_IMPORT, "form"] = "scenarionet"
        self.needed: dict[str, list[tuple[str, str]]] = {}
        for command, name, kind in (row for row in rows if len(row) == 3 and ", required" in row[2]):
            self.needed.setdefault(command, []).append((name, self._compare_value(command, name, kind)))

    def of(self, line: str) -> str | None:
        """Whether a command, an option or a choice is taken by the parser; else the refusal of the command line."""
        command, name, *rest = line.split(" | ")
        words = command.split()[1:]
        if command == _IMPORT and (name.startswith("-") or name == "source"):
            words.append("scenarionet")
        if name == "command":
            return refusal(*words, "--help")
        if name in _ENDS_AT_ONCE:
            return None if any(name in each.opts for each in _top().params) else f"there is no {name}"
        asked = [(each, value) for each, value in self.needed.get(command, ()) if (command, each) != (_IMPORT, "form")]
        needed = [word for each, value in asked if each != name for word in _said(each, value)]
        if rest[0].startswith("bool, "):
            tries = [[each] for each in name.split("/")]
        else:
            tries = [_said(name, self._compare_value(command, name, rest[0]) if ", " in rest[0] else rest[0])]
        return next((said for each in tries if (said := refusal(*words, *each, *needed)) is not None), None)

    def _compare_value(self, command: str, name: str, kind: str) -> str:
        return self.choices.get((command, name)) or _VALUES[kind.split(", ")[0]]


def _said(name: str, value: str) -> list[str]:
    """An option with its value, or an argument, which has no name on the command line."""
    return [name, value] if name.startswith("-") else [value]


def _top() -> Any:
    return typer.main.get_command(command_line.app)


class _Taken(BaseException):
    """The parser is done."""


def refusal(*words: str) -> str | None:
    """What the command line says to words that its parser does not take; ``None`` if it takes them. Nothing is run."""
    whole = typer.core.TyperGroup.invoke

    def of_group(self: Any, context: Any) -> Any:
        # A group goes on to its command; where none is named it would do its own work.
        return whole(self, context) if context._protected_args or context.args else taken()

    def taken(*_: Any) -> None:
        raise _Taken

    with (
        contextlib.redirect_stderr(io.StringIO()) as err,
        contextlib.redirect_stdout(io.StringIO()),
        mock.patch.object(sys, "argv", ["challenger-bench", *words]),
        mock.patch.object(typer.core.TyperGroup, "invoke", of_group),
        mock.patch.object(typer.core.TyperCommand, "invoke", taken),
        contextlib.suppress(_Taken),
    ):
        try:
            command_line.main()
        except SystemExit as ended:
            return err.getvalue() if ended.code else None
    return None
