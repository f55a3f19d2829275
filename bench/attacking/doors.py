"""Doors that are no file: every option of every command with absurd values, and planners that are anything but."""

import contextlib
import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any, Final

import typer

import benchmark.extensions.http.model
from bench.attacking.campaign import Result, listing, preload
from bench.attacking.children import HANG_S, MEMORY_BYTES, Ended, run_command
from bench.attacking.planners import ODD_PLANNERS
from bench.attacking.servers import SLOW, OddServer, odd_answers
from bench.attacking.valid import SEARCH, make_valid
from bench.attacking.verdicts import Verdict, is_sentence
from benchmark.cli.app import app

DOORS: Final = "doors-{seed}.jsonl"
_SHOWN: Final = 400
_AT_WORK: Final = ("--workers", "1")
_ROOT: Final = ("--data", "{valid}/root", "--out", "{out}", *_AT_WORK)
_CHALLENGE: Final = ("--base", "{valid}/root", "--out", "{out}", *_AT_WORK)
_SHOWN_ROOT: Final = ("--data", "{valid}/root", "--out", "{case}/shown")
BASES: Final[dict[str, tuple[str, ...]]] = {
    "ablate": (*_ROOT, "--dry-run"),
    "challenge check": ("{valid}/generated", *_CHALLENGE),
    "challenge rules": (),
    "challenge score": ("{valid}/generated", *_CHALLENGE, "--model", "constant-velocity"),
    "data build": (
        *("--root", "{out}", "--town-scenes", "1", "--size", "64x36", "--frames", "keyframes", "--renderer", "none"),
        *_AT_WORK,
    ),
    "data card": ("{valid}/generated", "--to", "{out}/card.json", "--out", "{case}/shown", *_AT_WORK),
    "data check": ("{valid}/root",),
    "data export openscenario": ("{valid}/generated", "--to", "{out}", *_AT_WORK),
    "data export scenarionet": ("{valid}/generated", "--to", "{out}", *_AT_WORK),
    "data export infos": ("{valid}/root", "--for", "vad", "--to", "{out}"),
    "data import": ("scenarionet", "{valid}/recordings", "--out", "{out}", "--renderer", "none", *_AT_WORK),
    "data info": ("{valid}/root",),
    "data pack": ("{valid}/frozen.json", "--root", "{valid}/generated", "--to", "{out}/a.zip", *_AT_WORK),
    "data review": ("{valid}/root", "--list"),
    "data show": ("{valid}/root", "--to", "{out}", *_AT_WORK),
    "data stats": ("{valid}/generated", *_AT_WORK),
    "data unpack": ("{valid}/package.zip", "--to", "{out}", *_AT_WORK),
    "doctor": (),
    "drive": (*_ROOT, "--split", "val", "--model", "stop"),
    "eval": (*_ROOT, "--model", "constant-velocity"),
    "film": (*_SHOWN_ROOT, "--split", "val", "--to", "{out}", "--format", "png", "--fps", "1", "--width", "320"),
    "generate": (*_ROOT, *SEARCH, "--dry-run"),
    "leaderboard": ("--records", "{valid}/records", "--to", "{out}", "--no-site", "--out", "{out}"),
    "leaderboard card": ("--to", "{out}/card.json", "--records", "{valid}/records", "--out", "{out}"),
    "leaderboard slices": ("--records", "{valid}/records", "--out", "{out}"),
    "leaderboard submit-check": ("{valid}/records", "--data", "{valid}/root", "--out", "{out}"),
    "models": (),
    "quality": (*_ROOT,),
    "reproduce": ("--model", "uniad", *_ROOT, "--dry-run"),
    "rescore": ("--records", "{case}/shown/runs", "--data", "{valid}/root", "--out", "{out}"),
    "serve": ("--model", "constant-velocity", "--port", "0"),
    "sheets": (*_ROOT, "--split", "val", "--pictures", "none"),
    "train denoiser": ("--tracks", "{case}/folder", "--out", "{out}/a.safetensors", "--steps", "1"),
    "train ego-status": ("--tracks", "{case}/folder", "--out", "{out}/a.safetensors"),
    "train planner": (
        *("--model", "uniad-mini", "--data", "{case}/folder", "--out", "{out}/a.safetensors", "--steps", "1"),
        *_AT_WORK,
    ),
    "train judge": ("{valid}/network.safetensors", "--data", "{case}/folder"),
    "transfer": ("--records", "{valid}/records", "--out", "{out}"),
    "verify": ("physics",),
    "weights anchors": ("--model", "sparsedrive", "--data", "{valid}/root", "--out", "{out}/a.npy", *_AT_WORK),
    "weights fetch": ("nobody's",),
    "weights import": ("{valid}/tensors.pth",),
    "weights list": (),
}
"""A cheap use of each command that is attacked, valid but for one that would go to the internet. Left out is ``demo``,
which does nothing that the others do not, for minutes."""
_SERVES: Final = "Ctrl-C ends it"
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
    "a folder": "{case}/folder",
    "a file": "{case}/file.txt",
    "a file of a picture's name": "{case}/picture.png",
    "a folder of a table's name": "{case}/table.csv",
    "a file below a file": "{case}/file.txt/below",
    "what is not there": "{case}/nowhere/at/all",
    "a path with a newline": "{case}/two\nlines",
    "a path with an escape": "{case}/\x1b[31mred",
    "bytes that are no text": "{case}/\udcff\udcfe",
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
class Try:
    """One command line.

    Attributes:
        kind: Row of the table.
        command: What is attacked.
        name: How.
        arguments: Of the command line, with places in braces.
        planner: Source of the module ``odd``, beside the command.
        server: Path and name of what a model server answers; its address is the place ``{server}``.
        keeps_work: Whether a command that is refused half-way keeps what was finished before, as drives of others.
    """

    kind: str
    command: str
    name: str
    arguments: tuple[str, ...]
    planner: str = ""
    server: tuple[str, str] | None = None
    keeps_work: bool = False


