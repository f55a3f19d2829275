"""Golden trajectories of the denoiser: actions to waypoints and back, and what makes a first batch varied."""

from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.verification.checks import Comparison
from generation.diffusion.prior import diversify
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS, actions_from_waypoints, waypoints_from_actions
from generation.extensions.golden_sets.processes import Parity

SHARE_TOLERANCE: Final = 5e-6
"""Of the largest value: the reference sums 16 steps in single precision, and here it is double."""
HISTORY_POSES: Final = 5
HISTORY_COLUMNS: Final = 7


class _StoredDraws(np.random.Generator):
    """Gives back uniform numbers that were drawn elsewhere, one array for each call."""

    def __init__(self, *draws: Floats) -> None:
        super().__init__(np.random.PCG64(0))
        self._draws = list(draws)

    def random(self, size: Any = None, dtype: Any = np.float64, out: Any = None) -> Any:
        """The next array."""
        return self._draws.pop(0)


def compare_trajectories(comparison: Comparison, parity: Parity) -> None:
    """Compare waypoints.

    Args:
        comparison: Takes the results.
        parity: The golden numbers.

    Raises:
        InputError: If arrays are absent or do not fit.
    """
    _compare_standardiser(comparison, parity)
    _compare_varied(comparison, parity)


def _compare_standardiser(comparison: Comparison, parity: Parity) -> None:
    """Verlet integration from rest and from a history, and its inverse."""
    actions = _waypoints(parity, "full_eta0_actions")
    still = _waypoints(parity, "full_eta0_trajectory_zero_history", len(actions))
    _compare_shares(comparison, "waypoints from rest", waypoints_from_actions(actions, np.zeros(CHANNELS)), still)
    history = parity.floats("verlet_history", len(actions), HISTORY_POSES, HISTORY_COLUMNS)[:, -2:, :CHANNELS]
    previous, now = history[:, 0], history[:, 1]
    moved = _waypoints(parity, "verlet_untransform_with_history", len(actions))
    ours = waypoints_from_actions(actions, previous, now)
    _compare_shares(comparison, "waypoints from a history", ours, moved)
    back = _waypoints(parity, "verlet_transform_back", len(actions))
    ours = actions_from_waypoints(moved, previous, now)
    _compare_shares(comparison, "actions from waypoints", ours, back, np.abs(moved).max(initial=1.0))


def _compare_varied(comparison: Comparison, parity: Parity) -> None:
    """Quarters of a batch scaled by the draws that the set stores."""
    plain = _waypoints(parity, "aug_in")
    varied = _waypoints(parity, "aug_out", len(plain))
    quarter = len(plain) // 4
    if len(plain) != 4 * quarter:
        raise InputError(f"array aug_in in {parity.stored.path} has no four equal quarters; make the file again")
    draws = [parity.floats(f"aug_u{part}", quarter, 1)[:, 0] for part in (1, 2, 3)]
    ours = diversify(plain, _StoredDraws(*draws))
    _compare_shares(comparison, "varied first batch", ours, varied)


def _compare_shares(
    comparison: Comparison, quantity: str, ours: Floats, golden: Floats, largest: float | None = None
) -> None:
    """Compare as shares of the largest waypoint, in metres or radians but at least one."""
    scale = float(np.abs(golden).max(initial=1.0)) if largest is None else float(largest)
    comparison.numbers(f"{quantity} (of the largest)", ours / scale, golden / scale, SHARE_TOLERANCE)


def _waypoints(parity: Parity, name: str, count: int | None = None) -> Floats:
    """An array of B x 48 as (B, 16, 3) in double precision."""
    return parity.floats(name, count, WAYPOINTS * CHANNELS).reshape(-1, WAYPOINTS, CHANNELS)
