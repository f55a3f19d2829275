"""Words that tell of a machine, its network and its people: absolute paths, names of hosts and users, keys."""

import contextlib
import getpass
import os
import re
import socket
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from leaderboard.extensions.publishing.findings import Kind

_TOP_FOLDERS: Final = (
    *("home", "Users", "root", "tmp", "var", "mnt", "media", "data", "datasets", "work", "workspace", "opt", "srv"),
    *("scratch", "private", "usr", "etc", "nfs", "gpfs", "lustre", "proc", "dev", "cluster", "project", "projects"),
    *("storage", "share", "shared", "volumes", "Volumes", "Library", "content", "kaggle", "app", "code"),
)
"""First parts of absolute paths on many machines, beside those of this one."""
_ANYBODY: Final = frozenset(
    (
        "root",
        "home",
        "user",
        "admin",
        "ubuntu",
        "debian",
        "runner",
        "nobody",
        "docker",
        "jovyan",
        "vscode",
        "localhost",
        "host",
    )
)
"""Names that tell nothing."""
_SHORTEST_NAME: Final = 3
_SHORTEST_IN_BINARY: Final = 6
_READABLE: Final = re.compile(rb"[\x20-\x7e]{6,}")
_LONGEST_SHOWN: Final = 80
_NOT_WITHIN: Final = r"(?<![\w.:/\\})~-])"
_WINDOWS: Final = rf"(?<![A-Za-z])[A-Z]:\\+(?:{'|'.join(_TOP_FOLDERS)}|[A-Z][\w .$-]*)(?:\\+[\w.$-]+)+"
_HOME: Final = r"(?<![\w/])~[\w.-]*/[A-Za-z.][\w.-]*"
_FILE_ADDRESS: Final = r"file:///?[\w%.-]+"
_NUMERIC_HOST: Final = (
    r"(?<![\d.])(?:10|127|192\.168|172\.(?:1[6-9]|2\d|3[01]))(?:\.\d{1,3}){2,3}(?![\d.])|localhost:\d+"
)
_INNER_HOST: Final = r"(?<![\w.-])[a-z][\w-]*(?:\.[\w-]+)*\.(?:local|lan|internal|intranet|corp|localdomain)(?![\w.-])"
_MAIL: Final = r"(?<![\w.+-])[\w.+-]+@[\w-]+(?:\.[\w-]+)+"
_SECRET: Final = (
    r"-----BEGIN [A-Z ]*PRIVATE KEY-----|(?<![\w-])(?:hf_[A-Za-z0-9]{30,}|gh[pousr]_[A-Za-z0-9]{30,}|AKIA[A-Z0-9]{16}|"
    r"sk-[A-Za-z0-9_-]{30,}|xox[abpr]-[A-Za-z0-9-]{10,})"
)


@dataclass(frozen=True, slots=True)
class House:
    """House: names that would tell of this machine.

    `folders` are first parts of absolute paths, `users` those logged in.
    """

    folders: tuple[str, ...]
    hosts: tuple[str, ...]
    users: tuple[str, ...]

    @classmethod
    def this_one(cls) -> "House":
        """The machine that this runs on."""
        host = socket.gethostname()
        names = {host, host.partition(".")[0]}
        users = {os.environ.get(name, "") for name in ("USER", "LOGNAME", "SUDO_USER", "USERNAME")}
        users |= {Path.home().name}
        # A container may run as a number without a name.
        with contextlib.suppress(KeyError, OSError):
            users.add(getpass.getuser())
        here = {path.name for path in Path("/").iterdir() if path.is_dir() and re.fullmatch(r"[\w.-]+", path.name)}
        return cls(tuple(sorted({*_TOP_FOLDERS, *here})), _telling(names), _telling(users))

    def in_text(self, text: str) -> Iterator[tuple[int, Kind, str]]:
        """Line, kind, and what was found of what tells of the house in a text."""
        ends = [place.start() for place in re.finditer("\n", text)]
        in_words: tuple[tuple[Kind, str], ...] = (("path", _HOME), ("host", _NUMERIC_HOST), ("user", _MAIL))
        patterns = [(kind, re.compile(pattern)) for kind, pattern in in_words]
        for kind, pattern in (*self._anywhere(_SHORTEST_NAME), *patterns):
            for match in pattern.finditer(text):
                yield 1 + bisect_left(ends, match.start()), kind, match.group()[:_LONGEST_SHOWN]

    def in_binary(self, content: bytes) -> Iterator[tuple[Kind, str]]:
        """Findings, without lines, in a picture or another file without lines, where random bytes make short words."""
        text = "\n".join(run.decode("ascii") for run in _READABLE.findall(content))
        for kind, pattern in self._anywhere(_SHORTEST_IN_BINARY):
            for match in pattern.finditer(text):
                if len(match.group()) >= _SHORTEST_IN_BINARY:
                    yield kind, match.group()[:_LONGEST_SHOWN]

    def _anywhere(self, shortest: int) -> Iterator[tuple[Kind, re.Pattern[str]]]:
        """Patterns looked for in pictures too: they hardly come about by chance."""
        folders = "|".join(map(re.escape, self.folders))
        # Not the path of an address, nor a part of a longer or a relative path.
        yield "path", re.compile(rf"{_NOT_WITHIN}/(?:{folders})(?:/[\w.@+=,~%-]+)+")
        yield "path", re.compile("|".join((_WINDOWS, _FILE_ADDRESS)))
        yield "host", re.compile(_INNER_HOST)
        yield "secret", re.compile(_SECRET)
        kinds: tuple[tuple[Kind, tuple[str, ...]], ...] = (("host", self.hosts), ("user", self.users))
        for kind, names in kinds:
            known = [re.escape(name) for name in names if len(name) >= shortest]
            if known:
                yield kind, re.compile(rf"(?<![\w-])(?:{'|'.join(known)})(?![\w-])", re.IGNORECASE)


def _telling(names: set[str]) -> tuple[str, ...]:
    return tuple(sorted(name for name in names if len(name) >= _SHORTEST_NAME and name.lower() not in _ANYBODY))
