"""What driving planners without images side by side brings, and whether a dry run is right about how long it takes.

Run ``python bench/driving_together.py [scenes]``: the five planners that every table has through scenes of the embedded
data, one planner after the other and all side by side; processor seconds of one core, records written and read back.
The records must be the same bytes. Then what `drive --dry-run` says of each planner beside what it takes.
"""

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark import api
from benchmark.cli.drive import BASELINES, TOGETHER
from benchmark.machine.workers import single_threaded
from benchmark.records.drives import ROWS_FILE
from benchmark.runs.drive_estimate import estimate
from benchmark.runs.driving import drive_planners, drive_split


def main(scenes: int) -> None:
    """Measure both policies of agents."""
    single_threaded()
    data = api.open_data("mini")
    # What is imported or read for the first time is nobody's.
    with tempfile.TemporaryDirectory() as folder:
        warm = [api.load_planner(name) for name in BASELINES]
        drive_planners(data, "val", warm, Path(folder), api.drive_settings("val", limit=1))
    for agents in ("replay", "idm"):
        settings = api.drive_settings("val", agents=agents, limit=scenes)
        planners = [api.load_planner(name) for name in BASELINES]
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)
            started = time.process_time()
            alone = [drive_split(data, "val", each, root / "alone", settings) for each in planners]
            middle = time.process_time()
            beside = drive_planners(data, "val", planners, root / "beside", replace(settings, together=TOGETHER))
            ended = time.process_time()
            rows = [[(record.directory / ROWS_FILE).read_bytes() for record in records] for records in (alone, beside)]
        if rows[0] != rows[1]:
            raise SystemExit("side by side, planners drive otherwise than alone")
        drives = sum(len(record.rows) for record in alone)
        print(
            f"{agents} agents, {drives} drives: one planner after another {(middle - started) / drives:.3f} s a drive, "
            f"side by side {(ended - middle) / drives:.3f} s: {(middle - started) / (ended - middle):.2f} times as fast"
        )
    for name in BASELINES:
        settings, planner = api.drive_settings("val", limit=scenes), api.load_planner(name)
        with tempfile.TemporaryDirectory() as folder:
            said = estimate(data, "val", planner, settings, Path(folder)).rpartition("about ")[2]
            started = time.perf_counter()
            drive_split(data, "val", planner, Path(folder), settings)
            print(f"{name}: at most about {said}; took {time.perf_counter() - started:.1f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
