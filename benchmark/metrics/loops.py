"""Open loop beside closed loop: the same planner on the same scenes, judged by both, from records alone.

Open loop fails a scene where any plan touches a recorded future (`records.rows.find_scene_failures`, ``exact``);
closed loop fails it where the driven ego touched an object in any run. A scene enters only where both can say.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from benchmark.closed_loop.scoring import VERSION
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.metrics.scores import require_current
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord
from benchmark.records.fault import FaultVerdict
from benchmark.records.planner_versions import describe_version
from benchmark.records.rows import find_scene_failures
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import find_source

OPEN_LOOP: Final = "exact"
"""Protocol of the open-loop evaluation."""
FEWEST_RANKED: Final = 3
"""Below this many planners a rank correlation is always 1 or -1."""


@dataclass(frozen=True, slots=True)
class SceneLoopComparison:
    """Open and closed loop of one planner on one scene made from the recording ``source``; shares are of drives.

    ``open_fails`` if any sample collides in open loop; ``at_fault`` is ``None`` where a contact does not say whose it
    is; ``first`` is the drive with a contact that has the lowest run.
    """

    scene: str
    source: str
    open_fails: bool
    contact: float
    at_fault: float | None
    first: EpisodeRow | None

    @property
    def closed_fails(self) -> bool:
        """Whether there was a contact in any drive."""
        return self.contact > 0.0

    @property
    def disagrees(self) -> bool:
        """Whether the scene is failed in one loop and not in the other."""
        return self.open_fails != self.closed_fails


@dataclass(frozen=True, slots=True)
class PlannerLoopComparison:
    """One planner in both loops.

    ``without`` are scenes that both have and of which one cannot say. ``open_rate`` is the share of scenes failed in
    open loop, ``contact`` and ``at_fault`` that of drives, the mean over scenes.
    """

    drives: DriveRecord
    run: RunRecord
    scenes: tuple[SceneLoopComparison, ...]
    without: tuple[str, ...]
    open_rate: Rate
    contact: Rate
    at_fault: Rate


@dataclass(frozen=True, slots=True)
class RankCorrelation:
    """Rank correlation of planners in open and closed loop: Kendall's tau-b over the scenes that all of them have.

    ``None`` of too few planners, or where one loop cannot tell any two of them apart.
    """

    tau: float | None
    planners: int
    scenes: int


def is_stale(record: DriveRecord) -> bool:
    """Whether drives were scored by another version of the scores than the present one."""
    return record.facts.scoring != VERSION


def find_run(drives: DriveRecord, runs: Sequence[RunRecord]) -> RunRecord | None:
    """The run record of what drove, with most of the driven scenes: same planner version, data and verdicts on scenes.

    ``None`` where none has any scene, or was judged by the present ``exact``.
    """
    same_planner_runs = [run for run in runs if _same_planner(drives, run) and _is_judged(run)]
    driven = set(drives.facts.scenes)
    shared = [(len(driven & set(run.run.scenes)), run.content_id, run) for run in same_planner_runs]
    best = max((candidate for candidate in shared if candidate[0]), key=lambda each: each[:2], default=None)
    return None if best is None else best[2]


def compare_loops(drives: DriveRecord, run: RunRecord) -> PlannerLoopComparison:
    """Both loops of one planner.

    A failed drive or sample that could have shown a contact leaves its scene out, unless another of its drives or
    samples has one; so do labels that are missing.
    """
    verdicts = find_scene_failures(run.rows, OPEN_LOOP)
    rows: dict[str, list[EpisodeRow]] = {}
    for row in drives.rows:
        rows.setdefault(row.scene, []).append(row)
    scenes, without = [], []
    for scene in sorted(verdicts.keys() & rows.keys()):
        scene_loops = _compare_scene(scene, drives, verdicts[scene], rows[scene])
        if scene_loops is None:
            without.append(scene)
        else:
            scenes.append(scene_loops)
    rates = _compute_rates(scenes, drives.facts.seed)
    return PlannerLoopComparison(drives, run, tuple(scenes), tuple(without), *rates)


def compute_rank_correlation(found: Sequence[PlannerLoopComparison], *, at_fault: bool = False) -> RankCorrelation:
    """Whether closed loop ranks planners of one world as open loop does; miniatures are not ranked.

    Kendall's tau-b between shares of failed scenes and of drives with a contact (``at_fault``: of the ego's fault
    only; none where a record does not say it), over the scenes that all ranked planners have.
    """
    ranked = [item for item in found if not item.drives.facts.planner.miniature and item.scenes]
    common = set.intersection(*({item.scene for item in one.scenes} for one in ranked)) if ranked else set()
    if len(ranked) < FEWEST_RANKED or not common:
        return RankCorrelation(None, len(ranked), len(common))
    if at_fault and any(scene.at_fault is None for one in ranked for scene in one.scenes):
        return RankCorrelation(None, len(ranked), len(common))
    shares = np.array([_compute_shares(one.scenes, common, at_fault=at_fault) for one in ranked], np.float64)
    return RankCorrelation(kendall_tau(shares[:, 0], shares[:, 1]), len(ranked), len(common))


def kendall_tau(first: Floats, second: Floats) -> float | None:
    """Kendall's tau-b (Kendall 1945): pairs in the same order less pairs in opposite order, ties taken out.

    -1 to 1, or ``None`` where all of one side are equal.
    """
    pairs = list(combinations(range(len(first)), 2))
    one = np.array([np.sign(first[a] - first[b]) for a, b in pairs])
    other = np.array([np.sign(second[a] - second[b]) for a, b in pairs])
    untied_product = np.count_nonzero(one) * np.count_nonzero(other)
    return float((one * other).sum() / np.sqrt(untied_product)) if untied_product else None


def _same_planner(drives: DriveRecord, run: RunRecord) -> bool:
    facts, ran = drives.facts, run.run
    if (facts.planner.name, facts.data.name, facts.split) != (ran.planner.name, ran.data.name, ran.split):
        return False
    review = None if facts.review is None else facts.review.content
    same_version = describe_version(facts.planner) == describe_version(ran.planner)
    return same_version and (facts.data.fingerprint, review) == run.judged_content


def _is_judged(run: RunRecord) -> bool:
    try:
        require_current(run, OPEN_LOOP)
    except InputError:
        return False
    return True


def _compare_scene(
    scene: str, drives: DriveRecord, open_fails: bool | None, rows: Sequence[EpisodeRow]
) -> SceneLoopComparison | None:
    driven = [row for row in rows if row.status == "ok" and not row.unlabelled]
    hits = [row for row in driven if row.first_contact is not None]
    if open_fails is None or not driven or (len(driven) < len(rows) and not hits):
        return None
    facts = drives.facts.scene_facts
    at_fault_count = sum(row.fault is FaultVerdict.EGO for row in hits)
    return SceneLoopComparison(
        scene=scene,
        source=find_source(scene, facts),
        open_fails=open_fails,
        contact=len(hits) / len(driven),
        at_fault=at_fault_count / len(driven) if all(row.says_fault for row in hits) else None,
        first=min(hits, key=lambda row: row.run, default=None),
    )


def _compute_rates(scenes: Sequence[SceneLoopComparison], seed: int) -> list[Rate]:
    values = np.array(
        [[scene_loops.open_fails, scene_loops.contact, scene_loops.at_fault] for scene_loops in scenes], np.float64
    ).reshape(-1, 3)
    # Of a column in which something is not known nothing counts.
    known = np.broadcast_to(~np.isnan(values).any(axis=0), values.shape)
    return compute_ratios_over_scenes(
        np.where(known, values, 0.0),
        known.astype(np.float64),
        [scene_loops.source for scene_loops in scenes],
        seed=seed,
    )


def _compute_shares(scenes: Sequence[SceneLoopComparison], common: set[str], *, at_fault: bool) -> tuple[float, float]:
    common_scenes = [scene_loops for scene_loops in scenes if scene_loops.scene in common]
    closed = [scene_loops.at_fault if at_fault else scene_loops.contact for scene_loops in common_scenes]
    return (
        float(np.mean([scene_loops.open_fails for scene_loops in common_scenes])),
        float(np.mean(np.array(closed, np.float64))),
    )
