"""`challenger-bench verify fault`: verdicts and reasons of ``fault@1`` against a set of cases written down beforehand.

Each case is also asked with the users exchanged, turned and moved, and mirrored with the other handedness.
"""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.fault.cases import compare_cases
from benchmark.verification.golden_sets import GoldenSet

BUILT_IN: Final = Path(__file__).parent / "golden" / "fault"
"""The golden set in the package, in the same form as any other."""
GOLDEN: Final = GoldenSet(name="fault", files=("manifest.json",), compare=(compare_cases,), built_in=BUILT_IN)
