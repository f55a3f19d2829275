"""Dictionaries from tokens to arrays: Agent-Driver, GPT-Driver (6 x 2), AD-MLP (1 x 6 x 3), SparseWorld (1 x 6 x 2)."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.result_files.contract import FileFrame, FilePlans, ResultFormat, find_rows, read_numbers
from adapters.result_files.samples import RecordedSamples
from benchmark.constants import PLAN_STEPS


def read_positions(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of ``pred_trajs_dict.pkl`` and its like."""
    rows = find_rows(path, list(content), samples)
    plans = [
        read_numbers(path, plan, f"the plan of sample {token}", (PLAN_STEPS, 2)) for token, plan in content.items()
    ]
    return FilePlans(FileFrame.LIDAR, rows, np.array(plans), "tokens", "each sample by its token")


def read_batches(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of AD-MLP's ``output_data.pkl``: 1 x 6 x 3 numbers, the third of which, a heading, is not needed.

    SparseWorld's files are the same without it: 1 x 6 x 2.
    """
    rows = find_rows(path, list(content), samples)
    plans = [
        read_numbers(path, plan, f"the plan of sample {token}", (1, PLAN_STEPS, 3), (1, PLAN_STEPS, 2))[0, :, :2]
        for token, plan in content.items()
    ]
    return FilePlans(FileFrame.LIDAR, rows, np.array(plans), "tokens", "each sample by its token")


POSITIONS: Final = ResultFormat("pred-trajs", "Agent-Driver, GPT-Driver", "agent-driver", read_positions)
BATCHES: Final = ResultFormat("admlp", "AD-MLP, SparseWorld", "stp3", read_batches)
