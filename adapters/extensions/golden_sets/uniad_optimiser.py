"""UniAD's collision optimisation against stored plans: alone, from stored occupancy, and behind the whole network."""

from importlib.util import find_spec
from typing import Final

import numpy as np

from adapters.networks.uniad.collision_optimiser import Solver, move_plan, nearby_cells
from adapters.networks.uniad.collision_solvers import cost
from adapters.networks.uniad.frames import UniADPredictions
from benchmark.geometry import Bools, Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays

SAME_M: Final = 1e-2
"""What the specification allows the moved plan."""
SAME_COST: Final = 1e-5
"""Stored plans are in single precision."""
CELLS: Final = "occupied cells that count for the plan"
COSTS: Final = "cost of the moved plan above the stored one's"
WHOLE: Final = "sdc_traj behind the network (m)"
LOWEST: Final = "lowest cost above the stored plan's"


def compare_optimiser(comparison: Comparison, predictions: UniADPredictions, stored: GoldenArrays) -> None:
    """Compare moved plans of a frame; without plans in its golden numbers nothing is compared."""
    occupied = predictions.occupancy.occupied.cpu().numpy()
    steps = len(predictions.plan.positions_m)
    if not {"sdc_traj", "sdc_traj_before_optim", "occ_seg_out_bits"} <= stored.names:
        return
    golden = stored.floats("sdc_traj", 1, steps, 2)[0]
    before = stored.floats("sdc_traj_before_optim", 1, steps, 2)[0]
    bits = stored.floats("occ_seg_out_bits", None)
    stored_cells = np.unpackbits(bits.astype(np.uint8)).reshape(occupied.shape).astype(bool)
    near = [nearby_cells(*each) for each in zip(before, _per_point(stored_cells, before))]
    if "col_optim_cells" in stored.names:
        comparison.same(CELLS, [len(cells) for cells in near], stored.floats("col_optim_cells", steps))
    costs = np.array([cost(*each) for each in zip(golden, before, near, strict=True)])
    solvers: list[Solver] = ["newton", "ipopt"] if find_spec("casadi") else ["newton"]
    for solver in solvers:
        moved = move_plan(before, stored_cells, solver)
        comparison.numbers(f"sdc_traj by {solver} from stored occupancy (m)", moved.points, golden, SAME_M)
        comparison.errors(f"{COSTS}, {solver}", np.maximum(moved.costs - costs, 0), SAME_COST)
    lowest = move_plan(before, stored_cells, "lowest")
    comparison.errors(LOWEST, np.maximum(lowest.costs - costs, 0), SAME_COST)
    if lower := int(np.count_nonzero(lowest.costs < costs - SAME_COST)):
        comparison.note(LOWEST, f"lower in {lower} of {steps} points of {comparison.where}")
    # The plan from our own occupancy, but for points near which cells that are too close to call are different.
    plan = predictions.plan.positions_m.double().cpu().numpy()
    pairs = zip(plan, _per_point(occupied, plan), _per_point(stored_cells, plan), strict=True)
    same = np.array([np.array_equal(nearby_cells(at, ours), nearby_cells(at, theirs)) for at, ours, theirs in pairs])
    comparison.numbers(WHOLE, move_plan(plan, occupied).points[same], golden[same], SAME_M)
    if not same.all():
        said = f"{np.count_nonzero(~same)} points with other occupied cells left out in {comparison.where}"
        comparison.note(WHOLE, said)


def _per_point(occupied: Bools, plan: Floats) -> list[Bools]:
    """Occupancy, (rows, columns), that counts for each point of a plan."""
    return [occupied[min(step + 1, len(occupied) - 1)] for step in range(len(plan))]
