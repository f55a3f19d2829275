"""Whose fault a contact is, in words (docs/fault.md)."""

from collections.abc import Mapping
from typing import Final

from benchmark.records.drive_schema import ScoredContact
from benchmark.records.fault import FaultReason, FaultVerdict, StoredFault
from benchmark.records.scene_assessment import CollisionSeverity

FAULT_CELLS: Final[Mapping[FaultVerdict, str]] = {
    FaultVerdict.EGO: "yes",
    FaultVerdict.OTHER: "no",
    FaultVerdict.SHARED: "shared",
    FaultVerdict.UNCLEAR: "unclear",
}
"""In a table's column *at fault*."""
_ACTS: Final[Mapping[FaultReason, str]] = {
    FaultReason.OBJECT: "drove into an object",
    FaultReason.STANDING: "drove into somebody who stood",
    FaultReason.REVERSING: "drove backwards",
    FaultReason.CROSSING_PERSON: "did not let a person cross",
    FaultReason.WALKWAY_PERSON: "hit a person off the road",
    FaultReason.ROAD_PERSON: "had to look out, with a person on the road",
    FaultReason.OFF_ROAD: "left the road",
    FaultReason.REAR_END: "ran into the rear of the car ahead",
    FaultReason.ROUNDABOUT: "entered the roundabout",
    FaultReason.TURN_ACROSS: "turned across",
    FaultReason.MERGE: "merged",
    FaultReason.CROSSING_PRIORITY: "crossed without priority",
    FaultReason.PULL_OUT: "pulled out",
    FaultReason.U_TURN: "turned round",
    FaultReason.WRONG_SIDE: "was on the wrong side",
    FaultReason.CUT_IN: "cut in",
    FaultReason.LANE_CHANGE: "changed lane",
    FaultReason.OVERTAKING: "overtook too near",
}
"""Acts of one road user; the other reasons name no road user."""
_UNCLEAR: Final[Mapping[FaultReason, str]] = {
    FaultReason.STANDING: "neither moved",
    FaultReason.CROSSING: "the map does not say who had priority",
    FaultReason.NO_MAP: "no map of the place",
    FaultReason.NO_LANE: "no drivable area on the map",
    FaultReason.NO_RULE: "no rule applies",
}


def describe_fault(contact: ScoredContact | CollisionSeverity) -> str:
    """``at fault: pulled out 0.8 s before the other arrived``; nuPlan's verdict where a record has no other."""
    fault = contact.fault
    if fault is None:
        told = {True: "at fault", False: "not at fault", None: "fault unknown"}[contact.at_fault]
        return f"{told} (nuPlan)"
    if fault.verdict is FaultVerdict.UNCLEAR:
        return f"fault unclear: {_UNCLEAR.get(fault.reason, spell_reason(fault.reason))}"
    if fault.verdict is FaultVerdict.SHARED:
        return f"shared fault: {spell_reason(fault.reason)}"
    act = f"{_ACTS.get(fault.reason, spell_reason(fault.reason))}{_describe_time(fault)}"
    return f"at fault: {act}" if fault.verdict is FaultVerdict.EGO else f"not at fault: the other {act}"


def spell_reason(reason: FaultReason) -> str:
    """A reason as people read it: ``lane change``."""
    return {FaultReason.U_TURN: "U-turn", FaultReason.CUT_IN: "cut-in", FaultReason.REAR_END: "rear end"}.get(
        reason, reason.replace("-", " ")
    )


def _describe_time(fault: StoredFault) -> str:
    if fault.time_left_s:
        return f" {fault.time_left_s:.1f} s before the other arrived"
    return "" if fault.entry_s is None else f" {fault.entry_s:.1f} s before the contact"
