"""What a checkout of this project writes: run records, drives and a frozen split of hand-made roads.

    cd CHECKOUT && PYTHONPATH=$PWD python PATH/TO/tests/promise/make_formats.py OUT

runs in a checkout of the version whose formats are kept, which may be older than this file; README.md in
``kept/formats`` says which ones were. What a checkout does not know yet is left out.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmark.evaluation import evaluate
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import Failing, Straight
from tests.hand_made import Car, scene_on_straight_road

WINDOWS = "window-adversarial", "window-unchanged"
MACHINE = {"hardware": {"cpu": "a processor"}, "packages": {"numpy": "1.26.4"}, "source": {"commit": None}}


def short_road() -> FakeData:
    """Five seconds behind a slow car, which an ego that keeps its speed runs into, beside a faster one."""
    cars = Car(75.0, 198.25, 2.0), Car(60.0, 194.75, 10.0)
    return FakeData({"scene-9902": scene_on_straight_road(cars, seconds=5.0, name="scene-9902")}, name="short")


def make_run(out: Path) -> Any:
    """A run of a planner that raises on the second sample and drives on straight at all others."""
    return evaluate(short_road(), "val", Failing(1), out)


def make_drives(out: Path) -> Any:
    """A drive straight into the slow car."""
    from benchmark.closed_loop.default_engine import DefaultBackend
    from benchmark.runs.driving import DriveSettings, drive_split

    return drive_split(short_road(), "val", Straight(), out, DriveSettings("default", DefaultBackend()))


def make_drives_of_windows(out: Path) -> Any:
    """Drives of a car that cuts in, in its window, and of the unchanged recording in the same one."""
    from tests.benchmark.runs.test_encounters import both

    unchanged, adversarial = both(out)
    return adversarial, unchanged


def keep(directory: Path, head: str, kind: str, out: Path) -> None:
    """Copy the three files of a record, without what they tell of the machine."""
    stored = json.loads((directory / head).read_text())
    stored["environment"] = MACHINE
    target = out / f"{kind}-{stored['schema']}"
    target.mkdir(parents=True)
    (target / head).write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n")
    for name in stored["files"]:
        shutil.copy(directory / name, target / name)


def main(out: Path) -> None:
    """Write into a folder whatever this checkout knows."""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder)
        keep(make_run(made / "runs").directory, "run.json", "run", out)
        try:
            keep(make_drives(made / "drives").directory, "drive.json", "drives", out)
        except ImportError:
            print("this checkout does not drive yet")
        try:
            for record, kind in zip(make_drives_of_windows(made / "windows"), WINDOWS, strict=True):
                keep(record.directory, "drive.json", kind, out)
        except ImportError:
            print("this checkout has no windows yet")
        try:
            from tests.generation.splits.frozen_files import frozen_file, recordings
        except ImportError:
            print("this checkout does not freeze yet")
            return
        split = frozen_file(recordings(made / "recorded"), made)
        shutil.copy(made / "road-adv-1.json", out / f"frozen-{split.frozen.schema_version}.json")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