class Doors:
    """Attempts on all of these doors, in an order of the seed; run by `run_campaign`."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder.resolve(), seed
        preload()
        self.valid = make_valid(self.folder)
        self.results = DOORS.format(seed=seed)
        # So long does a command wait for a server that went away; in a campaign nobody restarts any.
        benchmark.extensions.http.model.RETURN_S = 1.0  # type: ignore[misc]
        # And so long for its first answer, which is more than the time that a variant has.
        benchmark.extensions.http.model.ALIVE_S = 5.0  # type: ignore[attr-defined]
        tries = [*option_tries(), *planner_tries(), *server_tries()]
        self.tries = Random(seed).sample(tries, len(tries))

    def run(self, number: int) -> Result:
        """Give a command its line, and say what became of it; leaves nothing behind."""
        tried = self.tries[number]
        case = self.folder / f"door-{self.seed}-{number}"
        self._furnish(case, tried)
        before = listing(self.valid)
        places: dict[str, Path | str] = {"valid": self.valid, "case": case, "out": case / "out"}
        with contextlib.ExitStack() as stack:
            server = "" if tried.server is None else stack.enter_context(OddServer(*tried.server)).url
            # Values hold braces of their own.
            given = [_put(each, {**places, "server": server}) for each in tried.arguments]
            ended = run_command(given, case, case / "cache", until=_SERVES if tried.command == "serve" else "")
        found = door_verdict(ended, case / "out", keeps_work=tried.keeps_work)
        if listing(self.valid) != before:
            found = Verdict.WROTE
        _remove(case)
        said = "\n".join(ended.err.strip().splitlines()[-3:])[-_SHOWN:]
        measured = round(ended.cpu_s, 2), round(ended.wall_s, 2), ended.peak_bytes >> 20
        return Result(number, tried.kind, tried.command, tried.name, found.value, ended.code, *measured, said)

    def _furnish(self, case: Path, tried: Try) -> None:
        """Everything that a value may name."""
        _remove(case)
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


def _remove(case: Path) -> None:
    shutil.rmtree(case, ignore_errors=True)


def commands_of(command: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every command of the command line, with what is known of it."""
    if getattr(command, "commands", None):
        for each, below in sorted(command.commands.items()):
            yield from commands_of(below, f"{name} {each}".strip())
        if getattr(command, "invoke_without_command", False):
            yield name, command
    else:
        yield name, command


