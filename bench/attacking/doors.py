"""Doors that are no file: absurd options, planners that are anything but, odd model servers, requests to our own."""

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any, Final

import typer

import benchmark.extensions.http.model
from bench.attacking.campaign import Attempts, Result, listing
from bench.attacking.children import run_command
from bench.attacking.planners import ODD_PLANNERS
from bench.attacking.requests import SERVED, OwnServer
from bench.attacking.servers import SLOW, OddServer, odd_answers
from bench.attacking.table import TABLE, arguments
from bench.attacking.verdicts import FALLEN, Verdict, door_verdict
from benchmark.cli.app import app
from tests.benchmark.extensions.http.malformed import Request, malformed

DOORS: Final = "doors-{seed}.jsonl"
BASES: Final = {name: arguments(line) for name, line in TABLE["bases"].items()}
"""A cheap use of each command whose options are attacked."""
REQUESTS: Final = 1000
_SERVES: Final = "stop it with Ctrl-C"
"""Whoever says so goes on for ever, and is interrupted."""
ABSURD: Final[dict[str, str]] = {
    "zero": "0",
    "minus one": "-1",
    "not a number": "nan",
    "infinity": "inf",
    "a billion": "1000000000",
    "a number of 400 digits": "9" * 400,
    "almost nothing": "1e-300",
    "nothing": "",
    "a blank": " ",
    "an existing folder": "{case}/folder",
    "a file": "{case}/file.txt",
    "a file of a picture's name": "{case}/picture.png",
    "a folder of a table's name": "{case}/table.csv",
    "a file below a file": "{case}/file.txt/below",
    "what is not there": "{case}/nowhere/at/all",
    "a path with a newline": "{case}/two\nlines",
    "a path with an escape": "{case}/\x1b[31mred",
    "bytes that are not text": "{case}/\udcff\udcfe",
    "a name of 5000 letters": "{case}/" + "x" * 5000,
    "a pipe that nobody writes to": "{case}/pipe",
    "a link to itself": "{case}/loop",
    "a file that nobody may read": "{case}/secret",
    "an address": "http://127.0.0.1:1/",
    "a list of commas": ",,,",
    "other figures": "\u0663",
    "HTML": "<script>alert(1)</script>",
    "an option": "--help-me",
}
"""Values by what they are."""


@dataclass(frozen=True, slots=True)
class DoorAttempt:
    """One command line, or one request.

    Attributes:
        kind: Row of the table.
        command: What is attacked.
        name: How.
        arguments: Of the command line, with places in braces.
        planner: Source of the module ``odd``, beside the command.
        server: Path and name of what a model server answers; its address is the place ``{server}``.
        keeps_work: Whether a command that is refused half-way keeps what was finished before, as drives of others.
        request: What our own server is sent, in place of a command.
    """

    kind: str
    command: str
    name: str
    arguments: tuple[str, ...] = ()
    planner: str = ""
    server: tuple[str, str] | None = None
    keeps_work: bool = False
    request: Request | None = None


