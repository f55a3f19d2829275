"""The pictures of docs/fault.md, one a rule, from the golden cases of the package: ``python docs/making/fault.py``."""

from pathlib import Path
from typing import Any, Final

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmark.extensions.golden_sets.fault import BUILT_IN
from benchmark.extensions.golden_sets.fault.cases import FaultCase, read_cases
from benchmark.fairness.fault_timing import ContactGeometry
from benchmark.report.contact_pictures import draw_contact
from benchmark.verification.golden_sets import GoldenFolder

IMAGES: Final = Path(__file__).resolve().parents[1] / "images"
SHOWN: Final = (
    "hits-a-barrier", "stands-in-junction", "reversing-into-ego", "person-on-crossing", "child-runs-out",
    "leaves-the-road", "rear-end-by-other", "into-the-roundabout", "left-turn-across-oncoming", "merge-from-ramp",
    "from-the-stem", "pull-out-from-car-park", "u-turn-in-the-way", "over-the-centre-line", "cut-in-too-late",
    "lane-change-into-neighbour", "passes-a-bicycle-too-near", "line-0.2-over",
)  # fmt: skip
HALF_M: Final = (16.0, 11.0)


def main() -> None:
    """Draw all of them."""
    cases = {case.name: case for case in read_cases(GoldenFolder(BUILT_IN))}
    for name in SHOWN:
        figure, axes = plt.subplots(figsize=(2.9, 2.0))
        draw_case(axes, cases[name])
        figure.savefig(IMAGES / f"fault-{name}.png", dpi=100)
        plt.close(figure)


def draw_case(axes: Any, case: FaultCase) -> None:
    """The ego drives to the right; ways in pale, boxes at the contact in full, those at entry dashed with the time."""
    draw_contact(axes, ContactGeometry(case.tracks), case.roads(), HALF_M)
    axes.set_position([0.0, 0.0, 1.0, 1.0])


if __name__ == "__main__":
    main()
