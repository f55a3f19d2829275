"""UniAD: a dictionary of results by sample, each with its token; x may be mirrored, which is measured."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.result_files.contract import (
    FileFrame,
    FilePlans,
    ResultFormat,
    Rows,
    find_rows,
    read_key,
    read_numbers,
    refuse,
    refuse_duplicates,
)
from adapters.result_files.samples import RecordedSamples
from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats

SAME_M: Final = 0.05
"""Recorded futures that are of one sample differ by less."""
MIRRORED: Final = np.array([-1.0, 1.0])


def unwrap_entries(content: Any) -> Any:
    """The list of a file that may be wrapped in a dictionary."""
    return content["bbox_results"] if isinstance(content, dict) else content


def read(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of UniAD, mirrored back where the recorded futures in the file are mirrored.

    A sample that is unknown or occurs twice, and recorded futures of other samples, are refused.
    """
    entries = unwrap_entries(content)
    rows = find_rows(path, [read_key(path, entry, "token", f"entry {at}") for at, entry in enumerate(entries)], samples)
    refuse_duplicates(path, rows, samples)
    plans, recorded = [], []
    for entry in entries:
        where = f"of sample {entry['token']}"
        stored = read_key(path, entry, "planning_traj", f"the entry {where}")
        plans.append(read_numbers(path, stored, f"the plan {where}", (1, PLAN_STEPS, 2))[0])
        stored = read_key(path, entry, "planning_traj_gt", f"the entry {where}")
        stored = stored[0] if isinstance(stored, list | tuple) and len(stored) == 1 else stored
        recorded.append(read_numbers(path, stored, f"the recorded future {where}", (1, 1, PLAN_STEPS, 3))[0, 0, :, :2])
    waypoints = np.array(plans)
    mirrored, error_m = _measure_mirroring(path, rows, np.array(recorded), samples)
    return FilePlans(
        frame=FileFrame.LIDAR,
        rows=rows,
        waypoints=waypoints * MIRRORED if mirrored else waypoints,
        order="tokens",
        shown_by=f"each sample by its token, recorded futures in the file within {error_m:.2g} m of ours",
        mirrored=mirrored,
    )


def _measure_mirroring(path: Path, rows: Rows, recorded: Floats, samples: RecordedSamples) -> tuple[bool, float]:
    """Whether x is mirrored, by the recorded futures that the file holds, and how well they agree."""
    valid = samples.valid[rows]
    if not valid.any():
        advice = "judge a file with at least one sample that is not the last of its scene"
        refuse(path, "order", "none of its samples has a recorded future, so the sign of x cannot be measured", advice)
    ours = samples.future[rows][..., 0]
    as_read, turned = (np.where(valid, np.abs(sign * recorded[..., 0] - ours), 0.0).max(axis=1) for sign in (1.0, -1.0))
    best = as_read if as_read.max() <= turned.max() else turned
    if best.max() > SAME_M:
        worst = int(best.argmax())
        refuse(
            path,
            "order",
            f"the recorded future of sample {samples.tokens[int(rows[worst])]} in the file is {best[worst]:.2f} m from "
            "that of the data",
            "name the data that the planner ran on, or make the file again",
        )
    return bool(turned.max() < as_read.max()), float(best.max())


FORMAT: Final = ResultFormat("uniad", "UniAD 1.0 and 2.0", "uniad", read)
