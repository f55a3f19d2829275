"""Consequence of a reading that fits far better: a file is refused, a running planner's record gets a caveat."""

from collections.abc import Mapping
from pathlib import Path

from benchmark.records.caveats import Caveat
from benchmark.untrusted.plan_plausibility import ComparedPlans, Misreading, measure_plausibility

_RESTS = "all numbers use the plans as read"


def format_refusal(path: Path, misreading: Misreading) -> str:
    """The sentence that refuses a file: what was measured, what would fit, and the options that accept the file."""
    remedy = (
        "check which script wrote the file" if misreading.frame is None else f"--frame {misreading.frame} reads it so"
    )
    return f"{path}: {misreading.sentence}; {remedy}, or accept it with --as-is"


def describe_checks(measured: Mapping[str, str]) -> str:
    """Results of the tests, in one line."""
    return f"checks: {'; '.join(f'{name}: {text}' for name, text in measured.items())}"


def make_as_is_caveat(misreading: Misreading) -> Caveat:
    """The caveat of a file that ``--as-is`` took in."""
    return Caveat(kind="as-is", sentence=f"accepted as is (--as-is), although {misreading.sentence}; {_RESTS}")


def list_plan_caveats(compared: ComparedPlans) -> list[Caveat]:
    """Caveats on the plans of a planner or file: one where another reading fits far better."""
    misreading = measure_plausibility(compared).misreading
    if misreading is None:
        return []
    remedy = ""
    if misreading.frame is not None:
        remedy = f" (PlanFrame.{misreading.frame.upper()} of a class, --frame {misreading.frame} of a model server"
        remedy += ", the frame of VAD's fork for NeuroNCAP)" if misreading.frame == "lidar" else ")"
    return [Caveat(kind="plans", sentence=f"{misreading.sentence}{remedy}; {_RESTS}")]
