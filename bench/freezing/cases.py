"""The table of what is frozen, ``cases.toml`` beside this file, and whether it has every command of the app."""

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

_TABLE: Final = tomllib.loads((Path(__file__).parent / "cases.toml").read_text())
NOT_FROZEN: Final[dict[str, str]] = _TABLE["not_frozen"]
"""Commands whose work no case does, and why."""
_REFUSED: Final = 2


@dataclass(frozen=True)
class Case:
    """Command lines that run one after another, in a folder below which each case has one of its own by its name.

    A line may name ``{url}`` (of the server), ``--golden {golden}/SET`` (which goes where there are no golden sets)
    and ``inputs/NAME`` (`freezing.inputs`); ``@help`` stands for the help of all commands.

    Attributes:
        name: Of the case, and of the folder that its commands write into.
        lines: What follows ``challenger-bench``.
        own: Cases whose folders are copied into this one first, as the same tree wrote them.
        of_start: The same, as the start's tree wrote them: what one case changed shows there alone.
        reads: Cases of the same tree whose folders are read where they are.
        codes: Exit codes that are right.
        serve: Command of a server that runs beside.
        needs: Packages without which the case is left out.
        whole: Whether only the whole freeze has it.
    """

    name: str
    lines: tuple[str, ...]
    own: tuple[str, ...] = ()
    of_start: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    codes: tuple[int, ...] = (0,)
    serve: str = ""
    needs: tuple[str, ...] = ()
    whole: bool = False

    def needed(self, *, start: bool) -> set[str]:
        """Cases that must have run in the same tree before."""
        return {*self.own, *self.reads} | ({*self.of_start} if start else set())


def _case(name: str, members: dict[str, Any]) -> Case:
    lines = tuple(line for line in members.pop("lines").splitlines() if line)
    given: dict[str, Any] = {key: tuple(each) if isinstance(each, list) else each for key, each in members.items()}
    return Case(name, lines, **given)


CASES: Final = {name: _case(name, members) for name, members in _TABLE["case"].items()}
"""By name, in the order in which they begin, unless they wait for one another."""


def in_order(names: Iterable[str], *, start: bool) -> list[str]:
    """Cases to run, each behind what it reads: those asked for and what they read."""
    wanted = set(names)
    while more := {need for name in wanted for need in CASES[name].needed(start=start)} - wanted:
        wanted |= more
    ordered: list[str] = []
    while len(ordered) < len(wanted):
        left = (name for name in CASES if name in wanted - {*ordered})
        ordered.append(next(name for name in left if CASES[name].needed(start=start) <= {*ordered}))
    return ordered


def left_out(commands: Mapping[str, Mapping[str, Any]], cases: Iterable[Case] = tuple(CASES.values())) -> list[str]:
    """What neither a case has nor `NOT_FROZEN` explains, and what that explains for nothing; a sentence each.

    Args:
        commands: Those of the app (`freezing.walk.walked`).
        cases: The cases; one that is there for refusals does no command's work.

    Returns:
        The sentences.
    """
    by_command: dict[str, list[str]] = {name: [] for name, each in commands.items() if each["does"]}
    for line in (line for case in cases if case.codes != (_REFUSED,) for line in (*case.lines, case.serve)):
        named = max((name for name in by_command if f"{line} ".startswith(f"{name} ")), key=len, default=None)
        if named is not None:
            by_command[named].append(line)
    found = [f"no case has {name}" for name, lines in by_command.items() if not lines and name not in NOT_FROZEN]
    found += [f"{name} is no command, or a case has it" for name in NOT_FROZEN if by_command.get(name, [""])]
    for name, option in _TABLE["every_choice"].items():
        given = " ".join(by_command[name])
        choices = next(each for kind, each in commands[name]["choices"].items() if kind == option)
        before = option if option.startswith("-") else name
        found += [
            f"no case has {before} {choice}"
            for choice in choices
            if not re.search(rf"{re.escape(before)} {re.escape(choice)}(?![\w-])", given)
        ]
    return found
