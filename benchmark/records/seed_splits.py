"""Names of splits that are searched with a seed, beside ``adv`` itself; light, for whoever only looks at a name."""

import re
from typing import Final

_OF_SEED: Final = re.compile(r"adv-seed-(0|[1-9]\d{0,17})")


def parse_seed(split: str) -> int | None:
    """Seed of a split that is called after one, else ``None``."""
    named = _OF_SEED.fullmatch(split)
    return int(named[1]) if named else None


def is_adversarial(split: str) -> bool:
    """Whether a split is ``adv``, or one of those of several seeds."""
    return split == "adv" or parse_seed(split) is not None


def format_seed_split(seed: int) -> str:
    """Name of the split that is searched with a seed."""
    return f"adv-seed-{seed}"
