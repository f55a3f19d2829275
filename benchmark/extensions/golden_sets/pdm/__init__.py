"""`challenger-bench verify pdm`: motions, verdicts and scores against those of the official code.

Inputs are the set's own motions (mode ``direct`` and the official tracked ones), so that a verdict never hangs on an
earlier difference, and everything from the plans on, as an evaluation does it.
"""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.constants import EGO_WHEELBASE_M
from benchmark.extensions.golden_sets.pdm.golden_set import ModeComparison, PdmGoldenScene, compare_filter
from benchmark.geometry import Floats, to_global, wrap_angle
from benchmark.pdm.definition import HEADING, STATE_COLUMNS, STATES
from benchmark.pdm.plan_motion import build_history_rows, fit_reference_path, interpolate_poses, track_plans
from benchmark.pdm.road_polygons import compute_footprints
from benchmark.pdm.traffic import find_touching_at_start, interpolate_traffic
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet

BUILT_IN: Final = Path(__file__).parent / "golden" / "pdm"
"""The golden set in the package, in the same form as any other."""
SHORT_SAMPLES: Final = [0, 6]
"""Samples that the set has with a shorter wheelbase too."""


def _compare_scenes(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare objects, motions, areas, events, sub-scores, totals."""
    for path in folder.named("*.npz"):
        scene, at = PdmGoldenScene(folder.arrays(path.name)), comparison.at(path.name)
        _compare_inputs(at, scene)
        _compare_motions(at, scene)
        for mode in ("lqr", "direct"):
            stored = scene.by_plan(f"{mode}_states", STATES, STATE_COLUMNS)
            ModeComparison(at.at(path.name, f"{mode}: "), scene, mode).compare(stored)
        own = track_plans(scene.plans.reshape(-1, *scene.plans.shape[2:]), np.repeat(scene.now, scene.count, axis=0))
        own = own.reshape(scene.samples, scene.count, STATES, STATE_COLUMNS)
        scores = ModeComparison(at.at(path.name, "from plans: "), scene, "lqr").compare(own)
        compare_filter(at, scene, own, scores)


def _compare_inputs(comparison: Comparison, scene: PdmGoldenScene) -> None:
    """Objects at 10 Hz, which of them go, and the rows of history."""
    stored, traffic = scene.stored, interpolate_traffic(scene.key_frames)
    count = len(traffic.present)
    box = stored.floats("obj_box", count, STATES, 3)
    comparison.same("objects present", traffic.present, stored.verdicts("obj_valid", count, STATES))
    comparison.numbers("object position (m)", traffic.box[..., :2], box[..., :2])
    comparison.numbers("object heading (rad)", traffic.box[..., 4], box[..., 2], angle=True)
    velocity = stored.floats("obj_velocity", count, STATES, 2)
    comparison.numbers("object velocity (m/s)", traffic.velocity, velocity)
    removed = find_touching_at_start(traffic, compute_footprints(scene.now))
    comparison.same("objects removed", removed, stored.verdicts("obj_removed", count))
    rows = stored.floats("history_rows", scene.samples, None, STATE_COLUMNS)
    comparison.numbers("history", build_history_rows(scene.history), rows)


def _compare_motions(comparison: Comparison, scene: PdmGoldenScene) -> None:
    """Interpolated plans, profiles and tracked states."""
    plans, now = scene.plans.reshape(-1, *scene.plans.shape[2:]), np.repeat(scene.now, scene.count, axis=0)
    poses, golden = interpolate_poses(plans), scene.by_plan("plan_states", STATES, 3).reshape(-1, STATES, 3)
    comparison.numbers("plan position (m)", to_global(poses[..., :2], now[:, None, :3]), golden[..., :2])
    comparison.numbers("plan heading (rad)", poses[..., 2] + now[:, None, HEADING], golden[..., 2], angle=True)
    path = fit_reference_path(plans)
    profiles = {
        "speed profile (m/s)": (path.speed, "velocity"),
        "curvature profile (1/m)": (path.curvature, "curvature"),
    }
    for name, (ours, kind) in profiles.items():
        official = scene.by_plan(f"lqr_{kind}_profile", STATES - 1)
        comparison.numbers(name, ours.T.reshape(official.shape), official)
    _compare_states(comparison, "", track_plans(plans, now), scene.by_plan("lqr_states", STATES, STATE_COLUMNS))
    if scene.samples <= max(SHORT_SAMPLES):
        return
    shape = (len(SHORT_SAMPLES), scene.count, STATES, STATE_COLUMNS)
    plans = scene.plans[SHORT_SAMPLES].reshape(-1, *scene.plans.shape[2:])
    ours = track_plans(plans, np.repeat(scene.now[SHORT_SAMPLES], scene.count, axis=0), wheelbase_m=EGO_WHEELBASE_M)
    _compare_states(comparison, ", short wheelbase", ours, scene.stored.floats("lqr_states_short_wheelbase", *shape))


def _compare_states(comparison: Comparison, called: str, ours: Floats, golden: Floats) -> None:
    difference = ours - golden.reshape(ours.shape)
    difference[..., HEADING] = wrap_angle(difference[..., HEADING])
    comparison.errors(f"states (11 columns){called}", difference)


GOLDEN: Final = GoldenSet(
    name="pdm",
    files=("*.npz",),
    compare=(_compare_scenes,),
    quantities={"states (11 columns)*": 1e-9, "*: HC extremes": 2e-8, "*": 1e-8},
    built_in=BUILT_IN,
)
