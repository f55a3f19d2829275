"""Verdicts and values of the further protocols against those of the official code: sets with roads and the past."""

import zlib
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.golden_sets.protocols.golden_set import GoldenScene
from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, Outcomes, bev_planner, fine_grid, omnidrive, raster, stp3
from benchmark.protocols.stacked import StackedTruths, stack
from benchmark.verification.checks import Comparison

L2_M: Final = 2e-5
"""Allowed error of a displacement or a mean of them, where the official code adds in single precision."""
OMNIDRIVE_L2_M: Final = 1e-9
POINT_SHARE: Final = 1e-7
"""Allowed error of a share of steps in single precision."""
RECORDED_M: Final = 1e-5
"""Allowed error of a recorded waypoint in single precision."""
AXLE_M: Final = 2e-4
"""Allowed error of a recorded place of the rear axle, which went through single-precision global coordinates."""
PLAN_M: Final = 2e-7
"""Allowed error of a plan that is moved to the rear axle, from single-precision waypoints."""
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


def judged_further(scene: GoldenScene) -> dict[str, list[Outcomes]]:
    """Verdicts of every further protocol on each plan.

    Args:
        scene: A scene with roads.

    Returns:
        For each protocol its verdicts on each of the P plans; OmniDrive's also on plans that are not text.

    Raises:
        InputError: If an array is absent, damaged or of the wrong shape.
    """
    plans = range(len(scene.plan_names))
    found = {name: [PROTOCOLS[name].evaluate(scene.truths, scene.plans[:, at]) for at in plans] for name in FURTHER}
    truths, shape = stack(scene.truths), scene.plans.shape[:3]
    recorded = scene.inputs.floats("ego_fut_axle", shape[0], shape[2], 2)
    for name, array in {TEXT: "omni_plans_text", UNROUNDED: "omni_plans"}.items():
        paths = scene.inputs.floats(array, *shape, 2)
        found[name] = [_omnidrive().judged(truths, paths[:, at], recorded) for at in plans]
    return found


def compare_further(comparison: Comparison, scene: GoldenScene, outcomes: Mapping[str, list[Outcomes]]) -> None:
    """Compare all of them.

    Args:
        comparison: Where the errors go.
        scene: A scene with roads.
        outcomes: What `judged_further` says.

    Raises:
        InputError: If an array of verdicts is absent, damaged or of the wrong shape.
    """
    stacked = stack(scene.truths)
    _compare_stp3(comparison, scene, stacked, outcomes["stp3"])
    _compare_bev_planner(comparison, scene, stacked, outcomes["bev-planner"])
    _compare_omnidrive(comparison, scene, stacked, outcomes)
    for name, prefix in ON_RASTERS.items():
        _compare_on_rasters(comparison, scene, stacked, name, prefix, outcomes[name])
    for name, prefix in LATCHED.items():
        _compare_latched(comparison, scene, stacked, name, prefix, outcomes[name])


def _compare_stp3(comparison: Comparison, scene: GoldenScene, truths: StackedTruths, judged: list[Outcomes]) -> None:
    official, where, shape = scene.official, scene.name, scene.plans.shape[:3]
    counted = official.verdicts("stp3_valid", shape[0])
    comparison.verdicts("stp3 samples that count", judged[0].counted != counted, where=where)
    _flags(
        comparison,
        where,
        "stp3",
        {
            "before the mask": (_all(judged, "before_mask"), official.verdicts("stp3_raw_box", *shape)),
            "of the recorded ego": (judged[0].step("recorded"), official.verdicts("stp3_gt_box", *_row(shape))),
            "obj_box_col": (_all(judged), official.flags("stp3_obj_box_col", *shape)),
            "obj_col": (_all(judged, "obj_col"), official.flags("stp3_obj_col", *shape)),
        },
        counted,
    )
    distances = np.stack([one.l2 for one in judged], axis=1)[counted]
    comparison.numbers("stp3 L2 (m)", distances, official.floats("stp3_L2", *shape)[counted], L2_M, where=where)
    cells = warped_cells(truths)[counted]
    stored = official.rasters("stp3_seg_bits", shape[0])[counted]
    comparison.verdicts("stp3 raster cells", cells != stored, where=where)
    table = official.floats("stp3_table", shape[1], 3, 3)
    for at, plan in enumerate(judged):
        values = PROTOCOLS["stp3"].sample_values(plan)
        means = [values[column][counted].mean(axis=0) for column in ("obj_col", "collision", "l2")]
        if counted.any():
            comparison.numbers("stp3 table, fractions and m", np.stack(means, axis=-1), table[at], L2_M, where=where)


