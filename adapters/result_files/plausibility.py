"""Whether plans of result files can be what their format says (`benchmark.untrusted`)."""

from pathlib import Path

import numpy as np

from adapters.result_files.contract import Rows, refuse
from adapters.result_files.samples import RecordedSamples
from benchmark.constants import FARTHEST_WAYPOINT_M, PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.untrusted.plan_plausibility import Plausibility, plausibility_of
from benchmark.untrusted.plan_verdicts import refusal_of
from benchmark.untrusted.plans_beside_recording import ComparedPlans
from benchmark.untrusted.refusals import RefusedFile

_TOO_FAR = "such plans are not judged: check which script wrote the file"


def require_plausible(
    path: Path, plans: Floats, rows: Rows, samples: RecordedSamples, *, as_is: bool = False
) -> Plausibility:
    """Refuse plans that fit far better in another unit, frame or origin; give what was measured.

    `plans` are (N, K, 2) positions of the lidar, x right, y forward, as the format says, `rows` (N,) their samples.
    `as_is` takes plans as they stand, whatever would fit better; not what no plan can be. The refusal has the category
    of the first test that fails, and what would fit.
    """
    complete = samples.complete[rows]
    found = plausibility_of(ComparedPlans(plans[complete, :PLAN_STEPS], samples.future[rows][complete]))
    if found.misreading is not None and not as_is:
        raise RefusedFile(found.misreading.category, refusal_of(path, found.misreading))
    far = np.abs(plans).max(axis=(1, 2), initial=0.0)
    if far.max(initial=0.0) > FARTHEST_WAYPOINT_M:
        token = samples.tokens[int(rows[far.argmax()])]
        what = f"the plan of sample {token} reaches {far.max():.3g} m, which is a mistake of units or frame"
        refuse(path, "unit", what, _TOO_FAR)
    return found
