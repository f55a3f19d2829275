"""The caveats of a run record, put together in one place; each kind is decided in the room that knows of it."""

from collections.abc import Mapping, Sequence

from benchmark.records.caveats import OF_THE_DOOR, Caveat, in_order
from benchmark.records.drive_schema import DriveRow
from benchmark.records.rows import Rows
from benchmark.records.run_schema import PlannerFacts, SceneFacts
from benchmark.runs.truth_caveats import drive_truth, run_truth


def run_caveats(
    planner: PlannerFacts, scenes: Mapping[str, SceneFacts], rows: Rows, known: Sequence[Caveat] = ()
) -> list[Caveat]:
    """What the numbers of a run needed and did not get.

    Args:
        planner: Whose plans they are.
        scenes: Facts of the scenes that ran, with what the data set holds of their truth.
        rows: One for each sample.
        known: What the command that took the plans in knows, or what a stored record says: only what cannot be found
            out again is taken from it.

    Returns:
        The caveats, in order.
    """
    of_door = (caveat for caveat in known if caveat.kind in OF_THE_DOOR)
    return in_order([*of_door, *run_truth(scenes, rows)])


def drive_caveats(
    planner: PlannerFacts, scenes: Mapping[str, SceneFacts], rows: Sequence[DriveRow], known: Sequence[Caveat] = ()
) -> list[Caveat]:
    """`run_caveats` of a record of drives.

    Args:
        planner: Who drove.
        scenes: As there.
        rows: One for each drive.
        known: As there.

    Returns:
        The caveats, in order.
    """
    of_door = (caveat for caveat in known if caveat.kind in OF_THE_DOOR)
    return in_order([*of_door, *drive_truth(scenes, rows)])
