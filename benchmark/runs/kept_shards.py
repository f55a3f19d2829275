"""Shards of work that the same command without ``--shard`` finishes: drives, quality, and splits searched and drawn.

What a shard makes is kept under content keys, each piece in a file of its own. When all of its share is there it leaves
a note in a folder that nobody else writes to; the finishing command makes nothing while a note is missing.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from benchmark.errors import InputError
from benchmark.machine.storage import read_json, write_json
from benchmark.records.store import validated
from benchmark.records.stored import Stored
from benchmark.runs.shards import SHARDS_FOLDER, Shard, shard_folder
from benchmark.untrusted.limits import RECORD


@dataclass(frozen=True, slots=True)
class ShardedWork:
    """A kind of work that is done in shards.

    Attributes:
        note: Name of the file that a shard leaves when all of its share is there.
        what: What is made, for people.
        command: Which command makes it.
    """

    note: str
    what: str
    command: str


DRIVES: Final = ShardedWork("drives.json", "drives", "drive")
SCORES: Final = ShardedWork("scores.json", "scores", "quality")
SEARCH: Final = ShardedWork("search.json", "search", "generate")
DRAWING: Final = ShardedWork("drawing.json", "drawing", "generate")


class DoneShard(Stored):
    """What a shard says when all of its share is there: the pieces are found by their content.

    Attributes:
        number: Which, from 1.
        of: How many there are.
        scenes: Scenes that it did.
        work: Content key of what decides the work of all shards; empty where the folder decides it.
    """

    number: int
    of: int
    scenes: list[str]
    work: str = ""


@dataclass(frozen=True, slots=True)
class FinishedShard:
    """What a shard of a record did.

    Attributes:
        directory: Folder of the record.
        done: How many scenes it did or found done.
        scenes: How many the whole run has.
    """

    directory: Path
    done: int
    scenes: int


@dataclass(frozen=True, slots=True)
class Division:
    """How far work in shards is.

    Attributes:
        directory: Folder in which the shards leave their notes.
        kind: Which work.
        of: How many shards there are.
        done: Numbers of those that are done.
    """

    directory: Path
    kind: ShardedWork
    of: int
    done: frozenset[int]

    @property
    def missing(self) -> tuple[Shard, ...]:
        """Shards that are not done."""
        return tuple(Shard(number, self.of) for number in range(1, self.of + 1) if number not in self.done)

    def sentence(self) -> str:
        """What is missing, and what to run."""
        folder, command = self.directory / SHARDS_FOLDER, f"the same {self.kind.command} command"
        if not self.missing:
            return f"{self.directory}: all shards of the {self.kind.what} are done; run {command} without --shard"
        named = ", ".join(map(str, self.missing[:3]))
        rest = f" and {len(self.missing) - 3} more" if len(self.missing) > 3 else ""
        return (
            f"{self.directory}: shard {named}{rest} of the {self.kind.what} is missing; run {command} with --shard "
            f"{self.missing[0]}, or remove {folder} to do what is missing without shards"
        )


def note_done(directory: Path, kind: ShardedWork, shard: Shard, scenes: Sequence[str], work: str = "") -> None:
    """Write what a shard says when all of its share is there.

    Args:
        directory: Folder of the whole.
        kind: Which work.
        shard: Which shard.
        scenes: Scenes that it did.
        work: Content key of what decides the work of all shards.

    Raises:
        InputError: If it cannot be written.
    """
    facts = DoneShard(number=shard.number, of=shard.of, scenes=list(scenes), work=work)
    write_json(shard_folder(directory, shard) / kind.note, facts.model_dump(mode="json"))


def division_of(directory: Path, kind: ShardedWork, work: str = "") -> Division | None:
    """How far the shards of some work are.

    Args:
        directory: Folder of the whole.
        kind: Which work.
        work: Content key that every note must have; with none they are not compared.

    Returns:
        It, or ``None`` where no shard ever began.

    Raises:
        InputError: If there are shards of several divisions, a note is damaged, or it is of other work.
    """
    begun = [
        Shard(int(found.group(1)), int(found.group(2)))
        for path in (directory / SHARDS_FOLDER).glob("*-of-*")
        if (found := re.fullmatch(r"(\d{1,6})-of-(\d{1,6})", path.name))
    ]
    counts = sorted({shard.of for shard in begun})
    if not counts:
        return None
    if len(counts) > 1:
        raise InputError(
            f"the {kind.what} in {directory} were begun in shards of {' and of '.join(map(str, counts))}; remove the "
            f"folders of the others from {directory / SHARDS_FOLDER}"
        )
    done = {shard.number for shard in begun if _is_done(directory, kind, shard, work)}
    return Division(directory, kind, counts[0], frozenset(done))


def _is_done(directory: Path, kind: ShardedWork, shard: Shard, work: str) -> bool:
    path = shard_folder(directory, shard) / kind.note
    if not path.is_file():
        return False
    try:
        held = read_json(path, RECORD)
    except InputError as error:
        raise InputError(_fault(path, kind, shard, "", "it cannot be read")) from error
    facts = validated(DoneShard.model_validate, held, partial(_fault, path, kind, shard))
    if (facts.number, facts.of) != (shard.number, shard.of):
        raise InputError(_fault(path, kind, shard, "number", f"it is that of shard {facts.number}/{facts.of}"))
    if work and facts.work != work:
        raise InputError(
            f"{directory}: shard {shard} of the {kind.what} was done with other options or other data than these; give "
            f"the options that the shards were given, or run {kind.command} with these options and --shard {shard}"
        )
    return True


def _fault(path: Path, kind: ShardedWork, shard: Shard, where: str, why: str) -> str:
    return (
        f"{path} is not the note of a shard: {where or 'the whole'}: {why}; run the same {kind.command} command with "
        f"--shard {shard} again"
    )


def require_shards(directory: Path, kind: ShardedWork, work: str = "") -> Division | None:
    """Refuse to finish what some shards did and others did not.

    Args:
        directory: Folder of the whole.
        kind: Which work.
        work: As of `division_of`.

    Returns:
        The shards, all of them done, or ``None`` where there are none.

    Raises:
        InputError: If a shard is missing, which is named, or as of `division_of`.
    """
    division = division_of(directory, kind, work)
    if division is not None and division.missing:
        raise InputError(division.sentence())
    return division


def require_undivided(directory: Path, kind: ShardedWork, shard: Shard) -> None:
    """Refuse a shard where others are of another division.

    Args:
        directory: Folder of the whole.
        kind: Which work.
        shard: Which shard is to be done.

    Raises:
        InputError: If there are shards of another number.
    """
    for path in sorted((directory / SHARDS_FOLDER).glob("*-of-*")):
        of = path.name.rpartition("-")[2]
        if of != str(shard.of):
            raise InputError(
                f"the {kind.what} in {directory} were begun in shards of {of}; run --shard {min(shard.number, int(of))}"
                f"/{of}, or remove {path.parent} to divide anew"
            )


def waiting(folder: Path, kind: ShardedWork, pattern: str) -> list[Division]:
    """Work below a folder of which shards wait to be finished.

    Args:
        folder: Where to look.
        kind: Which work.
        pattern: Where below it the folders of ``shards`` are, as of `pathlib.Path.glob`.

    Returns:
        How far each is, by path.

    Raises:
        InputError: As of `division_of`.
    """
    places = sorted({path.parent for path in folder.glob(f"{pattern}/{SHARDS_FOLDER}")})
    found = [division_of(place, kind) for place in places]
    return [division for division in found if division is not None]
