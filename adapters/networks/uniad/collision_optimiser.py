r"""Moving a plan away from occupied cells.

Every planned point p, which is at q before, minimises

    |p - q|^2 + sum over cells c of w exp(-|p - c|^2 / 2),    w = 5 / 2.507,

over the occupied cells c within 5 m of q. The published planner gives all points to IPOPT at once, starts it at the
plan, and takes the minimum that it arrives at, which need not be the lowest.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from adapters.networks.uniad.collision_solvers import REACH_M, cost, lowest_point, newton_points, official_points
from adapters.networks.uniad.occupancy import CELL_M
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats

Solver = Literal["newton", "lowest", "ipopt"]
"""``newton`` goes the way of IPOPT without it, ``lowest`` finds the lowest minimum, and ``ipopt`` is the published one,
through the optional package casadi."""


@dataclass(frozen=True, slots=True)
class MovedPlan:
    """A moved plan, (T, 2) metres, with the (T,) costs of its points and of the given ones.

    `cells` are (T,) how many occupied cells counted.
    """

    points: Floats
    costs: Floats
    costs_before: Floats
    cells: NDArray[np.int64]
    solver: Solver


def move_plan(plan: Floats, occupied: Bools, solver: Solver = "newton") -> MovedPlan:
    """Move a plan, (T, 2) metres in the lidar frame 0.5 s apart from 0.5 s on, away from occupied cells.

    `occupied` is (S, rows, columns) occupancy now and every 0.5 s after; the last one counts for what is later. An
    `InputError` says that casadi is asked for and absent, or that the plan is not finite.
    """
    if not np.isfinite(plan).all():
        raise InputError("UniAD's plan has numbers that are not finite; check the weights and the images")
    cells = [nearby_cells(point, occupied[min(step + 1, len(occupied) - 1)]) for step, point in enumerate(plan)]
    if not any(len(places) for places in cells):
        points = plan.astype(np.float64)
    elif solver == "ipopt":
        points = official_points(plan, cells)
    elif solver == "newton":
        points = newton_points(plan, cells)
    else:
        points = np.stack([lowest_point(point, places) for point, places in zip(plan, cells, strict=True)])
    return MovedPlan(
        points=points,
        costs=np.array([cost(*each) for each in zip(points, plan, cells, strict=True)]),
        costs_before=np.array([cost(*each) for each in zip(plan, plan, cells, strict=True)]),
        cells=np.array([len(places) for places in cells], np.int64),
        solver=solver,
    )


def nearby_cells(point: Floats, occupied: Bools) -> Floats:
    """Centres of occupied cells near a point, (N, 2) x, y in whole metres; `occupied` is centred on the lidar.

    What is after the decimal point is cut off: the published code keeps them as whole numbers, so four cells or more
    lie on one another and all count.
    """
    row, column = np.nonzero(occupied)
    rows, columns = occupied.shape
    centres = np.stack([column - columns // 2, row - rows // 2], 1) * CELL_M + CELL_M / 2
    whole = np.trunc(centres)
    near: Floats = whole[((whole - point) ** 2).sum(1) < REACH_M**2]
    return near