def option_tries() -> list[Try]:
    """Each absurd value for each option and argument of each command that has a base."""
    found = []
    for name, command in commands_of(typer.main.get_command(app)):
        if name not in BASES:
            continue
        base = BASES[name]
        positional = [each for each in command.params if not each.opts[0].startswith("-")]
        options = [each.opts[0] for each in command.params if each.opts[0].startswith("--")]
        flags = {each.opts[0] for each in command.params if getattr(each, "is_flag", False)}
        for what, value in ABSURD.items():
            for option in options:
                if option not in flags and option != "--help":
                    line = (*name.split(), *_without(base, option), f"{option}={value}")
                    found.append(Try(f"options of {name.split()[0]}", name, f"{option} is {what}", line))
            if positional and base and not base[0].startswith("--"):
                line = (*name.split(), *base[1:], "--", value)
                found.append(Try(f"options of {name.split()[0]}", name, f"the argument is {what}", line))
    return found


def _without(base: tuple[str, ...], option: str) -> tuple[str, ...]:
    """A command line less one option and its value."""
    if option not in base:
        return base
    at = base.index(option)
    return (*base[:at], *base[at + 2 :])


def planner_tries() -> list[Try]:
    """Each odd planner in open and in closed loop."""
    commands: dict[str, Callable[[], tuple[str, ...]]] = {
        "eval": lambda: ("eval", *_ROOT, "--model", "odd:Planner", "--sample-limit", "4"),
        "drive": lambda: (
            "drive",
            *_ROOT,
            "--split",
            "val",
            "--model",
            "odd:Planner",
            "--agents",
            "idm",
            "--timeout",
            "4",
        ),
    }
    return [
        Try("planners of others", f"{command} --model module:Class", name, line(), source)
        for command, line in commands.items()
        for name, source in ODD_PLANNERS.items()
    ]


def server_tries() -> list[Try]:
    """Each odd answer of a model server in open and in closed loop; who is slow only where a limit can be said."""
    lines = {
        "eval": ("eval", *_ROOT, "--model", "{server}", "--image-format", "png"),
        "drive": (
            *("drive", *_ROOT, "--split", "val", "--model", "{server}", "--sensor", "schematic", "--timeout", "1"),
            *("--agents", "idm", "--image-format", "png"),
        ),
    }
    return [
        Try(
            "answers of model servers",
            f"{command} --model http",
            f"{path}: {name}",
            line,
            "",
            (path, name),
            command == "drive",
        )
        for command, line in lines.items()
        for path, name in odd_answers()
        if command == "drive" or name not in SLOW
    ]


def door_verdict(ended: Ended, out: Path, *, keeps_work: bool = False) -> Verdict:
    """Classify: 0 is fine, 1 a failed or partial run that is spoken of, 2 a sentence and nothing written.

    Args:
        ended: How the command ended.
        out: Folder that it might write to; nothing was in it before.
        keeps_work: Whether what is written there may be finished work.

    Returns:
        The worst that can be said.
    """
    if ended.peak_bytes > MEMORY_BYTES:
        return Verdict.MEMORY
    if ended.cpu_s > HANG_S or ended.wall_s > ended.patience_s:
        return Verdict.HANG
    if ended.code < 0:
        return Verdict.DEATH
    if "Traceback (most recent call last)" in ended.err:
        return Verdict.TRACEBACK
    if ended.code == 0:
        return Verdict.OTHER_INPUT
    if ended.code == 1:
        return Verdict.ANSWERED if (ended.out + ended.err).strip() else Verdict.UNCLEAR
    if ended.code != 2 or not is_sentence(ended.err):
        return Verdict.UNCLEAR
    wrote = [path for path in out.rglob("*") if path.is_file()]
    return Verdict.WROTE if wrote and not keeps_work and f"{out}/" not in ended.err else Verdict.ANSWERED
