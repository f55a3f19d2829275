"""Whose fault a contact is, as films, pages and tables say it."""

from typing import Any

import pytest

from benchmark.records.drive_schema import ScoredContact
from benchmark.records.fault import FaultReason, FaultVerdict, StoredFault
from benchmark.report.fault_words import FAULT_CELLS, describe_fault, spell_reason


def contact(at_fault: bool = True, **fault: Any) -> ScoredContact:
    return ScoredContact(
        seconds=1.0, agent="a", category="vehicle.car", adversary=True, kind="front", at_fault=at_fault,
        impact_speed=1.0, delta_v_ego=0.5, delta_v_other=0.5, fault=StoredFault(**fault) if fault else None,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (
            {"verdict": "ego", "reason": "pull-out", "entry_s": 1.1, "time_left_s": 0.84},
            "at fault: pulled out 0.8 s before the other arrived",
        ),
        ({"verdict": "other", "reason": "rear-end"}, "not at fault: the other ran into the rear of the car ahead"),
        (
            {"verdict": "other", "reason": "lane-change", "entry_s": 0.3, "time_left_s": 0.0},
            "not at fault: the other changed lane 0.3 s before the contact",
        ),
        ({"verdict": "shared", "reason": "cut-in"}, "shared fault: cut-in"),
        ({"verdict": "unclear", "reason": "crossing"}, "fault unclear: the map does not say who had priority"),
    ],
)
def test_the_reason_is_a_sentence(fault: dict[str, Any], words: str) -> None:
    assert describe_fault(contact(**fault)) == words


def test_an_older_contact_has_nuplans_verdict() -> None:
    assert describe_fault(contact(at_fault=False)) == "not at fault (nuPlan)"
    assert describe_fault(contact()) == "at fault (nuPlan)"


@pytest.mark.parametrize("verdict", FaultVerdict)
@pytest.mark.parametrize("reason", FaultReason)
def test_every_verdict_and_reason_has_words(verdict: FaultVerdict, reason: FaultReason) -> None:
    said = describe_fault(contact(verdict=verdict, reason=reason))
    assert "-" not in said.replace("cut-in", "").replace("U-turn", "") and verdict in FAULT_CELLS
    assert spell_reason(reason)[0] != " "
