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
from benchmark.verification.checks import Check, Comparison


def verify_made_here() -> list[Check]:
    """Write the made-up plans in every format and read them back.

    Returns:
        One check for each format: the largest difference of a waypoint, and whether its format and samples were found.
    """
    samples, comparison = made_up_samples(), Comparison()
    dumped = DumpedPlans(samples, tuple(dict.fromkeys(samples.scenes)), made_up_plans(samples), PLAN_STEPS)
    with tempfile.TemporaryDirectory() as folder:
        for name, write in WRITERS.items():
            imported = import_results([recognise(write(Path(folder) / name, dumped))], samples)
            found = imported.found
            wanted = np.array([dumped.waypoints(row, FileFrame.LIDAR) for row in found.rows.tolist()])
            comparison.verdicts("formats", np.array([imported.format.name != name]), where=name)
            comparison.verdicts("samples", np.array([len(found.rows) != len(dumped.plans)]), where=name)
            allowed = PRECISION_M.get(name, SINGLE_M)
            comparison.numbers(f"{name} (m)", lidar_waypoints(found, samples), wanted, allowed, where=name)
    return comparison.checks()
