"""Schedule, standardiser and diversification of the denoiser against the reference's numbers."""

import numpy as np

from benchmark.geometry import Floats
from generation.diffusion.prior import diversify
from generation.diffusion.schedule import ALPHA_BARS, BETAS, choose_strided_timesteps
from generation.diffusion.standardiser import convert_actions_to_waypoints, convert_waypoints_to_actions
from generation.extensions.golden_sets.built_in import BUILT_IN

GOLDEN = BUILT_IN / "denoiser"


def test_schedule_equals_the_reference() -> None:
    with np.load(GOLDEN / "schedule.npz") as golden:
        assert np.abs(golden["betas"] - BETAS).max() < 1e-8
        assert np.abs(golden["alphas_cumprod"] - ALPHA_BARS).max() < 1e-6
        assert golden["timesteps"].tolist() == list(choose_strided_timesteps(99, None))


def test_standardiser_equals_the_reference() -> None:
    with np.load(GOLDEN / "parity.npz") as golden:
        history = golden["verlet_history"][:, -2:, :3].astype(np.float64)
        actions = golden["full_eta0_actions"].reshape(8, 16, 3).astype(np.float64)
        still = convert_actions_to_waypoints(actions, np.zeros(3))
        stored = golden["full_eta0_trajectory_zero_history"].reshape(8, 16, 3)
        assert np.abs(still - stored).max() < 1e-6 * np.abs(stored).max()  # the reference sums in float32
        moved = golden["verlet_untransform_with_history"].reshape(8, 16, 3).astype(np.float64)
        error = np.abs(convert_actions_to_waypoints(actions, history[:, 0], history[:, 1]) - moved).max()
        assert error < 1e-6 * np.abs(moved).max()
        back = convert_waypoints_to_actions(moved, history[:, 0], history[:, 1])
        assert np.abs(back - golden["verlet_transform_back"].reshape(8, 16, 3)).max() < 5e-5


def test_quarters_equal_the_reference() -> None:
    class Played:
        """Plays the reference's uniform numbers."""

        def __init__(self, draws: list[Floats]) -> None:
            self.draws = draws

        def random(self, size: int) -> Floats:
            return self.draws.pop(0)[:size]

    with np.load(GOLDEN / "parity.npz") as golden:
        played = Played([golden[f"aug_u{part}"][:, 0].astype(np.float64) for part in (1, 2, 3)])
        varied = diversify(golden["aug_in"].reshape(8, 16, 3), played)  # type: ignore[arg-type]
        stored = golden["aug_out"].reshape(8, 16, 3)
        assert np.abs(varied - stored).max() < 1e-6 * max(1.0, float(np.abs(stored).max()))
