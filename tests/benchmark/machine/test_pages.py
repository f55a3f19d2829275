"""A process that keeps its pages does not have the kernel clear them again and again."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
FAULTS = """
import resource, sys
import numpy as np
from benchmark.machine.metering import disable_malloc_trim
if sys.argv[1] == "keep" and not disable_malloc_trim():
    sys.exit(3)
np.ones(2**23)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    np.ones(2**23)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how: str) -> int:
    # Huge pages, which some kernels give unasked, would hide what small ones cost.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMPY_MADVISE_HUGEPAGE": "0"}
    done = subprocess.run(
        [sys.executable, "-c", FAULTS, how], cwd=ROOT, env=environment, text=True, capture_output=True, check=False
    )
    if done.returncode == 3:
        pytest.skip("this C library has no such switch")
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


def test_kept_pages_are_not_cleared_again() -> None:
    assert faults("keep") * 10 < faults("give back")
