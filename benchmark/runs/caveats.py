"""The caveats of a run record, put together in one place; each kind is decided in the room that knows of it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Final

from benchmark.records.caveats import OF_THE_DOOR, Caveat, in_order
from benchmark.records.drive_schema import DriveRow, Measured
from benchmark.records.rows import Rows
from benchmark.records.run_schema import PlannerFacts, SceneFacts
from benchmark.runs.input_caveats import data_caveats, drive_input_caveats, planner_caveats
from benchmark.runs.time_caveat import time_caveats
from benchmark.runs.truth_caveats import drive_truth, run_truth
from benchmark.untrusted.plan_verdicts import plan_caveats
from benchmark.untrusted.plans_beside_recording import ComparedPlans

_Scenes = Mapping[str, SceneFacts]
_OF_RUNS: Final[tuple[Callable[[PlannerFacts, _Scenes, Rows], Iterable[Caveat]], ...]] = (
    lambda _, scenes, rows: run_truth(scenes, rows),
    lambda _, scenes, __: time_caveats(scenes),
    lambda _, scenes, __: data_caveats(scenes),
    planner_caveats,
)
_OF_DRIVES: Final[tuple[Callable[[PlannerFacts, _Scenes, Measured], Iterable[Caveat]], ...]] = (
    lambda _, scenes, __: drive_truth(scenes),
    lambda _, scenes, __: time_caveats(scenes),
    lambda _, scenes, __: data_caveats(scenes),
    drive_input_caveats,
)


def run_caveats(
    planner: PlannerFacts, scenes: Mapping[str, SceneFacts], rows: Rows, known: Sequence[Caveat] = ()
) -> list[Caveat]:
    """Caveats of a run, in order: inputs that its numbers needed and did not get.

    Args:
        scenes: Facts of the scenes that ran, with what the data set holds of their truth.
        known: What the command that took the plans in knows, or what a stored record says: only what cannot be found
            out again is taken from it.
    """
    columns = rows.columns
    compared = ComparedPlans.of(columns.in_lidar, columns.recorded)
    found = (find(planner, scenes, rows) for find in _OF_RUNS)
    return in_order(chain(_of_the_door(known), *found, _of_plans(compared, known)))


def drive_caveats(
    planner: PlannerFacts,
    scenes: Mapping[str, SceneFacts],
    rows: Sequence[DriveRow],
    measured: Measured,
    compared: ComparedPlans,
    known: Sequence[Caveat] = (),
) -> list[Caveat]:
    """`run_caveats` of a record of drives.

    Args:
        compared: Its plans of the instants at which the ego was still where it was recorded.
    """
    found = (find(planner, scenes, measured) for find in _OF_DRIVES)
    return in_order(chain(_of_the_door(known), *found, _of_plans(compared, known)))


def _of_the_door(known: Sequence[Caveat]) -> list[Caveat]:
    """Known caveats that are kept, since they cannot be found out again."""
    return [caveat for caveat in known if caveat.kind in OF_THE_DOOR]


def _of_plans(compared: ComparedPlans, known: Sequence[Caveat]) -> list[Caveat]:
    """Whether plans fit better otherwise; of those that a file was taken in with, that has been said."""
    return [] if any(caveat.kind == "as-is" for caveat in known) else plan_caveats(compared)
