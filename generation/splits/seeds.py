"""Splits that are searched with several seeds: which search each comes from, and their frozen files."""

import re
from pathlib import Path
from typing import Any

from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from benchmark.records.seed_splits import seed_of, seed_split
from generation.splits.format import Choice, SearchFacts
from generation.splits.packaged import NamedSplit, frozen_split


def search_hash(search: SearchFacts, chosen: Choice, adversaries: int) -> str:
    """Hash of what decided a split beside its recordings and its seed: splits of one search differ in the seed alone.

    64 hexadecimal digits. ``chosen`` says how scenes were chosen; what came of it is no part of the hash.
    """
    searched = [search.algorithm, search.hyper, search.prior, *([] if search.solvable is None else [search.solvable])]
    chose: list[Any] = [chosen.scenes, chosen.per_scene, chosen.total, chosen.surrogate, adversaries]
    younger = {"variants": chosen.variants, "asked": chosen.asked}
    # Searches without them keep the hash that they had before there were any.
    chose += [{name: value} for name, value in younger.items() if value]
    return content_key("search", searched, *chose)


def file_of_seed(path: Path, seed: int) -> Path:
    """The frozen split of one seed, beside those of the others: ``town-seed-2.json`` of ``town.json``."""
    return path.with_name(f"{path.stem}-seed-{seed}{path.suffix or '.json'}")


def frozen_of_seed(path: Path, seed: int) -> NamedSplit:
    """Read the frozen split of one seed; it must have been searched with that seed.

    ``path`` is what the files of all seeds are called after.
    """
    own = file_of_seed(path, seed)
    if not own.exists():
        raise InputError(
            f"there is no file {own}, the frozen split of seed {seed}; --from names the file that --freeze named, "
            "without the seed"
        )
    found = frozen_split(own)
    require_seed(seed_split(seed), found.frozen.search.seed, str(own))
    return found


def require_seed(split: str, seed: int, what: str) -> None:
    """Raise `InputError` if a split that is called after a seed comes from another one."""
    named = seed_of(split)
    if named is not None and named != seed:
        raise InputError(f"{what} was searched with seed {seed} and cannot be {split}; build it as {seed_split(seed)}")


def seeds_of(text: str) -> tuple[int, ...]:
    """Seeds between commas, such as ``0,1,2``, in their order: at least two, none of them twice."""
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"0|[1-9]\d{0,17}", word) for word in words) or len(set(words)) < max(len(words), 2):
        raise InputError(f"--seeds {text[:80]!r} must be two or more different whole numbers, such as 0,1,2")
    return tuple(map(int, words))
