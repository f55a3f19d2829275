"""VAD and GenAD: offsets for three commands, by token (results_nusc.pkl) or by place (--out)."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.result_files.contract import (
    FileFrame,
    FilePlans,
    ResultFormat,
    find_rows,
    read_key,
    read_numbers,
    refuse,
)
from adapters.result_files.samples import RecordedSamples
from adapters.result_files.uniad import unwrap_entries
from benchmark.constants import HORIZON_STEPS, PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.planning import Command
from benchmark.records.run_schema import SampleOrder

COMMANDS: Final = len(Command)
SAME_L2_M: Final = 2e-3
"""Stored displacements of the same plan from the same recording differ by less."""


def read_results(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of ``results_nusc.pkl``, of the stored commands; a command that is another sample's is refused."""
    stored = content["plan_results"]
    if not isinstance(stored, dict):
        refuse(path, "shape", "its plan_results are not a dictionary", "make the file again with the official script")
    rows = find_rows(path, list(stored), samples)
    plans = []
    for row, (token, entry) in zip(rows.tolist(), stored.items()):
        where = f"of sample {token}"
        if not isinstance(entry, list | tuple) or len(entry) != 2:
            refuse(path, "shape", f"the entry {where} is not a pair of offsets and command", "make the file again")
        plan, command = _select_plan(path, entry[0], entry[1], where)
        _require_command(path, row, command, samples)
        plans.append(plan)
    return FilePlans(
        FileFrame.LIDAR, rows, np.array(plans), "tokens", "each sample by its token, stored commands as ours"
    )


def read_out(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of ``--out``: the list has no tokens, but displacements from the recorded future, which prove the order.

    Refused if there is not one entry for each sample, or its command, its displacement or whether the recording goes
    on are those of another sample.
    """
    entries, rows = unwrap_entries(content), samples.by_time
    require_count(path, len(entries), len(rows), samples)
    plans, compared = [], 0
    for at, (row, entry) in enumerate(zip(rows.tolist(), entries)):
        where = f"of entry {at}"
        held = read_key(path, entry, "pts_bbox", f"entry {at}")
        offsets, stored = (read_key(path, held, key, f"entry {at}") for key in ("ego_fut_preds", "ego_fut_cmd"))
        plan, command = _select_plan(path, offsets, stored, where)
        _require_command(path, row, command, samples, f"entry {at}, which would be ")
        plans.append(plan)
        compared += _compare_metrics(path, at, row, plan, entry.get("metric_results"), samples)
    shown_by = f"commands, ends of scenes and {compared} stored displacements as ours"
    order: SampleOrder = "proven" if compared else "assumed"
    return FilePlans(FileFrame.LIDAR, rows, np.array(plans), order, shown_by)


def require_count(path: Path, found: int, wanted: int, samples: RecordedSamples) -> None:
    """Refuse a list of other length than the info file that it must follow."""
    if not found:
        refuse(path, "empty", "it has no entries", "run the planner again")
    if found != wanted:
        fault = f"it has {found} entries without tokens, and {samples.name} has {wanted} samples"
        other = None if samples.others is None else samples.others.first(lambda tokens: len(tokens) == found)
        if other is not None:
            refuse(path, "count", f"{fault}; split {other!r} has {found}", f"score it with --split {other}")
        advice = "run the planner on exactly this split, or name the scenes that it ran on with --scenes"
        refuse(path, "count", fault, advice)


def _select_plan(path: Path, offsets: Any, command: Any, where: str) -> tuple[Floats, int]:
    """Positions of the plan of the stored command, and the command."""
    modes = read_numbers(path, offsets, f"the offsets {where}", (COMMANDS, PLAN_STEPS, 2))
    one_hot = read_numbers(path, command, f"the command {where}", (1, 1, 1, COMMANDS), (COMMANDS,)).reshape(-1)
    if sorted(one_hot.tolist()) != [0.0, 0.0, 1.0]:
        refuse(path, "shape", f"the command {where} is not exactly one of three", "make the file again")
    chosen = int(one_hot.argmax())
    return np.cumsum(modes[chosen], axis=0), chosen


def _require_command(path: Path, row: int, command: int, samples: RecordedSamples, place: str = "") -> None:
    if not samples.may_have_command(row, command):
        stored, ours = (Command(number).name.lower() for number in (command, int(samples.commands[row])))
        refuse(
            path,
            "order",
            f"the stored command of {place}sample {samples.tokens[row]} is {stored}, that of the data is {ours}",
            "plans of another run or shifted ones cannot be scored; make the file again",
        )


def _compare_metrics(path: Path, at: int, row: int, plan: Floats, stored: Any, samples: RecordedSamples) -> int:
    """Number of stored displacements that agree; none where the sample has none."""
    if not isinstance(stored, dict) or stored.get("fut_valid_flag") is None:
        return 0
    complete, token = bool(samples.complete[row]), samples.tokens[row]
    advice = "shifted plans cannot be scored; make the file again with all samples"
    if bool(stored["fut_valid_flag"]) != complete:
        ends = "ends within" if complete else "goes on for"
        refuse(path, "order", f"entry {at} states that its scene {ends} 3 s, unlike that of sample {token}", advice)
    if not complete:
        return 0
    away_m = np.linalg.norm(plan - samples.future[row], axis=1)
    compared = 0
    for horizon, steps in HORIZON_STEPS.items():
        value = stored.get(f"plan_L2_{horizon}")
        if not isinstance(value, int | float | np.number):
            continue
        ours_m = float(away_m[:steps].mean())
        if not abs(float(value) - ours_m) <= SAME_L2_M:
            fault = f"entry {at} stores a displacement of {float(value):.3f} m at {horizon}, and its plan would be"
            refuse(path, "order", f"{fault} {ours_m:.3f} m from the recording of sample {token}", advice)
        compared += 1
    return compared


RESULTS: Final = ResultFormat("vad-results", "VAD, GenAD (results_nusc.pkl)", "vad", read_results)
OUT: Final = ResultFormat("vad-out", "VAD, GenAD (--out)", "vad", read_out, by_place=True)
