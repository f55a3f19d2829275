"""Parts of an evaluation for separate jobs: which scenes are whose, and what each leaves behind for `merge`.

A shard plans every n-th scene and keeps the plans where an evaluation of the whole split looks for them: a file a
scene, so that no two shards write the same one. What it planned, and who, is in a file of its own below ``shards/``.
"""

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, TypeVar

from benchmark.errors import InputError
from benchmark.machine.storage import read_json, write_json, writing_to
from benchmark.records.run_schema import PlannerFacts
from benchmark.records.store import validated
from benchmark.records.stored import Stored
from benchmark.untrusted.limits import RECORD

SHARDS_FOLDER: Final = "shards"

Part = TypeVar("Part")


@dataclass(frozen=True, slots=True)
class Shard:
    """One of so many parts.

    Attributes:
        number: Which, from 1.
        of: How many there are.
    """

    number: int
    of: int

    @classmethod
    def named(cls, text: str) -> Self:
        """The shard that a user asks for.

        Args:
            text: For example ``3/40``.

        Returns:
            The shard.

        Raises:
            InputError: If it is none.
        """
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        number, of = map(int, found.groups()) if found else (0, 0)
        if not 1 <= number <= of:
            raise InputError(f"--shard takes a number and how many shards there are, for example 3/40; got {text!r}")
        return cls(number, of)

    def part(self, everything: Sequence[Part]) -> tuple[Part, ...]:
        """What of a sequence is this shard's: every n-th, so that shards differ by one at most."""
        return tuple(everything[self.number - 1 :: self.of])

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


class ShardFacts(Stored):
    """What a shard says of itself; all but ``number`` and ``planned`` is the same for the shards of a run.

    Attributes:
        number: Which, from 1.
        of: How many there are.
        planned: Scenes that it planned.
        planner: Who.
        data: Name of the data set.
        fingerprint: Of the data set.
        split: Name of the split.
        scenes: Scenes of the whole run.
        protocols: Who judges when all shards are there.
        seed: Seed of the intervals.
        plans_from: Of plans from a file, where they come from.
    """

    number: int
    of: int
    planned: list[str]
    planner: PlannerFacts
    data: str
    fingerprint: str
    split: str
    scenes: list[str]
    protocols: list[str]
    seed: int
    plans_from: dict[str, Any] | None = None

    @property
    def run(self) -> dict[str, Any]:
        """What the shards of a run share."""
        return self.model_dump(mode="json", exclude={"number", "planned"})


def shard_folder(directory: Path, shard: Shard) -> Path:
    """Where a shard leaves what it says, below the run directory; nobody else writes there."""
    return directory / SHARDS_FOLDER / f"{shard.number}-of-{shard.of}"


def write_shard(directory: Path, facts: ShardFacts) -> None:
    """Write what a shard says of itself, when all its scenes are planned.

    Args:
        directory: Run directory.
        facts: What it says.

    Raises:
        InputError: If it cannot be written.
    """
    write_json(shard_folder(directory, Shard(facts.number, facts.of)) / "shard.json", facts.model_dump(mode="json"))


def sharded_runs(root: Path) -> list[Path]:
    """Run directories below a folder in which shards wait to be merged, by path."""
    return sorted({path.parents[2] for path in root.rglob(f"{SHARDS_FOLDER}/*-of-*/shard.json")})


def whole_run(directory: Path, data_name: str) -> ShardFacts | None:
    """What the shards of a run say, if all are there.

    Args:
        directory: Run directory.
        data_name: Name of the data set.

    Returns:
        The facts of the first, ``planned`` with all scenes; ``None`` for a run on another data set.

    Raises:
        InputError: If a shard is missing, which is named, or damaged, or the shards are not of one run.
    """
    found = {}
    for path in sorted((directory / SHARDS_FOLDER).glob("*-of-*/shard.json")):
        facts = validated(
            ShardFacts.model_validate,
            read_json(path, RECORD),
            lambda where, why, path=path: f"{path} is not that of a shard: {where}: {why}; plan that shard again",  # type: ignore[misc]
        )
        found[facts.number, facts.of] = facts
    if all(facts.data != data_name for facts in found.values()):
        return None
    counts = sorted({of for _, of in found})
    if len(counts) != 1:
        raise InputError(
            f"{directory} was planned in shards of {' and of '.join(map(str, counts)) or 'nothing'}; remove the "
            f"folders of the others from {directory / SHARDS_FOLDER}"
        )
    of = counts[0]
    missing = [number for number in range(1, of + 1) if (number, of) not in found]
    if missing:
        rest = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        raise InputError(
            f"{directory}: shard {', '.join(f'{number}/{of}' for number in missing[:3])}{rest} is missing; run the "
            f"same eval command with --shard {missing[0]}/{of}"
        )
    first = found[1, of]
    other = next((facts for facts in found.values() if facts.run != first.run), None)
    if other is not None:
        differing = next(name for name, value in other.run.items() if value != first.run[name])
        raise InputError(
            f"{directory}: shards {first.number}/{of} and {other.number}/{of} are not of one run ({differing} "
            f"differs); run the same eval command with --shard {other.number}/{of} again"
        )
    return first.model_copy(update={"planned": first.scenes})


def forget_shards(directory: Path) -> None:
    """Remove what shards left beside a record that has all of them.

    Args:
        directory: Folder of the record.

    Raises:
        InputError: If it cannot be removed.
    """
    folder = directory / SHARDS_FOLDER
    if folder.is_dir():
        with writing_to(folder):
            shutil.rmtree(folder)
