"""`challenger-bench verify protocols`: every protocol against verdicts of the official code and of exact polygons."""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.protocols.aggregates import SceneOutcomes, compare_rate_file, compare_rates
from benchmark.extensions.golden_sets.protocols.golden_set import list_golden_inputs, list_remarks, read_golden_scene
from benchmark.extensions.golden_sets.protocols.official import compare_further, compare_official, judge_further
from benchmark.extensions.golden_sets.protocols.polygons import compare_polygons
from benchmark.protocols import PROTOCOLS, STANDARD
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet

BUILT_IN: Final = Path(__file__).parent / "golden" / "protocols"
"""The golden set in the package, in the same form as any other."""


def _compare_scenes(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare each sample, plan and step, and the rates over all of them.

    A set may mix two forms: with verdicts of the protocols that every run is judged by, or with roads and the past and
    those of further ones. Scenes may lack exact verdicts (``NAME_exact.npz``), as notes say, but not only inputs or
    only official verdicts.
    """
    paths = list_golden_inputs(folder)
    judged, further = list[SceneOutcomes](), list[SceneOutcomes]()
    for path in paths:
        scene = read_golden_scene(path)
        at = comparison.at(scene.name)
        if scene.with_roads:
            outcomes = judge_further(scene)
            compare_further(at, scene, outcomes)
            further.append((scene, outcomes))
            continue
        plans = [scene.plans[:, plan] for plan in range(len(scene.plan_names))]
        outcomes = {
            name: [PROTOCOLS[name].evaluate(scene.truths, plan_points) for plan_points in plans] for name in STANDARD
        }
        compare_official(at, scene, outcomes)
        if scene.exact is not None:
            compare_polygons(at, scene, scene.exact, outcomes["exact"])
        judged.append((scene, outcomes))
    compare_rates(comparison, judged)
    compare_rate_file(comparison, folder, further)
    for text in list_remarks(folder, paths, {scene.name for scene, _ in further}):
        comparison.note(comparison.checks()[0].quantity, text)
    for check in comparison.checks():
        if check.quantity.endswith("(m)") and check.quantity.split()[0] in STANDARD:
            comparison.note(check.quantity, "the golden numbers are single precision")


GOLDEN: Final = GoldenSet(
    name="protocols",
    files=("*_official.npz",),
    compare=(_compare_scenes,),
    quantities={
        # The file has four decimals of per cent and metres, and some single precision.
        "* rates: *": 6e-5,
        "* rates, means: *": 6e-5,
        # As certain as the single precision of its terms lets a mean be.
        "* rates, *: l2 (m)": 1e-6,
        "* rates, *": 1e-9,
        "exact heading (rad)": 1e-6,
        "uniad L2 (m)": 1e-5,
        "vad L2 at 1, 2, 3 s (m)": 1e-5,
        "sparsedrive L2 (m)": 1e-5,
        "diffusiondrive L2 (m)": 1e-5,
        "omnidrive* L2 at 1, 2, 3 s (m)": 1e-9,
        # Waypoints in single precision: of plans, and by way of global coordinates.
        "omnidrive plan of the rear axle (m)": 2e-7,
        "omnidrive recorded path (m)": 2e-4,
        "bev-planner recorded path (m)": 1e-5,
        # Shares of steps, and displacements or means of them, where the official code adds in single precision.
        "bev-planner boundary_col at 1, 2, 3 s": 1e-7,
        "*": 2e-5,
    },
    built_in=BUILT_IN,
)
