"""Names of splits that are searched with a seed or driven by another ego; light, for whoever only looks at a name."""

import re
from typing import Final

RECORDED_EGO: Final = "recorded"
DRIVEN_EGOS: Final = ("idm", "careful")
"""Reference drivers that may take the place of the recorded ego."""
_OF_SEED: Final = re.compile(r"adv-seed-(0|[1-9]\d{0,17})")
_OF_EGO: Final = re.compile(rf"(adv|val-r)-ego-({'|'.join(DRIVEN_EGOS)})")


def parse_seed(split: str) -> int | None:
    """Seed of a split that is called after one, else ``None``."""
    named = _OF_SEED.fullmatch(split)
    return int(named[1]) if named else None


def is_adversarial(split: str) -> bool:
    """Whether a split is ``adv``, one of those of several seeds, or that of another ego."""
    return strip_ego(split) == "adv" or parse_seed(split) is not None


def format_seed_split(seed: int) -> str:
    """Name of the split that is searched with a seed."""
    return f"adv-seed-{seed}"


def parse_ego(split: str) -> str:
    """Who drives the ego of a split: ``recorded``, ``idm`` or ``careful``."""
    named = _OF_EGO.fullmatch(split)
    return named[2] if named else RECORDED_EGO


def strip_ego(split: str) -> str:
    """The same split with the recorded ego."""
    named = _OF_EGO.fullmatch(split)
    return named[1] if named else split


def format_ego_split(split: str, ego: str) -> str:
    """Name of ``adv`` or ``val-r`` with another ego; itself with the recorded one."""
    return split if ego == RECORDED_EGO else f"{split}-ego-{ego}"
