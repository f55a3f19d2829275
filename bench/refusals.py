"""How long a wrong argument takes to be refused, and a dry run to be said, where nothing has been built.

Run as ``python bench/refusals.py``. The commands are those of ``tests/benchmark/cli/refusals.py``, one after the other
in one process; of each group the first is run again as a process of its own, as a user meets it. ``--alone`` runs them
all so.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.benchmark.cli.refusals import all_refusals

AIM_S = 2.0
"""A refusal as a user meets it, the start of Python included."""


def alone(arguments: str, folder: Path) -> float:
    """Seconds of a command in a process of its own."""
    places = {name: str(folder / name) for name in ("new", "file", "empty")} | {"csv": str(folder / "plans.csv")}
    command = [sys.executable, "-m", "benchmark", *arguments.format(**places).split()]
    environment = {**os.environ, "CHALLENGER_BENCH_CACHE": str(folder / "cache")}
    began = time.perf_counter()
    subprocess.run(command, capture_output=True, check=False, env=environment)
    return time.perf_counter() - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--alone", action="store_true", help="run each command as a process of its own too")
    given = parser.parse_args()
    slowest, groups = 0.0, set()
    print(f"{'':<76}{'in one process':>16}{'alone':>10}")
    with tempfile.TemporaryDirectory() as folder:
        for arguments, refusal in all_refusals(Path(folder)).items():
            group = arguments.split()[0]
            seconds = alone(arguments, Path(folder)) if given.alone or group not in groups else None
            groups.add(group)
            slowest = max(slowest, seconds or 0.0)
            shown = "" if seconds is None else f"{seconds:8.2f} s"
            print(f"{arguments[:74]:<76}{refusal.seconds:14.2f} s{shown}")
    print(f"slowest alone {slowest:.2f} s (aim: below {AIM_S:.0f} s)")


if __name__ == "__main__":
    main()
