"""Moving a plan away from occupied cells.

Every planned point p, which is at q before, minimises

    |p - q|^2 + sum over cells c of w exp(-|p - c|^2 / 2),    w = 5 / 2.507,

over the occupied cells c within 5 m of q. The published planner gives all points to IPOPT at once, starts it at the
plan, and takes the minimum that it arrives at, which need not be the lowest.

Minima of the cost of `collision_optimiser`: the one that IPOPT arrives at, and the lowest.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from adapters.networks.uniad.occupancy import CELL_M
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats

SIGMA_M: Final = 1.0
WEIGHT: Final = 5.0 / (2.507 * SIGMA_M)
"""2.507 stands for the square root of two pi in the published code."""
REACH_M: Final = 5.0
"""Occupied cells at this distance or farther are not looked at."""
CONVERGED: Final = 1e-8
"""Gradient at which IPOPT stops."""
LARGEST_GRADIENT: Final = 100.0
"""IPOPT scales steeper costs down to it."""
MOST_ITERATIONS: Final = 3000
SMALLEST_SHARE: Final = 1e-14
GRID_M: Final = 0.25
"""Spacing of the starts for the lowest minimum; the bumps of the cost are one metre wide."""
MOST_STARTS: Final = 24
"""Lowest starts that are followed down."""
DESCENT_STEPS: Final = 60


def cost(point: Floats, reference: Floats, cells: Floats) -> float:
    """The cost of one (2,) point that was at (2,) `reference`, with (N, 2) cells."""
    return float(costs(np.asarray(point, np.float64)[None], reference, cells)[0])


def costs(points: Floats, reference: Floats, cells: Floats) -> Floats:
    """(P,) costs of (P, 2) points."""
    squares = ((points[:, None] - cells[None]) ** 2).sum(-1)
    bumps: Floats = np.exp(-squares / (2 * SIGMA_M**2)).sum(1)
    return np.asarray(((points - reference) ** 2).sum(1) + WEIGHT * bumps)


def derivatives(point: Floats, reference: Floats, cells: Floats) -> tuple[Floats, Floats]:
    """(2,) gradient and (2, 2) second derivatives of the cost."""
    apart = point - cells
    bumps = WEIGHT * np.exp(-(apart**2).sum(1) / (2 * SIGMA_M**2)) / SIGMA_M**2
    gradient = 2 * (point - reference) - bumps @ apart
    curvature = (2 - bumps.sum()) * np.eye(2) + (apart.T * bumps) @ apart / SIGMA_M**2
    return gradient, curvature


def newton_points(plan: Floats, cells: list[Floats]) -> Floats:
    """Minimum at the end of the path that IPOPT takes, without IPOPT: (T, 2) metres, from (N, 2) cells for each point.

    The program has no constraints, so that little of the interior-point method (Waechter and Biegler, 2006) is left:
    Newton steps for all points at once, a multiple of the unit matrix added where the second derivatives have a
    negative eigenvalue, and steps that are halved until the cost falls. The points share the multiple and the halving.
    No cost is higher in sum than at the start.
    """
    points, last = plan.astype(np.float64), 0.0

    def total(places: Floats) -> float:
        return sum(cost(*arguments) for arguments in zip(places, plan, cells, strict=True))

    value, scale = total(points), None
    for _ in range(MOST_ITERATIONS):
        parts = [derivatives(*arguments) for arguments in zip(points, plan, cells, strict=True)]
        gradient, curvature = np.stack([part[0] for part in parts]), np.stack([part[1] for part in parts])
        scale = min(1.0, LARGEST_GRADIENT / max(float(np.abs(gradient).max()), 1e-300)) if scale is None else scale
        gradient, curvature = gradient * scale, curvature * scale
        if np.abs(gradient).max() < CONVERGED:
            break
        lift = _lift(float(np.linalg.eigvalsh(curvature).min()), last)
        last = lift or last
        step = -np.linalg.solve(curvature + lift * np.eye(2), gradient[..., None])[..., 0]
        slope, share = float((gradient * step).sum()), 1.0
        slack = 10 * np.finfo(np.float64).eps * abs(value)
        while scale * (after := total(points + share * step)) > scale * value + 1e-8 * share * slope + slack:
            share /= 2
            if share < SMALLEST_SHARE:
                return points
        points, value = points + share * step, after
    return points


def _lift(lowest: float, last: float) -> float:
    """Regularisation that makes second derivatives with a given least eigenvalue positive, tried as in IPOPT."""
    if lowest > 0:
        return 0.0
    lift = last / 3 if last > 0 else 1e-4
    while lowest + lift <= 0:
        lift *= 8 if last > 0 else 100
    return lift


def lowest_point(reference: Floats, cells: Floats) -> Floats:
    """Point of the lowest cost, (2,), for a reference and (N, 2) cells.

    It is not farther away than the square root of the cost at the start: the search starts on a grid over that disc.
    """
    reference = np.asarray(reference, np.float64)
    if len(cells) == 0:
        return reference
    # Bumps lift the cost no farther out than about four metres from the outermost cell.
    farthest = min(np.sqrt(cost(reference, reference, cells)), REACH_M + 4 * SIGMA_M)
    count = int(np.ceil(farthest / GRID_M))
    axis = np.arange(-count, count + 1) * GRID_M
    starts = reference + np.stack(np.meshgrid(axis, axis, indexing="xy"), -1)
    values = costs(starts.reshape(-1, 2), reference, cells).reshape(len(axis), len(axis))
    padded = np.pad(values, 1, constant_values=np.inf)
    neighbours = [
        padded[1 + row : 1 + row + len(axis), 1 + column : 1 + column + len(axis)]
        for row in (-1, 0, 1)
        for column in (-1, 0, 1)
        if (row, column) != (0, 0)
    ]
    dents = np.flatnonzero(np.all([values <= other for other in neighbours], axis=0))
    lowest = dents[np.argsort(values.reshape(-1)[dents], kind="stable")[:MOST_STARTS]]
    minima = [descend(reference, cells, start) for start in (reference, *starts.reshape(-1, 2)[lowest])]
    return min(minima, key=lambda point: cost(point, reference, cells))


def descend(reference: Floats, cells: Floats, start: Floats | None = None) -> Floats:
    """Minimum, (2,), that a trust-region Newton method finds downhill from `start` or else the reference."""
    point, radius = np.asarray(reference if start is None else start, np.float64), 0.5
    if len(cells) == 0:
        return np.asarray(reference, np.float64)
    value = cost(point, reference, cells)
    for _ in range(DESCENT_STEPS):
        gradient, curvature = derivatives(point, reference, cells)
        step = _trusted_step(gradient, curvature, radius)
        foretold = -(gradient @ step + 0.5 * step @ curvature @ step)
        if foretold <= 1e-15 * max(1.0, abs(value)):
            break
        after = cost(point + step, reference, cells)
        agreement = (value - after) / foretold
        if agreement > 0.1:
            point, value = point + step, after
        radius = radius * 0.25 if agreement < 0.25 else min(2 * radius, 2.0) if agreement > 0.75 else radius
        if radius < 1e-12:
            break
    return point


def _trusted_step(gradient: Floats, curvature: Floats, radius: float) -> Floats:
    """(2,) step of at most `radius` that minimises the quadratic model, by its eigenvalues and bisection."""
    values, vectors = np.linalg.eigh(curvature)
    slopes = vectors.T @ gradient
    if values[0] > 0:
        newton = -slopes / values
        if np.hypot(*newton) <= radius:
            return np.asarray(vectors @ newton)
    low = max(0.0, -values[0])
    if abs(slopes[0]) < 1e-14:
        # On a symmetric descent neither side is preferred; either leads out of a saddle.
        slopes[0] = 1e-14
    high = low + np.hypot(*slopes) / radius
    for _ in range(100):
        middle = 0.5 * (low + high)
        longer = np.hypot(*(slopes / np.maximum(values + middle, 1e-300))) > radius
        low, high = (middle, high) if longer else (low, middle)
    step: Floats = vectors @ (-slopes / (values + high))
    return step


def require_casadi() -> Any:
    """Module casadi, an optional package; an `InputError` where it is not installed."""
    try:
        return import_module("casadi")
    except ImportError as error:
        raise InputError(
            "the official collision optimisation needs casadi, which is not installed; "
            "install challenger-bench[uniad] or choose another solver (--model uniad)"
        ) from error


def official_points(plan: Floats, cells: list[Floats]) -> Floats:
    """The minimum that IPOPT arrives at from the plan, all points at once, as in the published planner; (T, 2) metres.

    From (N, 2) cells for each point. IPOPT that finds no minimum is an `InputError`.
    """
    casadi = require_casadi()
    program = casadi.Opti()
    points = program.variable(2, len(plan))
    total = 0
    for step, (reference, places) in enumerate(zip(plan, cells, strict=True)):
        point = points[:, step]
        total += casadi.sumsqr(point - casadi.DM(reference))
        for x, y in places:
            total += WEIGHT * casadi.exp(-((point[0] - x) ** 2 + (point[1] - y) ** 2) / (2 * SIGMA_M**2))
    program.minimize(total)
    program.set_initial(points, casadi.DM(plan.T))
    program.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"})
    try:
        solution = program.solve()
    except RuntimeError as error:
        raise InputError(f"IPOPT found no plan clear of occupied cells ({error}); choose another solver") from error
    optimum: Floats = np.asarray(solution.value(points), np.float64).reshape(2, len(plan)).T
    return optimum


Solver = Literal["newton", "lowest", "ipopt"]
"""``newton`` goes the way of IPOPT without it, ``lowest`` finds the lowest minimum, and ``ipopt`` is the published one,
through the optional package casadi."""


@dataclass(frozen=True, slots=True)
class MovedPlan:
    """A moved plan, (T, 2) metres, with (T,) costs of its and of the given points, and counts of occupied cells."""

    points: Floats
    costs: Floats
    costs_before: Floats
    cells: NDArray[np.int64]
    solver: Solver


def move_plan(plan: Floats, occupied: Bools, solver: Solver = "newton") -> MovedPlan:
    """Move a plan, (T, 2) metres in the lidar frame 0.5 s apart from 0.5 s on, away from occupied cells.

    `occupied` is (S, rows, columns) now and every 0.5 s after; the last one counts for what is later. Absent casadi
    that is asked for, or a plan that is not finite, is an `InputError`.
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
        costs=np.array([cost(*arguments) for arguments in zip(points, plan, cells, strict=True)]),
        costs_before=np.array([cost(*arguments) for arguments in zip(plan, plan, cells, strict=True)]),
        cells=np.array([len(places) for places in cells], np.int64),
        solver=solver,
    )


def nearby_cells(point: Floats, occupied: Bools) -> Floats:
    """Centres of occupied cells near a point, (N, 2) x, y in whole metres; `occupied` is centred on the lidar.

    Decimals are truncated as in the published code, so four cells or more lie on one another and all count.
    """
    row, column = np.nonzero(occupied)
    rows, columns = occupied.shape
    centres = np.stack([column - columns // 2, row - rows // 2], 1) * CELL_M + CELL_M / 2
    truncated = np.trunc(centres)
    nearby: Floats = truncated[((truncated - point) ** 2).sum(1) < REACH_M**2]
    return nearby
