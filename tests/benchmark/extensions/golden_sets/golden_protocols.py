"""The built-in set of `challenger-bench verify protocols`: made-up scenes, judged by `slow_protocols.py`.

``python -m tests.benchmark.extensions.golden_sets.golden_protocols`` writes the set; a test compares what is stored
with what this makes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.sample_truth import compute_command
from benchmark.extensions.golden_sets.protocols import BUILT_IN
from benchmark.extensions.golden_sets.protocols.golden_set import read_truths
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.machine.storage import content_seed, file_sha256, write_json
from benchmark.truth import SampleTruth
from benchmark.verification.golden_sets import GoldenArrays
from tests.benchmark.protocols import slow_protocols as slow

Arrays = dict[str, NDArray[Any]]
KEYFRAMES = 11
LIDAR_AHEAD_M = 0.943713
PLAN_NAMES = ("recorded", "constant", "swerve", "hit", "jitter", "reverse", "far", "aside")


@dataclass(frozen=True)
class Thing:
    """An object: (K, 3) global x, y, yaw at the keyframes, where it is annotated, and where points were counted."""

    category: str
    length: float
    width: float
    path: Floats
    seen: Bools
    points: Bools


def moving(x: float, y: float, heading: float, speed: float, turn: float = 0.0) -> Floats:
    """(K, 3) poses of something that drives ``speed`` metres and turns ``turn`` radians a keyframe."""
    poses = [(x, y, heading)]
    for _ in range(KEYFRAMES - 1):
        x, y, heading = x + speed * math.cos(heading), y + speed * math.sin(heading), heading + turn
        poses.append((x, y, heading))
    return np.array(poses)


def thing(category: str, length: float, width: float, path: Floats, **where: list[int]) -> Thing:
    """An object that is annotated everywhere and has points, but at the keyframes ``absent`` and ``pointless``."""
    seen, points = np.ones(KEYFRAMES, np.bool_), np.ones(KEYFRAMES, np.bool_)
    seen[where.get("absent", [])] = False
    points[where.get("pointless", [])] = False
    return Thing(category, length, width, path, seen, points)


def beside(ego: Floats, ahead: float, left: float, turned: float = 0.0) -> tuple[float, float, float]:
    """A global pose given in the frame of a pose of the ego."""
    x, y, heading = ego.tolist()
    cos, sin = math.cos(heading), math.sin(heading)
    return x + ahead * cos - left * sin, y + ahead * sin + left * cos, heading + turned


def crossing() -> Arrays:
    """A bend with traffic of all kinds, some of it at the border of the grid, behind gaps or without points."""
    rng = np.random.default_rng(content_seed("golden protocols", "crossing"))
    ego = moving(1250.3, 878.9, 2.31, 3.1, 0.04)
    start = ego[0]
    things = [
        thing("vehicle.car", 4.6, 1.9, moving(*beside(start, 14.0, 0.3), 2.4, 0.03)),
        thing("vehicle.car", 4.4, 1.8, moving(*beside(start, 9.0, 3.2, math.pi), 3.0)),
        thing("vehicle.truck", 9.2, 2.6, moving(*beside(start, 4.0, -3.1), 2.9, 0.04), absent=[4]),
        thing("vehicle.bus.rigid", 12.1, 2.9, moving(*beside(start, 47.0, 8.0, 3.0), 2.2)),
        thing("vehicle.trailer", 11.0, 2.5, moving(*beside(start, 20.0, 49.0, 0.4), 0.0)),
        thing("vehicle.construction", 6.5, 2.8, moving(*beside(start, 18.0, -4.6, 0.9), 0.1)),
        thing("vehicle.motorcycle", 2.1, 0.8, moving(*beside(start, -7.0, 2.0), 4.4, 0.04)),
        thing("vehicle.bicycle", 1.8, 0.6, moving(*beside(start, 11.0, -6.0, 1.2), 1.2), pointless=[3, 4]),
        thing("vehicle.emergency.police", 5.0, 2.0, moving(*beside(start, 16.5, 3.0, 2.9), 1.0)),
        thing("human.pedestrian.adult", 0.7, 0.7, moving(*beside(start, 8.5, -6.5, 1.5), 0.7)),
        thing("human.pedestrian.child", 0.5, 0.4, moving(*beside(start, 12.5, 3.5, -1.6), 0.6)),
        thing("human.pedestrian.police_officer", 0.7, 0.6, moving(*beside(start, 17.0, 5.0), 0.0)),
        thing("human.pedestrian.construction_worker", 0.8, 0.7, moving(*beside(start, 15.0, -3.0), 0.3)),
        thing("human.pedestrian.stroller", 1.0, 0.6, moving(*beside(start, 13.0, -1.6), 0.5)),
        thing("movable_object.barrier", 0.5, 2.4, moving(*beside(start, 21.0, -1.2, 0.3), 0.0)),
        thing("movable_object.trafficcone", 0.4, 0.4, moving(*beside(start, 6.5, 2.4), 0.0)),
        thing("movable_object.debris", 0.9, 0.9, moving(*beside(start, 10.0, -2.0), 0.0), pointless=[0, 1, 2]),
        thing("animal", 0.8, 0.3, moving(*beside(start, 19.0, 4.0, -1.5), 1.1), absent=[0, 1, 2]),
        thing("vehicle.car", 4.5, 1.9, moving(*beside(start, 31.0, 6.0, math.pi), 5.0), absent=[0]),
        thing("vehicle.car", 4.7, 2.0, moving(*beside(start, 2.0, 16.5, -1.5), 3.0)),
        # VAD's centre test looks 25 m ahead and 25 m to the left of where the ego is.
        thing("vehicle.bus.bendy", 17.0, 3.0, moving(*beside(ego[2], 27.0, 11.8), 0.1)),
        thing("vehicle.construction", 9.0, 3.2, moving(*beside(ego[1], 27.0, -12.5), 0.1)),
    ]
    return judged(ego, things, rng)


def standing() -> Arrays:
    """A car that waits between others, so close that a grid sees contact on its left and none on its right."""
    rng = np.random.default_rng(content_seed("golden protocols", "standing"))
    ego = moving(604.2, 1640.7, 0.3, 0.02)
    start = ego[0]
    middle = LIDAR_AHEAD_M + 0.5
    rows = [
        thing("vehicle.car", 4.5, 1.9, moving(*beside(start, middle + ahead, left), 0.0))
        for ahead, left in ((-0.4, -2.1), (4.9, 0.1), (-5.6, 0.0), (6.0, 2.3), (5.1, -2.3))
    ]
    rows.append(thing("vehicle.car", 4.5, 1.9, moving(*beside(start, middle - 3.0, 2.2), 1.1)))
    walkers = [
        thing("human.pedestrian.adult", 0.6, 0.6, moving(*beside(start, 3.8, -8.0, 1.6), 0.8)),
        thing("human.pedestrian.adult", 0.7, 0.5, moving(*beside(start, 4.2, 5.0, -1.5), 0.9), absent=[6, 7]),
        thing("movable_object.pushable_pullable", 0.9, 0.6, moving(*beside(start, 3.9, 0.6, 0.4), 0.1)),
    ]
    return judged(ego, [*rows, *walkers], rng)


def ghost() -> Arrays:
    """A car drives in the very place of the recorded ego for some keyframes: what the ground-truth mask is about."""
    rng = np.random.default_rng(content_seed("golden protocols", "ghost"))
    ego = moving(310.0, 95.5, -0.7, 2.6, -0.02)
    start = ego[0]
    shadow = ego + [0.4, -0.5, 0.05]
    things = [
        thing("vehicle.car", 4.6, 1.9, shadow, absent=[0, 1, 2, 7]),
        thing("human.pedestrian.adult", 0.7, 0.7, moving(*beside(ego[5], 2.0, 0.4), 0.0)),
        thing("vehicle.truck", 7.5, 2.5, moving(*beside(start, 12.0, 3.4), 2.5, -0.02)),
        thing("movable_object.trafficcone", 0.4, 0.4, moving(*beside(ego[3], 1.5, -0.3), 0.0), pointless=[4]),
        thing("vehicle.car", 4.3, 1.8, moving(*beside(start, 9.0, -3.2), 2.7, -0.02)),
    ]
    return judged(ego, things, rng)


CASES: dict[str, Callable[[], Arrays]] = {"scene-crossing": crossing, "scene-standing": standing, "gtcol-ghost": ghost}


def judged(ego: Floats, things: list[Thing], rng: np.random.Generator) -> Arrays:
    """Inputs, and beside them the verdicts under the names of the three files, ``FILE/ARRAY``."""
    inputs = observed(ego, things)
    inputs["plans"] = plans_for(inputs, rng).astype(np.float32)
    inputs["plan_names"] = np.array(PLAN_NAMES)
    truths, plans = (
        read_truths(GoldenArrays(Path("made-up.npz"), inputs), KEYFRAMES),
        inputs["plans"].astype(np.float64),
    )
    official, exact = official_verdicts(truths, plans), exact_verdicts(truths, plans)
    parts = {"inputs": inputs, "official": official, "exact": exact}
    return {f"{part}/{name}": array for part, arrays in parts.items() for name, array in arrays.items()}


def observed(ego: Floats, things: list[Thing]) -> Arrays:
    """Every keyframe as a sample: what is annotated there and at the six keyframes after it, in its lidar frame."""
    lidar = ego.copy()
    lidar[:, :2] += LIDAR_AHEAD_M * np.column_stack([np.cos(ego[:, 2]), np.sin(ego[:, 2])])
    names = sorted({one.category for one in things})
    future, valid = np.zeros((KEYFRAMES, 6, 3)), np.zeros((KEYFRAMES, 6), np.bool_)
    rows: list[tuple[int, Thing, Floats, Bools, Bools]] = []
    offset = [0]
    for now in range(KEYFRAMES):
        for step in range(1, 7):
            if now + step < KEYFRAMES:
                future[now, step - 1], valid[now, step - 1] = seen_from(lidar[now], lidar[now + step]), True
        for index, one in enumerate(things):
            boxes, there, points = np.zeros((7, 3)), np.zeros(7, np.bool_), np.zeros(7, np.bool_)
            for step in range(7):
                if now + step < KEYFRAMES and one.seen[now + step]:
                    boxes[step], there[step] = seen_from(lidar[now], one.path[now + step]), True
                    points[step] = one.points[now + step]
            if there.any():
                rows.append((index, one, boxes, there, points))
        offset.append(len(rows))
    return {
        "keyframe": np.arange(KEYFRAMES),
        "ego_pose": ego,
        "lidar_pose": lidar,
        "ego_fut": future.astype(np.float32),
        "ego_fut_valid": valid,
        "command": np.array([int(compute_command(path, there)) for path, there in zip(future, valid)], np.int32),
        "obj_offset": np.array(offset, np.int32),
        "obj_instance": np.array([index for index, *_ in rows], np.int32),
        "instance_names": np.array([f"{one.category}-{index}" for index, one in enumerate(things)]),
        "obj_class": np.array([names.index(one.category) for _, one, *_ in rows], np.int8),
        "class_names": np.array(names),
        "obj_size": np.array([(one.length, one.width) for _, one, *_ in rows], np.float32),
        "obj_box": np.array([boxes for _, _, boxes, _, _ in rows], np.float32),
        "obj_annotated": np.array([there for *_, there, _ in rows]),
        "obj_has_points": np.array([points for *_, points in rows]),
    }


def seen_from(lidar: Floats, pose: Floats) -> Floats:
    """A global pose in the frame x right, y forward."""
    forward, left = to_local(pose[:2], lidar)
    return np.array([-left, forward, float(wrap_angle(pose[2] - lidar[2] + np.pi / 2))])


def plans_for(inputs: Arrays, rng: np.random.Generator) -> Floats:
    """(S, 8, 6, 2): drives that miss, graze and ram, that jitter, reverse, leave the grid and drift aside."""
    future, valid = inputs["ego_fut"][..., :2].astype(np.float64), inputs["ego_fut_valid"]
    plans = np.zeros((len(future), len(PLAN_NAMES), 6, 2))
    steps = np.arange(1, 7)[:, None]
    for sample in range(len(future)):
        speed = future[sample, 0] if valid[sample, 0] else np.array([0.0, 3.0])
        constant = speed * steps
        recorded = np.where(valid[sample][:, None], future[sample], constant)
        sideways = np.array([rng.normal(0.0, 0.9), rng.normal(0.0, 0.3)])
        rows = slice(inputs["obj_offset"][sample], inputs["obj_offset"][sample + 1])
        candidates = inputs["obj_box"][rows, 3, :2][inputs["obj_annotated"][rows, 3]].astype(np.float64)
        ahead = candidates[np.linalg.norm(candidates, axis=1) < 30.0] if len(candidates) else candidates
        target = ahead[rng.integers(len(ahead))] if len(ahead) else np.array([1.0, 9.0])
        plans[sample] = [
            recorded,
            constant,
            recorded + sideways * steps,
            (target - [0.0, 0.5]) * steps / 3,
            rng.normal(0.0, 0.25, (6, 2)),
            -(speed * 0.4 + [0.1, 0.3]) * steps,
            (speed + rng.normal(0.0, 2.0, 2)) * steps * 4.0,
            np.array([2.1, 0.3]) * steps,
        ]
    return plans


def official_verdicts(truths: list[SampleTruth], plans: Floats) -> Arrays:
    """Every array of an ``_official`` file that is compared."""
    table_23 = slow.COUNTED_BY_VAD_23
    uniad = [[slow.slow_uniad(truth, plan) for plan in own] for truth, own in zip(truths, plans)]
    vad = [[slow.slow_vad(truth, plan) for plan in own] for truth, own in zip(truths, plans)]
    vad_23 = [[slow.slow_vad(truth, plan, table_23) for plan in own] for truth, own in zip(truths, plans)]
    polygons = [[slow.slow_sparsedrive(truth, plan) for plan in own] for truth, own in zip(truths, plans)]
    complete = np.array([truth.complete for truth in truths])
    arrays: Arrays = {"sample_valid": complete}
    for prefix, verdicts, step in (("uniad", uniad, ""), ("vad", vad, "step_"), ("sd", polygons, "")):
        counted = np.ones_like(complete) if prefix == "uniad" else complete
        there = counted[:, None, None]
        arrays |= {
            f"{prefix}_raw_box": np.array([[one.before_mask for one in own] for own in verdicts]),
            f"{prefix}_gt_box": np.array([own[0].recorded for own in verdicts]),
            f"{prefix}_{step}obj_box_col": np.array([[one.collision for one in own] for own in verdicts], np.float32),
            f"{prefix}_{step}obj_col": np.array([[one.obj_col for one in own] for own in verdicts], np.float32),
        }
        if prefix != "vad":
            arrays[f"{prefix}_L2"] = np.where(there, [[one.l2 for one in own] for own in verdicts], 0).astype(
                np.float32
            )
            names = [f"{prefix}_{part}" for part in ("obj_box_col", "obj_col")]
            arrays |= {name: np.where(there, arrays[name], 0).astype(np.float32) for name in names}
    for prefix, verdicts in (("vad", vad), ("vad23", vad_23)):
        columns = {"obj_box_col": "collision", "obj_col": "obj_col"} | ({"L2": "l2"} if prefix == "vad" else {})
        for name, column in columns.items():
            values = [[one.values[column] for one in own] for own in verdicts]
            arrays[f"{prefix}_{name}"] = np.where(complete[:, None, None], values, 0.0)
    for prefix, verdicts in (("uniad", uniad), ("vad", vad)):
        drawn = np.array([own[0].rasters for own in verdicts])
        arrays[f"{prefix}_seg_bits"] = np.packbits(drawn.reshape(len(truths), 6, -1), axis=-1)
    return arrays


def exact_verdicts(truths: list[SampleTruth], plans: Floats) -> Arrays:
    """Every array of an ``_exact`` file that is compared."""
    shape = plans.shape[:2]
    arrays: Arrays = {"heading": np.zeros((*shape, 7), np.float32), "gt_cont_all": np.zeros((shape[0], 30), np.bool_)}
    for objects in ("all", "uniad", "vad", "sd"):
        arrays[f"cont_{objects}"] = np.zeros((*shape, 30), np.bool_)
        arrays[f"way_{objects}"] = np.zeros((*shape, 6), np.bool_)
        arrays[f"way0_{objects}"] = np.zeros((*shape, 6), np.bool_)
        arrays[f"gt_way_{objects}"] = np.zeros((shape[0], 6), np.bool_)
    for sample, truth in enumerate(truths):
        sets = object_sets(truth)
        logged = slow.slow_contacts(truth, [np.array([0.0, 0.0, math.pi / 2]), *truth.ego_future])
        logged &= np.repeat(truth.ego_future_valid, 5)
        for objects, present in sets.items():
            arrays[f"gt_way_{objects}"][sample] = (logged & present).any(axis=0)[4::5]
        arrays["gt_cont_all"][sample] = (logged & sets["all"]).any(axis=0)
        for plan in range(shape[1]):
            poses = slow.exact_poses(plans[sample, plan])
            turned = slow.slow_contacts(truth, poses)
            ahead = slow.slow_contacts(truth, [np.array([*pose[:2], math.pi / 2]) for pose in poses])
            arrays["heading"][sample, plan] = [pose[2] for pose in poses]
            for objects, present in sets.items():
                contact = (turned & present).any(axis=0)
                arrays[f"cont_{objects}"][sample, plan], arrays[f"way_{objects}"][sample, plan] = contact, contact[4::5]
                arrays[f"way0_{objects}"][sample, plan] = (ahead & present).any(axis=0)[4::5]
    del arrays["way0_sd"]
    return arrays


def object_sets(truth: SampleTruth) -> dict[str, Bools]:
    """(M, 30) which objects each protocol sees at each instant: at both keyframes around it, or at the keyframe."""
    sets = {name: np.zeros((len(truth.instances), 7), np.bool_) for name in ("all", "uniad", "vad", "sd")}
    for row, name in enumerate(truth.categories):
        sets["all"][row] = truth.annotated[row]
        sets["uniad"][row] = truth.annotated[row] & (name in slow.UNIAD_NAMES)
        sets["sd"][row] = truth.annotated[row] & truth.has_lidar_points[row]
        x, y = truth.boxes[row, 0, :2]
        near = name in slow.COUNTED_BY_VAD and truth.has_lidar_points[row, 0] and abs(x) < 15.0 and abs(y) < 30.0
        for step in range(7):
            sets["vad"][row, step] = near and truth.annotated[row, : step + 1].all()
    found = {}
    for name, there in sets.items():
        found[name] = np.zeros((len(there), 30), np.bool_)
        for instant in range(30):
            step = instant // 5
            found[name][:, instant] = there[:, step + 1] & (there[:, step] | (instant % 5 == 4))
    return found


def files_of(name: str, arrays: Arrays) -> dict[str, Arrays]:
    """File name to arrays."""
    endings = {"inputs": "", "official": "_official", "exact": "_exact"}
    return {
        f"{name}{ending}.npz": {key.split("/")[1]: array for key, array in arrays.items() if key.startswith(f"{part}/")}
        for part, ending in endings.items()
    }


def write(folder: Path) -> None:
    """Write all cases and the manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for name, make in CASES.items():
        for file, arrays in files_of(name, make()).items():
            np.savez_compressed(folder / file, **arrays)
            names.append(file)
    facts = {file: {"sha256": file_sha256(folder / file)} for file in sorted(names)}
    write_json(
        folder / "manifest.json",
        {"source": "made up; tests/benchmark/extensions/golden_sets/golden_protocols.py", "files": facts},
    )


if __name__ == "__main__":
    write(BUILT_IN)
