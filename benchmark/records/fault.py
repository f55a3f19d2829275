"""Whose fault a contact is, as records hold it: verdict, reason and times of ``fault@1`` (docs/fault.md)."""

from enum import StrEnum
from typing import Annotated, Final

from pydantic import Field, FiniteFloat

from benchmark.records.stored import Stored

FAULT: Final = "fault@1"
"""The rule behind every *at fault*; nuPlan's stands beside it as `NUPLAN_FAULT`."""
NUPLAN_FAULT: Final = "fault@nuplan"
Seconds = Annotated[FiniteFloat, Field(ge=0.0)]


class FaultVerdict(StrEnum):
    """Whose fault a contact is."""

    EGO = "ego"
    OTHER = "other"
    SHARED = "shared"
    UNCLEAR = "unclear"


class FaultReason(StrEnum):
    """What decided a verdict."""

    OBJECT = "object"
    STANDING = "standing"
    REVERSING = "reversing"
    CROSSING_PERSON = "crossing-person"
    WALKWAY_PERSON = "walkway-person"
    ROAD_PERSON = "road-person"
    OFF_ROAD = "off-road"
    REAR_END = "rear-end"
    ROUNDABOUT = "roundabout"
    TURN_ACROSS = "turn-across"
    MERGE = "merge"
    CROSSING_PRIORITY = "crossing-priority"
    PULL_OUT = "pull-out"
    U_TURN = "u-turn"
    WRONG_SIDE = "wrong-side"
    CUT_IN = "cut-in"
    LANE_CHANGE = "lane-change"
    OVERTAKING = "overtaking"
    SIDESWIPE = "sideswipe"
    CROSSING = "crossing"
    NO_MAP = "no-map"
    NO_LANE = "no-lane"
    NO_RULE = "no-rule"


UNTIMED_REASONS: Final = frozenset(
    {
        *(FaultReason.OBJECT, FaultReason.STANDING, FaultReason.REVERSING, FaultReason.CROSSING_PERSON),
        *(FaultReason.WALKWAY_PERSON, FaultReason.ROAD_PERSON, FaultReason.OFF_ROAD, FaultReason.REAR_END),
    }
)
"""Reasons without a time at which they began."""


class StoredFault(Stored):
    """Whose fault a contact is, by ``fault@1``.

    Attributes:
        verdict: Whose.
        reason: What decided it.
        entry_s: How long before the contact the one to blame came into the other's way; null where it always was there,
            where not one of the two is to blame, and of `UNTIMED_REASONS`.
        time_left_s: Time that the other had then; null where that is without end, and likewise.
    """

    verdict: FaultVerdict
    reason: FaultReason
    entry_s: Seconds | None = None
    time_left_s: Seconds | None = None


def blames_ego(fault: StoredFault | None) -> bool | None:
    """Whether a contact is the ego's fault; ``None`` where the rule was not asked, as in older records."""
    return None if fault is None else fault.verdict is FaultVerdict.EGO
