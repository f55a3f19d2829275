"""One tree of the code under comparison: its command line, run in a folder of its own, and what was seen of it."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

PACKAGES = ("benchmark", "generation", "adapters", "leaderboard")
TIMINGS = ".challenger/timing"
"""Of the state that a root keeps (``.challenger``), the one folder that holds seconds; all else in it is compared."""
_WIDTH = 100
_OPTION = re.compile(r"^  -")

Seen = dict[str, dict[str, str]]
"""For each compared thing, what stands under each path: the hash of a file, or the text that a command printed."""


@dataclass
class Tree:
    """A tree of the code and the folder in which its commands run.

    All paths in commands are relative to the folder, so that what is printed and written names no folder of the
    machine and needs no normalisation for it.

    Attributes:
        name: What messages call it.
        code: Root of the tree.
        work: Folder in which its commands run.
        start_work: The folder of the start's tree, whose records and sheets both trees read.
        seen: What was seen so far.
    """

    name: str
    code: Path
    work: Path
    start_work: Path
    seen: Seen = field(default_factory=dict)

    def check(self) -> None:
        """Whether commands import this tree's packages and no others, an installed one for example."""
        self.work.mkdir(parents=True, exist_ok=True)
        question = (
            "import importlib.util as u, sys; print(*[u.find_spec(each).origin for each in sys.argv[1:]], sep='\\n')"
        )
        found = self._start(["-c", question, *PACKAGES]).stdout.split()
        wrong = [path for path in found if not Path(path).is_relative_to(self.code)]
        if wrong or len(found) != len(PACKAGES):
            raise SystemExit(f"{self.name}: commands in {self.work} would import {wrong or 'nothing'}, not {self.code}")

    def run(self, *arguments: str, codes: tuple[int, ...] = (0,)) -> str:
        """Run a command of the command line.

        Args:
            arguments: What follows ``challenger-bench``.
            codes: Exit codes that are expected.

        Returns:
            What it printed on stdout; behind it, after an unexpected exit code, that code and stderr, which show as a
            difference. Of the start that is an error: nothing could be compared with it.
        """
        done = self._start(["-m", "benchmark", *arguments])
        if done.returncode in codes:
            return done.stdout
        if self.code_is_start:
            raise SystemExit(f"the start fails at {' '.join(arguments)} (exit code {done.returncode}): {done.stderr}")
        return f"{done.stdout}exit code {done.returncode}: {done.stderr}"

    def refusal(self, *arguments: str) -> str:
        """Exit code and stderr of a command that must refuse."""
        done = self._start(["-m", "benchmark", *arguments])
        return f"exit code {done.returncode}: {done.stdout}{done.stderr}"

    def print(self, thing: str, *arguments: str, codes: tuple[int, ...] = (0,)) -> None:
        """Run a command and compare what it prints."""
        self.note(thing, f"printed by {' '.join(arguments)}", self.run(*arguments, codes=codes))

    def note(self, thing: str, path: str, text: str) -> None:
        """Compare a text."""
        self.seen.setdefault(thing, {})[path] = text

    def files(self, thing: str, folder: str, keep: Callable[[str], bool] = lambda path: True) -> None:
        """Compare the files below a folder, by their hashes.

        Args:
            thing: What they are.
            folder: Relative to the work folder.
            keep: Whether a file counts, by its path relative to the folder.
        """
        root = self.work / folder
        of_thing = self.seen.setdefault(thing, {})
        for path in sorted(root.rglob("*")):
            relative = path.relative_to(root).as_posix()
            if path.is_file() and TIMINGS not in relative and keep(relative):
                of_thing[f"{folder}/{relative}"] = hashlib.sha256(path.read_bytes()).hexdigest()

    def remove(self, folder: str) -> None:
        """Remove what an interrupted run left."""
        shutil.rmtree(self.work / folder, ignore_errors=True)

    def copy_of_start(self, source: str, target: str) -> None:
        """A byte-identical copy of a folder that the start's tree wrote; both trees work on one."""
        self.remove(target)
        shutil.copytree(self.start_work / source, self.work / target)

    @property
    def code_is_start(self) -> bool:
        """Whether this is the tree that the other is compared with."""
        return self.work == self.start_work

    def _start(self, arguments: list[str]) -> subprocess.CompletedProcess[str]:
        environment = {name: value for name, value in os.environ.items() if name != "CHALLENGER_BENCH_CACHE"} | {
            "PYTHONPATH": str(self.code),
            "XDG_CACHE_HOME": str(self.work / "cache"),
            "OMP_NUM_THREADS": "1",
            "COLUMNS": str(_WIDTH),
        }
        # Not the tree itself: relative paths then lie in the work folder, and PYTHONPATH leads to the tree.
        command = [sys.executable, *arguments]
        return subprocess.run(command, cwd=self.work, env=environment, capture_output=True, text=True, check=False)


def commands_in(help_text: str) -> list[str]:
    """Names of the commands that a help lists."""
    _, _, listed = help_text.partition("\nCommands:\n")
    return re.findall(r"^  (\S+)  ", listed, re.MULTILINE)


def without_options(help_text: str, options: tuple[str, ...]) -> str:
    """A help without the lines of some options, and with single spaces: column widths follow the longest option."""
    kept, dropping = [], False
    for line in help_text.splitlines():
        if _OPTION.match(line) or not line.startswith("   "):
            dropping = any(re.search(rf"{option}\b", line[:40]) for option in options)
        if not dropping:
            kept.append(line)
    return re.sub(r"\s+", " ", " ".join(kept))
