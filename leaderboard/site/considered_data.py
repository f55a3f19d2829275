"""What an adversary considered, in the script of a drive (``considered``): planning frames, in force until the next.

Each has ``t`` (seconds from the first frame), ``did`` (`benchmark.records.considered`), ``paths`` (x, y in turn of each
candidate, decimetres as steps, worst first), ``shares`` (of each, hundredths: 0 for the best score, 100 for the worst
or infinite ones) and ``chosen`` (x, y in turn of the one that was driven; null where none was).
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from benchmark.records.considered import ConsideredFrame
from benchmark.records.scenes import Sheet
from benchmark.report.overlays import candidates_by_score
from leaderboard.site.packing import DECIMETRE, packed_path

_NOWHERE: Final = np.empty((0, 1, 2))


def considered_data(sheet: Sheet, frames: Sequence[ConsideredFrame]) -> list[dict[str, Any]]:
    """What the player draws, as above; the drive is of the sheet's scene."""
    found = []
    for each in frames:
        points = np.array(each.candidates, np.float64) - np.array(sheet.origin_m) if each.candidates else _NOWHERE
        shown = candidates_by_score(points, each.scores, each.chosen)
        found.append(
            {
                "t": round((each.time_us - sheet.timestamps_us[0]) * 1e-6, 3),
                "did": each.did,
                "paths": [packed_path(path, DECIMETRE) for path in shown.paths],
                "shares": [round(100 * share) for share in shown.shares.tolist()],
                "chosen": None if shown.chosen is None else packed_path(shown.chosen, DECIMETRE),
            }
        )
    return found
