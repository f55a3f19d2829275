"""The slow version of the PDM sub-scores against official answers."""

from pathlib import Path

import numpy as np
import pytest

from benchmark.extensions.golden_sets.pdm.golden_set import PdmGoldenScene
from benchmark.verification.golden_sets import GoldenArrays
from tests.benchmark.pdm.cases import slow_objects
from tests.benchmark.pdm.slow_motion import slow_motion
from tests.benchmark.pdm.slow_pdm import SlowSample, slow_states_verdict

OFFICIAL = Path(__file__).resolve().parents[6] / "shared" / "golden" / "pdm"


@pytest.mark.skipif(not OFFICIAL.is_dir(), reason="the official answers are not here")
def test_the_slow_version_says_what_the_official_code_says() -> None:
    scene = PdmGoldenScene(GoldenArrays.read(OFFICIAL / "scene-0553.npz"))
    frames = scene.key_frames
    for sample in (0, 3):
        around = SlowSample(
            scene.now[sample], scene.history[sample], slow_objects(frames, sample), scene.road(sample), scene.route
        )
        for plan in range(0, scene.count, 3):
            states = slow_motion(scene.plans[sample, plan], scene.now[sample])
            assert np.abs(states - scene.by_plan("lqr_states", 31, 11)[sample, plan]).max() < 1e-6
            for mode in ("lqr", "direct"):
                given = scene.by_plan(f"{mode}_states", 31, 11)[sample, plan]
                verdict = slow_states_verdict(given, around)
                for name in ("nc", "dac", "ddc", "ttc", "lk", "hc"):
                    assert getattr(verdict, name) == scene.by_plan(f"{mode}_{name}")[sample, plan], (mode, name, plan)
