"""SparseDrive, DiffusionDrive, MomAD, BridgeAD: a list in the order of the info file; nothing in it names samples."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.result_files.contract import (
    LONG_PLAN_STEPS,
    FileFrame,
    FilePlans,
    ResultFormat,
    read_key,
    read_numbers,
    refuse,
)
from adapters.result_files.samples import RecordedSamples
from adapters.result_files.uniad import MIRRORED, unwrap_entries
from adapters.result_files.vad import COMMANDS, require_count
from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.records.run_schema import SampleOrder

SAME_M: Final = 1e-4
"""The chosen plan and the same mode of all modes differ by less."""


def read(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of the SparseDrive family, those that were chosen.

    Their order is consistent where the chosen mode is that of our command and more than one command occurs, else it is
    assumed. A file without one entry for each sample, or that chose by another command, is refused.
    """
    entries, rows = unwrap_entries(content), samples.by_time
    require_count(path, len(entries), len(rows), samples)
    plans: list[Floats] = []
    commands: set[int] = set()
    for at, (row, entry) in enumerate(zip(rows.tolist(), entries)):
        held = read_key(path, entry, "img_bbox", f"entry {at}")
        stored = read_key(path, held, "final_planning", f"entry {at}")
        plan = read_numbers(path, stored, f"the plan of entry {at}", (PLAN_STEPS, 2), (LONG_PLAN_STEPS, 2))
        if plans and len(plan) != len(plans[0]):
            refuse(path, "shape", f"entry {at} has {len(plan)} waypoints, others {len(plans[0])}", "make it again")
        if _reveals_command(path, at, row, plan, held, samples):
            commands.add(int(samples.commands[row]))
        plans.append(plan)
    order: SampleOrder = "consistent" if len(commands) > 1 else "assumed"
    shown_by = (
        "the number of samples fits, and each plan is the best one of our command"
        if order == "consistent"
        else "the number of samples fits, and nothing in the file could contradict"
    )
    return FilePlans(FileFrame.LIDAR, rows, np.array(plans), order, shown_by)


def _reveals_command(path: Path, at: int, row: int, plan: Floats, held: Any, samples: RecordedSamples) -> bool:
    """Whether the entry's modes reveal the command it used; refuses an entry that used another than ours."""
    if held.get("planning") is None or held.get("planning_score") is None:
        return False
    modes = read_numbers(path, held["planning"], f"the modes of entry {at}", (COMMANDS, None, len(plan), 2))
    scores = read_numbers(path, held["planning_score"], f"the scores of entry {at}", (COMMANDS, modes.shape[1]))
    best = modes[np.arange(COMMANDS), scores.argmax(axis=1)]
    fits = np.abs(best - plan).max(axis=(1, 2)) <= SAME_M
    if not fits.any() and (np.abs(best * MIRRORED - plan).max(axis=(1, 2)) <= SAME_M).any():
        fault = f"the plan of entry {at} is one of its modes with left and right exchanged"
        refuse(path, "frame", fault, "the list was dumped after its metric had changed it; dump it before that")
    if not any(fits[command] and samples.may_have_command(row, command) for command in range(COMMANDS)):
        refuse(
            path,
            "order",
            f"the plan of entry {at} is not the best one of the command of sample {samples.tokens[row]}, whose place "
            "that would be",
            "plans of another split or shifted ones cannot be scored; make the file again",
        )
    return not bool(fits.all())


FORMAT: Final = ResultFormat(
    "sparsedrive", "SparseDrive, DiffusionDrive, MomAD, BridgeAD", "sparsedrive", read, by_place=True
)
