"""A small golden set of the form that has roads and the past, judged by the slow versions."""

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.golden_sets.protocols import BUILT_IN
from benchmark.extensions.golden_sets.protocols.golden_set import ProtocolGoldenScene, read_golden_scene
from benchmark.geometry import Floats, to_local
from tests.benchmark.extensions.golden_sets.altered import load
from tests.benchmark.protocols import slow_further_protocols as further
from tests.benchmark.protocols import slow_protocols as slow
from tests.benchmark.protocols.protocol_cases import roads_of

Arrays = dict[str, NDArray[Any]]
PLANS = [1, 3, 4]
"""Of those that the other form has: constant speed, into somebody, jitter."""


def write(folder: Path, case: str = "scene-crossing") -> Path:
    """Write inputs and official verdicts of a scene."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays = load(BUILT_IN / f"{case}.npz")
    path = folder / f"{case}.npz"
    np.savez_compressed(path, **inputs_of(arrays))
    np.savez_compressed(path.with_stem(f"{case}_official"), empty=np.zeros(1))
    np.savez_compressed(path.with_stem(f"{case}_official"), **official(read_golden_scene(path)))
    return folder


def inputs_of(arrays: Arrays) -> Arrays:
    """The inputs of the other form with fewer plans, and what this form has beside them."""
    rng = np.random.default_rng(7)
    plans, pose, valid = arrays["plans"][:, PLANS].astype(np.float64), arrays["ego_pose"], arrays["ego_fut_valid"]
    samples = len(plans)
    future, axle = np.zeros((samples, 6, 3)), np.zeros((samples, 6, 2))
    for sample, step in zip(*np.nonzero(valid)):
        future[sample, step] = pose[sample + step + 1]
        axle[sample, step] = to_local(pose[sample + step + 1, :2], pose[sample])
    offset, lines, cells = [0], [], []
    for _ in range(samples):
        roads = roads_of(rng)
        lines.append(roads.kerb_lines())
        offset.append(offset[-1] + len(lines[-1]))
        cells.append(np.packbits(roads.drivable_cells()))
    there = arrays["obj_annotated"][:, :1]
    heads = np.array([[[head[2] for head in slow.exact_poses(plan)[1:]] for plan in own] for own in plans]) - np.pi / 2
    ahead = 0.943713
    moved = np.stack(
        [plans[..., 1] + ahead - ahead * np.cos(heads), -plans[..., 0] - ahead * np.sin(heads)], axis=-1
    ).astype(np.float64)
    text = np.vectorize(further.written)(moved)
    return {
        **arrays,
        "plans": plans.astype(np.float32),
        "plan_names": arrays["plan_names"][PLANS],
        "past_frames": np.minimum(np.arange(samples), 2).astype(np.int8),
        "ego_pose_fut": future,
        "ego_fut_axle": axle,
        "obj_past_visibility": np.where(there, rng.integers(0, 2, (len(there), 3)), -1).astype(np.int8),
        "boundary_offset": np.array(offset, np.int32),
        "boundary_lines": np.concatenate(lines).astype(np.float32),
        "drivable_bits": np.array(cells),
        "omni_plans": moved,
        "omni_plans_text": text,
    }


def official(scene: ProtocolGoldenScene) -> Arrays:
    """Every array that is compared, from the slow versions."""
    truths, plans = scene.truths, scene.plans
    valid = np.array([truth.ego_future_valid for truth in truths])
    complete = valid.all(axis=1)
    stp3 = [[further.slow_stp3(truth, plan) for plan in own] for truth, own in zip(truths, plans)]
    bevp = [[further.slow_bev_planner(truth, plan) for plan in own] for truth, own in zip(truths, plans)]
    arrays = {**_stp3(stp3), **_bev_planner(bevp), **_on_rasters(scene), "bevp_valid": complete, "omni_valid": complete}
    future = np.array([truth.ego_future[:, :2] for truth in truths])
    arrays["bevp_gt"] = np.stack([future[..., 1], -future[..., 0]], axis=-1).astype(np.float32)
    axle = scene.inputs.floats("ego_fut_axle", len(truths), 6, 2)
    for prefix, name in (("omni_text", "omni_plans_text"), ("omni", "omni_plans")):
        paths = scene.inputs.floats(name, *plans.shape)
        judged = [
            [further.omnidrive_on(truth, path.tolist(), own.tolist()) for path in mine]
            for truth, mine, own in zip(truths, paths, axle)
        ]
        arrays |= {
            f"{prefix}_raw_box": _steps(judged, "before_mask"),
            f"{prefix}_raw_out": _steps(judged, "off_road"),
            f"{prefix}_L2": _values(judged, "l2"),
            f"{prefix}_obj_box_col": _values(judged, "collision"),
            f"{prefix}_boundary": _values(judged, "off_road"),
        }
    arrays["omni_gt_box"] = np.array([own[0].steps["recorded"] for own in judged])
    arrays["omni_rec_out"] = np.array([further.leaves(truth.roads.drivable_cells(), 0.0, 0.0, 0.0) for truth in truths])  # type: ignore[union-attr]
    sums = [[_sum(raster) for raster in own[0].rasters] for own in judged]
    arrays["omni_seg_crc"] = np.concatenate([np.zeros((len(truths), 1), np.uint32), np.array(sums, np.uint32)], axis=1)
    return arrays


def _stp3(judged: list[list[further.FurtherVerdicts]]) -> Arrays:
    counted = np.array([own[0].counted for own in judged])
    values = {name: _values(judged, name) for name in ("obj_col", "collision", "l2")}
    table = np.stack([values[name][counted].mean(axis=0) for name in values], axis=-1)
    rasters = np.array([np.array(own[0].rasters).reshape(6, -1) for own in judged])
    return {
        "stp3_valid": counted,
        "stp3_raw_box": _steps(judged, "before_mask"),
        "stp3_gt_box": np.array([own[0].steps["recorded"] for own in judged]),
        "stp3_obj_box_col": _steps(judged, "collision").astype(np.float32),
        "stp3_obj_col": _steps(judged, "obj_col").astype(np.float32),
        "stp3_L2": np.array([[one.l2 for one in own] for own in judged], np.float32),
        "stp3_seg_bits": np.packbits(rasters, axis=-1),
        "stp3_table": table,
    }


def _bev_planner(judged: list[list[further.FurtherVerdicts]]) -> Arrays:
    columns = {"obj_box_col": "collision", "obj_col": "obj_col", "boundary_box_col": "kerb", "L2": "l2"}
    return {
        "bevp_raw_box": _steps(judged, "before_mask"),
        "bevp_gt_box": np.array([own[0].steps["recorded"] for own in judged]),
        "bevp_raw_boundary": _steps(judged, "kerb_before_mask"),
        "bevp_gt_boundary": np.array([own[0].steps["kerb_recorded"] for own in judged]),
        **{f"bevp_{name}": _values(judged, column) for name, column in columns.items()},
        "bevp_boundary_col": _values(judged, "kerb_point"),
        "bevp_seg_crc": np.array([[_sum(raster) for raster in own[0].rasters[:6]] for own in judged], np.uint32),
        "bevp_boundary_crc": np.array([_sum(own[0].rasters[6]) for own in judged], np.uint32),
    }


def _on_rasters(scene: ProtocolGoldenScene) -> Arrays:
    truths, plans = scene.truths, scene.plans
    uniad = [[slow.slow_uniad(truth, plan) for plan in own] for truth, own in zip(truths, plans)]
    polygons = [[slow.slow_sparsedrive(truth, plan) for plan in own] for truth, own in zip(truths, plans)]
    everything = [
        [slow.slow_sparsedrive(further.with_points(truth), plan) for plan in own] for truth, own in zip(truths, plans)
    ]
    arrays: Arrays = {}
    l2 = np.array([[one.l2 for one in own] for own in uniad], np.float32)
    for prefix, judge, rows in (
        ("od_vehicle", slow.slow_uniad, False),
        ("od_all", slow.slow_vad, True),
        ("ad_stp3", slow.slow_vad, True),
    ):
        flags = [
            [further.slow_mirrored(truth, plan, judge, rows=rows) for plan in own] for truth, own in zip(truths, plans)
        ]
        recorded = [further.slow_mirrored(truth, truth.ego_future[:, :2], judge, rows=rows) for truth in truths]
        points = [
            [further.mirrored_points(truth, plan, judge, rows=rows) for plan in own]
            for truth, own in zip(truths, plans)
        ]
        arrays |= _masked(prefix, np.array(flags), np.array(recorded), np.array(points), l2)
    before, recorded_boxes = _old(uniad, "before_mask"), np.array([own[0].recorded for own in uniad])
    arrays |= _masked("ad_uniad", before, recorded_boxes, _old(uniad, "obj_col"), l2)
    dropped = recorded_boxes[:, 0]
    valid = np.array([truth.ego_future_valid for truth in truths])
    latched = np.maximum.accumulate(before & valid[:, None], axis=-1) & ~dropped[:, None, None]
    arrays |= {
        "smv_raster_counted": ~dropped,
        "smv_raster_raw_box": before,
        "smv_raster_obj_box_col": latched.astype(np.float32),
        "smv_raster_obj_col": (_old(uniad, "obj_col") & ~dropped[:, None, None]).astype(np.float32),
        "smv_raster_L2": l2,
    }
    for prefix, judged, seen in (("smv_box", polygons, False), ("smv_box_all", everything, True)):
        now = np.array([further.touches_now(truth, everything=seen) for truth in truths])
        counted = valid.all(axis=1) & ~now
        flags_of = np.maximum.accumulate(_old(judged, "before_mask"), axis=-1)
        arrays |= {
            f"{prefix}_counted": counted,
            f"{prefix}_obj_box_col": (flags_of & counted[:, None, None]).astype(np.float32),
            f"{prefix}_L2": l2 * counted[:, None, None],
        }
    return arrays


def _masked(prefix: str, flags: Any, recorded: Any, points: Any, l2: Floats | NDArray[np.float32]) -> Arrays:
    return {
        f"{prefix}_raw_box": flags,
        f"{prefix}_gt_box": recorded,
        f"{prefix}_obj_box_col": (flags & ~recorded[:, None]).astype(np.float32),
        f"{prefix}_obj_col": (points & ~recorded[:, None]).astype(np.float32),
        f"{prefix}_L2": l2,
    }


def _old(judged: list[list[slow.SlowVerdicts]], column: str) -> NDArray[np.bool_]:
    return np.array([[getattr(one, column) for one in own] for own in judged], np.bool_)


def _steps(judged: list[list[further.FurtherVerdicts]], column: str) -> NDArray[np.bool_]:
    return np.array([[one.steps[column] for one in own] for own in judged], np.bool_)


def _values(judged: list[list[further.FurtherVerdicts]], column: str) -> Floats:
    return np.array([[one.values[column] for one in own] for own in judged], np.float64)


def _sum(raster: NDArray[np.uint8]) -> int:
    return zlib.crc32(np.packbits(raster).tobytes())
