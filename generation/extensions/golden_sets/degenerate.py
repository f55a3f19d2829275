"""Degenerate candidates of the reference: nothing moves, everything jumps, all is behind."""

from typing import Final

import numpy as np

from benchmark.dynamics.bicycle import MotionModel, VehicleState, rear_axle, simulate
from benchmark.dynamics.reference_path import WAYPOINTS
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenFolder

STEPS: Final = 80
"""Frames that golden sets simulate."""
NUDGE_M: Final = 1e-6
"""The specification calls a candidate well-conditioned if it moves less than `STEADY_M` when its waypoints move so."""
STEADY_M: Final = 1e-3
NUDGES: Final = 8
FILE: Final = "physics_degenerate.npz"
COMMON: Final = "common_center_x_y_heading_width_length_height"


def compare_degenerate(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare the degenerate candidates of a set, where it has some.

    They carry no measure of how well-conditioned they are, so it is measured here: waypoints are nudged at random, and
    positions are compared for as many frames as they stay put. All must be finite where the golden ones are.
    """
    if not folder.has(FILE):
        return
    stored = folder.arrays(FILE)
    common = stored.floats(COMMON, 6)
    pose, length_m = rear_axle(common[:3], common[4]), float(common[4])
    names = sorted(name.removesuffix("/waypoints_local") for name in stored.names if name.endswith("/waypoints_local"))
    quantity = "degenerate candidates: centre position (m)"
    comparison.verdicts("degenerate candidates that are not finite", np.zeros(0, np.bool_))
    cut = []
    for name in names:
        golden = stored.floats(f"{name}/center_pose", STEPS + 1, 3)
        state = VehicleState(pose, float(stored.floats(f"{name}/speed_per_step")))
        centers = _drive(stored.floats(f"{name}/waypoints_local", WAYPOINTS, 3), state, length_m)
        comparison.verdicts("degenerate candidates that are not finite", ~np.isfinite(centers[:1]).all(axis=(1, 2)))
        steady = np.maximum.accumulate(np.abs(centers[1:] - centers[0]).max(axis=(0, 2))) < STEADY_M
        frames = int(np.count_nonzero(steady))
        if frames < len(golden):
            cut.append(f"{name} after frame {frames - 1}")
        comparison.numbers(quantity, centers[0, :frames], golden[:frames, :2], where=name)
    if cut:
        comparison.note(quantity, f"not compared where a micrometre decides: {', '.join(cut)}")


def _drive(waypoints: Floats, state: VehicleState, length_m: float) -> Floats:
    """Centres (1 + `NUDGES`, 81, 2): of the candidate, then of its nudged copies."""
    rng = np.random.default_rng(content_seed("nudged waypoints", waypoints.tolist()))
    nudges = NUDGE_M * rng.choice([-1.0, 1.0], (NUDGES, *waypoints.shape))
    all_of_them = np.concatenate([waypoints[None], waypoints + nudges])
    motion = simulate(all_of_them, state, length_m, steps=STEPS, model=MotionModel.reference())
    return motion.center[..., :2]
