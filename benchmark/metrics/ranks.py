"""Ranks of planners with intervals, and letters for those that are not told apart (docs/metrics.md).

Recordings are resampled with all that was made from them; each has the same weight, with any number of variants. The
scenes are those that all ranked planners have. A sample or drive on which a planner failed is its worst outcome: a
planner does not rise by failing.
"""

import string
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats
from benchmark.metrics.effect import AT_3_S, collect_sample_contacts
from benchmark.metrics.rates import INTERVAL, SceneSums, resample_totals, sum_by_scene
from benchmark.records.drives import DriveRecord, compute_column_values
from benchmark.records.fault import FaultVerdict
from benchmark.records.run import RunRecord

SEPARATED: Final = 0.975
"""Two planners are told apart where one is better with a probability above this."""
SceneTotals = Mapping[str, tuple[float, float]]
"""By scene a sum over its samples or drives, and what it is divided by for their mean."""
SCORE: Final = "nuplan_score"
"""Column of drives that is ranked."""


@dataclass(frozen=True, slots=True)
class PlannerRank:
    """A planner among others on the scenes that all of them have.

    ``value`` is the mean and ``low`` to ``high`` its 95 % interval; the rank is between ``best`` and ``worst`` with the
    same probability. Planners share one of the ``letters`` when no pair among those that have it is told apart.
    """

    value: float
    low: float
    high: float
    best: int
    worst: int
    letters: str


def sum_faults_by_scene(record: RunRecord) -> dict[str, tuple[float, float]] | None:
    """Samples of each scene whose plan touches the adversary first at the planner's fault, up to 3 s, or that failed.

    Beside them how many samples count. The record must say whom contacts are with (`compute_effect`); ``None`` where it
    does not say whose fault they are.
    """
    contacts, columns = collect_sample_contacts(record), record.columns
    if contacts.unknown_fault[contacts.counted].any():
        return None
    at_fault = contacts.faults[FaultVerdict.EGO]
    totals: dict[str, tuple[float, float]] = {}
    counted = np.flatnonzero(contacts.counted).tolist()
    found = [(columns.planned_scenes[row], float(at_fault[row, AT_3_S])) for row in counted]
    names = columns.values("scene")
    found += [(names[place], 1.0) for place in np.flatnonzero(columns.failed & columns.flags("complete")).tolist()]
    for scene, value in found:
        above, below = totals.get(scene, (0.0, 0.0))
        totals[scene] = above + value, below + 1.0
    return totals


def average_drives_by_scene(record: DriveRecord, column: str = SCORE) -> dict[str, tuple[float, float]]:
    """Mean of a column (`compute_column_values`; higher is better) over the drives of each scene, divided by 1.

    A failed drive is a 0.
    """
    values: dict[str, list[float]] = {}
    for row in record.rows:
        value = 0.0 if row.status == "failed" else compute_column_values(row).get(column)
        if value is not None:
            values.setdefault(row.scene, []).append(value)
    return {scene: (sum(own) / len(own), 1.0) for scene, own in values.items()}


def find_shared_scenes(totals: Sequence[SceneTotals]) -> list[str]:
    """Scenes that all planners have, by name."""
    return sorted(set.intersection(*(set(own) for own in totals))) if totals else []


def rank_planners(
    totals: Sequence[SceneTotals], source_of: Mapping[str, str], *, lower_is_better: bool, seed: int = 0
) -> list[PlannerRank] | None:
    """Rank P planners on the scenes that all of them have; ``None`` of fewer than two recordings.

    Args:
        totals: Of each planner.
        source_of: Recording of each scene.
        lower_is_better: Whether the lowest mean has rank 1.
        seed: Of the resamples.
    """
    scenes = find_shared_scenes(totals)
    variants = Counter(source_of[scene] for scene in scenes)
    if len(variants) < 2:
        return None
    above, below = (
        np.array([[own[scene][part] / variants[source_of[scene]] for own in totals] for scene in scenes])
        for part in (0, 1)
    )
    sums = sum_by_scene(above, below, [source_of[scene] for scene in scenes])
    values, draws = _compute_means(sums, seed)
    better = -draws if lower_is_better else draws
    ahead = (better[:, None, :] > better[:, :, None]).sum(axis=2)
    behind = (better[:, None, :] < better[:, :, None]).sum(axis=2)
    ends = np.percentile(draws, INTERVAL, axis=0)
    # Equals share the places that they take together.
    best = np.percentile(ahead + 1, INTERVAL[0], axis=0, method="inverted_cdf")
    worst = np.percentile(len(totals) - behind, INTERVAL[1], axis=0, method="inverted_cdf")
    wins = (better[:, :, None] > better[:, None, :]).mean(axis=0)
    order = np.argsort(-values if not lower_is_better else values, kind="stable")
    letters = assign_letters(wins > SEPARATED, order.tolist())
    numbers = zip(values, *ends, best, worst)
    return [
        PlannerRank(float(value), float(low), float(high), int(first), int(last), own)
        for (value, low, high, first, last), own in zip(numbers, letters, strict=True)
    ]


def _compute_means(sums: SceneSums, seed: int) -> tuple[Floats, Floats]:
    """(P,) means, and (2000, P) means of resamples."""
    above, below = (resample_totals(part, sums.names, seed=seed) for part in (sums.numerators, sums.denominators))
    return sums.numerators.sum(axis=0) / sums.denominators.sum(axis=0), above / below


def assign_letters(better: Bools, order: Sequence[int]) -> list[str]:
    """Letters of P planners, of which ``better`` (P, P) says who is told apart as better than whom.

    Sets without a separated pair, and none within another (Piepho 2004); ``a`` has the first of ``order``.
    """
    groups = [frozenset(order)]
    for first, second in combinations(order, 2):
        if not (better[first, second] or better[second, first]):
            continue
        parts = [
            part
            for group in groups
            for part in ((group - {first}, group - {second}) if {first, second} <= group else (group,))
        ]
        groups = [one for one in dict.fromkeys(parts) if one and not any(one < other for other in parts)]
    place = {planner: number for number, planner in enumerate(order)}
    groups.sort(key=lambda group: sorted(place[planner] for planner in group))
    return [
        "".join(_letter(number) for number, group in enumerate(groups) if planner in group)
        for planner in range(len(order))
    ]


def _letter(number: int) -> str:
    more, letter = divmod(number, len(string.ascii_lowercase))
    return string.ascii_lowercase[letter] + (str(more) if more else "")
