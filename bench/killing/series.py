"""One command killed at two moments of chance and run to its end, and every byte that it leaves compared."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from random import Random
from typing import Final

from bench.attacking.children import CommandOutcome, RunningCommand, begin_command, run_command
from bench.attacking.requests import OwnServer
from bench.killing.commands import KilledCommand, words, write_needed, write_recorded
from bench.processes import command_line, descendants, is_alive
from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256
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

WAYS: Final = {
    "kill": ("killed, {workers} worker{s}", "{workers}"),
    "ray-worker": ("a worker of Ray killed", "ray"),
    "ray-driver": ("the driver of Ray killed", "driver"),
    "disk": ("a full disk", "disk"),
    "server": ("its model server killed", "server"),
}
"""What may be done to a command: how the table says it, and the word for it in a case's seed."""
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


class KillBench:
    """A folder in which commands are run undisturbed once, and disturbed many times at the same place."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder.resolve(), seed
        self.case = self.folder / "case"
        self.data = write_recorded(self.folder / "recorded")
        self._build_away_error: dict[str, Listing] = {}
        self._lasting: dict[tuple[str, int], float] = {}
        self._pages: dict[str, int] = {}
        self._beside = contextlib.ExitStack()

    @cached_property
    def cluster(self) -> tuple[str, int]:
        """Address and process of a cluster of Ray of its own, begun where it is first wanted."""
        return self._beside.enter_context(start_ray())

    @cached_property
    def server(self) -> OwnServer:
        """A model server, begun where it is first wanted."""
        return OwnServer(self.folder / "served")

    def end(self) -> None:
        """Stop what runs beside the commands."""
        self._beside.close()

    def undisturbed(self, command: KilledCommand, workers: int) -> tuple[Listing, float]:
        """What a command leaves, and how long it takes with so many workers, seconds."""
        if command.name not in self._build_away_error or (command.name, workers) not in self._lasting:
            self._begin(command)
            ended = self._describe_run(command, workers)
            if ended.code:
                raise InputError(f"{command.name} failed undisturbed: {ended.err.strip()[-400:]}; mend it first")
            self._lasting[command.name, workers] = ended.wall_s
            self._pages.setdefault(command.name, pages_below(self.case / "out"))
            left = listing(self.case)
            if self._build_away_error.setdefault(command.name, left) != left:
                names = differences(self._build_away_error[command.name], left)
                raise InputError(f"{command.name} leaves other bytes with {workers} workers: {names[:5]}")
        return self._build_away_error[command.name], self._lasting[command.name, workers]

    def disturbed(self, command: KilledCommand, how: str, workers: int, number: int) -> Series:
        """Disturb a command in one of the `WAYS`, let it end, and compare what it leaves."""
        row, word = (template.format(workers=workers, s="s" * (workers > 1)) for template in WAYS[how])
        wanted, lasts_s = self.undisturbed(command, workers)
        chance = Random(f"{self.seed}/{command.name}/{word}/{number}")
        self._begin(command)
        with contextlib.ExitStack() as until_compared:
            if how == "disk":
                kills, note = self._fill_the_disk(command, chance, until_compared)
            else:
                kills, note = self._kill(command, how, workers, lasts_s, chance)
            for _ in range(TRIES_AT_LAST):
                ended = self._describe_run(command, workers)
                if ended.code == 0:
                    break
                time.sleep(1.0)
            else:
                note = note or f"does not go on: {ended.err.strip()[-400:]}"
            left = listing(self.case)
        return Series(command.name, row, number, kills, differences(wanted, left), len(wanted), note)

    def _kill(self, command: KilledCommand, how: str, workers: int, lasts_s: float, chance: Random) -> tuple[int, str]:
        """Kill something at a moment of chance: a command twice in a row, what works for it once; and let it end.

        Returns:
            How often it met a command at work; what is wrong of one that should have gone on by itself.
        """
        kills, note, dies = 0, "", how in ("kill", "ray-driver")
        ray = self.cluster[0] if how.startswith("ray") else ""
        for _ in range(1 + dies):
            with begin_command(self._words(command, workers, ray), self.case) as begun:
                if ray:
                    self._busy_on_ray(begun.process)
                time.sleep(chance.random() * lasts_s)
                met = self._strike(how, begun, chance)
                ended = begun.end(_PATIENCE_S)
            kills += ended.code == -signal.SIGKILL if dies else met
            note = "" if dies or ended.code == 0 else ended.err.strip()[-400:]
        return kills, note

    def _strike(self, how: str, begun: RunningCommand, chance: Random) -> bool:
        """Kill what is to be killed; whether a command was there that it works for."""
        met = is_alive(begun.process)
        if how == "server":
            self.server.end()
            self.server.begin()
        elif how == "kill" and chance.random() >= 0.3:
            begun.kill()
        else:
            # The first worker of a command notices that it is gone; so does Ray.
            victims = self._busy_on_ray(begun.process) if how == "ray-worker" else [begun.process]
            met &= bool(victims)
            with contextlib.suppress(ProcessLookupError, IndexError):
                os.kill(victims[0] if len(victims) == 1 else chance.choice(victims), signal.SIGKILL)
        return met

    def _busy_on_ray(self, child: int) -> list[int]:
        """Workers of Ray as soon as some have a unit of work, which their titles name; none if the command ends."""
        until = time.monotonic() + _PATIENCE_S
        while is_alive(child) and time.monotonic() < until:
            if busy := [
                process for process in descendants(self.cluster[1]) if command_line(process).startswith(_RAY_WORKER)
            ]:
                return busy
            time.sleep(_LOOK_S)
        return []

    def _fill_the_disk(
        self, command: KilledCommand, chance: Random, until_compared: contextlib.ExitStack
    ) -> tuple[int, str]:
        """Run a command on a disk that gets full, then give it room; needs the right to mount."""
        out, before = self.case / "out", self.folder / "before"
        has = pages_below(out)
        # One page less than all is the most that is too little.
        room = has + 1 + int(chance.random() * max(1, self._pages[command.name] - has - 1))
        shutil.rmtree(before, ignore_errors=True)
        out.rename(before)
        out.mkdir()
        give_room = until_compared.enter_context(mount_disk(out, room))
        shutil.copytree(before, out, dirs_exist_ok=True)
        ended = self._describe_run(command, 1)
        note = "" if ended.code == 0 else ended.err.strip().splitlines()[-1][:400]
        full = ended.code == 2 and note.startswith("error: ") and any(phrase in note for phrase in _FULL)
        give_room()
        return int(full), "" if full or ended.code == 0 else f"a full disk: exit code {ended.code}, {note}"

    def _begin(self, command: KilledCommand) -> None:
        """An ``--out`` with what the command needs, nothing else."""
        needed = write_needed(command, self.data, self.folder / "needed", self.case)
        shutil.rmtree(self.case, ignore_errors=True)
        shutil.copytree(needed, self.case / "out")

    def _words(self, command: KilledCommand, workers: int, ray: str = "") -> list[str]:
        url = self.server.url if command.served else ""
        return words(command, self.data, self.case / "out", workers, ray=ray, url=url)

    def _describe_run(self, command: KilledCommand, workers: int) -> CommandOutcome:
        return run_command(self._words(command, workers), self.case, patience=_PATIENCE_S)


def pages_below(folder: Path) -> int:
    """Pages that what is below a folder takes on a disk in memory, on which folders take none."""
    return sum(-(-path.lstat().st_size // 4096) for path in folder.rglob("*") if path.is_file())


@contextlib.contextmanager
def start_ray() -> Iterator[tuple[str, int]]:
    """A cluster of two processors on this machine: its address, and the process below which all of it runs."""
    command, pipe = [sys.executable, "-c", _CLUSTER], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        lines = (line.strip() for line in process.stdout)
        yield next(line.removeprefix(_AT) for line in lines if line.startswith(_AT)), process.pid
        process.communicate(timeout=_PATIENCE_S)


@contextlib.contextmanager
def mount_disk(folder: Path, pages: int) -> Iterator[Callable[[], None]]:
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
    entries = {}
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if parts[0] == "out" and len(parts) > 1 and parts[1] in EXEMPT:
            continue
        name = "/".join(parts)
        if path.is_symlink():
            entries[name] = f"link to {path.readlink()}"
        elif path.is_dir():
            entries[f"{name}/"] = ""
        else:
            entries[name] = file_sha256(path)
    return entries


def differences(wanted: Listing, found: Listing) -> list[str]:
    """What is missing, too many, or other bytes."""
    names = sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))
    missing, more = wanted.keys() - found.keys(), found.keys() - wanted.keys()
    return [
        f"{name}: {'missing' if name in missing else 'left over' if name in more else 'other bytes'}" for name in names
    ]
