"""One planning step of each preset, all of its stages chained, against the same written out in loops."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, load_denoiser
from generation.diffusion.prior import CandidateSource, SamplerSettings, TrajectoryPrior, diversify
from generation.search.hyperparameters import HyperParameters
from generation.search.planning import AdversaryPlanning
from generation.search.proposals import run_searches
from tests.generation.search.driving_prior import unchanged
from tests.generation.search.slow_step import SlowStep
from tests.hand_made import Car, scene_on_straight_road

SCENE = scene_on_straight_road(
    (Car(60.0, 194.75, 9.0), Car(78.0, 198.25, 7.0), Car(74.0, 194.75, 8.0), Car(120.0, 201.75, 9.0, np.pi)),
    seconds=14.0,
)
FRAME = 24
TEXT_ALONE = ("timestep_frames=6", "collision_reading=literal", "lookahead_frames=0", "clearance_m=0", "headway_s=0")
"""What the loops write out of the paper: no margin around bodies and nothing after the horizon."""


@pytest.mark.parametrize("reference", [False, True], ids=["paper", "reference"])
def test_a_planning_step_is_the_one_that_is_written_out(reference: bool) -> None:
    torch.set_num_threads(1)
    preset = HyperParameters.reference() if reference else HyperParameters.paper().changed(TEXT_ALONE)
    hyper = replace(preset, candidates=12, rounds=2)
    denoiser = load_denoiser(PACKAGED_WEIGHTS)
    slow = SlowStep(SCENE, 0, FRAME, hyper, denoiser, np.random.default_rng(5), reference=reference).run()
    prior = TrajectoryPrior.load(
        settings=SamplerSettings(samples=CandidateSource.REFERENCE, conditioned=False, drivable=False)
    )
    spread = diversify if hyper.varied else unchanged
    rng, model = np.random.default_rng(5), hyper.motion_model()
    planning = AdversaryPlanning(SCENE, 0, FRAME, hyper, spread, model, rng, {"physics": 0.0, "scoring": 0.0})
    step = planning.plan(FRAME, planning.compute_first_state(), planning.find_first_pose()[None])
    found = run_searches([step], prior)[0][0]
    assert found.round == 2
    assert found.chosen == slow.index
    for ours, theirs in zip(found.rounds, slow.scores, strict=True):
        np.testing.assert_allclose(ours.scores, theirs, atol=2e-4)
    assert np.ptp(slow.scores[0]) > 0.1
    np.testing.assert_allclose(found.waypoints, slow.waypoints, atol=1e-3)
    offsets = [offset for offset in hyper.scored_frames if FRAME + offset < len(SCENE.timestamps_us)]
    np.testing.assert_allclose(found.motion.center[found.chosen, offsets], slow.center, atol=1e-3)
