"""Splits that differ in the seed of the search alone: their names, and what made them.

``generate --seeds 0,1,2`` writes ``adv-seed-0``, ``adv-seed-1`` and ``adv-seed-2``, each a root, and a split, of its
own.
"""

import re
from collections.abc import Mapping
from typing import Any, Final

from benchmark.records.attempts import reports_of
from benchmark.records.run_schema import GeneratedFacts

_NAMED: Final = re.compile(r"adv-seed-(0|[1-9]\d{0,17})")
SEARCH: Final = "search"
"""In ``challenger.json`` of such a split: hash of everything but the seed that decided its search."""


def seed_split(seed: int) -> str:
    """Name of the split that is searched with a seed."""
    return f"adv-seed-{seed}"


def seed_of(split: str) -> int | None:
    """Seed of a split that is called after one, else ``None``."""
    named = _NAMED.fullmatch(split)
    return int(named[1]) if named else None


def is_adversarial(split: str) -> bool:
    """Whether a split is ``adv``, or one of those of several seeds."""
    return split == "adv" or seed_of(split) is not None


def generated_facts(made: Mapping[str, Any] | None) -> GeneratedFacts | None:
    """Which search a data set's scenes come from; ``None`` where they say no seed, or several.

    Args:
        made: What ``challenger.json`` says of the data set, if there is one.
    """
    scenes = made.get("scenes") if isinstance(made, Mapping) else None
    seeds = set()
    for entry in scenes.values() if isinstance(scenes, dict) else ():
        for report in reports_of(entry.get("report")):
            seeds.add(report.get("seed"))
    if len(seeds) != 1 or type(seed := next(iter(seeds))) is not int or not 0 <= seed < 1 << 63:
        return None
    search = made.get(SEARCH) if isinstance(made, Mapping) else None
    return GeneratedFacts(seed=seed, search=search if isinstance(search, str) and len(search) <= 64 else None)
