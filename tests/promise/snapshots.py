"""The snapshots beside this file: read, compared, and written anew by ``python -m tests.promise.renew``."""

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from tests.promise import surface

KEPT: Final = Path(__file__).resolve().parent / "kept"
CHANGELOG: Final = Path(__file__).resolve().parents[2] / "CHANGELOG.md"
SNAPSHOTS: Final[dict[str, Callable[[], list[str]]]] = {"face": surface.face, "options": surface.options}
"""Beside these there is ``json``, for which commands have to run (`tests.promise.said`)."""
_MARKS: Final = ((" | command", " | "), (" class", "."), (" function", "("))
_HEADS: Final = tuple(head for head, _ in _MARKS)
HOW: Final = "write what changed into the unreleased part of CHANGELOG.md and run python -m tests.promise.renew"


def stored(name: str, when: str = "now") -> list[str]:
    """Lines of a snapshot: as the code was when it was last renewed (``now``) or when the promise began (``then``)."""
    return (KEPT / f"{name}-{when}.txt").read_text().splitlines()


def unreleased(changelog: str) -> str:
    """The part of the changelog on the version that is not released yet.

    Raises:
        ValueError: If there is none.
    """
    parts = re.split(r"^## ", changelog, flags=re.MULTILINE)
    found = [part for part in parts if part.partition("\n")[0].endswith("(unreleased)")]
    if len(found) != 1:
        raise ValueError("CHANGELOG.md has no part, or more than one, whose head ends in (unreleased)")
    return found[0]


def word_of(line: str) -> str:
    """What a reader of the changelog looks for: the option, else the last word of the command, else the name."""
    command, _, rest = line.partition(" | ")
    if not rest:
        return re.split(r"[ .(:]", line, maxsplit=1)[0]
    return rest.split(" | ")[0].split("/")[0] if rest.startswith("--") else command.split()[-1]


def gone_unsaid(before: list[str], now: list[str], changelog: str) -> list[str]:
    """Members of JSON that are gone and that the unreleased part of the changelog does not name; new ones may come."""
    gone = [re.split(r"[.\[]", line.rstrip("[]*."))[-1].split(" | ")[-1] for line in sorted({*before} - {*now})]
    return without_mention(gone, changelog)


def without_mention(words: Iterable[str], changelog: str) -> list[str]:
    """Those words that do not stand, as words, in the unreleased part of the changelog; each once."""
    said = unreleased(changelog)
    return [word for word in dict.fromkeys(words) if not re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", said)]


def broken_unsaid(before: list[str], now: list[str], changelog: str) -> list[str]:
    """Words of what is gone or no longer as it was and that the unreleased part of the changelog does not have."""
    return without_mention(map(word_of, sorted({*before} - {*now})), changelog)


def unsaid(before: list[str], now: list[str], changelog: str) -> list[str]:
    """Words of all that changed, additions too, that the unreleased part of the changelog does not have.

    What belongs to a command or to a class that is new as a whole goes without saying.
    """
    known, present = set(before), set(now)
    heads = {line for line in present - known if line.endswith(_HEADS)}
    whole = tuple(line.removesuffix(head) + mark for line in heads for head, mark in _MARKS if line.endswith(head))
    changed = [line for line in sorted(known ^ present) if line in heads or not line.startswith(whole)]
    return without_mention(map(word_of, changed), changelog)