def warped_cells(truths: StackedTruths) -> NDArray[np.uint8]:
    """The rasters of ``stp3`` in the present frame.

    Args:
        truths: S samples.

    Returns:
        (S, 6, 200, 200) ones where occupied; row is forward, column is left.
    """
    definition = PROTOCOLS["stp3"]
    assert isinstance(definition, stp3.STP3)
    samples = len(truths.ego_future)
    drawn = raster.full_rasters(*stp3.drawn_polygons(definition, truths), samples * 6).reshape(samples, 6, 200, 200)
    rows, columns = np.mgrid[: raster.CELLS, : raster.CELLS]
    motions = stp3.warps(truths.axle_poses)
    found = np.zeros_like(drawn)
    for sample, step in np.ndindex(samples, 6):
        row, column = stp3.before_warp(rows, columns, *(part[sample, step] for part in motions))
        inside = (row >= 0) & (row < raster.CELLS) & (column >= 0) & (column < raster.CELLS)
        found[sample, step][inside] = drawn[sample, step][row[inside], column[inside]]
    return found


def _compare_bev_planner(
    comparison: Comparison, scene: GoldenScene, truths: StackedTruths, judged: list[Outcomes]
) -> None:
    official, where, shape = scene.official, scene.name, scene.plans.shape[:3]
    valid = truths.ego_future_valid
    counted = official.verdicts("bevp_valid", shape[0])
    comparison.verdicts("bev-planner samples that count", judged[0].counted != counted, where=where)
    steps = {
        "before the mask": (_all(judged, "before_mask"), official.verdicts("bevp_raw_box", *shape)),
        "of the recorded ego": (judged[0].step("recorded"), official.verdicts("bevp_gt_box", *_row(shape))),
        "kerb before the mask": (_all(judged, "kerb_before_mask"), official.verdicts("bevp_raw_boundary", *shape)),
        "kerb of the recorded ego": (
            judged[0].step("kerb_recorded"),
            official.verdicts("bevp_gt_boundary", *_row(shape)),
        ),
    }
    for quantity, (ours, golden) in steps.items():
        wrong = np.moveaxis(ours != golden, -1, 1)[valid]
        comparison.verdicts(f"bev-planner {quantity}", wrong, where=where)
    values = _values("bev-planner", judged)
    columns = {
        "obj_box_col": "collision",
        "obj_col": "obj_col",
        "boundary_box_col": "kerb",
        "boundary_col": "kerb_point",
        "L2": "l2",
    }
    for array, column in columns.items():
        wanted = official.floats(f"bevp_{array}", *shape[:2], 3)[counted]
        found = values[column][counted]
        if array in ("boundary_col", "L2"):
            unit, allowed = (" (m)", L2_M) if array == "L2" else ("", POINT_SHARE)
            comparison.numbers(f"bev-planner {array} at 1, 2, 3 s{unit}", found, wanted, allowed, where=where)
        else:
            comparison.verdicts(f"bev-planner {array} at 1, 2, 3 s", found != wanted, where=where)
    recorded = bev_planner.forward_left(truths.ego_future[..., :2])[valid]
    path = official.floats("bevp_gt", *_row(shape), 2)[valid]
    comparison.numbers("bev-planner recorded path (m)", recorded, path, RECORDED_M, where=where)
    _compare_bev_planner_rasters(comparison, scene, truths)


