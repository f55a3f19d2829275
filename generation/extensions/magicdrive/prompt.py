"""The words that go with a clip (sections 4.1 and 8)."""

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from benchmark.datasets.scene_descriptions import describe_traffic_and_road, join_words
from benchmark.scene import Scene

IMPORTED: Final = "Imported from ScenarioNet"
"""Placeholder description of every imported recording in earlier versions; ignored."""


class PromptLook(StrEnum):
    """Light and weather that are asked for."""

    RECORDED = "recorded"
    DAYTIME = "daytime"
    RAINY = "rainy"
    NIGHT = "night"


@dataclass(frozen=True, slots=True)
class Prompt:
    """Prompt, and what not to draw. ``negative`` replaces the model's null prompt in guidance; ``None`` leaves it."""

    positive: str
    negative: str | None = None


@dataclass(frozen=True, slots=True)
class _LookChange:
    """Change of a prompt to another look.

    Phrases (between commas) with an `unwanted` word are left out; `locations` maps places that do not fit to one that
    does.
    """

    opening: str
    negative: str
    unwanted: str
    replaced: tuple[tuple[str, str], ...]
    locations: dict[str, str]


# The published code says how it rewrites prompts for daytime; for rain and night it gives only the negative prompt, and
# the rewriting follows the same pattern here.
_CHANGES: Final = {
    PromptLook.DAYTIME: _LookChange(
        opening="Daytime. ",
        negative="Rain, Night, water reflections, umbrella",
        unwanted=r"night|dark|umbrella",
        replaced=((r"\brain\w*", "sunny"),),
        locations={"boston-seaport": "singapore-onenorth", "singapore-hollandvillage": "singapore-onenorth"},
    ),
    PromptLook.RAINY: _LookChange(
        opening="Rainy. ",
        negative="Daytime. night, onenorth, queenstown",
        unwanted=r"night|dark|dusk|sun",
        replaced=((r"\bday(time)?\b", "rain"),),
        locations={
            "singapore-onenorth": "singapore-hollandvillage",
            "singapore-queenstown": "singapore-hollandvillage",
        },
    ),
    PromptLook.NIGHT: _LookChange(
        opening="Night. ",
        negative="Daytime. rain, boston-seaport",
        unwanted=r"\brain|umbrella|dusk|sun",
        replaced=((r"\bday(time)?\b", "night"),),
        locations={"boston-seaport": "singapore-hollandvillage"},
    ),
}


def build_prompt(scene: Scene, look: PromptLook = PromptLook.RECORDED) -> Prompt:
    """Prompt of a scene: where it is, and its description; rewritten for another ``look``, with a negative prompt."""
    location, description = scene.road_map.location, scene.description
    if description == IMPORTED:
        description = join_words(describe_traffic_and_road(scene))
    if look is PromptLook.RECORDED:
        return Prompt(_format_sentence(location, description))
    change = _CHANGES[look]
    phrases = [phrase for phrase in description.lower().split(",") if not re.search(change.unwanted, phrase)]
    words = ",".join(phrases).strip()
    for pattern, replacement in change.replaced:
        words = re.sub(pattern, replacement, words)
    sentence = _format_sentence(change.locations.get(location, location), words)
    return Prompt(change.opening + sentence.lower(), change.negative)


def _format_sentence(location: str, description: str) -> str:
    start = f"A driving scene image at {location}."
    return f"{start} {description}." if description else start
