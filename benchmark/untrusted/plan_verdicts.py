"""What follows from a reading that fits far better: a file is refused, a running planner's record has a caveat."""

from collections.abc import Mapping
from pathlib import Path

from benchmark.records.caveats import Caveat
from benchmark.untrusted.plan_plausibility import ComparedPlans, Misreading, measure_plausibility

_RESTS = "every number rests on plans as they are read"


def format_refusal(path: Path, misreading: Misreading) -> str:
    """The sentence that refuses a file.

    Args:
        path: The file.
        misreading: What fits far better.

    Returns:
        What was measured, what would fit, and the options that accept the file.
    """
    remedy = (
        "check which script wrote the file" if misreading.frame is None else f"--frame {misreading.frame} reads it so"
    )
    return f"{path}: {misreading.sentence}; {remedy}, --as-is takes it as it stands"


def describe_checks(measured: Mapping[str, str]) -> str:
    """What tests measured, in a line."""
    return f"checks: {'; '.join(f'{name}: {text}' for name, text in measured.items())}"


def make_as_is_caveat(misreading: Misreading) -> Caveat:
    """The caveat of a file that ``--as-is`` took in."""
    return Caveat(kind="as-is", sentence=f"taken as the file stands (--as-is), though {misreading.sentence}; {_RESTS}")


def list_plan_caveats(compared: ComparedPlans) -> list[Caveat]:
    """What there is to say of the plans of a planner, running or of a file.

    Args:
        compared: Its plans beside what was recorded.

    Returns:
        A caveat where another reading fits far better.
    """
    misreading = measure_plausibility(compared).misreading
    if misreading is None:
        return []
    remedy = ""
    if misreading.frame is not None:
        remedy = f" (PlanFrame.{misreading.frame.upper()} of a class, --frame {misreading.frame} of a model server"
        remedy += ", as VAD's fork for NeuroNCAP answers)" if misreading.frame == "lidar" else ")"
    return [Caveat(kind="plans", sentence=f"{misreading.sentence}{remedy}; {_RESTS}")]
