"""`challenger-bench verify import-123d`: logs, maps and the root made of them, against what py123d itself reads."""

from typing import Final

from benchmark.verification.golden_sets import GoldenSet
from generation.extensions.logs123d.verification.logs import compare_logs
from generation.extensions.logs123d.verification.maps import compare_maps
from generation.extensions.logs123d.verification.roots import compare_roots, compare_source

GOLDEN: Final = GoldenSet(
    name="import-123d",
    files=("expected.json", "logs"),
    compare=(compare_logs, compare_maps, compare_roots, compare_source),
    quantities={
        # Rounded to six decimals; sums by their size.
        "*: rotation": 1e-8,
        "*: view": 1e-4,
        "*: mean colour": 4.0,
        "*: drivable area, relative": 1e-6,
        "*": 2e-6,
    },
    holds="123D logs with an expected.json",
)
