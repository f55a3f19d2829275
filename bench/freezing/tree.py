"""One tree of the code under comparison: its command line, run in a folder of its own, and what was seen of it."""

import contextlib
import hashlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from bench.freezing.cases import Case
from bench.freezing.inputs import INPUTS
from bench.freezing.numbers import numbers_in

PACKAGES: Final = ("benchmark", "generation", "adapters", "leaderboard")
_WIDTH = 100
_SECONDS = ("timings/", "/timing/", "timing.json", "/work.json")
"""What of a path says that seconds are in the file; all else is compared."""
_OF_THE_COMMIT = re.compile(r'"source": \{\s*"commit": [^}]*\}|\| commit \| [0-9a-f]{40} \|')
"""The commit that made a record or a model; the trees that are compared have two."""
_DURATION = re.compile(r'"total_s": ?\{[^}]*\}|"error": [\d.e-]+,(?=[^}]*"quantity": "longest refusal \(s\)")')
"""What took how long, inside a file of other things."""
_HASH = re.compile(r"(?<=\")[0-9a-f]{64}(?=\")")
_MODULE = re.compile(rf"\b(?:{'|'.join(PACKAGES)})(?:[./]\w+)*[./](\w+)(?:\.py)?\b(?![./])")
"""A module is compared by its last name, for modules move."""
_PROGRESS = re.compile(r"\d+:\d\d|\d s\b")
Seen = dict[str, list[str]]
"""For each path of a file, and each command line: what was seen, and the numbers, keys and names in it, or hashes."""


@dataclass
class Tree:
    """A tree of the code and the folder in which its commands run.

    All paths in commands are relative to the folder, so that what is printed and written names no folder of the
    machine.

    Attributes:
        name: What messages call it.
        code: Root of the tree.
        work: Folder in which its commands run.
        start_work: The folder of the start's tree, whose records and inputs both trees read.
        golden: Folder of golden sets; those of the packages are used without.
    """

    name: str
    code: Path
    work: Path
    start_work: Path
    golden: Path | None = None
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

    def commands(self) -> dict[str, dict[str, Any]]:
        """Every command of the app, with its help, whether it does something itself, and the choices of its options."""
        found: dict[str, dict[str, Any]] = json.loads(
            self._start(["-c", Path(__file__).with_name("walk.py").read_text()]).stdout
        )
        return found

    def run(self, case: Case) -> Seen:
        """Run a case and say what was seen of it.

        Raises:
            SystemExit: If the start's tree ends with an exit code that is not of the case: nothing could be compared.
        """
        folder = self.work / case.name
        shutil.rmtree(folder, ignore_errors=True)
        self._inputs(case)
        folder.mkdir()
        for source in (*(self.work / name for name in case.own), *(self.start_work / name for name in case.of_start)):
            shutil.copytree(source, folder, dirs_exist_ok=True)
        before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
        seen: Seen = {}
        with self._served(case, seen) as url:
            for line in case.lines:
                if line == "@help":
                    for name, command in self.commands().items():
                        self._note(seen, f"{name} --help", command["help"])
                    continue
                given = re.sub(r" --golden \{golden\}/\S+" if self.golden is None else "^$", "", line)
                words = shlex.split(given.replace("{url}", url).replace("{golden}", str(self.golden)))
                done = self._start(["-m", "benchmark", *words])
                if self.code_is_start and done.returncode not in case.codes:
                    raise SystemExit(f"the start fails at {given} (exit code {done.returncode}): {done.stderr}")
                told = "".join(each for each in done.stderr.splitlines(True) if not _PROGRESS.search(each))
                said = f"exit code {done.returncode}\n{done.stdout}{told}"
                self._note(seen, line, said.replace(url, "http://HOST:PORT") if url else said)
        for path in sorted(folder.rglob("*")):
            if path.is_file() and before.get(path) != path.stat().st_mtime_ns:
                relative = path.relative_to(self.work).as_posix()
                if not any(part in relative for part in _SECONDS):
                    self._note_file(seen, relative, path)
        return seen

    @property
    def code_is_start(self) -> bool:
        """Whether this is the tree that the other is compared with."""
        return self.work == self.start_work

    def _inputs(self, case: Case) -> None:
        """Make what its lines name below ``inputs``, or take what was made for the start."""
        for name in sorted({name for line in case.lines for name in re.findall(r"\binputs/([\w.]+)", line)}):
            made, here = self.start_work / "inputs" / name, self.work / "inputs" / name
            if not made.exists():
                made.parent.mkdir(exist_ok=True)
                INPUTS[name](made, self.start_work)
            if not here.exists():
                here.parent.mkdir(exist_ok=True)
                (shutil.copytree if made.is_dir() else shutil.copy)(made, here)

    @contextlib.contextmanager
    def _served(self, case: Case, seen: Seen) -> Iterator[str]:
        """The address of the case's server while it runs, if it has one; what it told is compared."""
        if not case.serve:
            yield ""
            return
        command = [sys.executable, "-m", "benchmark", *shlex.split(case.serve)]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, cwd=self.work, env=self._environment(), stderr=pipe, text=True) as server:
            said, url = [], None
            while url is None and server.stderr and (line := server.stderr.readline()):
                said.append(line)
                url = re.search(r"http://\S+?:\d+", line)
            if url is None:
                raise SystemExit(f"{self.name}: {case.serve} does not serve: {''.join(said)}")
            try:
                yield url[0]
            finally:
                server.send_signal(signal.SIGINT)
                _, rest = server.communicate(timeout=60)
            text = f"exit code {server.returncode}\n{''.join(said)}{rest}"
            self._note(seen, case.serve, text.replace(url[0], "http://HOST:PORT"))

    def _note(self, seen: Seen, what: str, text: str) -> None:
        text = self._plain(text)
        seen[what] = [text, numbers_in(text)]

    def _note_file(self, seen: Seen, relative: str, path: Path) -> None:
        content = path.read_bytes()
        try:
            text = self._plain(content.decode())
        except UnicodeDecodeError:
            seen[relative] = [hashlib.sha256(content).hexdigest()] * 2
            if path.suffix in (".png", ".webp"):
                # Words may be drawn in it; that there is such a picture is what remains.
                seen[relative][1] = "a picture"
            return
        seen[relative] = [hashlib.sha256(each.encode()).hexdigest() for each in (text, numbers_in(text))]

    def _plain(self, text: str) -> str:
        """A text without what differs between two trees and folders that do the same."""
        text = text.replace(str(self.work), "WORK").replace(str(self.code), "CODE")
        return _MODULE.sub(r"\1", _DURATION.sub("", _OF_THE_COMMIT.sub('"source": {}', text)))

    def _start(self, arguments: list[str]) -> subprocess.CompletedProcess[str]:
        # Not the tree itself: relative paths then lie in the work folder, and PYTHONPATH leads to the tree.
        command = [sys.executable, *arguments]
        return subprocess.run(
            command, cwd=self.work, env=self._environment(), capture_output=True, text=True, check=False
        )

    def _environment(self) -> dict[str, str]:
        return {name: value for name, value in os.environ.items() if name != "CHALLENGER_BENCH_CACHE"} | {
            "PYTHONPATH": str(self.code),
            "XDG_CACHE_HOME": str(self.work / "cache"),
            "OMP_NUM_THREADS": "1",
            "COLUMNS": str(_WIDTH),
        }
