"""BEV-Planner: displacements in the axes of the ego pose, samples by their place in an info file that is not sorted."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.result_files.contract import (
    LACKS,
    FileFrame,
    FilePlans,
    ResultFormat,
    Rows,
    read_key,
    read_numbers,
    refuse,
)
from adapters.result_files.samples import RecordedSamples, rotate
from adapters.result_files.uniad import SAME_M, unwrap_entries
from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats

_ADVICE: Final = "plans of another split or shifted ones cannot be scored; make the file again"


def read_out(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of ``--out``, without the padding at the end of a run on several GPUs.

    Refused if an entry is broken, one sample has two plans, or poses or recorded displacements are those of other
    samples.
    """
    plans: dict[int, Floats] = {}
    duplicates = 0
    for at, entry in enumerate(unwrap_entries(content)):
        held = read_key(path, entry, "pred_ego_traj", f"entry {at}")
        stored = read_key(path, held, "pred_ego_fut_trajs", f"entry {at}")
        plan = read_numbers(path, stored, f"the plan of entry {at}", (PLAN_STEPS, 2))
        row = _find_row(path, read_key(path, held, "index_w_scene", f"entry {at}"), samples)
        if held.get("index", entry.get("index")) != _read_index(held["index_w_scene"]):
            refuse(path, "order", f"entry {at} has another index than its name {held['index_w_scene']}", _ADVICE)
        path_global = read_numbers(path, held.get("ego_trajs_in_global"), f"the way of entry {at}", (PLAN_STEPS + 1, 2))
        _require_pose(path, row, path_global[0], samples)
        stored = held.get("gt_ego_fut_trajs")
        recorded = read_numbers(path, stored, f"the recorded future of entry {at}", (PLAN_STEPS, 2))
        _require_recorded(path, row, recorded, samples)
        if row in plans:
            if not np.array_equal(plans[row], plan):
                refuse(path, "duplicate", f"sample {samples.tokens[row]} has two different plans", "make it again")
            duplicates += 1
        else:
            plans[row] = plan
    return _collect_plans(path, plans, "ego poses and recorded displacements as ours", duplicates)


def read_json(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of ``results_nusc_planning.json``: global paths from the ego pose, turned into displacements in its axes.

    A path that begins elsewhere than at its sample's ego pose is refused.
    """
    if not isinstance(content["trajs"], dict):
        refuse(path, "shape", "its trajs are not an object", "make the file again with the official script")
    plans: dict[int, Floats] = {}
    for name, way in content["trajs"].items():
        row = _find_row(path, name, samples)
        points = read_numbers(path, way, f"the way of {name}", (PLAN_STEPS + 1, 2))
        _require_pose(path, row, points[0], samples)
        plans[row] = rotate(points[1:] - points[0], -float(samples.ego_pose[row, 2]))
    return _collect_plans(path, plans, "ego poses as ours")


def _collect_plans(path: Path, plans: dict[int, Floats], shown_by: str, duplicates: int = 0) -> FilePlans:
    if not plans:
        refuse(path, "empty", "it has no entries", "run the planner again")
    rows: Rows = np.array(list(plans), np.int64)
    return FilePlans(
        FileFrame.DISPLACEMENT, rows, np.array(list(plans.values())), "proven", shown_by, duplicates=duplicates
    )


def _read_index(name: str) -> int:
    index = name.rpartition("-")[2]
    return int(index) if index.isascii() and index.isdigit() and len(index) < 10 else -1


def _find_row(path: Path, name: Any, samples: RecordedSamples) -> int:
    """The sample of ``scene-0553-12``: the number counts over all scenes of the info file."""
    scene, index = (name.rpartition("-")[0], _read_index(name)) if isinstance(name, str) else ("", -1)
    if index < 0:
        refuse(path, "shape", f"it names a sample {str(name)[:60]!r}, not SCENE-NUMBER", "make the file again")
    if scene not in samples.scenes:
        refuse(path, "token", f"its scene {scene[:60]} is none of {samples.name}", "name the data that it is of")
    if index >= len(samples.by_table):
        refuse(path, "count", f"it names sample {index} of {len(samples.by_table)} of {samples.name}", _ADVICE)
    row = int(samples.by_table[index])
    if samples.scenes[row] != scene:
        refuse(path, "order", f"its sample {index} is of {scene}, but in the data of {samples.scenes[row]}", _ADVICE)
    return row


def _require_pose(path: Path, row: int, start: Floats, samples: RecordedSamples) -> None:
    away_m = float(np.linalg.norm(start - samples.ego_pose[row, :2]))
    if away_m > SAME_M:
        fault = f"the way of sample {samples.tokens[row]} begins {away_m:.2f} m from its ego pose"
        refuse(path, "order", fault, _ADVICE)


def _require_recorded(path: Path, row: int, recorded: Floats, samples: RecordedSamples) -> None:
    ours = rotate(samples.future[row], float(samples.lidar_in_ego[row, 2]))
    valid = samples.valid[row]
    away_m = float(np.where(valid, np.linalg.norm(recorded - ours, axis=1), 0.0).max())
    if away_m > SAME_M:
        fault = f"the recorded displacement of sample {samples.tokens[row]} in the file is {away_m:.2f} m from ours"
        refuse(path, "order", fault, _ADVICE)


OUT: Final = ResultFormat("bev-planner", "BEV-Planner (--out)", "bev-planner", read_out)
JSON: Final = ResultFormat(
    "bev-planner-json",
    "BEV-Planner (results_nusc_planning.json)",
    "bev-planner",
    read_json,
    (*LACKS, "positions finer than 0.1 mm"),
)
