"""Words of sentences that depend on numbers, of commands that a sentence names, and behind abbreviations."""

import shlex
from collections.abc import Mapping
from typing import Final

ABBREVIATIONS: Final[Mapping[str, str]] = {
    "R157": "UN Regulation 157 on automated lane keeping: its driver brakes when a cut-in comes too close",
    "CC": "careful and competent human driver of UN Regulation 157, Annex 3",
    "FSM": "fuzzy safety model: a driver who brakes the harder, the less safe the distance is",
    "RSS": "responsibility-sensitive safety: a driver who keeps the distance that a full stop needs",
    "IDM": "intelligent driver model: a driver who keeps a time gap to whoever is ahead",
    "TTC": "time to contact, if both keep their velocities",
    "TET": "time exposed: how long the time to contact is below 1.5 s",
    "TIT": "time integrated: by how much the time to contact is below 1.5 s, summed over time",
    "PET": "post-encroachment time: between one leaving a place and the other reaching it",
    "BTN": "braking threat number: deceleration that is needed, as a part of what the vehicle can do",
    "NC": "no collision at fault",
    "DAC": "drivable area compliance",
    "DDC": "driving direction compliance",
    "EP": "progress of the ego along its route",
    "LK": "lane keeping",
    "HC": "history comfort",
    "EC": "extended comfort: consecutive plans agree in their motion",
    "SC": "subject consistency",
    "IQ": "imaging quality",
    "MTR": "multi-round refinement",
}
"""Words behind abbreviations in heads and notes, which the site shows when they are pointed at."""


def pluralise(count: int, one: str, many: str | None = None) -> str:
    """A number with its noun, singular where it is one: ``1 scene``, ``3 scenes`` or ``1,204 samples``.

    ``many`` is by default with an s, or ``ies`` for a ``y`` after a consonant.
    """
    return f"{count:,} {inflect_noun(count, one, many)}"


def inflect_noun(count: int, one: str, many: str | None = None) -> str:
    """The noun of `pluralise` alone, for sentences in which the number stands apart."""
    if count == 1:
        return one
    if many is not None:
        return many
    return f"{one[:-1]}ies" if one.endswith("y") and one[-2] not in "aeiou" else f"{one}s"


def spell_name(name: str) -> str:
    """A stored name as people read it: ``against traffic``."""
    return name.replace("_", " ")


def format_split(split: str, data_name: str) -> str:
    """A split and its data set, as ``split adv of mini``; a data set that is called like its split is named once."""
    return f"split {split}" if data_name == split else f"split {split} of {data_name}"


def format_title(data_name: str, split: str) -> str:
    """The same as the beginning of a title: ``mini, split adv``."""
    return f"split {split}" if data_name == split else f"{data_name}, split {split}"


def format_options(**given: object) -> str:
    """Options of a command, each with a space before it and quoted for a shell; ``None`` and nothing are left out."""
    words: list[str] = []
    for name, value in given.items():
        for part in value if isinstance(value, list | tuple) else () if value is None else (value,):
            words += [f"--{name.replace('_', '-')}", str(part)]
    return "".join(f" {shlex.quote(word)}" for word in words)
