"""The set behind `verify results` without ``--golden``: files of every format, written here from made-up plans."""

import tempfile
from pathlib import Path

import numpy as np

from adapters.result_files.contract import FileFrame
from adapters.result_files.frames import lidar_waypoints
from adapters.result_files.importing import import_results
from adapters.result_files.made_up import PRECISION_M, SINGLE_M, made_up_plans, made_up_samples
from adapters.result_files.recognition import recognise
from adapters.result_files.writing.dumped import DumpedPlans
from adapters.result_files.writing.formats import WRITERS
from benchmark.constants import PLAN_STEPS
from benchmark.verification.checks import Comparison


def compare_made_here(comparison: Comparison) -> None:
    """Write the made-up plans in every format and read them back."""
    samples = made_up_samples()
    dumped = DumpedPlans(samples, tuple(dict.fromkeys(samples.scenes)), made_up_plans(samples), PLAN_STEPS)
    with tempfile.TemporaryDirectory() as folder:
        for name, write in WRITERS.items():
            imported, at = import_results([recognise(write(Path(folder) / name, dumped))], samples), comparison.at(name)
            found = imported.found
            wanted = np.array([dumped.waypoints(row, FileFrame.LIDAR) for row in found.rows.tolist()])
            at.verdicts("formats", imported.format.name != name)
            at.verdicts("samples", len(found.rows) != len(dumped.plans))
            at.numbers(f"{name} (m)", lidar_waypoints(found, samples), wanted, PRECISION_M.get(name, SINGLE_M))