class DoorCampaign(Attempts):
    """Attempts on all of these doors, in an order of the seed, requests last."""

    def __init__(self, folder: Path, seed: int) -> None:
        super().__init__(folder, seed, DOORS)
        # So long does a command wait for a server that went away; in a campaign nobody restarts any.
        benchmark.extensions.http.model.RETURN_S = 1.0  # type: ignore[attr-defined]
        # And so long for its first answer, which is more than the time that a variant has.
        benchmark.extensions.http.model.ALIVE_S = 5.0  # type: ignore[attr-defined]
        tries = [*option_tries(), *planner_tries(), *server_tries()]
        self.tries = [*Random(seed).sample(tries, len(tries)), *request_tries(seed)]
        self.server: OwnServer | None = None

    def kinds(self, count: int) -> list[str]:
        """All that there are."""
        return [tried.kind for tried in self.tries]

    def run(self, number: int) -> Result:
        """Give a command its line, or our server its request, and say what became of it; leaves nothing behind."""
        tried = self.tries[number]
        if tried.request is not None:
            self.server = self.server or OwnServer(self.folder / "served")
            outcome, ended = self.server.asked(tried.request)
            if outcome in FALLEN:
                self.server.end()
                self.server = None
            return Result.of(number, tried.kind, tried.command, tried.name, outcome, ended)
        case = self.folder / f"door-{self.seed}-{number}"
        self._furnish(case, tried)
        before = listing(self.valid)
        places: dict[str, Path | str] = {"valid": self.valid, "case": case, "out": case / "out"}
        with contextlib.ExitStack() as stack:
            server = "" if tried.server is None else stack.enter_context(OddServer(*tried.server)).url
            # Values hold braces of their own.
            words = [_put(argument, {**places, "server": server}) for argument in tried.arguments]
            ended = run_command(words, case, until=_SERVES if tried.command == "serve" else "")
        outcome = door_verdict(ended, case / "out", keeps_work=tried.keeps_work)
        if listing(self.valid) != before:
            outcome = Verdict.WROTE
        shutil.rmtree(case, ignore_errors=True)
        return Result.of(number, tried.kind, tried.command, tried.name, outcome, ended)

    def _furnish(self, case: Path, tried: DoorAttempt) -> None:
        """Everything that a value may name."""
        shutil.rmtree(case, ignore_errors=True)
        (case / "folder").mkdir(parents=True)
        (case / "table.csv").mkdir()
        for name in ("file.txt", "picture.png", "folder/inside", "two\nlines", "secret"):
            (case / name).write_text("a line of text\n")
        (case / "secret").chmod(0)
        (case / "loop").symlink_to("loop")
        os.mkfifo(case / "pipe")
        if "{case}/shown" in " ".join(tried.arguments):
            shutil.copytree(self.valid / "shown", case / "shown")
        if tried.planner:
            (case / "odd.py").write_text(tried.planner)


def _put(text: str, places: dict[str, Path | str]) -> str:
    return re.sub(r"\{(valid|case|out|server)\}", lambda found: str(places[found[1]]), text)


def commands_of(command: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every command of the command line, with what is known of it."""
    if getattr(command, "commands", None):
        for child_name, below in sorted(command.commands.items()):
            yield from commands_of(below, f"{name} {child_name}".strip())
        if getattr(command, "invoke_without_command", False):
            yield name, command
    else:
        yield name, command


def option_tries() -> list[DoorAttempt]:
    """Each absurd value for each option and argument of each command that has a base."""
    tries = []
    for name, command in commands_of(typer.main.get_command(app)):
        if name not in BASES:
            continue
        base, words = BASES[name], name.split()
        known = {entry.opts[0]: getattr(entry, "is_flag", False) for entry in command.params}
        options = [option for option, flag in known.items() if option.startswith("--") and not flag]
        positional = any(not entry.startswith("-") for entry in known) and base and not base[0].startswith("--")
        for kind, value in ABSURD.items():
            lines = {
                f"{option} is {kind}": (*words, *_without(base, option), f"{option}={value}")
                for option in options
                if option != "--help"
            }
            if positional:
                lines[f"the argument is {kind}"] = (*words, *base[1:], "--", value)
            tries += [
                DoorAttempt(f"options of {words[0]}", name, description, line) for description, line in lines.items()
            ]
    return tries


def _without(base: tuple[str, ...], option: str) -> tuple[str, ...]:
    """A command line less one option and its value."""
    if option not in base:
        return base
    at = base.index(option)
    return (*base[:at], *base[at + 2 :])


def planner_tries() -> list[DoorAttempt]:
    """Each odd planner in open and in closed loop."""
    return [
        DoorAttempt("planners of others", f"{command} --model module:Class", name, arguments(line), source)
        for command, line in TABLE["planners"].items()
        for name, source in ODD_PLANNERS.items()
    ]


def server_tries() -> list[DoorAttempt]:
    """Each odd answer of a model server in open and in closed loop; who is slow only where a limit can be said."""
    return [
        DoorAttempt(
            "answers of model servers",
            f"{command} --model http",
            f"{path}: {name}",
            arguments(line),
            server=(path, name),
            keeps_work=command == "drive",
        )
        for command, line in TABLE["servers"].items()
        for path, name in odd_answers()
        if command == "drive" or name not in SLOW
    ]


def request_tries(seed: int) -> list[DoorAttempt]:
    """Requests to our own server that are none."""
    return [
        DoorAttempt("requests to our server", f"serve --model {SERVED}", f"{request.name} ({number})", request=request)
        for number, request in enumerate(malformed(REQUESTS, seed))
    ]
