"""Verdicts and values of samples, plans and steps against official code, of the further protocols by roads and past."""

import zlib
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.golden_sets.protocols.golden_set import ProtocolGoldenScene
from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, ProtocolOutcomes, bev_planner, fine_grid, omnidrive, raster, stp3
from benchmark.protocols.raster import CELLS
from benchmark.protocols.stacked_truths import StackedTruths, stack
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays

_TABLES: Final = {"vad": "vad", "vad-23": "vad23"}
"""Protocol and prefix of its arrays, for both category tables."""


def find_complete_samples(scene: ProtocolGoldenScene) -> Bools:
    """Which samples have a recorded future of 3 s, (S,)."""
    return np.array([truth.complete for truth in scene.truths], dtype=np.bool_)


def compare_equal(
    comparison: Comparison,
    stored: GoldenArrays,
    ours: Mapping[str, tuple[NDArray[Any], str]],
    of: Bools | None = None,
) -> None:
    """Compare quantities that must be equal; ``ours`` has values and golden name, whose verdicts may be numbers."""
    for quantity, (values, array) in ours.items():
        comparison.same(quantity, values, stored.floats(array, *values.shape), of)


def compare_official(
    comparison: Comparison, scene: ProtocolGoldenScene, outcomes: Mapping[str, list[ProtocolOutcomes]]
) -> None:
    """Compare all four protocols, VAD with both category tables; outcomes are for each of the P plans."""
    stacked, complete = stack(scene.truths), find_complete_samples(scene)
    compare_equal(comparison, scene.official, {"samples that count": (complete, "sample_valid")})
    _compare_uniad(comparison, scene.official, outcomes["uniad"], stacked)
    _compare_vad(comparison, scene.official, outcomes, stacked, complete)
    for name in ("sparsedrive", "diffusiondrive"):
        _compare_polygons(comparison, scene.official, name, outcomes[name], complete)


def draw_rasters(name: str, truths: StackedTruths) -> NDArray[np.uint8]:
    """Rasters on which ``uniad``, ``vad`` or ``vad-23`` looks for collisions: (S, 6, 200, 200), 1 where occupied."""
    definition = PROTOCOLS[name]
    assert isinstance(definition, raster.RasterProtocol)
    objects, steps = np.nonzero(definition.counted_objects(truths))
    polygons = definition.drawn_polygons(definition.drawn_boxes(truths, objects, steps))
    samples = len(truths.ego_future)
    grids = raster.draw_full_rasters(polygons, truths.sample_of[objects] * PLAN_STEPS + steps, samples * PLAN_STEPS)
    return grids.reshape(samples, PLAN_STEPS, *grids.shape[1:])


