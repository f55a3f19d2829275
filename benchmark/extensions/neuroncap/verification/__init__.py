"""`challenger-bench verify neuroncap`: car, contacts, commands, scenarios, aggregates, runs against published code."""

from pathlib import Path
from typing import Final

from benchmark.extensions.neuroncap.verification.driving import compare_aggregates, compare_driving
from benchmark.extensions.neuroncap.verification.loops import compare_loops
from benchmark.extensions.neuroncap.verification.staged_scenarios import (
    compare_commands,
    compare_contacts,
    compare_scenarios,
)
from benchmark.verification.golden_sets import GoldenSet

BUILT_IN: Final = Path(__file__).parent / "golden" / "neuroncap"
"""The golden set in the package, in the same form as any other."""
_CODE: Final = 5e-6
"""Of what the published code computes partly in single precision."""
GOLDEN: Final = GoldenSet(
    name="neuroncap",
    files=("vehicle.npz", "contact.npz", "command.npz", "scenarios.json", "aggregate.json", "loops/index.json"),
    compare=(
        compare_driving,
        compare_contacts,
        compare_commands,
        compare_scenarios,
        compare_aggregates,
        compare_loops,
    ),
    quantities={
        "car as code: *": _CODE,
        "car in double precision: *": 1e-9,
        "contact: IoU": 1e-6,
        "contact: *": 1e-9,
        "scenarios: *": 1e-9,
        "loops: recorded *": 1e-9,
        "loops: * of the scenario's actors*": 1e-9,
        "loops: sizes (m)": 1e-9,
        "loops: IoU": 1e-6,
        "loops: score*": 1e-6,
        "loops: reference speed*": 1e-6,
        "loops: *": _CODE,
    },
    built_in=BUILT_IN,
)
