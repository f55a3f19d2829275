"""A scene that is begun again because its planner, which runs elsewhere, went away half-way and came back."""

from collections.abc import Callable
from typing import Final, TypeVar

from benchmark.planning import Planner, PlannerAwayError, RemotePlanner

TIMES: Final = 5
"""So often is one scene begun again; whoever goes away more often than that dies of the scene."""
Outcome = TypeVar("Outcome")


def begun_again(work: Callable[[], Outcome], planner: Planner) -> Outcome:
    """Outcome of work that begins with `Planner.reset`, begun again each time the planner goes away half-way.

    Nothing is asked twice in between: what came before is forgotten on both sides. The work of a scene leaves nothing
    behind where it raises.

    Raises:
        PlannerGoneError: If the planner does not come back, or goes away again and again.
    """
    for _ in range(TIMES):
        try:
            return work()
        except PlannerAwayError:
            if not isinstance(planner, RemotePlanner):
                raise
            planner.come_back()
    return work()