def unpack_rasters(stored: GoldenArrays, name: str, samples: int) -> NDArray[np.uint8]:
    """(S, 6, 200, 200) ones where occupied, which are stored eight cells to the byte."""
    packed = stored.integers(name, samples, PLAN_STEPS, CELLS * CELLS // 8).astype(np.uint8)
    return np.unpackbits(packed, axis=-1).reshape(samples, PLAN_STEPS, CELLS, CELLS)


def _compare_uniad(
    comparison: Comparison, official: GoldenArrays, judged: list[ProtocolOutcomes], stacked: StackedTruths
) -> None:
    # The official raster past the end of a scene is full, so both flags are up there; ours say nothing there.
    recorded = stacked.ego_future_valid
    ours = {
        "uniad before the mask": (stack_outcomes(judged, "before_mask") | ~recorded[:, None], "uniad_raw_box"),
        "uniad of the recorded ego": (judged[0].step("recorded") | ~recorded, "uniad_gt_box"),
        "uniad obj_box_col": (stack_outcomes(judged), "uniad_obj_box_col"),
        "uniad obj_col": (stack_outcomes(judged, "obj_col"), "uniad_obj_col"),
    }
    compare_equal(comparison, official, ours)
    compare_l2(comparison, official, "uniad L2 (m)", judged, "uniad_L2", np.ones(len(recorded), np.bool_))
    stored = unpack_rasters(official, "uniad_seg_bits", len(recorded))
    comparison.same("uniad raster cells", draw_rasters("uniad", stacked), stored, recorded)


def _compare_vad(
    comparison: Comparison,
    official: GoldenArrays,
    outcomes: Mapping[str, list[ProtocolOutcomes]],
    stacked: StackedTruths,
    complete: Bools,
) -> None:
    judged = outcomes["vad"]
    ours = {
        "vad before the mask": (stack_outcomes(judged, "before_mask"), "vad_raw_box"),
        "vad of the recorded ego": (judged[0].step("recorded"), "vad_gt_box"),
        "vad obj_box_col": (stack_outcomes(judged), "vad_step_obj_box_col"),
        "vad obj_col": (stack_outcomes(judged, "obj_col"), "vad_step_obj_col"),
    }
    compare_equal(comparison, official, ours, complete)
    for name, prefix in _TABLES.items():
        values = stack_horizon_values(name, outcomes[name])
        shares = {
            f"{name} obj_box_col at 1, 2, 3 s": (values["collision"], f"{prefix}_obj_box_col"),
            f"{name} obj_col at 1, 2, 3 s": (values["obj_col"], f"{prefix}_obj_col"),
        }
        compare_equal(comparison, official, shares, complete)
        if name == "vad":
            golden = official.floats("vad_L2", *values["l2"].shape)
            comparison.numbers("vad L2 at 1, 2, 3 s (m)", values["l2"][complete], golden[complete])
    stored = unpack_rasters(official, "vad_seg_bits", len(complete))
    comparison.same("vad raster cells", draw_rasters("vad", stacked), stored)


def _compare_polygons(
    comparison: Comparison, official: GoldenArrays, name: str, judged: list[ProtocolOutcomes], complete: Bools
) -> None:
    """SparseDrive or DiffusionDrive, whose evaluation is the same and which share their golden arrays."""
    recorded, collisions = judged[0].step("recorded"), stack_outcomes(judged)
    ours = {
        f"{name} before the mask": (stack_outcomes(judged, "before_mask"), "sd_raw_box"),
        f"{name} of the recorded ego": (recorded, "sd_gt_box"),
        f"{name} obj_box_col": (collisions, "sd_obj_box_col"),
        f"{name} obj_col": (np.broadcast_to(recorded[:, None], collisions.shape), "sd_obj_col"),
    }
    compare_equal(comparison, official, ours, complete)
    compare_l2(comparison, official, f"{name} L2 (m)", judged, "sd_L2", complete)


def compare_l2(
    comparison: Comparison, official: GoldenArrays, quantity: str, judged: list[ProtocolOutcomes], array: str, of: Bools
) -> None:
    """Compare displacements at the steps, of some samples."""
    ours = np.stack([outcomes.l2 for outcomes in judged], axis=1)
    comparison.numbers(quantity, ours[of], official.floats(array, *ours.shape)[of])


def stack_outcomes(judged: list[ProtocolOutcomes], column: str | None = None) -> NDArray[Any]:
    """(S, P, 6) verdicts on all plans: collisions, or a further column."""
    return np.stack([outcomes.collision if column is None else outcomes.step(column) for outcomes in judged], axis=1)


def stack_horizon_values(name: str, judged: list[ProtocolOutcomes]) -> dict[str, Floats]:
    """(S, P, 3) each column of the values at 1, 2 and 3 s."""
    values = [PROTOCOLS[name].sample_values(outcomes) for outcomes in judged]
    return {column: np.stack([outcomes[column] for outcomes in values], axis=1) for column in values[0]}


ON_RASTERS: Final = {
    "agent-driver": "ad_uniad",
    "agent-driver-stp3": "ad_stp3",
    "opendrivevla": "od_vehicle",
    "opendrivevla-stp3": "od_all",
}
LATCHED: Final = {"safemvdrive": "smv_raster", "safemvdrive-box": "smv_box", "safemvdrive-box-all": "smv_box_all"}
FURTHER: Final = ("stp3", "bev-planner", *ON_RASTERS, *LATCHED)
"""Protocols that judge the plans as they are; ``omnidrive`` is compared on plans that the set has in its form."""
TEXT, UNROUNDED = "omnidrive", "omnidrive, unrounded"


def judge_further(scene: ProtocolGoldenScene) -> dict[str, list[ProtocolOutcomes]]:
    """For each further protocol its verdicts on each of the P plans; OmniDrive's also on plans that are not text."""
    plans = range(len(scene.plan_names))
    outcomes = {name: [PROTOCOLS[name].evaluate(scene.truths, scene.plans[:, at]) for at in plans] for name in FURTHER}
    truths, shape = stack(scene.truths), scene.plans.shape[:3]
    recorded = scene.inputs.floats("ego_fut_axle", shape[0], shape[2], 2)
    for name, array in {TEXT: "omni_plans_text", UNROUNDED: "omni_plans"}.items():
        paths = scene.inputs.floats(array, *shape, 2)
        outcomes[name] = [_build_omnidrive().judged(truths, paths[:, at], recorded) for at in plans]
    return outcomes


def compare_further(
    comparison: Comparison, scene: ProtocolGoldenScene, outcomes: Mapping[str, list[ProtocolOutcomes]]
) -> None:
    """Compare all further protocols on a scene with roads; ``outcomes`` are of `judge_further`."""
    official, stacked = scene.official, stack(scene.truths)
    _compare_stp3(comparison, official, stacked, outcomes["stp3"])
    _compare_bev_planner(comparison, official, stacked, outcomes["bev-planner"])
    _compare_omnidrive(comparison, scene, stacked, outcomes)
    for name, prefix in ON_RASTERS.items():
        _compare_on_rasters(comparison, official, stacked, name, prefix, outcomes[name])
    for name, prefix in LATCHED.items():
        _compare_latched(comparison, official, stacked, name, prefix, outcomes[name])


def _compare_stp3(
    comparison: Comparison, official: GoldenArrays, truths: StackedTruths, judged: list[ProtocolOutcomes]
) -> None:
    counted = official.verdicts("stp3_valid", len(truths.ego_future))
    comparison.same("stp3 samples that count", judged[0].counted, counted)
    ours = {
        "stp3 before the mask": (stack_outcomes(judged, "before_mask"), "stp3_raw_box"),
        "stp3 of the recorded ego": (judged[0].step("recorded"), "stp3_gt_box"),
        "stp3 obj_box_col": (stack_outcomes(judged), "stp3_obj_box_col"),
        "stp3 obj_col": (stack_outcomes(judged, "obj_col"), "stp3_obj_col"),
    }
    compare_equal(comparison, official, ours, counted)
    compare_l2(comparison, official, "stp3 L2 (m)", judged, "stp3_L2", counted)
    comparison.same(
        "stp3 raster cells", warp_cells(truths), unpack_rasters(official, "stp3_seg_bits", len(counted)), counted
    )
    table, values = official.floats("stp3_table", len(judged), 3, 3), stack_horizon_values("stp3", judged)
    if counted.any():
        means = [values[column][counted].mean(axis=0) for column in ("obj_col", "collision", "l2")]
        comparison.numbers("stp3 table, fractions and m", np.stack(means, axis=-1), table)


def warp_cells(truths: StackedTruths) -> NDArray[np.uint8]:
    """Rasters of ``stp3`` in the present frame: (S, 6, 200, 200), 1 where occupied; row is forward, column is left."""
    definition = PROTOCOLS["stp3"]
    assert isinstance(definition, stp3.STP3Protocol)
    samples = len(truths.ego_future)
    drawn = raster.draw_full_rasters(*stp3.draw_polygons(definition, truths), samples * 6).reshape(samples, 6, 200, 200)
    rows, columns = np.mgrid[: raster.CELLS, : raster.CELLS]
    motions = stp3.compute_warps(truths.axle_poses)
    warped = np.zeros_like(drawn)
    for sample, step in np.ndindex(samples, 6):
        row, column = stp3.find_cells_before_warp(rows, columns, *(part[sample, step] for part in motions))
        inside = (row >= 0) & (row < raster.CELLS) & (column >= 0) & (column < raster.CELLS)
        warped[sample, step][inside] = drawn[sample, step][row[inside], column[inside]]
    return warped


def _compare_bev_planner(
    comparison: Comparison, official: GoldenArrays, truths: StackedTruths, judged: list[ProtocolOutcomes]
) -> None:
    valid = truths.ego_future_valid
    counted = official.verdicts("bevp_valid", len(valid))
    comparison.same("bev-planner samples that count", judged[0].counted, counted)
    of_plans = {
        "bev-planner before the mask": (stack_outcomes(judged, "before_mask"), "bevp_raw_box"),
        "bev-planner kerb before the mask": (stack_outcomes(judged, "kerb_before_mask"), "bevp_raw_boundary"),
    }
    of_ego = {
        "bev-planner of the recorded ego": (judged[0].step("recorded"), "bevp_gt_box"),
        "bev-planner kerb of the recorded ego": (judged[0].step("kerb_recorded"), "bevp_gt_boundary"),
    }
    for (quantity, (ours, array)), own in zip(of_plans.items(), of_ego.items()):
        golden = official.floats(array, *ours.shape)
        comparison.same(quantity, np.moveaxis(ours, -1, 1), np.moveaxis(golden, -1, 1), valid)
        compare_equal(comparison, official, dict([own]), valid)
    values = stack_horizon_values("bev-planner", judged)
    shares = {"obj_box_col": "collision", "obj_col": "obj_col", "boundary_box_col": "kerb"}
    equal = {f"bev-planner {array} at 1, 2, 3 s": (values[name], f"bevp_{array}") for array, name in shares.items()}
    compare_equal(comparison, official, equal, counted)
    for array, name, unit in (("boundary_col", "kerb_point", ""), ("L2", "l2", " (m)")):
        golden = official.floats(f"bevp_{array}", *values[name].shape)
        comparison.numbers(f"bev-planner {array} at 1, 2, 3 s{unit}", values[name][counted], golden[counted])
    path = official.floats("bevp_gt", *valid.shape, 2)
    recorded = bev_planner.to_forward_left(truths.ego_future[..., :2])
    comparison.numbers("bev-planner recorded path (m)", recorded[valid], path[valid])
    definition = PROTOCOLS["bev-planner"]
    assert isinstance(definition, bev_planner.BEVPlannerProtocol)
    polygons, place_of = bev_planner.draw_polygons(definition, truths)
    sums = official.integers("bevp_seg_crc", *valid.shape)
    drawn = [_checksum(fine_grid.fill, polygons[place_of == place]) for place in np.flatnonzero(valid).tolist()]
    comparison.same("bev-planner rasters", np.array(drawn, np.int64), sums[valid])
    kerbs = [
        _checksum(fine_grid.outline, bev_planner.compute_kerb_cells(roads))
        for roads in truths.roads
        if roads is not None
    ]
    comparison.same("bev-planner kerb rasters", kerbs, official.integers("bevp_boundary_crc", len(valid)))


def _compare_omnidrive(
    comparison: Comparison,
    scene: ProtocolGoldenScene,
    truths: StackedTruths,
    outcomes: Mapping[str, list[ProtocolOutcomes]],
) -> None:
    official, valid = scene.official, truths.ego_future_valid
    counted = official.verdicts("omni_valid", len(valid))
    for name, prefix in {TEXT: "omni_text", UNROUNDED: "omni"}.items():
        judged = outcomes[name]
        comparison.same(f"{name} samples that count", judged[0].counted, counted)
        flags = {
            f"{name} before the mask": (stack_outcomes(judged, "before_mask"), f"{prefix}_raw_box"),
            f"{name} off the road": (stack_outcomes(judged, "off_road"), f"{prefix}_raw_out"),
        }
        compare_equal(comparison, official, flags)
        values = stack_horizon_values("omnidrive", judged)
        shares = {
            f"{name} obj_box_col at 1, 2, 3 s": (values["collision"], f"{prefix}_obj_box_col"),
            f"{name} boundary at 1, 2, 3 s": (values["off_road"], f"{prefix}_boundary"),
        }
        compare_equal(comparison, official, shares, counted)
        golden = official.floats(f"{prefix}_L2", *values["l2"].shape)[counted]
        comparison.numbers(f"{name} L2 at 1, 2, 3 s (m)", values["l2"][counted], golden)
    first = outcomes[TEXT][0]
    ours = {"omnidrive of the recorded ego": (first.step("recorded"), "omni_gt_box")}
    compare_equal(comparison, official, ours, valid)
    off_now = np.array(first.facts["on_road_now"], np.float64) == 0.0
    compare_equal(comparison, official, {"omnidrive off the road now": (off_now, "omni_rec_out")})
    path = scene.inputs.floats("ego_fut_axle", *valid.shape, 2)
    comparison.numbers("omnidrive recorded path (m)", truths.axle_future[valid], path[valid])
    _compare_omnidrive_plans(comparison, scene, truths)
    polygons, place_of = omnidrive.draw_polygons(_build_omnidrive(), truths)
    wanted = official.integers("omni_seg_crc", len(valid), valid.shape[1] + 1)[:, 1:].reshape(-1)
    checksums = [_checksum(fine_grid.fill, polygons[place_of == place]) for place in range(len(wanted))]
    comparison.same("omnidrive rasters", checksums, wanted)


def _compare_omnidrive_plans(comparison: Comparison, scene: ProtocolGoldenScene, truths: StackedTruths) -> None:
    """The way from a plan of the lidar to one of the rear axle, and from that to text."""
    shape = scene.plans.shape[:3]
    wanted, text = (scene.inputs.floats(name, *shape, 2) for name in ("omni_plans", "omni_plans_text"))
    moved = [omnidrive.to_axle_path(scene.plans[:, at], truths.ahead_m) for at in range(shape[1])]
    comparison.numbers("omnidrive plan of the rear axle (m)", np.stack(moved, axis=1), wanted)
    comparison.same("omnidrive plan as text", omnidrive.round_to_text(wanted), text)


def _compare_on_rasters(
    comparison: Comparison,
    official: GoldenArrays,
    truths: StackedTruths,
    name: str,
    prefix: str,
    judged: list[ProtocolOutcomes],
) -> None:
    # UniAD's stored raster is full past the end of a scene, so both flags are up there; ours say nothing there.
    full = ~truths.ego_future_valid & (prefix in ("ad_uniad", "od_vehicle"))
    ours = {
        f"{name} before the mask": (stack_outcomes(judged, "before_mask") | full[:, None], f"{prefix}_raw_box"),
        f"{name} of the recorded ego": (judged[0].step("recorded") | full, f"{prefix}_gt_box"),
        f"{name} obj_box_col": (stack_outcomes(judged), f"{prefix}_obj_box_col"),
        f"{name} obj_col": (stack_outcomes(judged, "obj_col"), f"{prefix}_obj_col"),
    }
    compare_equal(comparison, official, ours)
    compare_l2(comparison, official, f"{name} L2 (m)", judged, f"{prefix}_L2", np.ones(len(full), np.bool_))


def _compare_latched(
    comparison: Comparison,
    official: GoldenArrays,
    truths: StackedTruths,
    name: str,
    prefix: str,
    judged: list[ProtocolOutcomes],
) -> None:
    counted, on_raster = official.verdicts(f"{prefix}_counted", len(truths.ego_future)), prefix == "smv_raster"
    comparison.same(f"{name} samples that count", judged[0].counted, counted)
    ours = {f"{name} latched": (stack_outcomes(judged), f"{prefix}_obj_box_col")}
    if on_raster:
        ours[f"{name} obj_col"] = (stack_outcomes(judged, "obj_col") & counted[:, None, None], f"{prefix}_obj_col")
        steps = stack_outcomes(judged, "at_step")
        golden = official.floats(f"{prefix}_raw_box", *steps.shape)
        comparison.same(
            f"{name} at the step", np.moveaxis(steps, -1, 1), np.moveaxis(golden, -1, 1), truths.ego_future_valid
        )
    compare_equal(comparison, official, ours)
    distances = np.stack([plan_outcomes.l2 for plan_outcomes in judged], axis=1) * (counted | on_raster)[:, None, None]
    comparison.numbers(f"{name} L2 (m)", distances, official.floats(f"{prefix}_L2", *distances.shape))


def _build_omnidrive() -> omnidrive.OmniDriveProtocol:
    definition = PROTOCOLS["omnidrive"]
    assert isinstance(definition, omnidrive.OmniDriveProtocol)
    return definition


def _checksum(draw: Any, shapes: NDArray[np.int32]) -> int:
    grid = np.zeros((fine_grid.CELLS, fine_grid.CELLS), np.uint8)
    draw(grid, shapes)
    return zlib.crc32(np.packbits(grid).tobytes())
