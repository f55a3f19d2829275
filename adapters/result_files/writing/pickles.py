"""Pickles of UniAD, VAD, SparseDrive, BEV-Planner, Agent-Driver and AD-MLP."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.result_files.contract import LONG_PLAN_STEPS, FileFrame
from adapters.result_files.turning import turned
from adapters.result_files.uniad import MIRRORED
from adapters.result_files.vad import COMMANDS
from adapters.result_files.writing.dumped import DumpedPlans, written
from adapters.result_files.writing.tensors import PickledTensor, write_pickle
from benchmark.constants import HORIZON_STEPS, PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.waypoints import chord_headings

_MODES: Final = 6
"""Plans of one command in SparseDrive."""
_PYTHON_3: Final = 4
"""Protocol of a pickle that is written without saying which."""


def write_uniad(folder: Path, dumped: DumpedPlans) -> Path:
    """``results.pkl`` of UniAD, x mirrored as its metric leaves it."""
    entries = []
    for token, row, plan in dumped.by_token(FileFrame.LIDAR):
        future = np.zeros((1, 1, PLAN_STEPS, 3))
        future[0, 0, :, :2] = dumped.samples.future[row] * MIRRORED
        entries.append(
            {
                "token": token,
                "planning_traj": PickledTensor([plan * MIRRORED]),
                "planning_traj_gt": [PickledTensor(future)],
                "command": [PickledTensor([dumped.samples.commands[row]], "<i8")],
            }
        )
    return write_pickle(written(folder, "results.pkl"), {"bbox_results": entries})


def write_vad_results(folder: Path, dumped: DumpedPlans) -> Path:
    """``results_nusc.pkl`` of VAD: offsets for three commands, those of the others zero."""
    plans = {
        token: [PickledTensor(part) for part in _offsets(dumped, row, plan)]
        for token, row, plan in dumped.by_token(FileFrame.LIDAR)
    }
    content = {"meta": {"use_camera": True}, "results": {}, "map_results": {}, "plan_results": plans}
    return write_pickle(written(folder, "results_nusc.pkl"), content)


def write_vad_out(folder: Path, dumped: DumpedPlans) -> Path:
    """VAD's ``--out``: one entry for each sample, with the displacements that prove their order."""
    dumped.require_all("vad-out")
    entries = []
    for row in dumped.info_rows.tolist():
        plan = dumped.waypoints(row, FileFrame.LIDAR)
        offsets, command = _offsets(dumped, row, plan)
        complete = bool(dumped.samples.complete[row])
        away_m = np.linalg.norm(plan - dumped.samples.future[row], axis=1) if complete else np.zeros(PLAN_STEPS)
        metrics: dict[str, Any] = {f"plan_L2_{name}": float(away_m[:end].mean()) for name, end in HORIZON_STEPS.items()}
        held = {"ego_fut_preds": PickledTensor(offsets), "ego_fut_cmd": PickledTensor(command)}
        entries.append({"pts_bbox": held, "metric_results": {**metrics, "fut_valid_flag": complete}})
    return write_pickle(written(folder, "out.pkl"), entries)


def write_sparsedrive(folder: Path, dumped: DumpedPlans) -> Path:
    """``results.pkl`` of SparseDrive: the plan as the best one of the command, all other modes zero."""
    dumped.require_all("sparsedrive")
    steps = LONG_PLAN_STEPS if dumped.steps >= LONG_PLAN_STEPS else PLAN_STEPS
    entries = []
    for row in dumped.info_rows.tolist():
        plan, command = dumped.waypoints(row, FileFrame.LIDAR, steps), int(dumped.samples.commands[row])
        modes, scores = np.zeros((COMMANDS, _MODES, steps, 2)), np.zeros((COMMANDS, _MODES))
        modes[command, 0], scores[command, 0] = plan, 1.0
        held = {"planning_score": scores, "planning": modes, "final_planning": plan}
        entries.append({"img_bbox": {name: PickledTensor(values) for name, values in held.items()}})
    return write_pickle(written(folder, "results.pkl"), entries)


def write_bev_planner(folder: Path, dumped: DumpedPlans) -> Path:
    """BEV-Planner's ``--out``."""
    samples, index_of = dumped.samples, {int(row): index for index, row in enumerate(dumped.samples.by_table)}
    entries = []
    for row in sorted(dumped.plans, key=index_of.__getitem__):
        plan = dumped.waypoints(row, FileFrame.DISPLACEMENT)
        recorded = turned(samples.future[row], float(samples.lidar_in_ego[row, 2])) * samples.valid[row][:, None]
        held = {
            "pred_ego_fut_trajs": PickledTensor(plan),
            "gt_ego_fut_trajs": PickledTensor(recorded),
            "index_w_scene": f"{samples.scenes[row]}-{index_of[row]}",
            "ego_trajs_in_global": PickledTensor(global_way(dumped, row, plan)),
            "index": index_of[row],
        }
        entries.append({"pred_ego_traj": held, "index": index_of[row]})
    return write_pickle(written(folder, "out.pkl"), entries)


def global_way(dumped: DumpedPlans, row: int, displacements: Floats) -> Floats:
    """(7, 2) the ego pose, and displacements from it in global axes, single precision."""
    pose = dumped.samples.ego_pose[row]
    way = pose[:2] + turned(np.concatenate([np.zeros((1, 2)), displacements]), float(pose[2]))
    return np.asarray(way.astype(np.float32), np.float64)


def write_pred_trajs(folder: Path, dumped: DumpedPlans) -> Path:
    """``pred_trajs_dict.pkl`` of Agent-Driver."""
    plans = {token: np.ascontiguousarray(plan) for token, _, plan in dumped.by_token(FileFrame.LIDAR)}
    return write_pickle(written(folder, "pred_trajs_dict.pkl"), plans, _PYTHON_3)


def write_admlp(folder: Path, dumped: DumpedPlans) -> Path:
    """``output_data.pkl`` of AD-MLP: positions and heading."""
    plans = {}
    for token, _, plan in dumped.by_token(FileFrame.LIDAR):
        heading = chord_headings(plan, start_heading_rad=np.pi / 2) - np.pi / 2
        plans[token] = np.column_stack([plan, heading])[None].astype(np.float32)
    return write_pickle(written(folder, "output_data.pkl"), plans, 3)


def _offsets(dumped: DumpedPlans, row: int, plan: Floats) -> tuple[Floats, Floats]:
    """Offsets of three commands, and the command as VAD has it."""
    command = int(dumped.samples.commands[row])
    offsets = np.zeros((COMMANDS, PLAN_STEPS, 2))
    offsets[command] = np.diff(plan, axis=0, prepend=np.zeros((1, 2)))
    return offsets, np.eye(COMMANDS)[command].reshape(1, 1, 1, COMMANDS)
