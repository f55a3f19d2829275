"""One command killed at two moments of chance and run to its end, and every byte that it leaves compared."""

import contextlib
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Final

from bench.attacking.children import Ended, begin_command, end_command, run_command
from bench.killing.commands import Killed, words, write_needed, write_recorded
from benchmark.errors import InputError
from benchmark.machine.workspace import TIMINGS_FOLDER

TRIES_AT_LAST: Final = 2
"""Commands after a kill until one ends well: a worker that outlived its command may still hold the folder at first."""
EXEMPT: Final = {TIMINGS_FOLDER: "how long work took, which no two runs have the same; outside of every data root"}
"""Folders of ``--out`` that are not compared, and why."""
_RAY_WORKER: Final = "ray::_unit"
_AT: Final = "at "
_CLUSTER: Final = f"""
import sys
from ray.cluster_utils import Cluster
node = {{"num_cpus": 2, "object_store_memory": 80 * 2**20, "include_dashboard": False}}
cluster = Cluster(initialize_head=True, head_node_args=node)
print({_AT!r} + cluster.address, flush=True)
sys.stdin.read()
cluster.shutdown()
"""
_FULL: Final = ("No space left", "free some space")
"""What a command says that meets a full disk, or sees before it begins that there is too little room."""
_LOOK_S: Final = 0.01
_PATIENCE_S: Final = 300.0

Listing = dict[str, str]
"""Hash of each file, the target of each link, by path; folders end with a slash."""


@dataclass(frozen=True, slots=True)
class Series:
    """What became of one case.

    Attributes:
        command: Which command.
        how: What was done to it.
        number: Of the case.
        killed: How many of its kills met it alive.
        differences: Paths that are not as an undisturbed command leaves them.
        files: How many files were compared.
        said: Why it did not end well, if so.
    """

    command: str
    how: str
    number: int
    killed: int
    differences: list[str] = field(default_factory=list)
    files: int = 0
    said: str = ""

    @property
    def same(self) -> bool:
        """Whether nothing tells that it was disturbed."""
        return not self.differences and not self.said


