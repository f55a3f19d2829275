"""Caveats of a record: what its numbers needed and did not get, printed once and marked in tables."""

from collections.abc import Iterable
from typing import Annotated, Final, Literal, get_args

from pydantic import Field

from benchmark.records.stored import Stored

CaveatKind = Literal[
    "truth",
    "boxes",
    "categories",
    "time",
    "map",
    "motion",
    "images",
    "cameras",
    "lidar",
    "forecasts",
    "masks",
    "pose",
    "plans",
    "panel",
    "ego",
    "as-is",
    "older",
]
KINDS: Final[tuple[CaveatKind, ...]] = get_args(CaveatKind)
"""In the order in which they are printed."""
OF_THE_DOOR: Final[frozenset[CaveatKind]] = frozenset({"as-is", "cameras", "panel", "ego"})
"""Kinds that only the command that made the plans, or took them in, knows: judging stored plans anew keeps them."""


class Caveat(Stored):
    """A thing that a number needed and did not get, and what that does to it; the sentence has no full stop.

    Attributes:
        kind: Which input is missing or doubtful.
        sentence: What was missing and its effect.
    """

    kind: CaveatKind
    sentence: Annotated[str, Field(max_length=1000)]


def sort_caveats(caveats: Iterable[Caveat]) -> list[Caveat]:
    """Caveats in the order of their kinds, each once."""
    each_once = dict.fromkeys((caveat.kind, caveat.sentence) for caveat in caveats)
    ordered = sorted(each_once, key=lambda pair: KINDS.index(pair[0]))
    return [Caveat(kind=kind, sentence=sentence) for kind, sentence in ordered]
