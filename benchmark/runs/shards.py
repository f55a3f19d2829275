"""Parts of a command's work for separate jobs, without a cluster: ``--shard 3/40`` does every 40th scene.

Everything that is worked out is kept under a content key, each piece in a file of its own. So a shard does its scenes
and keeps them, no two write the same file, and the same command without ``--shard`` finds what is there, does what is
missing and reports: the same bytes as of a run that was never cut.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self, TypeVar

from benchmark.errors import InputError

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


@dataclass(frozen=True, slots=True)
class FinishedShard:
    """What a shard did.

    Attributes:
        directory: Folder of the record, or root of the data set.
        done: How many scenes it did or found done.
        scenes: How many there are altogether.
    """

    directory: Path
    done: int
    scenes: int
