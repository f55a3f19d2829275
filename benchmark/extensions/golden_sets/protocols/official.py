"""Verdicts and values of each sample, plan and step against those of the official code."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.golden_sets.protocols.golden_set import GoldenScene
from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, Outcomes, raster
from benchmark.protocols.raster import CELLS
from benchmark.protocols.stacked import StackedTruths, stack
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays

_TABLES: Final = {"vad": "vad", "vad-23": "vad23"}
"""Protocol and prefix of its arrays, for both category tables."""


def complete_samples(scene: GoldenScene) -> Bools:
    """Which samples have a recorded future of 3 s, (S,)."""
    return np.array([truth.complete for truth in scene.truths], dtype=np.bool_)


def compare_equal(
    comparison: Comparison,
    stored: GoldenArrays,
    ours: Mapping[str, tuple[NDArray[Any], str]],
    of: Bools | None = None,
) -> None:
    """Compare quantities that must be equal, of all samples or of some.

    ``ours`` holds by quantity our values and the name of the golden array, where verdicts may be stored as numbers.
    """
    for quantity, (values, array) in ours.items():
        comparison.same(quantity, values, stored.floats(array, *values.shape), of)


def compare_official(comparison: Comparison, scene: GoldenScene, outcomes: Mapping[str, list[Outcomes]]) -> None:
    """Compare all four protocols, VAD with both category tables.

    Outcomes of each protocol are for each of the P plans.
    """
    stacked, complete = stack(scene.truths), complete_samples(scene)
    compare_equal(comparison, scene.official, {"samples that count": (complete, "sample_valid")})
    _compare_uniad(comparison, scene.official, outcomes["uniad"], stacked)
    _compare_vad(comparison, scene.official, outcomes, stacked, complete)
    for name in ("sparsedrive", "diffusiondrive"):
        _compare_polygons(comparison, scene.official, name, outcomes[name], complete)


def drawn(name: str, truths: StackedTruths) -> NDArray[np.uint8]:
    """Rasters on which ``uniad``, ``vad`` or ``vad-23`` looks for collisions: (S, 6, 200, 200), 1 where occupied."""
    definition = PROTOCOLS[name]
    assert isinstance(definition, raster.RasterProtocol)
    objects, steps = np.nonzero(definition.counted_objects(truths))
    polygons = definition.drawn_polygons(definition.drawn_boxes(truths, objects, steps))
    samples = len(truths.ego_future)
    grids = raster.full_rasters(polygons, truths.sample_of[objects] * PLAN_STEPS + steps, samples * PLAN_STEPS)
    return grids.reshape(samples, PLAN_STEPS, *grids.shape[1:])


def stored_rasters(stored: GoldenArrays, name: str, samples: int) -> NDArray[np.uint8]:
    """(S, 6, 200, 200) ones where occupied, which are stored eight cells to the byte."""
    packed = stored.integers(name, samples, PLAN_STEPS, CELLS * CELLS // 8).astype(np.uint8)
    return np.unpackbits(packed, axis=-1).reshape(samples, PLAN_STEPS, CELLS, CELLS)


def _compare_uniad(
    comparison: Comparison, official: GoldenArrays, judged: list[Outcomes], stacked: StackedTruths
) -> None:
    # The official raster past the end of a scene is full, so both flags are up there; ours say nothing there.
    seen = stacked.ego_future_valid
    ours = {
        "uniad before the mask": (on_all(judged, "before_mask") | ~seen[:, None], "uniad_raw_box"),
        "uniad of the recorded ego": (judged[0].step("recorded") | ~seen, "uniad_gt_box"),
        "uniad obj_box_col": (on_all(judged), "uniad_obj_box_col"),
        "uniad obj_col": (on_all(judged, "obj_col"), "uniad_obj_col"),
    }
    compare_equal(comparison, official, ours)
    compare_l2(comparison, official, "uniad L2 (m)", judged, "uniad_L2", np.ones(len(seen), np.bool_))
    stored = stored_rasters(official, "uniad_seg_bits", len(seen))
    comparison.same("uniad raster cells", drawn("uniad", stacked), stored, seen)


def _compare_vad(
    comparison: Comparison,
    official: GoldenArrays,
    outcomes: Mapping[str, list[Outcomes]],
    stacked: StackedTruths,
    complete: Bools,
) -> None:
    judged = outcomes["vad"]
    ours = {
        "vad before the mask": (on_all(judged, "before_mask"), "vad_raw_box"),
        "vad of the recorded ego": (judged[0].step("recorded"), "vad_gt_box"),
        "vad obj_box_col": (on_all(judged), "vad_step_obj_box_col"),
        "vad obj_col": (on_all(judged, "obj_col"), "vad_step_obj_col"),
    }
    compare_equal(comparison, official, ours, complete)
    for name, prefix in _TABLES.items():
        values = at_horizons(name, outcomes[name])
        shares = {
            f"{name} obj_box_col at 1, 2, 3 s": (values["collision"], f"{prefix}_obj_box_col"),
            f"{name} obj_col at 1, 2, 3 s": (values["obj_col"], f"{prefix}_obj_col"),
        }
        compare_equal(comparison, official, shares, complete)
        if name == "vad":
            golden = official.floats("vad_L2", *values["l2"].shape)
            comparison.numbers("vad L2 at 1, 2, 3 s (m)", values["l2"][complete], golden[complete])
    stored = stored_rasters(official, "vad_seg_bits", len(complete))
    comparison.same("vad raster cells", drawn("vad", stacked), stored)


def _compare_polygons(
    comparison: Comparison, official: GoldenArrays, name: str, judged: list[Outcomes], complete: Bools
) -> None:
    """SparseDrive or DiffusionDrive, whose evaluation is the same and which share their golden arrays."""
    recorded, collisions = judged[0].step("recorded"), on_all(judged)
    ours = {
        f"{name} before the mask": (on_all(judged, "before_mask"), "sd_raw_box"),
        f"{name} of the recorded ego": (recorded, "sd_gt_box"),
        f"{name} obj_box_col": (collisions, "sd_obj_box_col"),
        f"{name} obj_col": (np.broadcast_to(recorded[:, None], collisions.shape), "sd_obj_col"),
    }
    compare_equal(comparison, official, ours, complete)
    compare_l2(comparison, official, f"{name} L2 (m)", judged, "sd_L2", complete)


def compare_l2(
    comparison: Comparison, official: GoldenArrays, quantity: str, judged: list[Outcomes], array: str, of: Bools
) -> None:
    """Compare displacements at the steps, of some samples."""
    ours = np.stack([outcomes.l2 for outcomes in judged], axis=1)
    comparison.numbers(quantity, ours[of], official.floats(array, *ours.shape)[of])


def on_all(judged: list[Outcomes], column: str | None = None) -> NDArray[Any]:
    """(S, P, 6) verdicts on all plans: collisions, or a further column."""
    return np.stack([one.collision if column is None else one.step(column) for one in judged], axis=1)


def at_horizons(name: str, judged: list[Outcomes]) -> dict[str, Floats]:
    """(S, P, 3) each column of the values at 1, 2 and 3 s."""
    found = [PROTOCOLS[name].sample_values(one) for one in judged]
    return {column: np.stack([one[column] for one in found], axis=1) for column in found[0]}