class Bench:
    """A folder in which commands are run undisturbed once, and disturbed many times at the same place."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder.resolve(), seed
        self.case = self.folder / "case"
        self.data = write_recorded(self.folder / "recorded")
        self._left: dict[str, Listing] = {}
        self._lasting: dict[tuple[str, int], float] = {}
        self._pages: dict[str, int] = {}
        self._cluster: RayHere | None = None

    @property
    def cluster(self) -> "RayHere":
        """A cluster of Ray of its own, begun where it is first wanted."""
        if self._cluster is None:
            self._cluster = RayHere()
        return self._cluster

    def end(self) -> None:
        """Stop what runs beside the commands."""
        if self._cluster is not None:
            self._cluster.end()

    def undisturbed(self, command: Killed, workers: int) -> tuple[Listing, float]:
        """What a command leaves, and how long it takes with so many workers, seconds."""
        if command.name not in self._left or (command.name, workers) not in self._lasting:
            self._begin(command)
            ended = self._run(command, workers)
            if ended.code:
                raise InputError(f"{command.name} failed undisturbed: {ended.err.strip()[-400:]}; mend it first")
            self._lasting[command.name, workers] = ended.wall_s
            self._pages.setdefault(command.name, pages_below(self.case / "out"))
            found = listing(self.case)
            if self._left.setdefault(command.name, found) != found:
                names = differences(self._left[command.name], found)
                raise InputError(f"{command.name} leaves other bytes with {workers} workers: {names[:5]}")
        return self._left[command.name], self._lasting[command.name, workers]

    def killed(self, command: Killed, workers: int, number: int) -> Series:
        """Kill a command with all its processes twice in a row, then let it end."""
        wanted, lasts_s = self.undisturbed(command, workers)
        chance, kills = Random(f"{self.seed}/{command.name}/{workers}/{number}"), 0
        self._begin(command)
        for _ in range(2):
            with self._begun(command, workers) as (child, printed):
                time.sleep(chance.random() * lasts_s)
                with contextlib.suppress(ProcessLookupError):
                    # The first worker notices that its command is gone; at times it goes alone.
                    (os.kill if chance.random() < 0.3 else os.killpg)(child, signal.SIGKILL)
                kills += end_command(child, printed, _PATIENCE_S).code == -signal.SIGKILL
        return self._compared(command, f"killed, {workers} worker{'s' * (workers > 1)}", number, kills, wanted, workers)

    def worker_killed_on_ray(self, command: Killed, number: int) -> Series:
        """Kill a worker of Ray while a command runs; the command goes on by itself."""
        wanted, lasts_s = self.undisturbed(command, 1)
        chance, kills = Random(f"{self.seed}/{command.name}/ray/{number}"), 0
        self._begin(command)
        with self._begun(command, 0, ray=self.cluster.address) as (child, printed):
            wait, began = chance.random() * lasts_s, time.monotonic()
            working: float | None = None
            while alive(child) and time.monotonic() - began < _PATIENCE_S and not kills:
                workers = busy_ray_workers(self.cluster.head)
                working = working or (time.monotonic() if workers else None)
                if working is not None and workers and time.monotonic() - working > wait:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(chance.choice(workers), signal.SIGKILL)
                        kills += 1
                time.sleep(_LOOK_S)
            ended = end_command(child, printed, _PATIENCE_S)
        said = "" if ended.code == 0 else ended.err.strip()[-400:]
        return self._compared(command, "a worker of Ray killed", number, kills, wanted, 1, said)

    def driver_killed_on_ray(self, command: Killed, number: int) -> Series:
        """Kill the command that works on Ray, once its workers are at work; then the same command goes on."""
        wanted, lasts_s = self.undisturbed(command, 1)
        chance, kills = Random(f"{self.seed}/{command.name}/driver/{number}"), 0
        self._begin(command)
        for _ in range(2):
            with self._begun(command, 0, ray=self.cluster.address) as (child, printed):
                began = time.monotonic()
                while (
                    alive(child) and not busy_ray_workers(self.cluster.head) and time.monotonic() - began < _PATIENCE_S
                ):
                    time.sleep(_LOOK_S)
                time.sleep(chance.random() * lasts_s)
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
                kills += end_command(child, printed, _PATIENCE_S).code == -signal.SIGKILL
        return self._compared(command, "the driver of Ray killed", number, kills, wanted, 1)

    def full_disk(self, command: Killed, number: int) -> Series:
        """Run a command on a disk that gets full, then with room; needs the right to mount."""
        wanted, _ = self.undisturbed(command, 1)
        chance = Random(f"{self.seed}/{command.name}/disk/{number}")
        self._begin(command)
        out = self.case / "out"
        has = pages_below(out)
        # One page less than all is the most that is too little.
        room = has + 1 + int(chance.random() * max(1, self._pages[command.name] - has - 1))
        before = self.folder / "before"
        shutil.rmtree(before, ignore_errors=True)
        out.rename(before)
        out.mkdir()
        with mounted(out, room) as give_room:
            shutil.copytree(before, out, dirs_exist_ok=True)
            ended = self._run(command, 1)
            said = "" if ended.code == 0 else ended.err.strip().splitlines()[-1][:400]
            full = ended.code == 2 and said.startswith("error: ") and any(each in said for each in _FULL)
            give_room()
            wrong = "" if full or ended.code == 0 else f"a full disk: exit code {ended.code}, {said}"
            return self._compared(command, "a full disk", number, int(full), wanted, 1, wrong)

    def _begin(self, command: Killed) -> None:
        """An ``--out`` with what the command needs, nothing else."""
        needed = write_needed(command, self.data, self.folder / "needed", self.case)
        shutil.rmtree(self.case, ignore_errors=True)
        shutil.copytree(needed, self.case / "out")

    def _run(self, command: Killed, workers: int) -> Ended:
        given = words(command, self.data, self.case / "out", workers)
        return run_command(given, self.case, self.case / "cache", patience=_PATIENCE_S)

    @contextlib.contextmanager
    def _begun(
        self, command: Killed, workers: int, *, ray: str | None = None
    ) -> Iterator[tuple[int, tuple[Path, Path]]]:
        given = words(command, self.data, self.case / "out", workers, ray=ray)
        child, printed = begin_command(given, self.case, self.case / "cache")
        try:
            yield child, printed
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)

    def _compared(
        self, command: Killed, how: str, number: int, kills: int, wanted: Listing, workers: int, said: str = ""
    ) -> Series:
        for _ in range(TRIES_AT_LAST):
            ended = self._run(command, workers)
            if ended.code == 0:
                break
            time.sleep(1.0)
        else:
            said = said or f"does not go on: {ended.err.strip()[-400:]}"
        found = listing(self.case)
        return Series(command.name, how, number, kills, differences(wanted, found), len(wanted), said)


def pages_below(folder: Path) -> int:
    """Pages that what is below a folder takes on a disk in memory, on which folders take none."""
    return sum(-(-path.lstat().st_size // 4096) for path in folder.rglob("*") if path.is_file())


class RayHere:
    """A cluster of two processors on this machine, which ends with this process.

    Attributes:
        address: HOST:PORT.
        head: The process below which all of it runs.
    """

    def __init__(self) -> None:
        process = subprocess.Popen(
            [sys.executable, "-c", _CLUSTER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdin is not None and process.stdout is not None
        said = (line.strip() for line in process.stdout)
        self.address = next(line.removeprefix(_AT) for line in said if line.startswith(_AT))
        self.head, self._process = process.pid, process

    def end(self) -> None:
        """Stop it."""
        self._process.communicate(timeout=_PATIENCE_S)


@contextlib.contextmanager
def mounted(folder: Path, pages: int) -> Iterator[Callable[[], None]]:
    """A disk in memory with so many pages of room in a folder; what is yielded gives it room enough.

    Raises:
        InputError: If this user may not mount.
    """
    mount = ["mount", "-t", "tmpfs", "-o", f"size={pages * 4096}", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        raise InputError("this user may not mount a small disk, so a full one cannot be had; leave --how disk out")

    def give_room() -> None:
        subprocess.run(["mount", "-o", "remount,size=1g", str(folder)], check=True)

    try:
        yield give_room
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def listing(folder: Path) -> Listing:
    """Everything below a folder, hidden files and empty folders too, but for what is `EXEMPT`."""
    found = {}
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if parts[0] == "out" and len(parts) > 1 and parts[1] in EXEMPT:
            continue
        name = "/".join(parts)
        if path.is_symlink():
            found[name] = f"link to {path.readlink()}"
        elif path.is_dir():
            found[f"{name}/"] = ""
        else:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def differences(wanted: Listing, found: Listing) -> list[str]:
    """What is missing, too many, or other bytes."""
    named = {name: ("missing" if name not in found else "left over" if name not in wanted else "other bytes")
             for name in sorted(wanted.keys() | found.keys())}  # fmt: skip
    return [f"{name}: {what}" for name, what in named.items() if wanted.get(name) != found.get(name)]


def alive(child: int) -> bool:
    """Whether a child process runs; it is not waited for."""
    try:
        state = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def busy_ray_workers(child: int) -> list[int]:
    """Workers of Ray below a process that have a unit of work: their titles name its function."""
    parents = {}
    titles = {}
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            parents[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            titles[int(path.name)] = (path / "cmdline").read_bytes().split(b"\0")[0].decode(errors="replace")

    def below(number: int) -> bool:
        while number > 1:
            number = parents.get(number, 0)
            if number == child:
                return True
        return False

    busy = [each for each, title in titles.items() if title.startswith(_RAY_WORKER)]
    return [each for each in busy if below(each)]
