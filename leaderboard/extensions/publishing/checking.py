"""Look through a folder that is to be published."""

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

from benchmark.errors import InputError
from leaderboard.extensions.publishing.elsewhere import in_markdown, in_page, in_script, in_style, names
from leaderboard.extensions.publishing.findings import Found, Kind
from leaderboard.extensions.publishing.house import House
from leaderboard.extensions.publishing.pictures import INDEX, pictures_of_recordings

_MOST_OF_ONE: Final = 5
"""So often is one word of one file named; then it is counted."""
_MOST_TEXT_BYTES: Final = 256 * 1024 * 1024
LEADERBOARD: Final = "leaderboard"


def check_publishable(
    folder: Path, *, may_show: Collection[str] = (), house: House | None = None
) -> tuple[Path, list[Found]]:
    """Say what of a site or a leaderboard should not leave the house, or does not work on a static host.

    Args:
        folder: A site, a leaderboard, or a folder of outputs with a leaderboard in it.
        may_show: Names of data sets whose pictures may be shown.
        house: What tells of the machine; this one by default.

    Returns:
        The folder that was looked at, and what was found, by file.

    Raises:
        InputError: If there is no such folder, nothing is in it, or a file cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; name the one that is to be published")
    below = folder / LEADERBOARD
    root = below if below.is_dir() and not (folder / INDEX).is_file() else folder
    files = {path.relative_to(root).as_posix(): path for path in sorted(root.rglob("*")) if not path.is_dir()}
    if not files:
        raise InputError(f"{root} is empty; run challenger-bench leaderboard first")
    found = list(_found(files, tuple(may_show), house or House.this_one()))
    return root, sorted(set(found))


def _found(files: dict[str, Path], may_show: Collection[str], house: House) -> Iterator[Found]:
    there: dict[str, int] = {}
    indices: dict[str, str] = {}
    for file, path in files.items():
        if path.is_symlink():
            yield Found(file, 0, "link", "is a link to elsewhere; publish a copy")
        else:
            there[file] = path.stat().st_size
    for file in there:
        content = _content(files[file])
        text = _text(content)
        if text is None:
            yield from (Found(file, 0, kind, f"{word!r}") for kind, word in house.in_binary(content))
            continue
        yield from _words(file, text, house)
        yield from _followed(file, text, there)
        if file == INDEX or file.endswith(f"/{INDEX}"):
            indices[file] = text
    yield from names(there)
    roots = {file.removesuffix(INDEX) for file in indices} | {
        file.partition("media/")[0] for file in there if "/cameras/" in file and "media/" in file
    }
    for root in sorted(roots):
        yield from pictures_of_recordings(root, indices, there, may_show)


def _words(file: str, text: str, house: House) -> Iterator[Found]:
    """Findings of words that tell of the house in a text, each word of a file a few times."""
    often: Counter[tuple[Kind, str]] = Counter()
    for line, kind, word in house.in_text(text):
        often[kind, word] += 1
        if often[kind, word] <= _MOST_OF_ONE:
            yield Found(file, line, kind, f"{word!r}")
    for (what, word), count in often.items():
        if count > _MOST_OF_ONE:
            yield Found(file, 0, what, f"{word!r}, {count} times")


def _followed(file: str, text: str, there: dict[str, int]) -> Iterator[Found]:
    """Findings of addresses that a browser would follow from a text."""
    kind = Path(file).suffix.lower()
    if kind in (".html", ".htm", ".svg"):
        yield from in_page(file, text, there, is_whole=kind != ".svg")
    elif kind == ".css":
        yield from in_style(file, text, there)
    elif kind in (".js", ".mjs"):
        yield from in_script(file, text)
    elif kind == ".md":
        yield from in_markdown(file, text, there)


def _content(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MOST_TEXT_BYTES:
            raise InputError(f"{path} has more than {_MOST_TEXT_BYTES:,} bytes; take it out of what is to be published")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def _text(content: bytes) -> str | None:
    """A file's text, or ``None`` where it is none."""
    if b"\0" in content[:8192]:
        return None
    try:
        return content.decode()
    except UnicodeDecodeError:
        return None
