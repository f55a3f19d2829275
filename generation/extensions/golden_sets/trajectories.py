"""Golden trajectories of the denoiser: actions to waypoints and back, and what makes a first batch varied."""

from typing import Any

import numpy as np

from benchmark.geometry import Floats
from generation.diffusion.prior import diversify
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS, actions_from_waypoints, waypoints_from_actions
from generation.extensions.golden_sets.processes import Parity


class _StoredDraws(np.random.Generator):
    """Gives back uniform numbers that were drawn elsewhere, one array for each call."""

    def __init__(self, *draws: Floats) -> None:
        super().__init__(np.random.PCG64(0))
        self._draws = list(draws)

    def random(self, size: Any = None, dtype: Any = np.float64, out: Any = None) -> Any:
        """The next array."""
        return self._draws.pop(0)


def compare_trajectories(parity: Parity) -> None:
    """Compare waypoints: from rest, from a history and back, and quarters of a batch scaled by the stored draws."""
    actions = _waypoints(parity, "full_eta0_actions")
    still = waypoints_from_actions(actions, np.zeros(CHANNELS))
    _compare_shares(parity, "waypoints from rest", still, "full_eta0_trajectory_zero_history")
    history = parity.floats("verlet_history", len(actions), None, None)[:, -2:, :CHANNELS]
    previous, now = history[:, 0], history[:, 1]
    ours, moved = waypoints_from_actions(actions, previous, now), "verlet_untransform_with_history"
    _compare_shares(parity, "waypoints from a history", ours, moved)
    golden = _waypoints(parity, moved)
    ours, largest = actions_from_waypoints(golden, previous, now), float(np.abs(golden).max(initial=1.0))
    _compare_shares(parity, "actions from waypoints", ours, "verlet_transform_back", largest)
    plain = _waypoints(parity, "aug_in")
    draws = [parity.floats(f"aug_u{part}", len(plain) // 4, 1)[:, 0] for part in (1, 2, 3)]
    _compare_shares(parity, "varied first batch", diversify(plain, _StoredDraws(*draws)), "aug_out")


def _compare_shares(parity: Parity, quantity: str, ours: Floats, name: str, largest: float | None = None) -> None:
    """Compare as shares of the largest waypoint, in metres or radians but at least one."""
    golden = _waypoints(parity, name)
    scale = float(np.abs(golden).max(initial=1.0)) if largest is None else largest
    parity.comparison.numbers(f"{quantity} (of the largest)", ours / scale, golden / scale)


def _waypoints(parity: Parity, name: str) -> Floats:
    """An array of B x 48 as (B, 16, 3) in double precision."""
    return parity.floats(name, None, WAYPOINTS * CHANNELS).reshape(-1, WAYPOINTS, CHANNELS)