def _compare_bev_planner_rasters(comparison: Comparison, scene: GoldenScene, truths: StackedTruths) -> None:
    official, where, shape, valid = scene.official, scene.name, scene.plans.shape[:3], truths.ego_future_valid
    definition = PROTOCOLS["bev-planner"]
    assert isinstance(definition, bev_planner.BEVPlanner)
    polygons, place_of = bev_planner.drawn_polygons(definition, truths)
    sums = official.integers("bevp_seg_crc", *_row(shape))
    drawn = [_checksum(fine_grid.fill, polygons[place_of == place]) for place in np.flatnonzero(valid).tolist()]
    comparison.verdicts("bev-planner rasters", np.array(drawn, np.int64) != sums[valid], where=where)
    kerbs = [_checksum(fine_grid.outline, bev_planner.kerb_cells(roads)) for roads in truths.roads if roads is not None]
    sums = official.integers("bevp_boundary_crc", shape[0])
    comparison.verdicts("bev-planner kerb rasters", np.array(kerbs, np.int64) != sums, where=where)


def _compare_omnidrive(
    comparison: Comparison, scene: GoldenScene, truths: StackedTruths, outcomes: Mapping[str, list[Outcomes]]
) -> None:
    official, where, shape = scene.official, scene.name, scene.plans.shape[:3]
    counted = official.verdicts("omni_valid", shape[0])
    for name, prefix in {TEXT: "omni_text", UNROUNDED: "omni"}.items():
        judged = outcomes[name]
        comparison.verdicts(f"{name} samples that count", judged[0].counted != counted, where=where)
        flags = {
            "before the mask": (_all(judged, "before_mask"), official.verdicts(f"{prefix}_raw_box", *shape)),
            "off the road": (_all(judged, "off_road"), official.verdicts(f"{prefix}_raw_out", *shape)),
        }
        _flags(comparison, where, name, flags, np.ones_like(counted))
        values = _values("omnidrive", judged)
        for array, column in {"obj_box_col": "collision", "boundary": "off_road"}.items():
            golden = official.floats(f"{prefix}_{array}", *shape[:2], 3)
            wrong = (values[column] != golden)[counted]
            comparison.verdicts(f"{name} {array} at 1, 2, 3 s", wrong, where=where)
        golden = official.floats(f"{prefix}_L2", *shape[:2], 3)[counted]
        quantity = f"{name} L2 at 1, 2, 3 s (m)"
        comparison.numbers(quantity, values["l2"][counted], golden, OMNIDRIVE_L2_M, where=where)
    first = outcomes[TEXT][0]
    recorded = (first.step("recorded") != official.verdicts("omni_gt_box", *_row(shape)))[truths.ego_future_valid]
    comparison.verdicts("omnidrive of the recorded ego", recorded, where=where)
    off_now = np.array(first.facts["on_road_now"], np.float64) == 0.0
    wrong = off_now != official.verdicts("omni_rec_out", shape[0])
    comparison.verdicts("omnidrive off the road now", wrong, where=where)
    path, valid = scene.inputs.floats("ego_fut_axle", shape[0], shape[2], 2), truths.ego_future_valid
    comparison.numbers("omnidrive recorded path (m)", truths.axle_future[valid], path[valid], AXLE_M, where=where)
    _compare_omnidrive_plans(comparison, scene, truths)
    polygons, place_of = omnidrive.drawn_polygons(_omnidrive(), truths)
    wanted = official.integers("omni_seg_crc", shape[0], shape[2] + 1)[:, 1:].reshape(-1)
    found = [_checksum(fine_grid.fill, polygons[place_of == place]) for place in range(len(wanted))]
    comparison.verdicts("omnidrive rasters", np.array(found, np.int64) != wanted, where=where)


def _compare_omnidrive_plans(comparison: Comparison, scene: GoldenScene, truths: StackedTruths) -> None:
    """The way from a plan of the lidar to one of the rear axle, and from that to text."""
    shape = scene.plans.shape[:3]
    wanted, text = (scene.inputs.floats(name, *shape, 2) for name in ("omni_plans", "omni_plans_text"))
    moved = [omnidrive.axle_path(scene.plans[:, at], truths.ahead_m) for at in range(shape[1])]
    comparison.numbers("omnidrive plan of the rear axle (m)", np.stack(moved, axis=1), wanted, PLAN_M, where=scene.name)
    comparison.verdicts("omnidrive plan as text", omnidrive.written(wanted) != text, where=scene.name)


