"""`challenger-bench verify pdm`: motions, verdicts and scores against those of the official code.

Two kinds of input: the set's own motions (mode ``direct`` and the official tracked ones), so that a verdict never hangs
on an earlier difference, and everything from the plans on, as an evaluation does it.
"""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.constants import EGO_WHEELBASE_M
from benchmark.extensions.golden_sets.pdm.golden_set import GoldenScene, golden_scenes
from benchmark.extensions.golden_sets.pdm.verdicts import ModeComparison, compare_filter
from benchmark.geometry import Floats, to_global, wrap_angle
from benchmark.pdm.comfort import history_rows
from benchmark.pdm.definition import HEADING, STATE_COLUMNS, STATES
from benchmark.pdm.motion import interpolated, reference_of, tracked
from benchmark.pdm.road import footprints
from benchmark.pdm.traffic import at_states, touching_at_start
from benchmark.verification.checks import Check, Comparison

__all__ = ["BUILT_IN", "verify_pdm"]

BUILT_IN: Final = Path(__file__).parent / "golden" / "pdm"
"""The golden set in the package, in the same form as any other."""
STATES_TOLERANCE, TOLERANCE = 1e-9, 1e-8
SHORT_SAMPLES: Final = (0, 6)
"""Samples that the set has with a shorter wheelbase too."""


def verify_pdm(golden: Path | None = None) -> list[Check]:
    """Compare the PDM sub-scores with a golden set: objects, motions, areas, events, sub-scores, totals.

    Args:
        golden: Directory of golden numbers; the built-in set by default.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    comparison = Comparison()
    for path in golden_scenes(BUILT_IN if golden is None else golden):
        scene = GoldenScene(path)
        _compare_inputs(comparison, scene)
        _compare_motions(comparison, scene)
        for mode in ("lqr", "direct"):
            stored = scene.by_plan(f"{mode}_states", STATES, STATE_COLUMNS)
            ModeComparison(comparison, scene, mode, mode).compare(stored)
        own = tracked(scene.plans.reshape(-1, *scene.plans.shape[2:]), np.repeat(scene.now, scene.count, axis=0))
        own = own.reshape(scene.samples, scene.count, STATES, STATE_COLUMNS)
        scores = ModeComparison(comparison, scene, "lqr", "from plans").compare(own)
        compare_filter(comparison, scene, own, scores)
    return comparison.checks()


def _compare_inputs(comparison: Comparison, scene: GoldenScene) -> None:
    """Objects at 10 Hz, which of them go, and the rows of history."""
    stored, where = scene.stored, scene.name
    traffic = at_states(scene.key_frames)
    count = len(traffic.present)
    box = stored.floats("obj_box", count, STATES, 3)
    comparison.verdicts("objects present", traffic.present != stored.verdicts("obj_valid", count, STATES), where=where)
    comparison.numbers("object position (m)", traffic.box[..., :2], box[..., :2], TOLERANCE, where=where)
    comparison.numbers("object heading (rad)", traffic.box[..., 4], box[..., 2], TOLERANCE, angle=True, where=where)
    velocity = stored.floats("obj_velocity", count, STATES, 2)
    comparison.numbers("object velocity (m/s)", traffic.velocity, velocity, TOLERANCE, where=where)
    removed = touching_at_start(traffic, footprints(scene.now)) != stored.verdicts("obj_removed", count)
    comparison.verdicts("objects removed", removed, where=where)
    rows = stored.floats("history_rows", scene.samples, None, STATE_COLUMNS)
    ours = history_rows(scene.history)
    comparison.numbers("history", ours, rows, TOLERANCE, where=where)


def _compare_motions(comparison: Comparison, scene: GoldenScene) -> None:
    """Interpolated plans, profiles and tracked states."""
    stored, where, shape = scene.stored, scene.name, (scene.samples, scene.count)
    plans, now = scene.plans.reshape(-1, *scene.plans.shape[2:]), np.repeat(scene.now, scene.count, axis=0)
    poses, golden = interpolated(plans), scene.by_plan("plan_states", STATES, 3).reshape(-1, STATES, 3)
    heading = poses[..., 2] + now[:, None, HEADING]
    position = to_global(poses[..., :2], now[:, None, :3])
    comparison.numbers("plan position (m)", position, golden[..., :2], TOLERANCE, where=where)
    comparison.numbers("plan heading (rad)", heading, golden[..., 2], TOLERANCE, angle=True, where=where)
    path = reference_of(plans)
    profiles = {
        "speed profile (m/s)": (path.speed, "velocity"),
        "curvature profile (1/m)": (path.curvature, "curvature"),
    }
    for name, (ours, kind) in profiles.items():
        official = scene.by_plan(f"lqr_{kind}_profile", STATES - 1)
        comparison.numbers(name, ours.T.reshape(*shape, -1), official, TOLERANCE, where=where)
    _compare_states(comparison, "", tracked(plans, now), scene.by_plan("lqr_states", STATES, STATE_COLUMNS), where)
    if scene.samples <= max(SHORT_SAMPLES):
        return
    some = list(SHORT_SAMPLES)
    short = stored.floats("lqr_states_short_wheelbase", len(some), scene.count, STATES, STATE_COLUMNS)
    plans, now = scene.plans[some].reshape(-1, *scene.plans.shape[2:]), np.repeat(scene.now[some], scene.count, axis=0)
    ours = tracked(plans, now, wheelbase_m=EGO_WHEELBASE_M)
    _compare_states(comparison, ", short wheelbase", ours, short, where)


def _compare_states(comparison: Comparison, called: str, ours: Floats, golden: Floats, where: str) -> None:
    theirs = golden.reshape(ours.shape)
    difference = np.abs(ours - theirs)
    difference[..., HEADING] = np.abs(wrap_angle(ours[..., HEADING] - theirs[..., HEADING]))
    comparison.errors(f"states (11 columns){called}", difference, STATES_TOLERANCE, where=where)
