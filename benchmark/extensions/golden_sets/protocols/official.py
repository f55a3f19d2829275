"""Verdicts and values of each sample, plan and step against those of the official code."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.golden_sets.protocols.golden_set import GoldenScene
from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, Outcomes, raster
from benchmark.protocols.stacked import StackedTruths, stack
from benchmark.verification.checks import Comparison

L2_M: Final = 1e-5
"""Allowed error of one displacement: the golden ones are single precision, up to about 100 m."""
_TABLES: Final = {"vad": "vad", "vad-23": "vad23"}
"""Protocol and prefix of its arrays, for both category tables."""


def complete_samples(scene: GoldenScene) -> Bools:
    """Which samples have a recorded future of 3 s, (S,)."""
    return np.array([truth.complete for truth in scene.truths], dtype=np.bool_)


def compare_official(comparison: Comparison, scene: GoldenScene, outcomes: Mapping[str, list[Outcomes]]) -> None:
    """Compare all four protocols, VAD with both category tables.

    Args:
        comparison: Where the errors go.
        scene: The scene.
        outcomes: For each protocol its verdicts on each of the P plans.

    Raises:
        InputError: If an array of verdicts is absent, damaged or of the wrong shape.
    """
    stacked, complete = stack(scene.truths), complete_samples(scene)
    counted = scene.official.verdicts("sample_valid", len(scene.truths))
    comparison.verdicts("samples that count", counted != complete, where=scene.name)
    _compare_uniad(comparison, scene, outcomes["uniad"], stacked)
    _compare_vad(comparison, scene, outcomes, stacked, complete)
    for name in ("sparsedrive", "diffusiondrive"):
        _compare_polygons(comparison, scene, name, outcomes[name], complete)


def drawn(name: str, truths: StackedTruths) -> NDArray[np.uint8]:
    """The rasters on which a protocol looks for collisions.

    Args:
        name: ``uniad``, ``vad`` or ``vad-23``.
        truths: S samples.

    Returns:
        (S, 6, 200, 200) ones where occupied.
    """
    definition = PROTOCOLS[name]
    if not isinstance(definition, raster.RasterProtocol):
        raise ValueError(f"protocol {name} draws no raster")
    objects, steps = np.nonzero(definition.counted_objects(truths))
    polygons = definition.drawn_polygons(definition.drawn_boxes(truths, objects, steps))
    samples = len(truths.ego_future)
    grids = raster.full_rasters(polygons, truths.sample_of[objects] * PLAN_STEPS + steps, samples * PLAN_STEPS)
    return grids.reshape(samples, PLAN_STEPS, *grids.shape[1:])


def _compare_uniad(comparison: Comparison, scene: GoldenScene, judged: list[Outcomes], stacked: StackedTruths) -> None:
    official, where = scene.official, scene.name
    shape = scene.plans.shape[:3]
    # The official raster past the end of a scene is full, so both flags are up there; ours say nothing there.
    past_end = ~stacked.ego_future_valid
    flags = {
        "before the mask": (
            _steps(judged, "before_mask") | past_end[:, None],
            official.verdicts("uniad_raw_box", *shape),
        ),
        "of the recorded ego": (judged[0].step("recorded") | past_end, official.verdicts("uniad_gt_box", *_row(shape))),
        "obj_box_col": (_collisions(judged), official.flags("uniad_obj_box_col", *shape)),
        "obj_col": (_steps(judged, "obj_col"), official.flags("uniad_obj_col", *shape)),
    }
    for quantity, (ours, golden) in flags.items():
        comparison.verdicts(f"uniad {quantity}", ours != golden, where=where)
    displacement = official.floats("uniad_L2", *shape)
    comparison.numbers("uniad L2 (m)", _displacements(judged), displacement, L2_M, where=where)
    seen = stacked.ego_future_valid
    stored = official.rasters("uniad_seg_bits", len(scene.truths))
    comparison.verdicts("uniad raster cells", drawn("uniad", stacked)[seen] != stored[seen], where=where)


def _compare_vad(
    comparison: Comparison,
    scene: GoldenScene,
    outcomes: Mapping[str, list[Outcomes]],
    stacked: StackedTruths,
    complete: Bools,
) -> None:
    official, where, judged = scene.official, scene.name, outcomes["vad"]
    shape = scene.plans.shape[:3]
    flags = {
        "before the mask": (_steps(judged, "before_mask"), official.verdicts("vad_raw_box", *shape)),
        "of the recorded ego": (judged[0].step("recorded"), official.verdicts("vad_gt_box", *_row(shape))),
        "obj_box_col": (_collisions(judged), official.flags("vad_step_obj_box_col", *shape)),
        "obj_col": (_steps(judged, "obj_col"), official.flags("vad_step_obj_col", *shape)),
    }
    for quantity, (ours, golden) in flags.items():
        comparison.verdicts(f"vad {quantity}", (ours != golden)[complete], where=where)
    for name, prefix in _TABLES.items():
        values = [PROTOCOLS[name].sample_values(plan) for plan in outcomes[name]]
        for column, array in {"collision": "obj_box_col", "obj_col": "obj_col"}.items():
            wanted = official.floats(f"{prefix}_{array}", *shape[:2], 3)
            found = np.stack([value[column] for value in values], axis=1)
            comparison.verdicts(f"{name} {array} at 1, 2, 3 s", (found != wanted)[complete], where=where)
        if name == "vad":
            wanted = official.floats("vad_L2", *shape[:2], 3)
            found = np.stack([value["l2"] for value in values], axis=1)
            quantity = "vad L2 at 1, 2, 3 s (m)"
            comparison.numbers(quantity, found[complete], wanted[complete], L2_M, where=where)
    stored = official.rasters("vad_seg_bits", len(scene.truths))
    comparison.verdicts("vad raster cells", drawn("vad", stacked) != stored, where=where)


def _compare_polygons(
    comparison: Comparison, scene: GoldenScene, name: str, judged: list[Outcomes], complete: Bools
) -> None:
    """SparseDrive or DiffusionDrive, whose evaluation is the same and which share their golden arrays."""
    official, where = scene.official, scene.name
    shape = scene.plans.shape[:3]
    recorded = judged[0].step("recorded")
    flags = {
        "before the mask": (_steps(judged, "before_mask"), official.verdicts("sd_raw_box", *shape)),
        "of the recorded ego": (recorded, official.verdicts("sd_gt_box", *_row(shape))),
        "obj_box_col": (_collisions(judged), official.flags("sd_obj_box_col", *shape)),
        "obj_col": (np.broadcast_to(recorded[:, None], shape), official.flags("sd_obj_col", *shape)),
    }
    for quantity, (ours, golden) in flags.items():
        comparison.verdicts(f"{name} {quantity}", (ours != golden)[complete], where=where)
    displacement = official.floats("sd_L2", *shape)
    ours = _displacements(judged)
    comparison.numbers(f"{name} L2 (m)", ours[complete], displacement[complete], L2_M, where=where)


def _row(shape: tuple[int, ...]) -> tuple[int, int]:
    """Shape of what is the same for all plans."""
    return shape[0], shape[2]


def _steps(judged: list[Outcomes], column: str) -> NDArray[Any]:
    return np.stack([outcomes.step(column) for outcomes in judged], axis=1)


def _collisions(judged: list[Outcomes]) -> Bools:
    return np.stack([outcomes.collision for outcomes in judged], axis=1)


def _displacements(judged: list[Outcomes]) -> Floats:
    return np.stack([outcomes.l2 for outcomes in judged], axis=1)
