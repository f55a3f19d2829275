"""How far apart keyframes are: official protocols take them for steps of half a second, whatever the data say."""

from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise

from benchmark.datasets.schema import FaultList
from benchmark.datasets.schema.table_checks import CheckedTables, Row
from benchmark.datasets.steps import LONGEST_KNOWN_US, STEP_US, is_step, other_interval_us


def check_rates(tables: CheckedTables, faults: FaultList) -> None:
    """Warn of scenes whose median keyframe interval is not that of nuScenes; samples of all scenes are needed."""
    for scene, times_us in _times_of_scenes(tables):
        usual_us = other_interval_us(times_us)
        if usual_us is None:
            continue
        what = (
            "nothing is known at steps" if usual_us > LONGEST_KNOWN_US else "exact and driving scores interpolate steps"
        )
        sentence = (
            f"the keyframes of {scene['name']} are {usual_us * 1e-6:.3g} s apart (median): {what} of "
            f"{STEP_US * 1e-6:g} s, and official protocols, whose steps are keyframes, do not count its samples"
        )
        faults.add("scenes with another keyframe rate", "scene", scene["token"], sentence, severity="warning")


def check_gaps(tables: CheckedTables, faults: FaultList) -> None:
    """Warn of keyframes that are nearer to each other or farther apart than steps, in scenes at 2 Hz.

    In scenes at another rate only gaps are named across which nothing is known.
    """
    for scene, times_us in _times_of_scenes(tables):
        usual_us = other_interval_us(times_us)
        if usual_us is not None and usual_us > LONGEST_KNOWN_US:
            continue
        for number, (now, then) in enumerate(pairwise(times_us)):
            gap_us = then - now
            if gap_us <= LONGEST_KNOWN_US if usual_us is not None else is_step(gap_us):
                continue
            effect = (
                "what lies in it or beyond is unknown to exact and driving scores"
                if gap_us > LONGEST_KNOWN_US
                else f"exact and driving scores interpolate steps of {STEP_US * 1e-6:g} s there"
            )
            sentence = (
                f"keyframes {number} and {number + 1} of {scene['name']} are {gap_us * 1e-6:.3g} s apart: {effect}, "
                "and official protocols take the k-th following keyframe for step k"
            )
            faults.add("gaps between keyframes", "scene", scene["token"], sentence, severity="warning")


def _times_of_scenes(tables: CheckedTables) -> Iterator[tuple[Row, list[int]]]:
    """Scenes with the times of their samples, increasing."""
    times_us: defaultdict[str, list[int]] = defaultdict(list)
    for row in tables.having("sample", "scene_token", "timestamp"):
        times_us[row["scene_token"]].append(row["timestamp"])
    for scene in tables.having("scene", "name"):
        yield scene, sorted(times_us[scene["token"]])
