"""How far apart keyframes are: protocols count steps of half a second, whatever the data say."""

from collections import defaultdict
from itertools import pairwise
from statistics import median
from typing import Final

from benchmark.constants import KEYFRAME_HZ
from benchmark.datasets.integrity.tables import CheckedTables
from benchmark.datasets.schema import FaultList

_INTERVAL_US: Final = 1_000_000 // KEYFRAME_HZ
_TOLERANCE_US: Final = _INTERVAL_US // 10
"""Of a scene's median; single intervals of nuScenes run from 0.4 to 0.6 s."""


def check_rates(tables: CheckedTables, faults: FaultList) -> None:
    """Note scenes whose median keyframe interval is not that of nuScenes.

    Args:
        tables: Checked tables, the samples of all scenes among them.
        faults: Gets the faults.
    """
    times_us: defaultdict[str, list[int]] = defaultdict(list)
    for row in tables.having("sample", "scene_token", "timestamp"):
        times_us[row["scene_token"]].append(row["timestamp"])
    for scene in tables.having("scene", "name"):
        intervals_us = [then - now for now, then in pairwise(sorted(times_us[scene["token"]]))]
        if not intervals_us:
            continue
        usual_us = median(intervals_us)
        if abs(usual_us - _INTERVAL_US) > _TOLERANCE_US:
            sentence = (
                f"the keyframes of {scene['name']} are {usual_us * 1e-6:.3g} s apart (median), and whatever judges it "
                f"counts steps of {_INTERVAL_US * 1e-6:g} s"
            )
            faults.add("scenes with another keyframe rate", "scene", scene["token"], sentence)