def _compare_on_rasters(
    comparison: Comparison, scene: GoldenScene, truths: StackedTruths, name: str, prefix: str, judged: list[Outcomes]
) -> None:
    official, where, shape = scene.official, scene.name, scene.plans.shape[:3]
    # UniAD's stored raster is full past the end of a scene, so both flags are up there; ours say nothing there.
    full = ~truths.ego_future_valid & (prefix in ("ad_uniad", "od_vehicle"))
    flags = {
        "before the mask": (
            _all(judged, "before_mask") | full[:, None],
            official.verdicts(f"{prefix}_raw_box", *shape),
        ),
        "of the recorded ego": (judged[0].step("recorded") | full, official.verdicts(f"{prefix}_gt_box", *_row(shape))),
        "obj_box_col": (_all(judged), official.flags(f"{prefix}_obj_box_col", *shape)),
        "obj_col": (_all(judged, "obj_col"), official.flags(f"{prefix}_obj_col", *shape)),
    }
    _flags(comparison, where, name, flags, np.ones(shape[0], dtype=np.bool_))
    distances = np.stack([one.l2 for one in judged], axis=1)
    comparison.numbers(f"{name} L2 (m)", distances, official.floats(f"{prefix}_L2", *shape), L2_M, where=where)


def _compare_latched(
    comparison: Comparison, scene: GoldenScene, truths: StackedTruths, name: str, prefix: str, judged: list[Outcomes]
) -> None:
    official, where, shape = scene.official, scene.name, scene.plans.shape[:3]
    counted = official.verdicts(f"{prefix}_counted", shape[0])
    comparison.verdicts(f"{name} samples that count", judged[0].counted != counted, where=where)
    everywhere = np.ones_like(counted)
    flags = {"latched": (_all(judged), official.flags(f"{prefix}_obj_box_col", *shape))}
    if prefix == "smv_raster":
        flags["obj_col"] = (
            _all(judged, "obj_col") & counted[:, None, None],
            official.flags(f"{prefix}_obj_col", *shape),
        )
        wrong = _all(judged, "at_step") != official.verdicts(f"{prefix}_raw_box", *shape)
        recorded = np.moveaxis(wrong, -1, 1)[truths.ego_future_valid]
        comparison.verdicts(f"{name} at the step", recorded, where=where)
    _flags(comparison, where, name, flags, everywhere)
    there = np.ones_like(counted) if prefix == "smv_raster" else counted
    distances = np.stack([one.l2 for one in judged], axis=1) * there[:, None, None]
    comparison.numbers(f"{name} L2 (m)", distances, official.floats(f"{prefix}_L2", *shape), L2_M, where=where)


def _flags(
    comparison: Comparison,
    where: str,
    name: str,
    flags: Mapping[str, tuple[NDArray[Any], NDArray[Any]]],
    counted: Bools,
) -> None:
    for quantity, (ours, golden) in flags.items():
        comparison.verdicts(f"{name} {quantity}", (ours != golden)[counted], where=where)


def _omnidrive() -> omnidrive.OmniDrive:
    definition = PROTOCOLS["omnidrive"]
    assert isinstance(definition, omnidrive.OmniDrive)
    return definition


def _values(name: str, judged: Sequence[Outcomes]) -> dict[str, Floats]:
    """(S, P, 3) each column of the values at 1, 2 and 3 s."""
    found = [PROTOCOLS[name].sample_values(one) for one in judged]
    return {column: np.stack([one[column] for one in found], axis=1) for column in found[0]}


def _checksum(draw: Any, shapes: NDArray[np.int32]) -> int:
    grid = np.zeros((fine_grid.CELLS, fine_grid.CELLS), np.uint8)
    draw(grid, shapes)
    return zlib.crc32(np.packbits(grid).tobytes())


def _row(shape: tuple[int, ...]) -> tuple[int, int]:
    return shape[0], shape[2]


def _all(judged: Sequence[Outcomes], column: str | None = None) -> NDArray[Any]:
    """(S, P, 6) verdicts on all plans: collisions, or a further column."""
    return np.stack([one.collision if column is None else one.step(column) for one in judged], axis=1)
