"""The part of a scene that is driven around an encounter with adversaries, as records hold it."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal

from pydantic import ConfigDict, Field

from benchmark.records.run_schema import Name
from benchmark.records.scene_assessment import NotNegative
from benchmark.records.stored import Stored

WindowName = Literal["scene", "encounter"]
"""Part of a scene that is driven: all of it, or that around the encounter with its adversaries."""
ON_TRACK: Final = {"adversary": "on its track"}
"""Fact on ``idm`` agents among whom adversaries, or who stands for them in a recording, keep their tracks."""


@dataclass(frozen=True, slots=True)
class EncounterWindow:
    """Part of a scene that is driven around the encounter with the adversaries of the adversarial scene ``of``.

    Up to the keyframe ``start`` the ego is the recorded one, the drive ends at the keyframe ``end``. ``adversaries``
    are instances of the scene that is driven, of a recording those that became adversaries in ``of``. ``departs_s`` is
    when the first of them leaves its recording, in seconds of the scene; null where nothing says so.

    Attributes:
        of: Name of the adversarial scene.
        start: First keyframe that is driven from.
        end: Keyframe at which it is over.
        adversaries: Instance identifiers.
        departs_s: When the first one departs.
    """

    __pydantic_config__: ClassVar[ConfigDict] = Stored.model_config
    of: Name
    start: Annotated[int, Field(ge=1)]
    end: Annotated[int, Field(ge=2)]
    adversaries: tuple[str, ...]
    departs_s: NotNegative | None
