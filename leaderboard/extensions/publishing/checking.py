"""Folders that are to be published: traces of a machine, its network and people, and permission to show pictures."""

import contextlib
import getpass
import os
import re
import socket
from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from leaderboard.extensions.publishing.static_hosting import (
    FindingKind,
    PublicationFinding,
    check_file_names,
    check_markdown,
    check_page,
    check_script,
    check_style,
)
from leaderboard.site.packing import decode_script

_TOP_FOLDERS: Final = (
    *("home", "Users", "root", "tmp", "var", "mnt", "media", "data", "datasets", "work", "workspace", "opt", "srv"),
    *("scratch", "private", "usr", "etc", "nfs", "gpfs", "lustre", "proc", "dev", "cluster", "project", "projects"),
    *("storage", "share", "shared", "volumes", "Volumes", "Library", "content", "kaggle", "app", "code"),
)
"""First parts of absolute paths on many machines, beside those of this one."""
_COMMON_NAMES: Final = frozenset(
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
"""Generic names, which reveal nothing."""
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
class MachineIdentity:
    """Names that would tell of this machine; `folders` are first parts of absolute paths, `users` those logged in."""

    folders: tuple[str, ...]
    hosts: tuple[str, ...]
    users: tuple[str, ...]

    @classmethod
    def of_this_machine(cls) -> "MachineIdentity":
        """The machine that this runs on."""
        host = socket.gethostname()
        names = {host, host.partition(".")[0]}
        users = {os.environ.get(name, "") for name in ("USER", "LOGNAME", "SUDO_USER", "USERNAME")}
        users |= {Path.home().name}
        # A container may run under a user id without a name.
        with contextlib.suppress(KeyError, OSError):
            users.add(getpass.getuser())
        here = {path.name for path in Path("/").iterdir() if path.is_dir() and re.fullmatch(r"[\w.-]+", path.name)}
        return cls(tuple(sorted({*_TOP_FOLDERS, *here})), _select_identifying(names), _select_identifying(users))

    def search_text(self, text: str) -> Iterator[tuple[int, FindingKind, str]]:
        """Line, kind, and what was found of what tells of the house in a text."""
        ends = [place.start() for place in re.finditer("\n", text)]
        in_words: tuple[tuple[FindingKind, str], ...] = (("path", _HOME), ("host", _NUMERIC_HOST), ("user", _MAIL))
        patterns = [(kind, re.compile(pattern)) for kind, pattern in in_words]
        for kind, pattern in (*self._common_patterns(_SHORTEST_NAME), *patterns):
            for match in pattern.finditer(text):
                yield 1 + bisect_left(ends, match.start()), kind, match.group()[:_LONGEST_SHOWN]

    def search_binary(self, content: bytes) -> Iterator[tuple[FindingKind, str]]:
        """Findings, without lines, in a picture or another file without lines, where random bytes make short words."""
        text = "\n".join(run.decode("ascii") for run in _READABLE.findall(content))
        for kind, pattern in self._common_patterns(_SHORTEST_IN_BINARY):
            for match in pattern.finditer(text):
                if len(match.group()) >= _SHORTEST_IN_BINARY:
                    yield kind, match.group()[:_LONGEST_SHOWN]

    def _common_patterns(self, shortest: int) -> Iterator[tuple[FindingKind, re.Pattern[str]]]:
        """Patterns looked for in pictures too: they hardly come about by chance."""
        folders = "|".join(map(re.escape, self.folders))
        # Not the path of an address, nor a part of a longer or a relative path.
        yield "path", re.compile(rf"{_NOT_WITHIN}/(?:{folders})(?:/[\w.@+=,~%-]+)+")
        yield "path", re.compile("|".join((_WINDOWS, _FILE_ADDRESS)))
        yield "host", re.compile(_INNER_HOST)
        yield "secret", re.compile(_SECRET)
        kinds: tuple[tuple[FindingKind, tuple[str, ...]], ...] = (("host", self.hosts), ("user", self.users))
        for kind, private in kinds:
            known = [re.escape(name) for name in private if len(name) >= shortest]
            if known:
                yield kind, re.compile(rf"(?<![\w-])(?:{'|'.join(known)})(?![\w-])", re.IGNORECASE)


def _select_identifying(names: set[str]) -> tuple[str, ...]:
    return tuple(sorted(name for name in names if len(name) >= _SHORTEST_NAME and name.lower() not in _COMMON_NAMES))


INDEX: Final = "data/index.js"
DRAWN: Final = ("schematic", "schematic-restyled")
"""Renderers that draw boxes and maps; no pixel is of a recording."""
_NAMED: Final = 3


def find_recorded_pictures(
    root: str, read: Mapping[str, str], there: Collection[str], may_show: Collection[str]
) -> Iterator[PublicationFinding]:
    """Findings of camera pictures, one a data set, split and renderer, that are not said to be showable, or untold.

    `root` is the path of the site below the folder, with a slash at its end, or empty; `read` are texts of its scripts.
    """
    recorded_keys = {
        file.removeprefix(f"{root}media/").partition("/")[0]
        for file in there
        if file.startswith(f"{root}media/") and "/cameras/" in file
    }
    if not recorded_keys:
        return
    index = f"{root}{INDEX}"
    try:
        scenes = decode_script(read[index])["scenes"]
        known = {str(scene["key"]): scene for scene in scenes}
        rows = [known[key] for key in sorted(recorded_keys)]
        groups: dict[tuple[str, str, str | None], list[str]] = defaultdict(list)
        for row in rows:
            groups[str(row["data"]), str(row["split"]), _find_renderer(row)].append(str(row["scene"]))
    except (InputError, KeyError, TypeError):
        yield PublicationFinding(
            index, 0, "picture", "there are camera pictures below media/, but their origin is not recorded"
        )
        return
    for (data, split, drawn_by), scenes in sorted(
        groups.items(), key=lambda one: (one[0][0], one[0][1], one[0][2] or "")
    ):
        if drawn_by in DRAWN or data in may_show:
            continue
        maker = f"drawn by {drawn_by} from recordings" if drawn_by else "presumably taken by cameras"
        some = ", ".join(sorted(scenes)[:_NAMED]) + (", ..." if len(scenes) > _NAMED else "")
        yield PublicationFinding(
            f"{root}media",
            0,
            "picture",
            f"pictures of {len(scenes)} scenes of {data}, split {split} ({some}), {maker}: read the licence of the "
            f"recordings; if it allows publication, name the data set with --may-show {data}, else write the sheets "
            "again with --pictures none",
        )


def _find_renderer(row: Mapping[str, Any]) -> str | None:
    name = row.get("drawnBy")
    return name if isinstance(name, str) else None


_MOST_PER_WORD: Final = 5
"""So often is one word of one file named; then it is counted."""
_MOST_TEXT_BYTES: Final = 256 * 1024 * 1024
LEADERBOARD: Final = "leaderboard"


def check_publishable(
    folder: Path, *, may_show: Collection[str] = (), house: MachineIdentity | None = None
) -> tuple[Path, list[PublicationFinding]]:
    """Say what of a site or a leaderboard should not leave the house, or does not work on a static host.

    Args:
        folder: A site, a leaderboard, or a folder of outputs with a leaderboard in it.
        may_show: Names of data sets whose pictures may be shown.
        house: Names and paths that identify the machine; this one by default.

    Returns:
        The folder that was looked at, and what was found, by file.

    Raises:
        InputError: If there is no such folder, nothing is in it, or a file cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; name the folder to publish")
    below = folder / LEADERBOARD
    root = below if below.is_dir() and not (folder / INDEX).is_file() else folder
    files = {path.relative_to(root).as_posix(): path for path in sorted(root.rglob("*")) if not path.is_dir()}
    if not files:
        raise InputError(f"{root} is empty; run challenger-bench leaderboard first")
    findings = list(_check_files(files, tuple(may_show), house or MachineIdentity.of_this_machine()))
    return root, sorted(set(findings))


def _check_files(
    files: dict[str, Path], may_show: Collection[str], house: MachineIdentity
) -> Iterator[PublicationFinding]:
    there: dict[str, int] = {}
    indices: dict[str, str] = {}
    for file, path in files.items():
        if path.is_symlink():
            yield PublicationFinding(file, 0, "link", "is a link that leads outside; publish a copy")
        else:
            there[file] = path.stat().st_size
    for file in there:
        content = _read_content(files[file])
        text = _decode_text(content)
        if text is None:
            yield from (PublicationFinding(file, 0, kind, f"{word!r}") for kind, word in house.search_binary(content))
            continue
        yield from _find_identifying_words(file, text, house)
        yield from _check_addresses(file, text, there)
        if file == INDEX or file.endswith(f"/{INDEX}"):
            indices[file] = text
    yield from check_file_names(there)
    roots = {file.removesuffix(INDEX) for file in indices} | {
        file.partition("media/")[0] for file in there if "/cameras/" in file and "media/" in file
    }
    for root in sorted(roots):
        yield from find_recorded_pictures(root, indices, there, may_show)


def _find_identifying_words(file: str, text: str, house: MachineIdentity) -> Iterator[PublicationFinding]:
    """Findings of words that tell of the house in a text, each word of a file a few times."""
    often: Counter[tuple[FindingKind, str]] = Counter()
    for line, kind, word in house.search_text(text):
        often[kind, word] += 1
        if often[kind, word] <= _MOST_PER_WORD:
            yield PublicationFinding(file, line, kind, f"{word!r}")
    for (word_kind, word), count in often.items():
        if count > _MOST_PER_WORD:
            yield PublicationFinding(file, 0, word_kind, f"{word!r}, {count} times")


def _check_addresses(file: str, text: str, there: dict[str, int]) -> Iterator[PublicationFinding]:
    """Findings of addresses that a browser would follow from a text."""
    kind = Path(file).suffix.lower()
    if kind in (".html", ".htm", ".svg"):
        yield from check_page(file, text, there, is_whole=kind != ".svg")
    elif kind == ".css":
        yield from check_style(file, text, there)
    elif kind in (".js", ".mjs"):
        yield from check_script(file, text)
    elif kind == ".md":
        yield from check_markdown(file, text, there)


def _read_content(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MOST_TEXT_BYTES:
            raise InputError(f"{path} has more than {_MOST_TEXT_BYTES:,} bytes; remove it from the folder to publish")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def _decode_text(content: bytes) -> str | None:
    """A file's text, or ``None`` where it is none."""
    if b"\0" in content[:8192]:
        return None
    try:
        return content.decode()
    except UnicodeDecodeError:
        return None
