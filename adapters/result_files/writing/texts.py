"""Texts and JSON of OmniDrive, OpenDriveVLA, GPT-Driver and BEV-Planner."""

import json
from pathlib import Path
from typing import Final

from adapters.result_files.contract import FileFrame
from adapters.result_files.text_answers import SUFFIX
from adapters.result_files.writing.pickles import PlansToWrite, global_path, prepare_path, write_pickle
from benchmark.geometry import Floats
from benchmark.machine.storage import write_bytes

_TINY: Final = 0.01
"""OmniDrive writes what rounds to so little or less as 0.0."""
_PYTHON_3: Final = 4


def write_omnidrive(folder: Path, dumped: PlansToWrite) -> Path:
    """A folder of answers, one file a sample, named by its token."""
    target = folder / "results_planning_only"
    for token, _, plan in dumped.by_token(FileFrame.EGO):
        pairs = ", ".join(f"({_signed(x)}, {_signed(y)})" for x, y in plan.tolist())
        answer = f"Here is the planning trajectory [PT, {pairs}]."
        question = "You are driving. Please provide the planning trajectory for the ego car without reasons."
        write_bytes(prepare_path(target, token), json.dumps([{"Q": question, "A": [answer]}]).encode())
    return target


def write_modes(folder: Path, dumped: PlansToWrite) -> Path:
    """``pred_trajs_dict.json`` of OpenDriveVLA: one mode a sample, two decimals."""
    plans = {f"{token}{SUFFIX}": [_rounded(plan)] for token, _, plan in dumped.by_token(FileFrame.LIDAR)}
    path = prepare_path(folder, "pred_trajs_dict.json")
    write_bytes(path, json.dumps(plans, indent=2).encode())
    return path


def write_conversation(folder: Path, dumped: PlansToWrite) -> Path:
    """``plan_conv.json`` of OpenDriveVLA: one line a sample."""
    lines = [
        json.dumps({"id": f"{token}{SUFFIX}", "question": "planning", "answer": [_pairs(plan)]})
        for token, _, plan in dumped.by_token(FileFrame.LIDAR)
    ]
    path = prepare_path(folder, "plan_conv.json")
    write_bytes(path, "".join(f"{line}\n" for line in lines).encode())
    return path


def write_gptdriver(folder: Path, dumped: PlansToWrite) -> Path:
    """``NAME_text.pkl`` of GPT-Driver: the answers."""
    answers = {token: f"Trajectory:\n{_pairs(plan)}" for token, _, plan in dumped.by_token(FileFrame.LIDAR)}
    return write_pickle(prepare_path(folder, "plans_text.pkl"), answers, _PYTHON_3)


def write_global(folder: Path, dumped: PlansToWrite) -> Path:
    """``results_nusc_planning.json`` of BEV-Planner: global ways."""
    samples = dumped.samples
    ways = {
        f"{samples.scenes[row]}-{index}": global_path(
            dumped, row, dumped.waypoints(row, FileFrame.DISPLACEMENT)
        ).tolist()
        for index, row in enumerate(samples.by_table.tolist())
        if row in dumped.plans
    }
    path = prepare_path(folder, "results_nusc_planning.json")
    write_bytes(path, json.dumps({"trajs": ways, "map_lane": {}, "map_label": {}}).encode())
    return path


def _signed(value: float) -> str:
    return "0.0" if abs(round(value, 2)) <= _TINY else f"{value:+.2f}"


def _rounded(plan: Floats) -> list[list[float]]:
    return [[round(x, 2), round(y, 2)] for x, y in plan.tolist()]


def _pairs(plan: Floats) -> str:
    return f"[{','.join(f'({x:.2f},{y:.2f})' for x, y in plan.tolist())}]"
